"""The page of a diagnosis, of torques and of positions: one screen with the answer, and below it
what it rests on, which folds."""

from collections.abc import Sequence
from functools import partial

from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.position.diagnosis import PositionDiagnosis
from torchid.report import gap, position
from torchid.report.cautions import caution_section
from torchid.report.exported import simulator_block
from torchid.report.over_time import NARROW, OverTime, motion_over_time, torque_over_time
from torchid.report.page.answer import answer_bars, first_steps
from torchid.report.page.document import Origin
from torchid.report.panels import Picture
from torchid.report.repeats import repeats_pictures
from torchid.report.skeleton import PHONE, skeleton_of
from torchid.report.table import Code, Page, Section, Table, filled
from torchid.results.answer import Answer, Diagnosis
from torchid.results.words import count, percent
from torchid.simulation.two_models import RESTART_S, Horizon

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
USUAL_S = 0.5
"""Of simulated motion, whose error stands beside the headline [s]."""


def page(result: Diagnosis, origin: Origin) -> Page:
    """The page of a diagnosis."""
    answer, band = result.answer, None
    if isinstance(result, TorqueDiagnosis):
        title, band = f"Sim-to-real gap of {result.robot.name}", result.band
        sections = _of_torques(result)
    else:
        assert isinstance(result, PositionDiagnosis)
        title = f"Command and position of {result.data.robot.name}"
        sections = _of_positions(result)
    return Page(
        title=title,
        verdict=answer.headline,
        facts=facts(result),
        origin=origin,
        answer=answer_bars(answer, band),
        picture=_arm_picture(result),
        advice=(
            ("What to do first", first_steps(answer)),
            ("Which model to use", [which_model(result)]),
            ("Suspects, not sure enough", _suspects(answer)),
        ),
        sections=sections,
    )


def facts(result: TorqueDiagnosis | PositionDiagnosis) -> list[tuple[str, str]]:
    """The few numbers beside the headline, the same of every kind of log."""
    answer = result.answer
    unit = answer.unit
    noise = " to ".join(dict.fromkeys(f"{x:.3g}" for x in answer.noise))
    out = [
        ("Verdict", STATUS[answer.status]),
        ("Error before", f"{answer.before:.3g} {unit}"),
        ("Error after", f"{answer.after:.3g} {unit}"),
        ("Removed", percent(answer.less)),
        ("Noise", f"{noise} {unit}"),
    ]
    if isinstance(result, PositionDiagnosis):
        return [*out, ("Command alone", f"{result.commanded.mean[0]:.3g} {unit}")]
    row = _usual_horizon(result)
    if row is not None and row.ratio is not None:
        out.append((f"Simulated motion, {row.horizon_s:g} s", f"{row.ratio:.2g} of its error"))
    return out


def _suspects(answer: Answer) -> list[str]:
    """Causes that are not sure enough; without causes, what would settle them is said already."""
    return [f"{answer.suspect_words(c)}: {c.remedy}." for c in answer.suspects if answer.causes]


def _usual_horizon(d: TorqueDiagnosis) -> Horizon | None:
    """The row of simulated motion after `USUAL_S`, or the one nearest to it."""
    rows = d.how_far.rollout.horizons if d.how_far.rollout else ()
    known = [row for row in rows if row.ratio is not None]
    return min(known, key=lambda row: abs(row.horizon_s - USUAL_S), default=None)


def which_model(result: TorqueDiagnosis | PositionDiagnosis) -> str:
    """One sentence: the model as given, or the corrected one, and how to write it."""
    answer = result.answer
    if not answer.causes or not answer.after < answer.before:
        enough = answer.status in ("no_gap", "negligible")
        return (
            "The model as given: these logs show no error that matters."
            if enough
            else "The model as given: no cause is sure enough to change it."
        )
    change = f"on new data it errs by {answer.after:.3g} in the place of {answer.before:.3g}"
    change += f" {answer.unit}"
    written = "`torchid gap .. --save-model corrected.yaml` writes it"
    if isinstance(result, PositionDiagnosis):
        return f"The corrected model, with its servos: {change}. {written}."
    row = _usual_horizon(result)
    if row is not None and row.ratio is not None:
        worse = row.ratio >= 1 or (row.ratio_ci95 is not None and row.ratio_ci95[1] >= 1)
        if worse:
            return (
                f"The corrected model for torques: {change}. Its simulated motion is no better "
                f"({row.ratio:.2g} of the error after {row.horizon_s:g} s): compare both before "
                f"you simulate. {written}."
            )
        change += (
            f", and simulated for {row.horizon_s:g} s its positions err {row.ratio:.2g} times as "
            "much"
        )
    return (
        f"The corrected model: {change}. {written}; `torchid correct ROBOT LOG.. --to mjcf` (or "
        "urdf) corrects your simulator's own file."
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


def _over_time(name: str, shown: OverTime | None, caption: str) -> list[Picture]:
    """A figure over time, for desk and phone, which zooms."""
    if shown is None or not shown.runs:
        return []
    first = f"{shown.quantity} of joint {shown.joints[shown.order[0]]}"
    return [
        Picture(
            name, caption, f"Over time: {first}, of the arm and of both models.", shown.draw,
            narrow=partial(shown.draw, None, NARROW), numbers=shown.numbers,
        )
    ]  # fmt: skip


def _torque_motion(d: TorqueDiagnosis) -> list[Picture]:
    fitted = d.how_far.rollout is not None and d.how_far.rollout.fitted_on_these_data
    return _over_time(
        "motion",
        motion_over_time(d),
        "Joint positions: the arm, and both models simulated with the measured torque, without a "
        f"controller, anew from the measured state every {RESTART_S:g} s; of each run the stretch "
        "in which it moves most. A line that ends early has lost the arm by more than 1 rad."
        + (" These runs were also used for fitting: the numbers are optimistic." if fitted else ""),
    )


def _of_torques(d: TorqueDiagnosis) -> list[Section]:
    """What the answer of torques rests on."""
    record = d.record
    rollout = record.how_far.rollout
    torque = _over_time(
        "torque",
        torque_over_time(d) if d.traces else None,
        "Torque of the arm and of both models, on data that was not fitted; below, what the model "
        "lacks. Grey stretches do not count: there the joint rests or reverses, and friction can "
        "be anything.",
    )
    return _sections(
        answer=d.answer,
        motion=_torque_motion(d),
        torque=torque,
        where=[*gap.where_pictures(record), gap.where_table(record)]
        if gap.stands_out(record)
        else [],
        against=gap.joint_pictures(d),
        causes=[gap.which_table(record), gap.small_table(record), gap.meaning_table(record)],
        repeats=repeats_pictures(record),
        numbers=[
            gap.how_far_table(record), gap.budget_table(record),
            gap.rollout_table(rollout) if rollout else None, *gap.known_pictures(record),
            gap.known_table(record), gap.open_table(record),
        ],
        block=simulator_block(d.corrected, d.nearest_fields) if record.which else "",
        notes=[*record.warnings, *record.noise_floor.notes, *gap.remarks(record)],
        unseen=[
            gap.not_testable_table(record),
            gap.experiment_table(d.next_experiment) if d.next_experiment else None,
        ],
    )  # fmt: skip


def _of_positions(d: PositionDiagnosis) -> list[Section]:
    """What the answer of positions rests on."""
    record = d.record
    motion = _over_time(
        "motion",
        motion_over_time(d),
        "Joint positions: the arm, and both models moved by the same commands, in motions that "
        "were left out of the fit. A plain servo has a gain, friction, inertia, delay and offset.",
    )
    return _sections(
        answer=d.answer,
        motion=motion,
        where=[
            position.where_picture(record), position.where_table(record),
            position.regime_table(record),
        ],
        causes=[position.which_table(record), position.meaning_table(record)],
        repeats=repeats_pictures(record),
        numbers=[
            position.motion_table(record), position.nominal_table(record, record.nominal or ())
        ],
        notes=[*record.warnings, *position.remarks(record)],
    )  # fmt: skip


def _sections(
    *,
    answer: Answer,
    motion: Sequence[Picture],
    where: Sequence[Picture | Table | None],
    causes: Sequence[Table | None],
    repeats: Sequence[Picture],
    numbers: Sequence[Picture | Table | None],
    notes: Sequence[str],
    torque: Sequence[Picture] = (),
    against: Sequence[Picture] = (),
    block: str = "",
    unseen: Sequence[Table | None] = (),
) -> list[Section]:
    """The sections of every diagnosis, in their order."""

    def whole(parts: Sequence[Picture | Table | None]) -> list[Picture | Table]:
        out: list[Picture | Table] = []
        for part in parts:
            kept = filled(part) if isinstance(part, Table) else [part]
            out += [p.on_page() if isinstance(p, Table) else p for p in kept if p is not None]
        return out

    code = (
        "The corrected joints, to copy into the simulator's file; torchid export writes the file."
    )
    return [
        Section("Motion: the arm and the simulation, before and after", motion, folded=False),
        Section("Torque, before and after", torque, folded=bool(motion)),
        Section("Where the error lies", whole(where)),
        Section("What the error depends on", against),
        Section(f"The causes in numbers ({count(len(answer.causes), 'cause')})", whole(causes)),
        Section("Is each cause the same in every motion?", repeats),
        Section("Errors in numbers", whole(numbers)),
        Section("For your simulator", [Code(block, code)] if block else []),
        caution_section(notes),
        Section("What this log could not show", whole(unseen)),
    ]
