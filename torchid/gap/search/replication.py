"""Whether a law is the same in every motion.

A cause fitted to all motions at once may be what one of them wanted. Each part of the data is asked
by which factor it wants the whole effect: 1 is as it was fitted, 0 not at all. Only the part of the
effect's torque is looked at that nothing else which is fitted can make. The factors of n parts vary
by more than their standard deviations where the law is another from motion to motion; that spread
(DerSimonian and Laird 1986) belongs into what is said of the next motion.
"""

import itertools
import math

import torch

from torchid.design.segments import Samples
from torchid.gap.record import MotionScale, Replication
from torchid.gap.search.evidence import prior_of
from torchid.gap.search.solve import Solution
from torchid.typing import Tensor

PART = 10.0
"""Length of a part of a longer trajectory [s]: several motions of a joint, and many of the
residual's correlation times."""

FACTOR = 2.0
"""Factor within which sizes are the same law [1]; friction laws vary by 1.02 - 1.04 between motions
that have them, effects that are not there by 1.3 - 1.6."""

TELLS = 0.5
"""Standard deviation of a factor up to which a part can tell whether the effect is there: two of
them from 0 to 1."""


def replication(solution: Solution, k: int, samples: Samples) -> Replication | None:
    """By which factor each part of the data wants a term of a solution; None of what happened once
    or changes with time, and where fewer than two parts can tell.

    Args:
        solution: columns at the corrected model, and what it leaves.
        k: number of the term among the solution's.
        samples: of the log.
    """
    term = solution.terms[k]
    if term.inertial or any(e.event or e.family == "time" for e in term.effects):
        return None
    # Torque of the term, without what the others can make in its place.
    sizes = [len(v) for v in solution.values]
    own = slice(sum(sizes[:k]), sum(sizes[: k + 1]))
    weight = solution.weight.sqrt().unsqueeze(1)
    torque = torch.tensordot(solution.values[k], solution.a[own], 1) * weight
    others = torch.cat([solution.a[: own.start], solution.a[own.stop :]]) * weight
    rest = [t for i, t in enumerate(solution.terms) if i != k]
    flat = others.flatten(1)
    held = prior_of(rest).solve(flat @ flat.T, flat @ torque.flatten()).x if rest else flat.sum(1)
    alone = torque - torch.tensordot(held, others, 1)
    left = solution.left * weight
    scales = []
    for (name, start, stop), rows in parts(samples):
        information = float(alone[:, rows].square().sum())
        if information > 0:
            scale = 1 + float((alone[:, rows] * left[:, rows]).sum()) / information
            scales.append(MotionScale(name, start, stop, scale, information**-0.5))
    telling = [s for s in scales if s.std <= TELLS]
    if len(telling) < 2:
        return None
    x = torch.tensor([s.scale for s in telling], dtype=torch.float64)
    v = torch.tensor([s.std**2 for s in telling], dtype=torch.float64)
    spread = between(x, v)
    w = 1 / (v + spread**2)
    mean = float((w * x).sum() / w.sum())
    # The same sign and nearly the size of all, as far as the part can tell.
    slack = 2 * v.sqrt()
    same = (x > 0) & (x + slack >= mean / FACTOR) & (x - slack <= FACTOR * mean)
    return Replication(
        motions=tuple(scales),
        mean=mean,
        spread=spread,
        next_std=math.sqrt(float(1 / w.sum()) + spread**2),
        repeats=int(same.sum()),
        asked=len(telling),
    )


def between(x: Tensor, variances: Tensor) -> float:
    """Standard deviation of n quantities beyond their own (DerSimonian and Laird 1986, eq. 8)."""
    w = 1 / variances
    mean = (w * x).sum() / w.sum()
    excess = (w * (x - mean).square()).sum() - (len(x) - 1)
    return float((excess / (w.sum() - w.square().sum() / w.sum())).clamp(min=0).sqrt())


def parts(samples: Samples) -> list[tuple[tuple[str, float, float], slice]]:
    """Name, start and end [s] of parts of about ten seconds of every trajectory, and their rows."""
    out = []
    for segment, own in zip(samples.segments, samples.bounds, strict=True):
        count = max(1, round((own.stop - own.start) * samples.interval / PART))
        ends = [own.start + (own.stop - own.start) * i // count for i in range(count + 1)]
        begin = float(samples.t[own.start])
        for a, b in itertools.pairwise(ends):
            times = samples.t[a:b] - begin
            out.append(((segment.name, float(times[0]), float(times[-1])), slice(a, b)))
    return out
