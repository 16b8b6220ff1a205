"""A diagnosis for people, the same for every kind of log: the answer, then the evidence for it; and
its page: one screen with the answer, and below it what it rests on, which folds."""

from collections.abc import Callable, Sequence
from functools import partial

from torchid.errors import TorchidError
from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.gap.record import GapRecord
from torchid.position.diagnosis import PositionDiagnosis
from torchid.position.record import PositionRecord
from torchid.report import gap, gap_figures, position
from torchid.report.brief import Screen, model_words
from torchid.report.causes import (
    Evidence,
    agreement_table,
    cause_table,
    meaning_table,
    not_testable_table,
)
from torchid.report.cautions import caution_section
from torchid.report.friction import friction_figure, friction_picture
from torchid.report.over_time import NARROW, OverTime, motion_over_time, torque_over_time
from torchid.report.page.answer import first_steps
from torchid.report.panels import Figure, Figures, Picture
from torchid.report.table import Code, Origin, Page, Report, Section, Table, table_of
from torchid.results.agreement import agreement, disagreement
from torchid.results.answer import Answer, Diagnosis, DiagnosisRecord
from torchid.results.words import count, digits, percent, span

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


def suspects_table(answer: Answer) -> Table:
    """The likeliest causes that are not sure enough for a name."""
    title = (
        "suspects: the likeliest causes that are not sure enough, and what would settle them; the "
        "share of the error that they take where the corrected model holds them, for the data need "
        "a term there"
    )
    return table_of(title, answer.suspects, "name at numbers how_sure share remedy")


def report_of_diagnosis(result: Diagnosis | DiagnosisRecord, model: str = "") -> Report:
    """All that there is to see of a diagnosis, or of one that was read back.

    Args:
        result: what was diagnosed.
        model: which model to use next, one sentence.

    Raises:
        TorchidError: the file of an older version, which holds no answer.
    """
    record = result.record
    assert isinstance(record, GapRecord | PositionRecord)
    if record.answer is None:
        raise TorchidError(
            "this file of an older version holds no answer.", hint="diagnose its logs again"
        )
    rests_on, odd = evidence(record), disagreement(record.agreement, most=1)
    warnings = (*([f"Caution: {odd}"] if odd else []), *record.warnings)
    live = result if isinstance(result, TorqueDiagnosis | PositionDiagnosis) else None
    parts = [part for section in _sections(record, live) for part in section.parts]
    tables = (part for part in parts if isinstance(part, Table))
    return Report(
        screen=Screen(
            answer=record.answer, band=getattr(record, "band_hz", None), warnings=warnings,
            model=model, robot=_called(result),
        ),
        verdict=record.answer.headline,
        parts=[
            suspects_table(record.answer), agreement(record.agreement), *tables, *rests_on.remarks
        ],
        warnings=warnings,
        last=model,
        figures={part.name: part.draw for part in parts if isinstance(part, Picture)},
        page=None if live is None else partial(page, live, model=model),
    )  # fmt: skip


def evidence(record: GapRecord | PositionRecord) -> Evidence:
    """What a diagnosis rests on beside what all have."""
    return gap.evidence(record) if isinstance(record, GapRecord) else position.evidence(record)


def page(result: Diagnosis, origin: Origin, model: str = "") -> Page:
    """The page of a diagnosis; `model` says which model to use next."""
    answer, band = result.answer, None
    steps = first_steps(answer, _called(result))
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
        advice=(
            ("What to do first", [step[:1].upper() + step[1:] for step in steps]),
            ("Which model to use", [model or model_words(answer, None, "the model as given")]),
            # Without causes, what would settle the suspects is what to do first.
            (
                "Suspects, not sure enough",
                [f"{line.rstrip('.')}." for line in answer.suspect_lines if answer.causes],
            ),
        ),
        sections=_sections(result.record, result),
    )


def _called(result: Diagnosis | DiagnosisRecord) -> str:
    """What a command line calls the robot of a diagnosis: its file, where that is known."""
    source = result.data.robot.source if isinstance(result, PositionDiagnosis) else ""
    return source or "ROBOT"


def facts(result: TorqueDiagnosis | PositionDiagnosis) -> list[tuple[str, str]]:
    """The few numbers beside the headline, the same of every kind of log."""
    answer = result.answer
    unit = answer.unit
    out = [
        ("Verdict", STATUS[answer.status]),
        ("Error before", answer.before.size),
        ("Error after", answer.after.size),
        ("Less by", percent(answer.less)),
        ("Judged", answer.after.whole),
        ("Noise", f"{span(answer.noise)} {unit}"),
    ]
    if isinstance(result, PositionDiagnosis):
        alone = f"{digits(result.commanded.whole_mrad)} {unit}"
        return [*out, ("Command alone", alone)]
    return out


def _signals(name: str, signals: OverTime, caption: str) -> Picture | None:
    """A figure over time, for desk and phone."""
    if not signals.runs:
        return None
    first = f"{signals.quantity} of joint {signals.joints[signals.order[0]]}"
    models = " and of both models" if signals.models else ""
    alt = f"Over time: {first}, of the arm{models}."
    narrow = partial(signals.draw, None, NARROW)
    return Picture(name, caption, alt, signals.draw, narrow=narrow)


def _sections(
    record: GapRecord | PositionRecord, live: TorqueDiagnosis | PositionDiagnosis | None = None
) -> list[Section]:
    """What an answer rests on, in the same order for every kind of log; what needs signals over
    time where they are there."""
    rests_on, runs = evidence(record), agreement(record.agreement)
    assert record.answer is not None
    torque = live if isinstance(live, TorqueDiagnosis) else None
    against = [] if torque is None else gap.joint_pictures(torque)
    laws = [] if torque is None else [friction_picture(torque)]
    return [
        *([] if live is None else _over_time(live, against[:1])),
        Section("Where the error lies", rests_on.where),
        Section("What the error of other joints depends on", against[1:]),
        Section("Friction, one law a joint", [*laws, *rests_on.friction]),
        Section(
            f"The causes in numbers ({count(len(record.answer.causes), 'cause')})",
            [cause_table(record), meaning_table(record)],
        ),
        Section("Whether the runs agree", [[runs] if runs else [], agreement_table(record)]),
        Section("Errors in numbers", rests_on.numbers),
        Section("For your simulator", [] if torque is None else _simulator_code(torque)),
        caution_section([*record.warnings, *rests_on.remarks]),
        Section("What this log could not show", [not_testable_table(record), *rests_on.unseen]),
    ]


def _over_time(d: TorqueDiagnosis | PositionDiagnosis, against: Sequence[Picture]) -> list[Section]:
    """What an engineer looks at first: the joint that errs most, over time and `against` all else;
    and the motion of the arm, of commands beside the simulation's."""
    text = (
        "Joint positions: the arm, and both models moved by the same commands, in motions that "
        "were left out of the fit; before, the file's servos, or, where it has none, a plain servo "
        "refitted to this log: a gain, friction, inertia, and a usual offset and delay."
    )
    torque = None
    if isinstance(d, TorqueDiagnosis):
        text = "Joint positions of the arm, as measured: along them both models have their torque."
        torque = _signals(
            "torque",
            torque_over_time(d),
            "Torque of the arm and of both models, on data that was not fitted; below, what the "
            "model lacks. Grey stretches do not count: there the joint rests or reverses, and "
            "friction can be anything.",
        )
    motion = _signals("motion", motion_over_time(d), text)
    if torque is None:
        title = "Motion: the arm and the simulation, before and after"
        return [Section(title, [motion], folded=False)]
    worst = "Torque of the joint that errs most, over time and over what it may depend on"
    moved = Section("Motion of the arm", [motion])
    return [Section(worst, [torque, *against], folded=False), moved]


def _simulator_code(d: TorqueDiagnosis) -> list[Code]:
    """The corrected joints for a simulator's file, where something was found."""
    if not d.record.which:
        return []
    from torchid.report.exported import simulator_block

    note = "The corrected joints, to copy into the simulator's file; torchid export writes it."
    return [Code(simulator_block(d.corrected, d.nearest_fields), note)]


def kinds(result: Diagnosis | DiagnosisRecord) -> Figures:
    """What can be drawn, by kind; those of one joint take it as `joint`. Of a record those that
    need no signals over time."""
    record, drawn = result.record, dict[str, Callable[..., Figure | None]]()
    if isinstance(record, GapRecord):
        drawn["where"] = partial(gap_figures.map_figure, record)
        if record.knowledge is not None and record.knowledge.coefficients:
            drawn["known"] = partial(gap_figures.known_figure, record)
    else:
        assert isinstance(record, PositionRecord)
        drawn["where"] = partial(position.where_figure, record)
    if isinstance(result, TorqueDiagnosis) and result.traces:
        drawn["torque"] = torque_over_time(result).draw
        drawn["gap"] = partial(gap_figures.joint_figure, result)
        if result.friction:
            drawn["friction"] = partial(friction_figure, result)
    if isinstance(result, PositionDiagnosis) or "torque" in drawn:
        assert isinstance(result, TorqueDiagnosis | PositionDiagnosis)
        drawn["motion"] = motion_over_time(result).draw
    return drawn
