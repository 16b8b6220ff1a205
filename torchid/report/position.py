"""A diagnosis of commands and positions for people: the verdict, tables, figures, and a page."""

import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import torch
from torch import Tensor

from torchid.errors import TorchidError
from torchid.position.diagnosis import PositionDiagnosis, PositionFinding, Size
from torchid.position.model import Replay
from torchid.position.next_motion import NextCommands
from torchid.position.nominal import unit_of
from torchid.position.record import PositionRecord
from torchid.report.colours import AFTER, BEFORE, GREY, INK
from torchid.report.gap_words import effect_words, regime_words
from torchid.report.page.document import Origin, Page
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
from torchid.report.table import Shown, Table

WORST = 3
"""Joints that get a figure of their own."""
MOST_FINDINGS = 16
"""That are drawn, those that close most."""
SHOWN_S = 8.0
"""Of a motion in a joint's figure [s]."""


def shown(result: PositionDiagnosis) -> Shown:
    """All that there is to see of a diagnosis."""
    return Shown(
        verdict=position_verdict(result),
        parts=position_tables(result),
        warnings=result.warnings,
        figures=figures(result),
        page=partial(position_page, result),
    )


MOST_WORSE = 3
"""Places where an answer is worse than a plain servo that are named."""
_STATUS = {
    "no_gap": "Nothing beside a plain servo is needed.",
    "detected_unexplained": "A gap is left that no effect closes.",
    "partly_explained": "That is not all: something else is there too.",
}


def position_verdict(result: PositionDiagnosis) -> str:
    """How far, and by what, in two sentences."""
    commanded, plain, answered = (
        way.mean[0] for way in (result.commanded, result.plain_servo, result.answered)
    )
    names = list(dict.fromkeys(f.effect for f in result.findings))
    said = (
        f"Whole motions are foretold to {answered:.1f} mrad (mean of the joints that move, held "
        f"out), a plain servo reaches {plain:.1f}, the command alone {commanded:.1f}."
    )
    if result.held_out is not None:
        whole, windows = result.held_out
        said += f" Held-out logs: {whole:.1f} mrad, in windows of 2 s {windows:.1f} mrad."
    if not names:
        said = f"{said} {_STATUS[result.status]}"
        if result.status == "no_gap":
            low, high = (float(x) for x in result.unseen[~result.still].aminmax())
            said += (
                f" What moves a joint by less than {low:.1f} to {high:.1f} mrad beside a refitted "
                "plain servo would not be seen."
            )
        return said
    said += f" What closes it: {', '.join(names)}."
    worse = [f"{place}, {_change(before, after)} mrad" for place, before, after in _worse(result)]
    if worse:
        more = " and elsewhere" if len(worse) > MOST_WORSE else ""
        said += f" It is worse than a plain servo on {'; '.join(worse[:MOST_WORSE])}{more}."
    return said if result.status == "explained" else f"{said} {_STATUS[result.status]}"


def _worse(result: PositionDiagnosis) -> list[tuple[str, Tensor, Tensor]]:
    """Joints, or regimes of them, whose error is larger by more than would be seen: where, the
    plain servo's error, and the answer's [mrad]."""

    def larger(before: Tensor, after: Tensor) -> list[int]:
        seen = (after - before > result.unseen) & ~result.still
        return [int(j) for j in seen.nonzero().flatten()]

    before, after = result.plain_servo.whole, result.answered.whole
    joints = larger(before, after)
    rows = [(f"joint {j + 1}", before[j], after[j]) for j in joints]
    return rows + [
        (f"joint {j + 1} ({regime_words(name)})", before[j], after[j])
        for name, (before, after) in result.regimes.items()
        for j in larger(before, after)
        if j not in joints
    ]


def position_tables(result: PositionDiagnosis) -> list[Table]:
    """Where, which and how far."""
    joints = [
        (
            str(j + 1),
            name,
            *(
                "-" if result.still[j] else f"{float(x[j]):.1f}"
                for x in (
                    result.commanded.whole, result.plain_servo.whole, result.answered.whole,
                    result.plain_servo.windows, result.answered.windows,
                )
            ),
            "-"
            if result.still[j]
            else f"{float(result.gains[0][j]):.1f}" + (" (ratio)" if result.ratio_only[j] else ""),
        )
        for j, name in enumerate(result.data.robot.joint_names)
    ]  # fmt: skip
    where = Table(
        "Position error of motions left out [mrad]",
        ("joint", "name", "command", "plain", "answered", "plain 2 s", "answered 2 s", "kp"),
        joints,
        names=("name",),
        note="kp [N m/rad]; (ratio): without a load on the joint its torques are known up to one "
        "factor",
    )
    regimes = [
        (regime_words(name), *(_change(b, a) for b, a in zip(*both, strict=True)))
        for name, both in result.regimes.items()
    ]
    when = Table(
        "By regime, plain -> answered [mrad]",
        ("regime", *result.data.robot.joint_names),
        regimes,
        names=("regime",),
    )
    findings = [
        (
            f.effect,
            "all" if f.joint is None else f"{f.joint} {result.data.robot.joint_names[f.joint - 1]}",
            ", ".join(_size(s) for s in f.sizes),
            f"{f.error_without:.1f} -> {f.error_with:.1f}",
            ", ".join(f.ambiguous_with) or "-",
        )
        for f in result.findings
    ]
    which = Table(
        "What lies between command and position",
        ("effect", "joint", "size (95 %)", "without -> with [mrad]", "or"),
        findings,
        names=("effect", "joint"),
        words=("size (95 %)", "or"),
        note="error in windows of 2 s when all else is fitted without the effect, and with it",
    )
    out = [where, when, *([which] if findings else [])]
    return [*out, nominal_table(result)] if result.nominal else out


def nominal_table(result: PositionDiagnosis) -> Table:
    """What servos are said to be, beside what was found of the same numbers."""
    steps = result.data.resolution * 12**0.5
    rows = []
    for j, servo in enumerate(result.nominal):
        place = (str(j + 1), servo.name)
        sizes = {s.name: s for f in result.findings if f.joint == j + 1 for s in f.sizes}
        if not result.still[j]:
            value, ends = float(result.gains[0][j]), tuple(result.gains[1][j].tolist())
            sizes["kp"] = Size("kp", "N m/rad", value, ends)
        for name in dict.fromkeys([*servo.values, *servo.units]):
            size, said = sizes.get(name), servo.values.get(name)
            if size is None and said is None:
                continue
            text = "never moves" if result.still[j] else "not needed"
            text = text if size is None else _size(size).removeprefix(f"{name} ")
            if size is not None and name in servo.units:
                text += f" = {size.value / servo.units[name]:.0f} steps of the register"
            nominal = "unknown" if said is None else f"{said:.3g} {unit_of(name)}".rstrip()
            rows.append((*place, name, nominal, text))
        if servo.counts is not None and result.data.scale[j] == 1:
            rows.append(
                (
                    *place, "resolution", f"{2e3 * math.pi / servo.counts:.3g} mrad",
                    f"{1e3 * float(steps[j]):.3g} mrad",
                )
            )  # fmt: skip
    return Table(
        "Servos: what they are said to be, and what was found (95 %)",
        ("joint", "servo", "value", "nominal", "found"),
        rows,
        names=("servo", "value"),
        words=("nominal", "found"),
        note="nominal: makers' tables for a new servo at its supply's voltage; nothing found "
        "depends on it",
    )


def motion_table(result: PositionDiagnosis) -> Table:
    """Errors of the answered model in every motion, when it was left out."""
    names, errors = result.motions
    joints = result.data.robot.joint_names
    rows = [
        (name, *(f"{x:.1f}" for x in row.tolist()), f"{float(row[~result.still].mean()):.1f}")
        for name, row in zip(names, errors, strict=True)
    ]
    title = "Error of each motion, left out [mrad]"
    return Table(title, ("motion", *joints, "mean"), rows, names=("motion",))


def meaning_table(result: PositionDiagnosis) -> Table:
    """What each effect means and what a simulator needs for it, once."""
    said = [(effect_words(f.effect), f.meaning, f.remedy) for f in result.findings]
    columns = ("effect", "what it means", "what to do")
    title = "What it means, and what to do"
    return Table(title, columns, list(dict.fromkeys(said)), names=("effect",), words=columns[1:])


def position_page(result: PositionDiagnosis, origin: Origin) -> Page:
    """The page of a diagnosis."""
    r, names = result, result.data.robot.joint_names
    order = worst_joints(r)
    left = int(r.answered.whole.nan_to_num().argmax())
    tables = position_tables(r)
    if r.findings:
        tables.insert(3, meaning_table(r))
    return Page(
        f"Command and position of {r.data.robot.name}",
        position_verdict(r),
        (
            ("Status", r.status.replace("_", " ")),
            ("Command alone", _mrad(r.commanded.mean[0])),
            ("Plain servo, motions left out", _mrad(r.plain_servo.mean[0])),
            ("With what was found", _mrad(r.answered.mean[0])),
            ("The same, windows of 2 s", _mrad(r.answered.mean[1])),
            (
                "Most is left on",
                f"joint {left + 1} {names[left]}: {_mrad(r.answered.whole[left])}",
            ),
        ),
        origin,
        pictures=_pictures(r, order),
        findings=[_sentence(f, names) for f in r.findings],
        tables=[table.on_page() for table in (*tables, motion_table(r))],
        notes=list(r.warnings),
    )


def _pictures(r: PositionDiagnosis, order: list[int]) -> list[Picture]:
    """Where, which, how far, and the worst joints over time."""
    names = r.data.robot.joint_names
    worst = order[0] if order else 0

    def error_there(item: tuple[str, tuple[Tensor, Tensor]]) -> float:
        return float(item[1][0][worst].nan_to_num())

    regime, (before, after) = max(r.regimes.items(), key=error_there)
    each = ", ".join(
        f"joint {j + 1} {float(a):.1f} to {float(b):.1f}"
        for j, (a, b) in enumerate(zip(r.plain_servo.whole, r.answered.whole, strict=True))
    )
    out = [
        Picture(
            "where",
            "Where command and position part. Rows are joints, columns what the command does; a "
            "blue cell is one that a plain servo (gain, friction, inertia, delay, offset) does not "
            f"foretell. It errs most on joint {worst + 1} {names[worst]}, above all at "
            f"{regime_words(regime)}: {_mrad(before[worst])}, {_mrad(after[worst])} with what was "
            "found.",
            f"Map of joints and regimes. Plain servo and answer [mrad]: {each}.",
            partial(where_figure, r),
        )
    ]
    if r.findings:
        first = r.findings[0]
        out.append(
            Picture(
                "which",
                "Which effects close it: the error when one is left out and all others are fitted "
                "again, and with it. A short bar is a cause that others can nearly replace.",
                f"Effects by what they close; most: {_sentence(first, names)}",
                partial(which_figure, r),
            )
        )
    out.append(
        Picture(
            "how_far",
            "How far, joint by joint, on motions that took no part in the fit that foretells them.",
            f"Bars of errors of a plain servo and of the answer [mrad]: {each}.",
            partial(error_figure, r.record),
        )
    )
    return out + [
        Picture(
            f"joint_{j + 1}",
            f"Joint {j + 1} {names[j]} where a plain servo errs most: "
            f"{_mrad(r.plain_servo.whole[j])} over all motions, {_mrad(r.answered.whole[j])} with "
            "what was found.",
            f"Command, measured and simulated positions of joint {j + 1} over time.",
            partial(joint_figure, r, j),
        )
        for j in order
    ]


def _sentence(f: PositionFinding, names: Sequence[str]) -> str:
    """Which, where, how much."""
    place = "the arm" if f.joint is None else f"joint {f.joint} {names[f.joint - 1]}"
    sizes = ", ".join(_size(s) for s in f.sizes)
    others = ", ".join(map(effect_words, f.ambiguous_with))
    return (
        f"{effect_words(f.effect)} on {place} ({sizes}): {f.error_without:.1f} mrad without, "
        f"{f.error_with:.1f} with it{f'; cannot be told from {others}' if others else ''}."
    )


def _change(before: Tensor, after: Tensor) -> str:
    return "-" if before.isnan() else f"{float(before):.1f} -> {float(after):.1f}"


def _mrad(value: Tensor | float) -> str:
    return f"{float(value):.1f} mrad"


def _size(size: Size) -> str:
    unit = "" if size.unit == "1" else f" {size.unit}"
    low, high = size.interval
    if math.isnan(low):
        return f"{size.name} {size.value:.3g}{unit}"
    unsure = ", not determined" if low <= 0 <= high else ""
    return f"{size.name} {size.value:.3g} [{low:.3g}, {high:.3g}]{unit}{unsure}"


def figures(result: PositionDiagnosis) -> Figures:
    """What draws each figure, by the names of their files."""
    out: dict[str, Callable[[], Figure | None]] = {
        "where": partial(where_figure, result),
        "how_far": partial(error_figure, result.record),
    }
    if result.findings:
        out["which"] = partial(which_figure, result)
    return out | {
        f"gap_joint_{j + 1}": partial(joint_figure, result, j) for j in worst_joints(result)
    }


def worst_joints(result: PositionDiagnosis, most: int = WORST) -> list[int]:
    """Joints on which a plain servo is worst, those that never move left out."""
    order = result.plain_servo.whole.nan_to_num().argsort(descending=True).tolist()
    return [j for j in order if not result.still[j]][:most]


def labels(result: PositionDiagnosis) -> list[str]:
    """Joints by number and name."""
    return [f"{j + 1} {name}" for j, name in enumerate(result.data.robot.joint_names)]


def where_figure(result: PositionDiagnosis) -> Figure:
    """Joints x what the command does: the plain servo's error as colour, and what the answer leaves
    of it; beside it the joints' errors of the command alone."""
    names, n = list(result.regimes), result.servos.n
    before, after = (
        torch.stack([result.regimes[name][k] for name in names], 1).numpy() for k in (0, 1)
    )
    figure = new_figure(9.0, 2.0 + 0.42 * n)
    axes, bars = figure.subplots(1, 2, width_ratios=(3, 1), sharey=True)
    regimes = [regime_words(name) for name in names]
    shaded_map(axes, np.nan_to_num(before), regimes, labels(result), "plain servo [mrad]")
    for y in range(n):
        for x in range(len(names)):
            text = f"{before[y, x]:.1f} \u2192 {after[y, x]:.1f}"
            text = "-" if np.isnan(before[y, x]) else text
            axes.text(x, y, text, ha="center", va="center", fontsize=SMALL, color=INK)
    said = result.commanded.whole.nan_to_num().tolist()
    words = [
        " never moves" if still else f" {value:.1f}"
        for value, still in zip(said, result.still.tolist(), strict=True)
    ]
    title = "command less position [mrad]"
    side_bars(bars, said, words, GREY, title, 1.35 * max(*said, 1e-9))
    axes.set_title(
        "error of whole motions left out [mrad]: a plain servo \u2192 with what was found",
        fontsize=SMALL, color=INK, loc="left",
    )  # fmt: skip
    return finish(figure, f"{result.data.robot.name}: where command and position part")


def which_figure(result: PositionDiagnosis) -> Figure:
    """Effects: the error when each is left out and all others are fitted again, and with it."""
    shown = result.findings[:MOST_FINDINGS]
    figure, axes = panel(8.0, 1.6 + 0.3 * len(shown))
    names = result.data.robot.joint_names
    for y, f in enumerate(shown):
        axes.plot([f.error_with, f.error_without], [y, y], color=GREY, linewidth=2, zorder=1)
        axes.scatter([f.error_without], [y], color=BEFORE, s=28, label="without it", zorder=2)
        axes.scatter([f.error_with], [y], color=AFTER, s=28, label="with it", zorder=2)
        place = "arm" if f.joint is None else names[f.joint - 1]
        axes.text(
            f.error_without, y, f"  {f.error_without - f.error_with:.1f} mrad",
            va="center", fontsize=SMALL, color=INK,
        )  # fmt: skip
        axes.text(
            -0.01, y, f"{effect_words(f.effect)}, {place}", ha="right", va="center",
            fontsize=SMALL, color=INK, transform=axes.get_yaxis_transform(),
        )  # fmt: skip
    axes.set(yticks=[], ylim=(len(shown) - 0.4, -0.6), xlabel="error in windows of 2 s [mrad]")
    axes.set_xlim(0, 1.25 * max(f.error_without for f in shown))
    many = len(result.findings)
    most = f" (the {len(shown)} largest of {many})" if many > len(shown) else ""
    return finish(figure, f"what closes it: each effect left out in turn{most}", axes)


def error_figure(record: PositionRecord) -> Figure:
    """RMS errors of motions left out, joint by joint: command alone, plain servo, answer."""
    joints = record.where.joints
    figure, axes = panel(2.4 + 1.0 * len(joints), 4.0)
    place = np.arange(len(joints))
    ways = (
        ("the command alone", GREY, [j.commanded_mrad for j in joints]),
        ("a plain servo", BEFORE, [j.plain_mrad for j in joints]),
        ("with what was found", AFTER, [j.answered_mrad for j in joints]),
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
    joint = worst_joints(result)[0] if joint is None else joint
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
        (answered[rows, joint], AFTER, "with what was found"),
    ):
        above.plot(t, (q + error).numpy(), color=colour, linewidth=1, label=name)
        below.plot(t, 1e3 * error.numpy(), color=colour, linewidth=1)
    below.axhline(0, color=INK, linewidth=0.6)
    above.set_ylabel("position [rad or m]")
    below.set(ylabel="simulated less\nmeasured [mrad]", xlabel="time [s]")
    motion = log.names[int(log.trajectory[rows.start])]
    return finish(figure, f"joint {labels(result)[joint]} in {motion}, which was left out", above)


def commands_shown(made: NextCommands, unknown: Sequence[str] = ()) -> Shown:
    """What the next commands are and tell.

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
    said = f"{len(made.motions)} motions of {made.seconds:g} s at {made.rate:g} commands a second: "
    said += "; ".join(made.motions) + "."
    if not rows:
        said += " The diagnosis leaves nothing open; they serve all of its parameters."
    note = (
        "half widths of 95 % intervals, foretold for servos like the answered ones; of gains, "
        "friction and inertia as shares"
    )
    columns = ("joint", "parameter", "open because of", "now +-", "then +-")
    table = Table("What they would tell", columns, rows, names=("parameter",), note=note)
    return Shown(verdict=said, parts=[table] if rows else [], warnings=(*made.warnings, *unknown))
