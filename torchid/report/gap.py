"""A diagnosis of torques as tables and pictures for people; all of it from its record, but for
figures of torque over time."""

from functools import partial

from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.gap.record import GapRecord, Known
from torchid.report import gap_figures
from torchid.report.causes import Evidence
from torchid.report.friction import friction_table
from torchid.report.gap_figures import CLEAR, clear_regimes, excess_words, stands_out
from torchid.report.panels import Picture
from torchid.report.table import Table, table_of
from torchid.results.words import (
    digits,
    effect_words,
    interval,
    listed,
    percent,
    regime_words,
)
from torchid.robot.model import Robot, joint_unit, torque_unit


def evidence(record: GapRecord) -> Evidence:
    """What a diagnosis of torques rests on."""
    return Evidence(
        where=[where_picture(record)],
        friction=[friction_table(record)],
        numbers=[
            joint_table(record), known_picture(record), known_table(record), open_table(record),
        ],
        unseen=[experiment_table(record)],
        remarks=[*record.noise_floor.notes, *remarks(record)],
    )  # fmt: skip


def model_of(record: GapRecord) -> Robot:
    """The robot as given."""
    return record.model


def joint_table(record: GapRecord) -> Table:
    """Joints: what the model lacks as given and corrected, beside the noise, and the regimes that
    hold more than their share of it; in the note, what closes the gap."""
    unit, joints = torque_unit(model_of(record)), record.how_far.per_joint
    shares = {gap.joint: percent(gap.share) for gap in record.where.joints}
    return table_of(
        f"RMS of the torque the model lacks [{unit}], below {digits(record.band_hz)} Hz",
        joints,
        note=budget_words(record),
        beside={
            "share": [shares[one.joint] for one in joints],
            f"holds more than its share (excess [95 %], p < {CLEAR:g})": [
                _regimes(record, one.joint) for one in joints
            ],
        },
    )


def _regimes(record: GapRecord, joint: int) -> str:
    """What holds more than its share of a joint's gap."""
    # 3: regimes a joint at most
    return ", ".join(map(excess_words, clear_regimes(record, joint)[:3])) or "-"


def budget_words(record: GapRecord) -> str:
    """The share of the gap beyond noise that is closed, with its interval, and by what."""
    far, budget = record.how_far, record.budget
    if far.closed is None or far.closed_ci95 is None:
        quiet = {"no_gap": "the gap may be noise", "negligible": "too little to say"}
        return f"closed beyond noise: {quiet.get(record.status, 'none')}"
    return (
        f"closed beyond noise: {percent(far.closed)} {interval(far.closed_ci95)}; base parameters "
        f"{percent(budget.parametric)}, effects {percent(budget.structural)}, unexplained "
        f"{percent(budget.unexplained)}"
    )


def known_table(record: GapRecord) -> Table:
    """Coefficients of the model's effects before this log and after it."""
    known = record.knowledge or Known(sources=())
    moved = [
        "changed" if c.changed else "suspected" if c.name in known.moved else "as known"
        for c in known.coefficients
    ]
    title = f"known: what this log adds to {', '.join(known.sources)}"
    note = "changed: by more than the standard deviations leave open" * ("changed" in moved)
    return table_of(title, known.coefficients, "words before after", note, beside={"": moved})


def open_table(record: GapRecord) -> Table:
    """Joints on which the model left torque open that could hide a cause."""
    joints = [j for j in (record.knowledge.joints if record.knowledge else ()) if j.hides]
    sizes = [f"{digits(j.added_rms)} {joint_unit(model_of(record), j.joint)}" for j in joints]
    title = "torque that the previous model could not predict"
    return table_of(title, joints, beside={"open before this log, RMS": sizes})


def remarks(record: GapRecord) -> list[str]:
    """What to know about the tables, one sentence each."""
    source = "repeats of a motion" if record.noise_floor.source == "repeats" else "the residual"
    out = [
        f"Errors are of data that no model was fitted to, while each joint moves, below "
        f"{digits(record.band_hz)} Hz. The fit is below {digits(record.cutoff_hz)} Hz. The noise "
        f"is estimated from {source}.",
    ]
    if not stands_out(record):
        out.append("The error is spread evenly over all kinds of motion.")
    if record.knowledge is not None:
        out += [f"{note[0].upper()}{note[1:]}." for note in record.knowledge.notes]
    for one in record.which:
        place = f" {one.place}" if one.place else ""
        name = effect_words(one.effect)
        out += [f"{name[0].upper()}{name[1:]}{place}: {note}." for note in one.notes]
    return out


def experiment_table(record: GapRecord) -> Table:
    """What to record next."""
    experiment = record.next_experiment
    return table_of("next experiment", [] if experiment is None else [experiment])


def joint_pictures(d: TorqueDiagnosis) -> list[Picture]:
    """What the model lacks on the worst joints, against all that it may depend on."""
    out = []
    for k, joint in enumerate(gap_figures.worst_joints(d.record) if d.traces else ()):
        errors = d.record.how_far.per_joint[joint]
        unit = joint_unit(d.robot, joint)
        change = f"RMS {digits(errors.before)} {unit} before and {digits(errors.after)} after"
        out.append(
            Picture(
                f"joint_{joint + 1}",
                f"What the model lacks on joint {joint + 1}: {change}.{'' if k else _AGAINST}",
                f"Gap of joint {joint + 1} against velocity, position and torque: {change}.",
                partial(gap_figures.joint_figure, d, joint),
                narrow=partial(gap_figures.joint_figure, d, joint, narrow=True),
            )
        )
    return out


def where_picture(record: GapRecord) -> Picture | None:
    """The map of joints and kinds of motion, where it shows something."""
    if not stands_out(record):
        return None
    worst = gap_figures.worst_joints(record, 1)[0]
    clear = clear_regimes(record, worst)
    when = f"above all in the columns {listed(regime_words(r.regime) for r in clear)}"
    shares = {gap.joint: percent(gap.share) for gap in record.where.joints}
    each = ", ".join(f"joint {j + 1} {share}" for j, share in shares.items())
    return Picture(
        "where",
        "Rows are joints, columns kinds of motion: a blue cell holds more of the joint's error "
        "than its share of the time. Beside a joint stands its share of all of it. Joint "
        f"{worst + 1} holds {shares[worst]} of the error, "
        f"{when if clear else 'at no time more than at others'}.",
        f"Map of joints and kinds of motion. Shares of the error: {each}.",
        partial(gap_figures.map_figure, record),
    )


def known_picture(record: GapRecord) -> Picture | None:
    """What a log makes of what was known, where something was."""
    if record.knowledge is None or not record.knowledge.coefficients:
        return None
    return Picture(
        "known",
        "What this log makes of what was known. Intervals hold 95 %; those before the log hold the "
        "change from one session to the next. A diamond marks a coefficient that has changed.",
        "Known coefficients before this log and with it.",
        partial(gap_figures.known_figure, record),
    )


_AGAINST = (
    " Points are samples, lines their means with 95 % intervals. An orange line that leaves the "
    "grey band of noise follows a quantity that the cause depends on; where the blue one stays in "
    "the band, nothing systematic is left."
)
