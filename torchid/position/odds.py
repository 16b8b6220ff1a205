"""How sure an effect of a servo is, as of a cause of torques (see `torchid.statistics.odds`)."""

import math

from torchid.results.replication import Replication
from torchid.statistics.criteria import EXPECTED
from torchid.statistics.odds import probability, unknown_rise


def effect_sure(
    without: float,
    with_it: float,
    least: float,
    numbers: int,
    replication: Replication | None = None,
    *,
    rows: float,
    looks: int,
) -> float:
    """Probability of an effect, or of the set with what does as well in its place.

    Args:
        without, with_it: losses of all motions [rad^2].
        least: loss that calls for no cause [rad^2].
        numbers: that it has.
        replication: by which factor motions want it; None where that is not asked.
        rows: as many independent errors as the motions have [1].
        looks: effects that were looked at, at all joints.
    """
    risen = rows * math.log(max(without, 1e-300) / max(with_it, 1e-300))
    ways = []
    if replication is not None and replication.repeats < replication.asked:
        # A servo's effect is not linear: factors count where they differ by more than that makes.
        ways.append([(m.scale, m.std) for m in replication.motions])
    paid = 2 * math.log(looks / EXPECTED) + numbers * math.log(max(rows, 2.0))
    misfit = max(with_it - least, 1e-12 * with_it + 1e-300)
    ratio = (without - with_it) / misfit
    beyond = unknown_rise(ratio, misfit / max(without, misfit), ways)
    return probability([paid - risen, beyond])
