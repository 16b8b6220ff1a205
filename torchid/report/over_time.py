"""Signals of the arm and of two models over time: one drawing for every kind of log."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.position.diagnosis import PositionDiagnosis
from torchid.report.colours import AFTER, BEFORE, GREY, INK
from torchid.report.panels import Figure, finish, panel, worst_stretch
from torchid.results.words import joint_labels, span
from torchid.robot.model import Robot, error_unit, joint_unit
from torchid.typing import Bool, Float, Tensor

NARROW = 4.2
"""Width of a figure on a phone [inch]."""
WINDOW_S = 12.0
"""Of a run that is shown first, where a model errs most [s]."""


@dataclass(frozen=True, eq=False)
class Run:
    """One run.

    Attributes:
        name: of the run.
        t: (T,) [s].
        measured: (T, n) of the arm.
        before, after: (T, n) of both models, or None; NaN where there is nothing.
        command: (T, n) what the arm was asked for.
        aside: (T, n) instants that do not count.
        moving: (T, n) instants of motion, of which as many as may be are shown first.
    """

    name: str
    t: Float[Tensor, " T"]
    measured: Float[Tensor, "T n"]
    before: Float[Tensor, "T n"] | None = None
    after: Float[Tensor, "T n"] | None = None
    command: Float[Tensor, "T n"] | None = None
    aside: Bool[Tensor, "T n"] | None = None
    moving: Bool[Tensor, "T n"] | None = None

    def window(self, joint: int) -> tuple[slice, float]:
        """Rows of `WINDOW_S` where the model before errs most on a joint (without models, where the
        joint is farthest from its mean), and the mean square of that."""
        apart = self.measured - (self.measured.mean(0) if self.before is None else self.before)
        squares = apart[:, joint].square().nan_to_num()
        if self.aside is not None:
            squares = squares * ~self.aside[:, joint]
        if self.moving is not None:
            squares = squares * self.moving[:, joint]
        step = float(self.t.diff().median()) if len(self.t) > 1 else 1.0
        return worst_stretch(squares, max(2, round(WINDOW_S / step)))


@dataclass(frozen=True, eq=False)
class OverTime:
    """Arm and models, joint by joint and run by run; below them what parts them.

    Attributes:
        quantity: that is shown: `torque`.
        runs: some.
        joints, units: names and units, n.
        order: joints, the one with the largest error first.
        models: names of the models before and after; none where the arm is shown alone.
        error: unit of the errors, and how many of it one of the joint's units is; the joint's own
            unit if None.
        noise: (n, 2) ends of its RMS in the joints' units, the upper one NaN where nothing bounds
            it; or None.
        where: added to the title.
    """

    quantity: str
    runs: Sequence[Run]
    joints: Sequence[str]
    units: Sequence[str]
    order: Sequence[int]
    models: tuple[str, ...]
    error: tuple[str, float] | None = None
    noise: Float[Tensor, "n 2"] | None = None
    where: str = ""

    def draw(self, joint: int | None = None, width: float = 10.0) -> Figure:
        """A joint (from 0; the worst, if None) in the run and at the time where it is worst;
        `width` [inch]."""
        joint = self.order[0] if joint is None else joint
        # Where the model before errs most on the joint.
        run = max(self.runs, key=lambda run: run.window(joint)[1])
        whole, _ = run.window(joint)
        # 4000: instants at most
        rows = slice(whole.start, whole.stop, max(1, (whole.stop - whole.start) // 4000))
        t = run.t[rows].numpy()
        measured = run.measured[rows, joint].numpy()
        models = [x[rows, joint].numpy() for x in (run.before, run.after) if x is not None]
        if models:
            figure, panels = panel(width, 4.9, 2, 1, sharex=True, height_ratios=(3, 2))
        else:
            figure, panels = panel(width, 3.0, 1, 1, squeeze=False)
        upper, *below = panels.ravel()
        if run.command is not None:
            command = run.command[rows, joint].numpy()
            upper.plot(t, command, color=GREY, linewidth=1.2, label="command")
        upper.plot(t, measured, color=INK, linewidth=2.2, label="arm, measured")
        looks = ((BEFORE, "solid"), (AFTER, (0, (5, 1.5))))
        for x, name, (colour, dashes) in zip(models, self.models, looks, strict=False):
            upper.plot(t, x, color=colour, linewidth=1.3, label=name, linestyle=dashes)
        aside = None if run.aside is None else run.aside[rows, joint].numpy()
        if aside is not None and aside.any():
            texts = ("not counted: at rest, at a reversal", None)
            for axes, text in zip((upper, *below), texts, strict=False):
                axes.fill_between(
                    t, 0, 1, where=aside, transform=axes.get_xaxis_transform(), color=GREY,
                    alpha=0.22, linewidth=0, label=text,
                )  # fmt: skip
        for lower in below:
            self._draw_errors(lower, joint, t, [measured - x for x in models])
        upper.set_ylabel(f"{self.quantity} [{self.units[joint]}]")
        panels.ravel()[-1].set_xlabel(f"time in {run.name} [s]")
        upper.set_xlim(t[0], t[-1])
        where = self.where if width > NARROW else ""
        title = f"joint {self.joints[joint]}: {self.quantity}{where}"
        return finish(figure, title, upper, *below, columns=5 if width > NARROW else 1)

    def _draw_errors(self, axes: Any, joint: int, t: np.ndarray, off: Sequence[np.ndarray]) -> None:
        """What parts a joint from each model, over the noise."""
        unit, scale = self.error or (self.units[joint], 1.0)
        if self.noise is not None:
            draw_noise(axes, (scale * self.noise[joint]).tolist())
        axes.axhline(0, color=GREY, linewidth=0.8)
        for x, colour in zip(off, (BEFORE, AFTER), strict=True):
            axes.plot(t, scale * x, color=colour, linewidth=1.2)
        axes.set_ylabel(f"arm - model [{unit}]")


def draw_noise(axes: Any, ends: Sequence[float]) -> None:
    """A band over an error: the noise as the answer says it."""
    low, high = ends
    width = low if math.isnan(high) else high
    label = f"noise, RMS {span(ends, 2)}"
    axes.axhspan(-width, width, color=INK, alpha=0.12, linewidth=0, label=label)


def _worst_first(d: TorqueDiagnosis) -> list[int]:
    """Joints, the one with the largest share of the gap first."""
    return [gap.joint for gap in sorted(d.record.where.joints, key=lambda gap: -gap.share)]


def _units(robot: Robot) -> list[str]:
    """Unit of each joint's position."""
    return ["m" if joint_unit(robot, j) == "N" else "rad" for j in range(robot.n)]


def torque_over_time(d: TorqueDiagnosis) -> OverTime:
    """Torque of the arm and of both models, on data that was not fitted."""
    runs = []
    for trace in d.traces:
        valid = trace.valid[:, None]
        measured, before, after = (
            torch.where(valid, x, torch.nan) for x in (trace.measured, trace.before, trace.after)
        )
        t = torch.arange(len(trace.valid), dtype=torch.float64) / trace.rate
        # What does not count for how far the gap shrinks: a joint at rest, or where it may stick.
        runs.append(Run(trace.name, t, measured, before, after, aside=valid & ~trace.counting))
    return OverTime(
        "torque", runs, joint_labels(d.robot.joint_names),
        [joint_unit(d.robot, j) for j in range(d.robot.n)],
        _worst_first(d),
        ("model as given", "corrected model"), noise=d.floor.ends, where=" on data not fitted",
    )  # fmt: skip


def motion_over_time(d: TorqueDiagnosis | PositionDiagnosis) -> OverTime:
    """Positions of the arm: of torques as measured; of commands beside those of both models, in
    whole motions left out."""
    if isinstance(d, TorqueDiagnosis):
        seconds = (torch.arange(len(x.valid), dtype=torch.float64) / x.rate for x in d.traces)
        return OverTime(
            "position",
            [Run(x.name, t, x.motion.q) for x, t in zip(d.traces, seconds, strict=True)],
            joint_labels(d.robot.joint_names), _units(d.robot), _worst_first(d), (),
        )  # fmt: skip
    data, (before, answered), runs = d.data, d.errors, []
    log = data.log
    for k, (a, b) in enumerate(
        zip(data.tracks.first.tolist(), data.tracks.last.tolist(), strict=True)
    ):
        rows = slice(a, b + 1)
        q = log.q[rows]
        command = None if log.u is None else log.u[rows]
        speed = torch.gradient(q, dim=0)[0].abs()
        # 0.1: share of a joint's RMS speed below which it rests
        runs.append(
            Run(log.names[int(log.trajectory[a])] if len(log.names) else f"motion {k + 1}",
                log.t[rows] - log.t[a], q, q + before[rows], q + answered[rows], command,
                moving=speed > 0.1 * speed.square().mean(0).sqrt())
        )  # fmt: skip
    moving = [j for j in range(data.robot.n) if not bool(d.still[j])]
    order = sorted(moving, key=lambda j: -float(d.before.whole[j])) or [0]
    units = _units(data.robot)
    units = [u if float(s) == 1 else "log's unit" for u, s in zip(units, data.scale, strict=True)]
    return OverTime(
        "position", runs, joint_labels(data.robot.joint_names), units, order,
        ("plain servo" if d.file is None else "the file's servo", "corrected servo"),
        (error_unit(data.robot), 1e3),
        where=", in a motion left out",
    )  # fmt: skip
