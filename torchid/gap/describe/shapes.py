"""Shapes of causes as free numbers: by how much torque changes with a Stribeck speed, an exponent
or a wave number, beside the coefficients.

A shape that a search has refined is as much an estimate as a coefficient. So it is fitted with
them, along its slope, and what it leaves open is in their standard deviations (Seber and Wild 1989,
Nonlinear Regression, section 2.1).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import torch

from torchid.design.columns import Columns
from torchid.effects.base import JointEffect
from torchid.typing import Float, Tensor

FINE = 5
"""Level of the search's refinement, each three times as fine, at which a slope is taken."""


@dataclass(frozen=True, eq=False)
class FreeShape:
    """A shape of a part of a corrected model, at an estimate.

    Attributes:
        part: number of the part.
        effect: of which it is a field.
        name: of the shape.
        std: before the log is seen: a quarter of its range, of what is refined in ratios as a share
            of the value.
        near: a little smaller, and a little larger.
        ends: as far as a step goes: within the grid's step, and the range.
        slope: (n, N) torque per unit of it.
    """

    part: int
    effect: JointEffect
    name: str
    std: float
    near: tuple[float, float]
    ends: tuple[float, float]
    slope: Float[Tensor, "n N"]

    @property
    def value(self) -> float:
        """The estimate."""
        return float(getattr(self.effect, self.name))

    @property
    def known(self) -> str:
        """Its name among all of an arm: `vs3`."""
        places = [s.name for s in self.effect.shapes]
        return self.effect.shape_names()[places.index(self.name)]

    @property
    def around(self) -> tuple[JointEffect, JointEffect]:
        """The effect with the smaller and the larger shape."""
        low, high = (shaped(self.effect, self.name, x) for x in self.near)
        return low, high


def shaped(effect: JointEffect, name: str, value: float) -> JointEffect:
    """An effect with one shape at another value."""
    return replace(effect, **{name: value})  # type: ignore[arg-type]


def free_shapes(
    part: int, effect: JointEffect, values: Float[Tensor, " C"], at: Columns
) -> Iterator[FreeShape]:
    """Shapes of an effect that a search refines: none of which there is a choice alone, and none of
    zero, which is a simpler law.

    Args:
        part: number of the part that the effect is.
        effect: with shapes at the estimate.
        values: its coefficients.
        at: columns at the corrected model.
    """
    levels = [effect.finer(at.motions, level, at.samples.cutoff) for level in (FINE, 0)]
    for p, shape in enumerate(effect.shapes):
        near, ends = ((float(x[:, p].min()), float(x[:, p].max())) for x in levels if x is not None)
        value = effect.shape_values[p]
        if value == 0 or not near[0] < near[1]:
            continue
        low, high = (
            torch.tensordot(values, at.on_all_joints(shaped(effect, shape.name, x)), 1)
            for x in near
        )
        if shape.logarithmic:
            std = abs(value) * math.log(shape.high / shape.low) / 4
        else:
            std = (shape.high - shape.low) * shape.size(at.motions, effect.joint) / 4
        slope = (high - low) / (near[1] - near[0])
        yield FreeShape(part, effect, shape.name, std, near, ends, slope)
