"""Whether a law is the same in every motion: by which factor each part of the data wants it.

Only the part of the effect's torque is looked at that nothing else which is fitted can make; see
`torchid.results.replication`.
"""

import itertools

import torch

from torchid.design.segments import Samples
from torchid.gap.search.evidence import prior_of
from torchid.gap.search.solve import Solution
from torchid.results.replication import MotionScale, Replication, replication_of

PART = 10.0
"""Length of a part of a longer trajectory [s]: several motions of a joint, and many of the
residual's correlation times."""


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
    return replication_of(scales)


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
