"""A diagnosis of commands and positions as tables and pictures for people; all of it from its
record, but for figures of motions over time."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import torch
from msgspec import UNSET

from torchid.effects.servo import INDEX, PARAMETERS, PER_KP, TORQUES, as_share
from torchid.errors import TorchidError
from torchid.position.next_motion import NextCommands
from torchid.position.nominal import unit_of
from torchid.position.record import JointRecord, PositionRecord
from torchid.position.replay import Replay
from torchid.report.causes import Evidence
from torchid.report.colours import AFTER, GREY, INK
from torchid.report.panels import (
    Figure,
    Picture,
    joint_lines,
    map_with_words,
    thin,
)
from torchid.report.table import Report, Table, cells, joint_table, table_of
from torchid.results.words import regime_words, unit_behind, within

WORST = 3
"""Joints that get a figure of their own."""


def label(record: PositionRecord, joint: int) -> str:
    """A joint by number and name."""
    return f"{joint + 1} {record.where.joints[joint].name}".rstrip()


def before(record: PositionRecord, joint: JointRecord) -> float:
    """Error of a joint's servo in the robot's file, or of a plain one where it has none [mrad]."""
    return joint.plain_mrad if record.how_far.file is UNSET else joint.file_mrad


def unit_of_errors(record: PositionRecord) -> str:
    """Unit of the joints' position errors; files without an answer are older than joints that
    slide."""
    return "mrad" if record.answer is None else record.answer.unit


def before_words(record: PositionRecord) -> str:
    """Whose error the one before is, in words."""
    return "a plain servo" if record.how_far.file is UNSET else "the file's servo"


def remarks(record: PositionRecord) -> list[str]:
    """What to know about the answer, one sentence each."""
    far, unit = record.how_far, unit_of_errors(record)
    file = "the file has no servos"
    if far.file is not UNSET:
        file = f"the file's servos as they are {far.file.whole_mrad:.1f}"
    out = [
        f"Errors are of whole motions that no model was fitted to, the mean of the joints that "
        f"move: the command alone {far.commanded.whole_mrad:.1f} {unit}, {file}, a plain servo "
        f"refitted to this log {far.plain.whole_mrad:.1f}, corrected "
        f"{far.answered.whole_mrad:.1f}; in windows of 2 s {far.answered.windows_2s_mrad:.1f}. A "
        "plain servo has a gain, friction, inertia, and a usual offset and delay."
    ]
    noises = [j.noise_mrad for j in record.where.joints if not math.isnan(j.noise_mrad[0])]
    if noises:
        low, high = min(a for a, _ in noises), max(b for _, b in noises)
        out.append(
            f"Repeats of motions tell the noise of {len(noises)} joints, {low:.1f} to "
            f"{high:.1f} {unit}."
        )
    if record.held_out is not UNSET:
        held = record.held_out
        out.append(
            f"Held-out logs: {held.whole_mrad:.1f} {unit}, in windows of 2 s "
            f"{held.windows_2s_mrad:.1f} {unit}."
        )
    worse = _worse(record)
    # Places where an answer is worse than a plain servo that are named
    most_worse = 3
    if worse:
        more = " and elsewhere" if len(worse) > most_worse else ""
        where = "; ".join(worse[:most_worse])
        out.append(f"It is worse than {before_words(record)} on {where}{more}.")
    return out


def _worse(record: PositionRecord) -> list[str]:
    """Joints, or regimes of them, whose error is larger by more than could be seen."""
    joints, unit = record.where.joints, unit_of_errors(record)
    worse = [j for j in joints if j.answered_mrad - before(record, j) > j.unseen_mrad]
    change = "joint {}, {:.1f} -> {:.1f} {}".format
    out = [change(j.joint + 1, before(record, j), j.answered_mrad, unit) for j in worse]
    named = {j.joint for j in worse} | {j.joint for j in joints if j.never_moves}
    return out + [
        f"joint {r.joint + 1} ({regime_words(r.regime)}), {r.before_mrad:.1f} -> "
        f"{r.answered_mrad:.1f} {unit}"
        for r in record.where.regimes
        if r.joint not in named and r.answered_mrad - r.before_mrad > joints[r.joint].unseen_mrad
    ]


def evidence(record: PositionRecord) -> Evidence:
    """What a diagnosis of commands and positions rests on."""
    return Evidence(
        where=[where_picture(record), where_table(record)],
        numbers=[motion_table(record), nominal_table(record), change_table(record)],
        remarks=remarks(record),
    )


def where_table(record: PositionRecord) -> Table:
    """Joints: errors of the command alone, of the file's servo if it has one, of a plain servo and
    of the answer, and the gain."""
    far = record.how_far
    file = "" if far.file is UNSET else "file_mrad "
    note = (
        "kp [N m/rad]; ratio: no load anchors the joint's torques, which are known as shares of kp "
        "alone"
    )
    table = table_of(
        f"Position error of motions left out [{unit_of_errors(record)}]",
        record.where.joints,
        f"joint name commanded_mrad {file}plain_mrad answered_mrad gain",
        note,
        beside={
            "plain, 2 s": cells(far.plain.windows, ".1f"),
            "corrected, 2 s": cells(far.answered.windows, ".1f"),
        },
    )
    return replace(table, align="rp")  # numbers beyond the name


def nominal_table(record: PositionRecord) -> Table:
    """What servos are said to be, beside what was found of the same numbers."""
    rows = []
    for servo in () if record.nominal is UNSET else record.nominal:
        j, joint = servo.joint, record.where.joints[servo.joint]
        place = (str(j + 1), servo.servo)
        findings = [f for f in record.which if f.joints == (j,)]
        sizes = {
            name: (f.parameters[name], f.ci95[name]) for f in findings for name in f.parameters
        }
        if not joint.never_moves and not joint.ratio_only:
            sizes["kp"] = (joint.kp, joint.kp_ci95)
        for name in dict.fromkeys([*servo.values, *servo.register_units]):
            stated = servo.values.get(name)
            unasked = not {name, as_share(name)} & sizes.keys() and stated is None
            if unasked or name == "damping_share":  # of what the clip limits, which none seeks
                continue
            text = "never moves" if joint.never_moves else "not needed"
            if joint.ratio_only and name in TORQUES and not joint.never_moves:
                text = "as a share of kp alone"
                if as_share(name) in sizes:
                    unit = unit_behind(PER_KP[PARAMETERS[INDEX[name]].unit])
                    text = f"{as_share(name)} {_size(*sizes[as_share(name)], unit)}"
            elif name in sizes:
                value, ends = sizes[name]
                text = _size(value, ends, unit_of(name))
                if name in servo.register_units:
                    steps = value / servo.register_units[name]
                    text += f" = {steps:.0f} steps of the register"
            of_maker = "unknown" if stated is None else f"{stated:.3g} {unit_of(name)}".rstrip()
            rows.append((*place, name, of_maker, text))
        if math.isfinite(servo.counts) and float(record.log_scale[j]) == 1:
            step = f"{2e3 * math.pi / servo.counts:.3g} mrad"
            rows.append((*place, "resolution", step, f"{joint.resolution_mrad:.3g} mrad"))
    note = (
        "nominal: makers' tables for a new servo at its supply's voltage, or the earlier fit or "
        "the actuators in the robot's file; servos of one name are taken for units of one type"
    )
    title = "Servos: nominal values, and what was found (95 %)"
    return Table(title, ("joint", "servo", "value", "nominal", "found"), rows, "rllpp", note)


def change_table(record: PositionRecord) -> Table:
    """The servos beside those of the robot's file: what is new, changed, open and as known."""
    note = "open: this log does not say it; /kp: as a share of the gain, where no load anchors it"
    changes = () if record.changes is UNSET else record.changes
    return table_of("Servos of the robot's file, and what was found", changes, note=note)


def motion_table(record: PositionRecord) -> Table:
    """Errors of the answered model in every motion, when it was left out."""
    moves = torch.tensor([not j.never_moves for j in record.where.joints])
    rows = []
    for one in record.how_far.per_motion:
        errors = one.answered_mrad
        rows.append((one.motion, [*errors.tolist(), float(errors[moves].mean())]))
    title = f"Error of each motion, left out, per joint [{unit_of_errors(record)}]"
    return joint_table(title, rows, ".1f", last=("mean",))


def where_picture(record: PositionRecord) -> Picture:
    """The map of joints and of what the command does."""
    worst, unit = (worst_joints(record, 1) or [0])[0], unit_of_errors(record)
    regime = max(
        (x for x in record.where.regimes if x.joint == worst),
        key=lambda x: x.before_mrad if x.before_mrad == x.before_mrad else -1.0,
    )
    each = ", ".join(
        f"joint {j.joint + 1} {before(record, j):.1f} to {j.answered_mrad:.1f}"
        for j in record.where.joints
        if not j.never_moves
    )
    return Picture(
        "where",
        f"Rows are joints, columns what the command does; a blue cell is one that "
        f"{before_words(record)} does not predict. It errs most on joint {label(record, worst)}, "
        f"above all at {regime_words(regime.regime)}: {regime.before_mrad:.1f} {unit}, "
        f"{regime.answered_mrad:.1f} {unit} corrected.",
        f"Map of joints and regimes. Before and after [{unit}]: {each}.",
        partial(where_figure, record),
    )


def _size(value: float, ends: tuple[float, float], unit: str) -> str:
    """`39 [35.1, 42.9] rad/s²`."""
    return within(value, ends, unit) + (", not determined" if ends[0] <= 0 <= ends[1] else "")


def worst_joints(record: PositionRecord, most: int = WORST) -> list[int]:
    """Joints on which the servo before is worst, those that never move left out."""
    moving = [j for j in record.where.joints if not j.never_moves]
    return [j.joint for j in sorted(moving, key=lambda j: -before(record, j))][:most]


def where_figure(record: PositionRecord) -> Figure:
    """Joints x what the command does: the error of the servo before as colour, and what the answer
    leaves of it."""
    joints, errors = record.where.joints, record.where.regimes
    regimes = list(dict.fromkeys(r.regime for r in errors))
    first, after = (
        np.array([[getattr(r, key) for r in errors if r.regime == name] for name in regimes]).T
        for key in ("before_mrad", "answered_mrad")
    )
    texts: dict[Any, tuple[str, dict[str, Any]]] = {
        place: ("-" if np.isnan(value) else f"{value:.1f} \u2192 {after[place]:.1f}", {})
        for place, value in np.ndenumerate(first)
    }
    unit = unit_of_errors(record)
    return map_with_words(
        f"{record.robot}: where command and position part",
        f"error of whole motions left out [{unit}]: {before_words(record)} \u2192 corrected",
        [label(record, j.joint) for j in joints],
        [regime_words(name) for name in regimes],
        np.nan_to_num(first),
        texts,
        f"{before_words(record)} [{unit}]",
    )[0]


def replay_figure(result: Replay, log: int = 0) -> Figure:
    """Command, measured and simulated position of every joint over one log's time.

    Raises:
        TorchidError: no such log.
    """
    if not 0 <= log < len(result.measured):
        raise TorchidError("there is no such log.", got=log, expected=f"0..{len(result.files) - 1}")
    real, far = result.measured[log], result.simulated[log]
    assert real.u is not None
    curves = {
        "commanded": (thin(real.u), {"color": GREY, "linewidth": 1.0}),
        "measured": (thin(real.q), {"color": INK, "linewidth": 2.0}),
        "simulated": (thin(far.q), {"color": AFTER, "linewidth": 1.0}),
    }
    error = f"{float(result.error[log].mean()):.1f} {result.unit}"
    title = f"{result.files[log] or result.robot}: {error} RMS"
    # Motions one after the other, each from its own beginning.
    samples = thin(torch.arange(real.samples))
    alone = real.trajectory_count == 1
    t, x = (thin(real.t - real.t[0]), "time [s]") if alone else (samples, "sample")
    return joint_lines(title, "position [rad or m]", t, curves, x)[0]


def report_of_commands(made: NextCommands, unknown: Sequence[str] = ()) -> Report:
    """What the next commands are, and what they would show.

    Args:
        made: the commands.
        unknown: what could not be checked, one sentence each.
    """
    text = f"{len(made.motions)} motions of {made.seconds:g} s at {made.rate:g} commands a second: "
    text += "; ".join(made.motions) + "."
    if not made.open:
        text += " The diagnosis leaves nothing open; they serve all of its parameters."
    note = (
        "half widths of 95 % intervals, predicted for servos like the answered ones; of gains, "
        "friction and inertia as shares"
    )
    table = table_of("What they would show", made.open, note=note)
    return Report(verdict=text, parts=[table], warnings=(*made.warnings, *unknown))
