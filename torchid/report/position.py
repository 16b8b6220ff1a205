"""A diagnosis of commands and positions as tables and pictures for people; all of it from its
record, but for figures of motions over time."""

import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import torch
from msgspec import UNSET

from torchid.errors import TorchidError
from torchid.position.diagnosis import PositionDiagnosis
from torchid.position.model import Replay
from torchid.position.next_motion import NextCommands
from torchid.position.nominal import unit_of
from torchid.position.record import EffectRecord, NominalRecord, PositionRecord, RegimeRecord
from torchid.report.colours import AFTER, BEFORE, GREY, INK
from torchid.report.panels import (
    SMALL,
    Figure,
    Figures,
    Picture,
    finish,
    joint_lines,
    new_figure,
    panel,
    shaded_map,
    side_bars,
    thin,
    worst_stretch,
)
from torchid.report.repeats import repeats_figures, repeats_pictures
from torchid.report.table import Shown, Table, filled
from torchid.results.replication import times
from torchid.results.words import effect_words, listed, regime_words

WORST = 3
"""Joints that get a figure of their own."""
MOST_FINDINGS = 16
"""That are drawn, those that close most."""
SHOWN_S = 8.0
"""Of a motion in a joint's figure [s]."""
MOST_WORSE = 3
"""Places where an answer is worse than a plain servo that are named."""


def label(record: PositionRecord, joint: int) -> str:
    """A joint by number and name."""
    return f"{joint + 1} {record.where.joints[joint].name}".rstrip()


def regimes_of(record: PositionRecord) -> dict[str, list[RegimeRecord]]:
    """By name, joint by joint."""
    out: dict[str, list[RegimeRecord]] = {}
    for one in record.where.regimes:
        out.setdefault(one.regime, []).append(one)
    return out


def remarks(record: PositionRecord) -> list[str]:
    """What to know about the answer, one sentence each."""
    far = record.how_far
    out = [
        f"Errors are of whole motions that no model was fitted to, the mean of the joints that "
        f"move: the command alone {far.commanded.whole_mrad:.1f} mrad, a plain servo "
        f"{far.plain.whole_mrad:.1f}, corrected {far.answered.whole_mrad:.1f}; in windows of 2 s "
        f"{far.answered.windows_2s_mrad:.1f}. A plain servo has a gain, friction, inertia, delay "
        "and offset."
    ]
    if record.held_out is not UNSET:
        held = record.held_out
        out.append(
            f"Held-out logs: {held.whole_mrad:.1f} mrad, in windows of 2 s "
            f"{held.windows_2s_mrad:.1f} mrad."
        )
    worse = _worse(record)
    if worse:
        more = " and elsewhere" if len(worse) > MOST_WORSE else ""
        out.append(f"It is worse than a plain servo on {'; '.join(worse[:MOST_WORSE])}{more}.")
    return out


def _worse(record: PositionRecord) -> list[str]:
    """Joints, or regimes of them, whose error is larger by more than could be seen."""
    joints = record.where.joints
    worse = [j for j in joints if j.answered_mrad - j.plain_mrad > j.unseen_mrad]
    out = [f"joint {j.joint + 1}, {j.plain_mrad:.1f} -> {j.answered_mrad:.1f} mrad" for j in worse]
    named = {j.joint for j in worse} | {j.joint for j in joints if j.never_moves}
    return out + [
        f"joint {r.joint + 1} ({regime_words(r.regime)}), {r.plain_mrad:.1f} -> "
        f"{r.answered_mrad:.1f} mrad"
        for r in record.where.regimes
        if r.joint not in named and r.answered_mrad - r.plain_mrad > joints[r.joint].unseen_mrad
    ]


def tables(record: PositionRecord) -> list[Table]:
    """What stands below the answer: where, which and how far."""
    far = record.how_far
    joints = []
    for j in record.where.joints:
        levels = (
            j.commanded_mrad, j.plain_mrad, j.answered_mrad,
            float(far.plain.windows_per_joint[j.joint]),
            float(far.answered.windows_per_joint[j.joint]),
        )  # fmt: skip
        gain = f"{j.kp:.1f}" + (" (ratio)" if j.ratio_only else "")
        cells = ["-"] * 6 if j.never_moves else [*(f"{x:.1f}" for x in levels), gain]
        joints.append((str(j.joint + 1), j.name, *cells))
    where = Table(
        "Position error of motions left out [mrad]",
        (
            "joint",
            "name",
            "command",
            "plain servo",
            "corrected",
            "plain, 2 s",
            "corrected, 2 s",
            "kp",
        ),
        joints,
        names=("name",),
        note="kp [N m/rad]; (ratio): without a load on the joint its torques are known up to one "
        "factor",
    )
    regimes = [
        (regime_words(name), *(_change(r.plain_mrad, r.answered_mrad) for r in own))
        for name, own in regimes_of(record).items()
    ]
    when = Table(
        "By kind of motion, plain servo -> corrected [mrad]",
        ("kind of motion", *(j.name for j in record.where.joints)),
        regimes,
        names=("kind of motion",),
    )
    findings = [
        (
            f.effect,
            label(record, f.joints[0]) if f.joints else "all",
            ", ".join(_sizes(f)),
            f"{f.error_without_mrad:.1f} -> {f.error_with_mrad:.1f}",
            ", ".join(f.ambiguous_with) or "-",
            times(f.replication),
        )
        for f in record.which
    ]
    which = Table(
        "What lies between command and position",
        ("effect", "joint", "size (95 %)", "without -> with [mrad]", "could also be", "found in"),
        findings,
        names=("effect", "joint"),
        words=("size (95 %)", "could also be"),
        note="error in windows of 2 s when all else is fitted without the effect, and with it; "
        "found in: motions with the same sign and size, of the motions that can show it",
    )
    meant = [(effect_words(f.effect), f.meaning, f.remedy) for f in record.which]
    columns = ("effect", "what it means", "what to do")
    meaning = Table(
        "What it means, and what to do", columns, list(dict.fromkeys(meant)), names=("effect",),
        words=columns[1:],
    )  # fmt: skip
    nominal = () if record.nominal is UNSET else record.nominal
    return filled(where, when, which, meaning, nominal_table(record, nominal))


def nominal_table(record: PositionRecord, nominal: Sequence[NominalRecord]) -> Table:
    """What servos are said to be, beside what was found of the same numbers."""
    rows = []
    for servo in nominal:
        j, joint = servo.joint, record.where.joints[servo.joint]
        place = (str(j + 1), servo.servo)
        own = [f for f in record.which if f.joints == (j,)]
        found = {name: (f.parameters[name], f.ci95[name]) for f in own for name in f.parameters}
        if not joint.never_moves:
            found["kp"] = (joint.kp, joint.kp_ci95)
        for name in dict.fromkeys([*servo.values, *servo.register_units]):
            stated = servo.values.get(name)
            if name not in found and stated is None:
                continue
            text = "never moves" if joint.never_moves else "not needed"
            if name in found:
                value, ends = found[name]
                text = _size(value, ends, unit_of(name))
                if name in servo.register_units:
                    steps = value / servo.register_units[name]
                    text += f" = {steps:.0f} steps of the register"
            of_maker = "unknown" if stated is None else f"{stated:.3g} {unit_of(name)}".rstrip()
            rows.append((*place, name, of_maker, text))
        if math.isfinite(servo.counts) and float(record.log_scale[j]) == 1:
            step = f"{2e3 * math.pi / servo.counts:.3g} mrad"
            rows.append((*place, "resolution", step, f"{joint.resolution_mrad:.3g} mrad"))
    return Table(
        "Servos: nominal values, and what was found (95 %)",
        ("joint", "servo", "value", "nominal", "found"),
        rows,
        names=("servo", "value"),
        words=("nominal", "found"),
        note="nominal: makers' tables for a new servo at its supply's voltage; nothing found "
        "depends on it",
    )


def motion_table(record: PositionRecord) -> Table:
    """Errors of the answered model in every motion, when it was left out."""
    moves = torch.tensor([not j.never_moves for j in record.where.joints])
    rows = []
    for one in record.how_far.per_motion:
        errors = one.answered_mrad
        levels = [*errors.tolist(), float(errors[moves].mean())]
        rows.append((one.motion, *(f"{x:.1f}" for x in levels)))
    columns = ("motion", *(j.name for j in record.where.joints), "mean")
    return Table("Error of each motion, left out [mrad]", columns, rows, names=("motion",))


def page_tables(record: PositionRecord) -> list[Table]:
    """The tables of the page: those of the terminal, and one of motions."""
    return [*tables(record), motion_table(record)]


def facts(record: PositionRecord) -> list[tuple[str, str]]:
    """The few numbers beside the headline."""
    far = record.how_far
    moving = [j for j in record.where.joints if not j.never_moves]
    worst = max(moving, key=lambda j: j.answered_mrad, default=None)
    most = [] if worst is None else [("Most is left on", f"joint {label(record, worst.joint)}: "
                                      f"{worst.answered_mrad:.1f} mrad")]  # fmt: skip
    return [
        ("Status", record.status.replace("_", " ")),
        ("Command alone", f"{far.commanded.whole_mrad:.1f} mrad"),
        ("Plain servo, motions left out", f"{far.plain.whole_mrad:.1f} mrad"),
        ("Corrected", f"{far.answered.whole_mrad:.1f} mrad"),
        ("The same, windows of 2 s", f"{far.answered.windows_2s_mrad:.1f} mrad"),
        *most,
    ]


def pictures(r: PositionDiagnosis) -> list[Picture]:
    """The worst joint over time, where, which, how far, and the other joints."""
    record = r.record
    order = worst_joints(record)
    joints = [
        Picture(
            f"joint_{j + 1}",
            f"Joint {label(record, j)} where a plain servo errs most: "
            f"{record.where.joints[j].plain_mrad:.1f} mrad over all motions, "
            f"{record.where.joints[j].answered_mrad:.1f} mrad corrected.",
            f"Command, measured and simulated positions of joint {j + 1} over time.",
            partial(joint_figure, r, j),
        )
        for j in order
    ]
    each = ", ".join(
        f"joint {j.joint + 1} {j.plain_mrad:.1f} to {j.answered_mrad:.1f}"
        for j in record.where.joints
        if not j.never_moves
    )
    worst = order[0] if order else 0
    regime = max(
        (x for x in record.where.regimes if x.joint == worst),
        key=lambda x: x.plain_mrad if x.plain_mrad == x.plain_mrad else -1.0,
    )
    out = [
        *joints[:1],
        Picture(
            "where",
            "Where command and position part. Rows are joints, columns what the command does; a "
            "blue cell is one that a plain servo (gain, friction, inertia, delay, offset) does not "
            f"predict. It errs most on joint {label(record, worst)}, above all at "
            f"{regime_words(regime.regime)}: {regime.plain_mrad:.1f} mrad, "
            f"{regime.answered_mrad:.1f} mrad corrected.",
            f"Map of joints and regimes. Plain servo and answer [mrad]: {each}.",
            partial(where_figure, record),
        ),
    ]
    if record.which:
        out.append(
            Picture(
                "which",
                "Which effects close it: the error when one is left out and all others are fitted "
                "again, and with it. A short bar is a cause that others can nearly replace.",
                f"Effects by what they close; most: {sentence(record, record.which[0])}",
                partial(which_figure, record),
            )
        )
    out += repeats_pictures(record)
    out.append(
        Picture(
            "how_far",
            "How far, joint by joint, on motions that took no part in the fit that predicts them.",
            f"Bars of errors of a plain servo and of the answer [mrad]: {each}.",
            partial(error_figure, record),
        )
    )
    return [*out, *joints[1:]]


def sentence(record: PositionRecord, f: EffectRecord) -> str:
    """Which, where, how much."""
    place = f"joint {label(record, f.joints[0])}" if f.joints else "the arm"
    others = listed(map(effect_words, f.ambiguous_with), "or")
    return (
        f"{effect_words(f.effect)} on {place} ({', '.join(_sizes(f))}): "
        f"{f.error_without_mrad:.1f} mrad without, {f.error_with_mrad:.1f} with it"
        f"{f'; this log cannot separate it from {others}' if others else ''}."
    )


def _change(before: float, after: float) -> str:
    return "-" if math.isnan(before) else f"{before:.1f} -> {after:.1f}"


def _sizes(f: EffectRecord) -> list[str]:
    return [
        f"{name} {_size(value, f.ci95[name], f.unit.get(name, '1'))}"
        for name, value in f.parameters.items()
    ]


def _size(value: float, ends: tuple[float, float], unit: str) -> str:
    """`39 [35.1, 42.9] rad/s^2`."""
    unit = "" if unit == "1" else f" {unit}".rstrip()
    low, high = ends
    if math.isnan(low):
        return f"{value:.3g}{unit}"
    unsure = ", not determined" if low <= 0 <= high else ""
    return f"{value:.3g} [{low:.3g}, {high:.3g}]{unit}{unsure}"


def figures(result: PositionDiagnosis | PositionRecord) -> Figures:
    """What draws each figure, by the names of their files; of a record those that need no motion
    over time."""
    record = result.record
    assert isinstance(record, PositionRecord)
    out: dict[str, Callable[[], Figure | None]] = {
        "where": partial(where_figure, record),
        "how_far": partial(error_figure, record),
    }
    if record.which:
        out["which"] = partial(which_figure, record)
    out |= repeats_figures(record)
    if isinstance(result, PositionDiagnosis):
        for j in worst_joints(record):
            out[f"gap_joint_{j + 1}"] = partial(joint_figure, result, j)
    return out


def kinds(result: PositionDiagnosis | PositionRecord) -> Figures:
    """By kind; that of one joint takes it as `joint`."""
    out = {k: v for k, v in figures(result).items() if not k.startswith("gap_joint")}
    return out | (
        {"joint": partial(joint_figure, result)} if isinstance(result, PositionDiagnosis) else {}
    )


def worst_joints(record: PositionRecord, most: int = WORST) -> list[int]:
    """Joints on which a plain servo is worst, those that never move left out."""
    moving = [j for j in record.where.joints if not j.never_moves]
    return [j.joint for j in sorted(moving, key=lambda j: -j.plain_mrad)][:most]


def where_figure(record: PositionRecord) -> Figure:
    """Joints x what the command does: the plain servo's error as colour, and what the answer leaves
    of it; beside it the joints' errors of the command alone."""
    regimes, joints = regimes_of(record), record.where.joints
    before, after = (
        np.array([[getattr(r, key) for r in own] for own in regimes.values()]).T
        for key in ("plain_mrad", "answered_mrad")
    )
    figure = new_figure(9.0, 2.0 + 0.42 * len(joints))
    axes, bars = figure.subplots(1, 2, width_ratios=(3, 1), sharey=True)
    labels = [label(record, j.joint) for j in joints]
    names = [regime_words(name) for name in regimes]
    shaded_map(axes, np.nan_to_num(before), names, labels, "plain servo [mrad]")
    for (y, x), value in np.ndenumerate(before):
        text = "-" if np.isnan(value) else f"{value:.1f} \u2192 {after[y, x]:.1f}"
        axes.text(x, y, text, ha="center", va="center", fontsize=SMALL, color=INK)
    sizes = [0.0 if j.never_moves else j.commanded_mrad for j in joints]
    words = [
        " never moves" if j.never_moves else f" {value:.1f}"
        for j, value in zip(joints, sizes, strict=True)
    ]
    title = "command less position [mrad]"
    side_bars(bars, sizes, words, GREY, title, 1.35 * max(*sizes, 1e-9))
    axes.set_title(
        "error of whole motions left out [mrad]: a plain servo \u2192 corrected",
        fontsize=SMALL, color=INK, loc="left",
    )  # fmt: skip
    return finish(figure, f"{record.robot}: where command and position part")


def which_figure(record: PositionRecord) -> Figure:
    """Effects: the error when each is left out and all others are fitted again, and with it."""
    shown = record.which[:MOST_FINDINGS]
    figure, axes = panel(8.0, 1.6 + 0.3 * len(shown))
    for y, f in enumerate(shown):
        with_it, without = f.error_with_mrad, f.error_without_mrad
        axes.plot([with_it, without], [y, y], color=GREY, linewidth=2, zorder=1)
        axes.scatter([without], [y], color=BEFORE, s=28, label="without it", zorder=2)
        axes.scatter([with_it], [y], color=AFTER, s=28, label="with it", zorder=2)
        place = record.where.joints[f.joints[0]].name if f.joints else "arm"
        axes.text(
            without, y, f"  {without - with_it:.1f} mrad", va="center", fontsize=SMALL, color=INK
        )
        axes.text(
            -0.01, y, f"{effect_words(f.effect)}, {place}", ha="right", va="center",
            fontsize=SMALL, color=INK, transform=axes.get_yaxis_transform(),
        )  # fmt: skip
    axes.set(yticks=[], ylim=(len(shown) - 0.4, -0.6), xlabel="error in windows of 2 s [mrad]")
    axes.set_xlim(0, 1.25 * max(f.error_without_mrad for f in shown))
    many = len(record.which)
    most = f" (the {len(shown)} largest of {many})" if many > len(shown) else ""
    return finish(figure, f"what closes it: each effect left out{most}", axes)


def error_figure(record: PositionRecord) -> Figure:
    """RMS errors of motions left out, joint by joint: command alone, plain servo, answer."""
    joints = record.where.joints
    figure, axes = panel(2.4 + 1.0 * len(joints), 4.0)
    place = np.arange(len(joints))
    ways = (
        ("the command alone", GREY, [j.commanded_mrad for j in joints]),
        ("a plain servo", BEFORE, [j.plain_mrad for j in joints]),
        ("corrected", AFTER, [j.answered_mrad for j in joints]),
    )
    for k, (name, colour, errors) in enumerate(ways):
        axes.bar(place + 0.27 * (k - 1), errors, 0.25, color=colour, label=name)
        for x, error in zip(place, errors, strict=True):
            if math.isnan(error):
                continue
            axes.text(
                x + 0.27 * (k - 1), error, f"{error:.1f}", ha="center", va="bottom", fontsize=7,
                color=INK,
            )  # fmt: skip
    axes.set_xticks(place, [f"joint {j.joint + 1}" for j in joints])
    axes.set_ylabel("RMS error of whole motions left out [mrad]")
    axes.grid(False, axis="x")
    return finish(figure, "how far: motions that the model has not seen", axes)


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
    title = f"{result.files[log] or result.robot}: {float(result.error[log].mean()):.1f} mrad RMS"
    # Motions one after the other, each from its own beginning.
    samples = thin(torch.arange(real.samples))
    alone = real.trajectory_count == 1
    t, x = (thin(real.t - real.t[0]), "time [s]") if alone else (samples, "sample")
    return joint_lines(title, "position [rad or m]", t, curves, x)[0]


def worst_place(result: PositionDiagnosis, joint: int) -> slice:
    """Rows of `SHOWN_S` of the motion left out in which the plain servo errs most on a joint."""
    data = result.data
    length = max(2, round(SHOWN_S / data.tracks.dt))
    best, chosen = -1.0, slice(0, 0)
    for a, b in zip(data.tracks.first.tolist(), data.tracks.last.tolist(), strict=True):
        rows, mean = worst_stretch(result.errors[0][a : b + 1, joint].square(), length)
        if mean > best:
            best, chosen = mean, slice(a + rows.start, a + rows.stop)
    return chosen


def joint_figure(result: PositionDiagnosis, joint: int | None = None) -> Figure:
    """One joint (from 0; the worst, if None) where a plain servo errs most: command, measured and
    simulated positions, and both models' errors below."""
    joint = worst_joints(result.record)[0] if joint is None else joint
    rows = worst_place(result, joint)
    log, (plain, answered) = result.data.log, result.errors
    t = log.t[rows].numpy()
    q = log.q[rows, joint]
    figure, (above, below) = panel(9.0, 4.8, 2, 1, sharex=True, height_ratios=(2, 1))
    if log.u is not None:
        above.plot(t, log.u[rows, joint].numpy(), color=GREY, linewidth=1, label="command")
    above.plot(t, q.numpy(), color=INK, linewidth=1.4, label="measured")
    for error, colour, name in (
        (plain[rows, joint], BEFORE, "a plain servo"),
        (answered[rows, joint], AFTER, "corrected"),
    ):
        above.plot(t, (q + error).numpy(), color=colour, linewidth=1, label=name)
        below.plot(t, 1e3 * error.numpy(), color=colour, linewidth=1)
    below.axhline(0, color=INK, linewidth=0.6)
    above.set_ylabel("position [rad or m]")
    below.set(ylabel="simulated less\nmeasured [mrad]", xlabel="time [s]")
    motion = log.names[int(log.trajectory[rows.start])]
    place = label(result.record, joint)
    return finish(figure, f"joint {place} in {motion}, which was left out", above)


def commands_shown(made: NextCommands, unknown: Sequence[str] = ()) -> Shown:
    """What the next commands are, and what they would show.

    Args:
        made: the commands.
        unknown: what could not be checked, one sentence each.
    """
    rows = [
        (
            str(o.joint + 1), o.parameter, o.why,
            "-" if math.isnan(o.now) else f"{o.now:.2g}", f"{o.then:.2g}",
        )
        for o in made.open
    ]  # fmt: skip
    text = f"{len(made.motions)} motions of {made.seconds:g} s at {made.rate:g} commands a second: "
    text += "; ".join(made.motions) + "."
    if not rows:
        text += " The diagnosis leaves nothing open; they serve all of its parameters."
    note = (
        "half widths of 95 % intervals, predicted for servos like the answered ones; of gains, "
        "friction and inertia as shares"
    )
    columns = ("joint", "parameter", "open because of", "now +-", "then +-")
    table = Table("What they would show", columns, rows, names=("parameter",), note=note)
    return Shown(verdict=text, parts=[table] if rows else [], warnings=(*made.warnings, *unknown))
