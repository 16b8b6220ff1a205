"""Parameters of an effect: coefficients, which it is linear in, and shapes, which it is not."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import torch
from torch import Tensor

from torchid.effects.motion import Motion
from torchid.typing import Float

Scale = Literal["one", "speed", "torque", "travel"]
"""What the grid of a shape parameter is relative to: nothing, or the joint's 99 % speed, the 99 %
torque of its model, or its range of positions."""


QUANTILE_OF = 100_000
"""Samples that a quantile is taken of: all of a minute at 1 kHz, every so many of a longer log."""


@dataclass(frozen=True)
class Coefficient:
    """One coefficient of an effect that is linear in it.

    Attributes:
        name: as in files and tables, e.g. `Fv`.
        unit: for a revolute joint; for a prismatic one N replaces N m and m replaces rad.
        non_negative: whether physics forbids a negative value.
        meaning: one line.
        largest: size that it hardly exceeds on any arm, in `unit`: two standard deviations of what
            is expected before a log is seen; what seems larger is something else.
        least: below which it is on no arm, in `unit`, beside the sign that physics forbids.
    """

    name: str
    unit: str
    non_negative: bool
    meaning: str
    largest: float = math.inf
    least: float = -math.inf

    @property
    def range(self) -> tuple[float, float]:
        """Least and largest that it is on any arm, in `unit`."""
        return max(0.0 if self.non_negative else -math.inf, self.least), self.largest

    def unit_for(self, prismatic: bool) -> str:
        """The unit on this kind of joint."""
        if not prismatic:
            return self.unit
        return self.unit.replace("kg m^2", "kg").replace("N m", "N").replace("rad", "m")


@dataclass(frozen=True)
class Shape:
    """A parameter that an effect is not linear in.

    Attributes:
        name: as in files and tables, e.g. `vs`; also the name of the effect's field.
        unit: as Coefficient's.
        low, high: bounds, in units of `scale`.
        grid: where a search starts, in units of `scale`.
        scale: what bounds and grid are relative to.
        meaning: one line.
        logarithmic: whether to refine it in ratios rather than differences.
    """

    name: str
    unit: str
    low: float
    high: float
    grid: tuple[float, ...]
    meaning: str
    scale: Scale = "one"
    logarithmic: bool = True

    def size(self, motions: Sequence[Motion], joint: int) -> float:
        """What bounds and grid are relative to on a joint, in the shape's unit per unit of them.

        Args:
            motions: with torque, where `scale` is the torque.
            joint: from 0.
        """
        if self.scale == "one":
            return 1.0
        if self.scale == "travel":
            return max(1e-9, travel(motions, joint))
        torques = [m.require("torque", "a grid") for m in motions]
        x = [m.dq for m in motions] if self.scale == "speed" else torques
        size = torch.cat([s[:, joint] for s in x]).abs()
        return max(1e-9, float(torch.quantile(size[:: max(1, len(size) // QUANTILE_OF)], 0.99)))

    def around(
        self, value: float, level: int, size: float, step: float | None = None
    ) -> Float[Tensor, "7"]:
        """Seven values about one: within the grid's widest step, then a third of it, a ninth, ...

        Args:
            value: in the shape's unit.
            level: 0 for the whole step, ever finer with it.
            size: from `size`.
            step: the grid's step [the shape's unit]; of `grid` if None.
        """
        offsets = torch.linspace(-1, 1, 7, dtype=torch.float64)
        if step is None and self.logarithmic:
            ratio = max((b / a for a, b in pairwise(self.grid)), default=2.0)
            tried = value * (ratio ** (1 / 3**level)) ** offsets
        else:
            if step is None:
                step = max(b - a for a, b in pairwise(self.grid)) * size
            tried = value + offsets * step / 3**level
        return tried.clamp(self.low * size, self.high * size)


def travel(motions: Sequence[Motion], joint: int) -> float:
    """Range of a joint's positions over all motions [rad; m]."""
    q = torch.cat([m.q[:, joint] for m in motions])
    return float(q.max() - q.min())
