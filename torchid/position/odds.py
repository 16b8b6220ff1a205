"""How sure an effect of a servo is, as of a cause of torques: a mean over logs that might have been
(`torchid.statistics.bagging`), beside something unknown (`torchid.statistics.odds`)."""

import math

import torch

from torchid.results.agreement import Replication
from torchid.simulation.servo_loop import Windows
from torchid.statistics.bagging import Draws, bagged
from torchid.statistics.criteria import EXPECTED, ONE_TYPE, TELLING_STD
from torchid.statistics.odds import stands_in, unknown_rise
from torchid.typing import Float, Tensor

FEW = 3
"""Motions below which windows are drawn in their place."""


def drawn_windows(windows: Windows) -> Draws:
    """Logs that might have been: of other motions, or of other windows where they are few."""
    several = int(windows.motion.max()) + 1 >= FEW
    return Draws.of(windows.motion if several else torch.arange(len(windows.motion)))


def effect_sure(
    without: Float[Tensor, " W"],
    with_it: Float[Tensor, " W"],
    least: float,
    numbers: int,
    replication: Replication | None = None,
    *,
    rows: Float[Tensor, " W"],
    draws: Draws,
    looks: int,
    alike: float = 0.0,
) -> float:
    """Probability of an effect, or of the set with what does as well in its place.

    Args:
        without, with_it: losses of windows [rad^2].
        least: loss of all that calls for no cause [rad^2].
        numbers: that it has.
        replication: by which factor motions want it; None where that is not asked.
        rows: as many independent errors as each window has [1].
        draws: logs that might have been, of these windows.
        looks: effects that were looked at, at all joints.
        alike: rise of the effect by what other joints say of it (`alike_rises`).
    """
    before, after, many = draws.sums(torch.stack([without, with_it, rows])).unbind(1)
    risen = many * (before.clamp(min=1e-300) / after.clamp(min=1e-300)).log()
    all_rows, lost, kept = (float(x.sum()) for x in (rows, without, with_it))
    ways = []
    if replication is not None:
        # A servo's effect is not linear: motions that can hardly tell have any factor. The one that
        # tells most has the size that was fitted.
        telling = ((m.std, m.scale) for m in replication.motions if m.std <= TELLING_STD)
        ways.append([(scale, std) for std, scale in sorted(telling)[1:]])
    paid = 2 * math.log(looks / EXPECTED) + numbers * math.log(max(all_rows, 2.0))
    misfit = max(kept - least, 1e-12 * kept + 1e-300)
    ratio = (lost - kept) / misfit
    beyond = unknown_rise(ratio + alike, misfit / max(lost, misfit), ways)
    return bagged([(-risen, paid), (None, beyond)], draws)[0]


def alike_rises(values: Float[Tensor, " J"], std: Float[Tensor, " J"]) -> Float[Tensor, " J"]:
    """Rises of an effect by the size that it has on other joints: servos of one type have one size
    each, what stands in for something else has another on every joint.

    Args:
        values: sizes on the J joints that have it, of one sign.
        std: their standard deviations.
    """
    rises = torch.zeros_like(values)
    if len(values) < 2:
        return rises
    for j in range(len(values)):
        others = torch.arange(len(values)) != j
        weight = 1 / std[others].square().clamp(min=1e-300)
        mean = float((weight * values[others]).sum() / weight.sum())
        wide = math.hypot(float(std[j]), float(weight.sum()) ** -0.5)
        law = math.exp(-stands_in([(float(values[j]) / mean, wide / abs(mean))]))
        rises[j] = 2 * math.log(ONE_TYPE * law + 1 - ONE_TYPE)
    return rises
