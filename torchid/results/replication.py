"""Whether a cause is the same in every motion.

A cause fitted to all motions at once may be what one of them wanted. Each motion, or part of one,
is asked by which factor it wants the whole cause: 1 is as it was fitted, 0 not at all. The factors
of n parts vary by more than their standard deviations where the law is another from motion to
motion; that spread (DerSimonian and Laird 1986) widens the prediction of the next motion.
"""

import math
from collections.abc import Sequence

import torch

from torchid.results.record import Part, Real
from torchid.statistics.criteria import SAME_FACTOR, TELLING_STD
from torchid.typing import Tensor


class MotionScale(Part, frozen=True):
    """By which factor a part of the data wants an effect, 1 being as it was fitted to all.

    Attributes:
        trajectory, from_s, to_s: which part.
        scale, std: the factor.
    """

    trajectory: str
    from_s: float
    to_s: float
    scale: Real
    std: float


class Replication(Part, frozen=True, kw_only=True):
    """Whether an effect is the same in every motion.

    Attributes:
        motions: part by part.
        mean: of the parts that can tell.
        spread: standard deviation between these parts, beyond that of each.
        next_std: of the factor in the next part.
        repeats, asked: in how many of the trajectories that can tell it has the same sign and size;
            of the parts of a log of one trajectory.
    """

    motions: tuple[MotionScale, ...]
    mean: Real
    spread: Real
    next_std: Real
    repeats: int
    asked: int


def repeat_words(found: Replication | None) -> str:
    """`5 of 6`: motions that want the effect with the same sign and size, of those that can show
    it; of a log of one motion its stretches."""
    if found is None:
        return "-"
    one = len({m.trajectory for m in found.motions}) == 1
    return f"{found.repeats} of {found.asked}{' stretches' if one else ''}"


def replication_of(scales: Sequence[MotionScale]) -> Replication | None:
    """The factors of all parts together; None where fewer than two can tell."""
    telling = [s for s in scales if s.std <= TELLING_STD]
    if len(telling) < 2:
        return None
    x, v = _factors(telling)
    spread = excess_std(x, v)
    w = 1 / (v + spread**2)
    mean = float((w * x).sum() / w.sum())
    # Motions that are asked: all parts of a trajectory are one.
    names = dict.fromkeys(s.trajectory for s in scales)
    if len(names) > 1:
        each = [_factors([s for s in scales if s.trajectory == name]) for name in names]
        v = torch.stack([1 / (1 / own).sum() for _, own in each])
        x = torch.stack([(own / var).sum() / (1 / var).sum() for own, var in each])
        x, v = x[v <= TELLING_STD**2], v[v <= TELLING_STD**2]
    # The same sign and nearly the size of all, as far as the part can tell.
    slack = 2 * v.sqrt()
    same = (x > 0) & (x + slack >= mean / SAME_FACTOR) & (x - slack <= SAME_FACTOR * mean)
    return Replication(
        motions=tuple(scales),
        mean=mean,
        spread=spread,
        next_std=math.sqrt(float(1 / w.sum()) + spread**2),
        repeats=int(same.sum()),
        asked=len(x),
    )


def _factors(scales: Sequence[MotionScale]) -> tuple[Tensor, Tensor]:
    """Factors and their variances (K,)."""
    x, std = torch.tensor([(s.scale, s.std) for s in scales], dtype=torch.float64).unbind(1)
    return x, std**2


def excess_std(x: Tensor, variances: Tensor) -> float:
    """Standard deviation of n quantities beyond their own (DerSimonian and Laird 1986, eq. 8)."""
    w = 1 / variances
    mean = (w * x).sum() / w.sum()
    excess = (w * (x - mean).square()).sum() - (len(x) - 1)
    return float((excess / (w.sum() - w.square().sum() / w.sum())).clamp(min=0).sqrt())
