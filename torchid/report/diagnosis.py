"""A diagnosis for people, the same for every kind of log: the answer, then the evidence for it; and
its page: one screen with the answer, and below it what it rests on, which folds."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from torchid.errors import TorchidError
from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.gap.record import GapRecord
from torchid.position.diagnosis import PositionDiagnosis
from torchid.position.record import PositionRecord
from torchid.report import gap, gap_figures, position
from torchid.report.brief import Screen, model_words
from torchid.report.causes import agreement_table, cause_table, meaning_table, not_testable_table
from torchid.report.cautions import caution_section
from torchid.report.friction import friction_picture, friction_table
from torchid.report.over_time import NARROW, OverTime, motion_over_time, torque_over_time
from torchid.report.page.answer import first_steps
from torchid.report.panels import Figures, Picture
from torchid.report.skeleton import PHONE, skeleton_of
from torchid.report.table import Code, Origin, Page, Section, Shown, Table
from torchid.results.agreement import agreement, disagreement
from torchid.results.answer import MOST_SIZES, Answer, Diagnosis, DiagnosisRecord, named_size
from torchid.results.words import percent, span, sure
from torchid.simulation.two_models import CONTROLLER, Horizon

STATUS = {
    "no_gap": "no gap",
    "negligible": "too small to matter",
    "parametric_only": "wrong parameters only",
    "explained": "explained",
    "partly_explained": "explained in part",
    "detected_unexplained": "not fully explained",
    "not_testable": "cannot tell",
}
"""What a status says, in the fewest words."""
Parts = Sequence[Picture | Table | None]
USUAL_S = 0.5
"""Of simulated motion, whose error stands beside the headline [s]."""


def suspects_table(answer: Answer) -> Table:
    """The likeliest causes that are not sure enough for a name."""
    rows = [
        (f"{c.name} {c.place}".strip(), ", ".join(map(named_size, c.sizes[:MOST_SIZES])),
         sure(c.how_sure), "" if math.isnan(c.closes) else percent(c.closes), c.remedy)
        for c in answer.suspects
    ]  # fmt: skip
    columns = ("suspect", "value ± std", "sure", "in the model", "what would settle it")
    title = (
        "suspects: the likeliest causes that are not sure enough; the share of the error that they "
        "take where the corrected model holds them, for the data need a term there"
    )
    return Table(title, columns, rows, "lrrrp")


def shown(result: Diagnosis | DiagnosisRecord, model: str = "") -> Shown:
    """All that there is to see of a diagnosis, or of one that was read back.

    Args:
        result: what was diagnosed.
        model: which model to use next, one sentence.

    Raises:
        TorchidError: the file of an older version, which holds no answer.
    """
    record = result.record
    assert isinstance(record, DiagnosisRecord)
    if record.answer is None:
        raise TorchidError(
            "this file of an older version holds no answer.", hint="diagnose its logs again"
        )
    figures: Figures
    if isinstance(record, GapRecord):
        assert isinstance(result, TorqueDiagnosis | GapRecord)
        band, lower, notes = record.band_hz, gap.tables(record), gap.remarks(record)
        figures = gap_figures.figures(result)
    else:
        assert isinstance(record, PositionRecord)
        assert isinstance(result, PositionDiagnosis | PositionRecord)
        band, lower, notes = None, position.tables(record), position.remarks(record)
        figures = position.figures(result)
    odd, runs = disagreement(record.agreement, most=1), agreement_table(record)
    warnings = (*([f"Caution: {odd}"] if odd else []), *record.warnings)
    return Shown(
        screen=Screen(answer=record.answer, band=band, warnings=warnings, model=model),
        verdict=record.answer.headline,
        parts=[suspects_table(record.answer), agreement(record.agreement), runs, *lower, *notes],
        warnings=warnings,
        last=model,
        figures=figures,
        page=partial(page, result, model=model) if isinstance(result, Diagnosis) else None,
    )


def page(result: Diagnosis, origin: Origin, model: str = "") -> Page:
    """The page of a diagnosis; `model` says which model to use next."""
    answer, band = result.answer, None
    if isinstance(result, TorqueDiagnosis):
        title, band = f"Sim-to-real gap of {result.robot.name}", result.band
    else:
        assert isinstance(result, PositionDiagnosis)
        title = f"Command and position of {result.data.robot.name}"
    return Page(
        title=title,
        verdict=answer.headline,
        facts=facts(result),
        origin=origin,
        answer=answer,
        band=band,
        picture=_arm_picture(result),
        advice=(
            ("What to do first", [step[:1].upper() + step[1:] for step in first_steps(answer)]),
            ("Which model to use", [which_model(result, model)]),
            # Without causes, what would settle the suspects is what to do first.
            (
                "Suspects, not sure enough",
                [f"{line.rstrip('.')}." for line in answer.suspect_lines if answer.causes],
            ),
        ),
        sections=_sections(result),
    )


def facts(result: TorqueDiagnosis | PositionDiagnosis) -> list[tuple[str, str]]:
    """The few numbers beside the headline, the same of every kind of log."""
    answer = result.answer
    unit = answer.unit
    out = [
        ("Verdict", STATUS[answer.status]),
        ("Error before", f"{answer.before:.3g} {unit}"),
        ("Error after", f"{answer.after:.3g} {unit}"),
        ("Removed", percent(answer.less)),
        ("Noise", f"{span(answer.noise)} {unit}"),
    ]
    if isinstance(result, PositionDiagnosis):
        return [*out, ("Command alone", f"{result.commanded.whole_mrad:.3g} {unit}")]
    row = _usual_horizon(result)
    if row is not None and row.ratio is not None:
        out.append((f"Simulated motion, {row.horizon_s:g} s", f"{row.ratio:.2g} of its error"))
    return out


def _usual_horizon(d: TorqueDiagnosis) -> Horizon | None:
    """The row of simulated motion after `USUAL_S`, or the one nearest to it."""
    rows = d.how_far.rollout.horizons if d.how_far.rollout else ()
    known = [row for row in rows if row.ratio is not None]
    return min(known, key=lambda row: abs(row.horizon_s - USUAL_S), default=None)


def which_model(result: TorqueDiagnosis | PositionDiagnosis, model: str = "") -> str:
    """The model as given, or the corrected one, as `model` says it where it does, and whether its
    simulated motion is better."""
    answer = result.answer
    said = model or model_words(answer, None, "the model as given", ())
    row = _usual_horizon(result) if isinstance(result, TorqueDiagnosis) else None
    if not answer.causes or row is None or row.ratio is None:
        return said
    said = f"{said.rstrip('.')}."
    if row.ratio >= 1 or (row.ratio_ci95 is not None and row.ratio_ci95[1] >= 1):
        return (
            f"{said} Its simulated motion is no better ({row.ratio:.2g} of the error after "
            f"{row.horizon_s:g} s): compare both before you simulate."
        )
    return (
        f"{said} Simulated for {row.horizon_s:g} s its positions err {row.ratio:.2g} times as "
        "much. `torchid correct ROBOT LOG.. --to mjcf` (or urdf) corrects your simulator's file."
    )


def _arm_picture(result: TorqueDiagnosis | PositionDiagnosis) -> Picture | None:
    """The robot with its errors and causes at its joints."""
    if isinstance(result, TorqueDiagnosis) and not result.traces:
        return None
    errors = ", ".join(
        f"joint {j.joint + 1} {j.before:.3g} to {j.after:.3g}"
        for j in result.answer.joints
        if j.before == j.before
    )
    return Picture(
        "robot",
        "The robot in a pose of this log. The whole disc of a joint is its error, the solid part "
        f"what remains with the causes [{result.answer.unit}].",
        f"The robot by its joints. Errors before and after: {errors}.",
        partial(skeleton_of, result),
        narrow=partial(skeleton_of, result, PHONE),
    )


def _over_time(name: str, shown: OverTime | None, caption: str) -> Picture | None:
    """A figure over time, for desk and phone, which zooms."""
    if shown is None or not shown.runs:
        return None
    first = f"{shown.quantity} of joint {shown.joints[shown.order[0]]}"
    alt = f"Over time: {first}, of the arm and of both models."
    narrow = partial(shown.draw, None, NARROW)
    return Picture(name, caption, alt, shown.draw, narrow=narrow, numbers=shown.numbers)


def _sections(d: TorqueDiagnosis | PositionDiagnosis) -> list[Section]:
    """What an answer rests on, in the same order for every kind of log."""
    record, block = d.record, ""
    torque: Picture | None = None
    against: Parts = ()
    laws: Parts = ()
    text = (
        "Joint positions: the arm, and both models moved by the same commands, in motions that "
        "were left out of the fit; before, the file's servos, or, where it has none, a plain servo "
        "refitted to this log: a gain, friction, inertia, delay and offset."
    )
    if isinstance(d, TorqueDiagnosis):
        assert isinstance(record, GapRecord)
        rollout = d.how_far.rollout
        text = (
            "Joint positions: the arm, and both models with the measured torque under one "
            f"controller ({CONTROLLER.natural_frequency:g} Hz), which holds them to the arm; of "
            "each run the stretch in which it moves most. What parts a model from the arm is what "
            "the controller has to make up for."
        )
        if rollout is not None and rollout.fitted_on_these_data:
            text += " These runs were also used for fitting: the numbers are optimistic."
        torque = _over_time(
            "torque",
            torque_over_time(d) if d.traces else None,
            "Torque of the arm and of both models, on data that was not fitted; below, what the "
            "model lacks. Grey stretches do not count: there the joint rests or reverses, and "
            "friction can be anything.",
        )
        against = gap.joint_pictures(d)
        laws = [friction_picture(d), friction_table(record)]
        where: Parts = [gap.where_picture(record)]
        numbers: Parts = [
            gap.joint_table(record), gap.rollout_table(record), gap.known_picture(record),
            gap.known_table(record), gap.open_table(record),
        ]  # fmt: skip
        notes = [*d.record.noise_floor.notes, *gap.remarks(record)]
        unseen: Parts = [not_testable_table(record), gap.experiment_table(record)]
        from torchid.report.exported import simulator_block

        block = simulator_block(d.corrected, d.nearest_fields) if record.which else ""
    else:
        assert isinstance(record, PositionRecord)
        where = [position.where_picture(record), position.where_table(record)]
        numbers = [
            position.motion_table(record), position.nominal_table(record, record.nominal or ())
        ]  # fmt: skip
        notes, unseen = position.remarks(record), [not_testable_table(record)]
    motion = _over_time("motion", motion_over_time(d), text)
    # First what an engineer looks at: the joint that errs most, over time and over all else.
    moved = Section("Motion: the arm and the simulation, before and after", [motion])
    first = [replace(moved, folded=False)]
    if torque is not None:
        first = [
            Section(
                "Torque of the joint that errs most, over time and over what it may depend on",
                [torque, *against[:1]],
                folded=False,
            ),
            moved,
        ]
    code = "The corrected joints, to copy into the simulator's file; torchid export writes it."
    said = agreement(record.agreement)
    return [
        *first,
        Section("Where the error lies", where),
        Section("What the error of other joints depends on", against[1:]),
        Section("Friction, one law a joint", laws),
        Section("The causes in numbers", [cause_table(record), meaning_table(record)]),
        Section("Whether the runs agree", [[said] if said else [], agreement_table(record)]),
        Section("Errors in numbers", numbers),
        Section("For your simulator", [Code(block, code)] if block else []),
        caution_section([*record.warnings, *notes]),
        Section("What this log could not show", unseen),
    ]
