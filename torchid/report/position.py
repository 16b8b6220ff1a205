"""A diagnosis of commands and positions for people: the verdict, tables and figures."""

import math

import numpy as np
import torch

from torchid.errors import TorchidError
from torchid.position.diagnosis import PositionDiagnosis, Size
from torchid.position.model import Replay
from torchid.position.record import PositionRecord
from torchid.report.colours import AFTER, BEFORE, GREY, INK
from torchid.report.panels import Figure, finish, joint_lines, panel, thin
from torchid.report.table import Table


def position_verdict(result: PositionDiagnosis) -> str:
    """How far, and by what, in two sentences."""
    plain, answered = float(result.plain_servo.whole.mean()), float(result.answered.whole.mean())
    names = list(dict.fromkeys(f.effect for f in result.findings))
    said = (
        f"Whole motions are foretold to {answered:.1f} mrad (mean of the joints, held out), "
        f"a plain servo reaches {plain:.1f}, the command alone "
        f"{float(result.commanded.whole.mean()):.1f}."
    )
    if result.held_out is not None:
        whole, windows = result.held_out
        said += f" Held-out logs: {whole:.1f} mrad, in windows of 2 s {windows:.1f} mrad."
    if not names:
        return f"{said} Nothing beside a plain servo is needed."
    return f"{said} What closes it: {', '.join(names)}."


def position_tables(result: PositionDiagnosis) -> list[Table]:
    """Where, which and how far."""
    joints = [
        (
            str(j + 1),
            name,
            *(
                f"{float(x[j]):.1f}"
                for x in (
                    result.commanded.whole, result.plain_servo.whole, result.answered.whole,
                    result.plain_servo.windows, result.answered.windows,
                )
            ),
            f"{float(result.gains[0][j]):.1f}" + (" (ratio)" if result.ratio_only[j] else ""),
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
        (name, *(f"{float(b):.1f} -> {float(a):.1f}" for b, a in zip(*both, strict=True)))
        for name, both in result.regimes.items()
    ]
    when = Table(
        "By regime, plain -> answered [mrad]",
        ("regime", *(f"joint {j + 1}" for j in range(result.servos.n))),
        regimes,
        names=("regime",),
    )
    findings = [
        (
            f.effect,
            "all" if f.joint is None else str(f.joint),
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
        names=("effect",),
        words=("size (95 %)", "or"),
        note="error in windows of 2 s when all else is fitted without the effect, and with it",
    )
    return [where, when, *([which] if findings else [])]


def _size(size: Size) -> str:
    unit = "" if size.unit == "1" else f" {size.unit}"
    low, high = size.interval
    if math.isnan(low):
        return f"{size.name} {size.value:.3g}{unit}"
    return f"{size.name} {size.value:.3g} [{low:.3g}, {high:.3g}]{unit}"


def error_figure(record: PositionRecord) -> Figure:
    """RMS position errors of motions left out, joint by joint: the command, a plain servo and the
    answer."""
    joints = record.where.joints
    figure, axes = panel(2.4 + 0.85 * len(joints), 3.6)
    place = np.arange(len(joints))
    ways = (
        ("the command", GREY, [j.commanded_mrad for j in joints]),
        ("a plain servo", BEFORE, [j.plain_mrad for j in joints]),
        ("with the effects found", AFTER, [j.answered_mrad for j in joints]),
    )
    for k, (label, colour, errors) in enumerate(ways):
        axes.bar(place + 0.27 * (k - 1), errors, 0.25, color=colour, label=label)
    axes.set_xticks(place, [f"joint {j.joint + 1}" for j in joints])
    axes.grid(axis="x", visible=False)
    axes.set_ylabel("position error, RMS [mrad]")
    return finish(figure, f"{record.robot}: whole motions, left out of the fit", axes, columns=3)


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
    return joint_lines(title, "position [rad]", t, curves, x)[0]
