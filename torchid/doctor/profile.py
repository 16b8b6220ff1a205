"""The best value of a number in a hypothesis, with an interval that respects slow errors."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from torchid.doctor.cone import fit, shares
from torchid.doctor.hypothesis import Hypothesis, Judge
from torchid.doctor.samples import BLOCKS
from torchid.statistics.jackknife import from_left_out

Family = Callable[[float], Hypothesis]


@dataclass(frozen=True)
class Profile:
    """A number and what is known of it.

    Attributes:
        value: where the loss is lowest.
        low, high: 95 %, from leaving out one block of time after the other.
        gain: by how much the loss is lower than at the starting value.
    """

    value: float
    low: float
    high: float
    gain: float


def profile(
    judge: Judge, family: Family, grid: Sequence[float], start: float, step: float
) -> Profile:
    """Minimise the loss over one number: on a grid, then by parabolas, then by the jackknife.

    Args:
        judge: of the log.
        family: the hypothesis for each value.
        grid: first values tried; `start` is one more.
        start: the value that would be fine.
        step: distance of the values that a parabola goes through.
    """

    def loss(x: float) -> float:
        return judge.score(family(x)).loss

    best = minimum(loss, (*grid, start), step)
    values = (best - step, best, best + step)
    normals = [judge.normal(family(x)) for x in values]
    weights = fit(normals[1], judge.cone).weights
    estimates = []
    for b in range(BLOCKS):
        others = [normal.without(b) for normal in normals]
        errors = [shares(fit(x, judge.cone, weights=weights).variance, x.spread) for x in others]
        estimates.append(_vertex(values, [float(np.log(e).sum()) for e in errors]))
    left_out = torch.tensor(estimates, dtype=torch.float64).unsqueeze(1)
    low, high = from_left_out(left_out).interval(left_out.new_tensor([best]))[0].tolist()
    return Profile(best, low, high, loss(start) - loss(best))


def minimum(loss: Callable[[float], float], grid: Sequence[float], step: float) -> float:
    """The lowest point of a grid, refined by three parabolas through points `step` apart."""
    at = {x: loss(x) for x in grid}
    best = min(at, key=lambda x: at[x])
    for _ in range(3):
        values = (best - step, best, best + step)
        at |= {x: loss(x) for x in values if x not in at}
        best = _vertex(values, [at[x] for x in values])
    at[best] = loss(best)
    return min(at, key=lambda x: at[x])


def _vertex(values: Sequence[float], losses: Sequence[float]) -> float:
    """The lowest point of the parabola through three points, at most two steps away."""
    a, b, c = losses
    step = values[2] - values[1]
    curve = a - 2 * b + c
    if curve <= 0:
        return values[int(np.argmin(losses))]
    return float(values[1] + np.clip(0.5 * (a - c) / curve, -2.0, 2.0) * step)
