"""Whether a law is the same everywhere: by which factor each part of the data wants it.

Only the part of the effect's torque is looked at that nothing else which is fitted can make; see
`torchid.results.replication`.
"""

import itertools
from collections.abc import Sequence

import torch

from torchid.design.segments import Samples
from torchid.gap.describe.model import Solution, prior_of
from torchid.results.agreement import MotionScale, Replication
from torchid.results.replication import replication_of
from torchid.typing import Float, Tensor

PART = 10.0
"""Length of a part of a longer trajectory [s]: several motions of a joint, and many of the
residual's correlation times."""


def replication(solution: Solution, k: int, samples: Samples) -> Replication | None:
    """By which factor each motion wants a part of a solution; None of what happened once or changes
    with time, and where fewer than two parts of the data can tell.

    Args:
        solution: of which.
        k: number of the part.
        samples: of the log.
    """
    part = solution.parts[k]
    if part.inertial or any(e.event or e.family == "time" for e in part.effects):
        return None
    torque = own_torque(solution, k)
    left = solution.left * solution.weight.sqrt().unsqueeze(1)
    places = motions(samples)
    found = factors(torque, left, [rows for _, rows in places])
    return replication_of(
        [MotionScale(*name, *f) for (name, _), f in zip(places, found, strict=True)]
    )


def own_torque(solution: Solution, k: int) -> Float[Tensor, "n N"]:
    """Torque of a part that nothing else which is fitted can make, in units in which what an
    independent sample leaves is one."""
    weight = solution.weight.sqrt().unsqueeze(1)
    flat = (solution.a * weight).flatten(1)
    # Its coefficients, and less of the others' what they would make in its place.
    x = torch.zeros(len(flat), dtype=torch.float64)
    own = solution.at(k)
    x[own] = solution.values[k]
    others = torch.ones(len(x), dtype=torch.bool)
    others[own] = False
    if bool(others.any()):
        known = prior_of(solution.parts).squares[others][:, others]
        gram, right = flat[others] @ flat[others].T + known, flat[others] @ (x @ flat)
        size = gram.diagonal().clamp(min=1e-300).sqrt()
        unit = gram / size / size.unsqueeze(1)
        x[others] = -(torch.linalg.pinv(unit, hermitian=True, rtol=1e-12) @ (right / size)) / size
    return torch.tensordot(x, solution.a, 1) * weight


def factors(
    torque: Float[Tensor, "n N"], left: Float[Tensor, "n N"], parts: Sequence[slice]
) -> list[tuple[float, float]]:
    """The factor of each part of the data, and its standard deviation: as unsure as what the part
    leaves at its own factor, not at that of all; of a part that holds nothing infinitely.

    Args:
        torque, left: (n, N) of the cause, and what the model leaves.
        parts: of the samples.
    """
    whole, out = left.square().mean(1).clamp(min=1e-300), []
    for rows in parts:
        own, rest = torque[:, rows], left[:, rows]
        information = max(float(own.square().sum()), 1e-300)
        scale = 1 + float((own * rest).sum()) / information
        beside = (rest - (scale - 1) * own).square().mean(1) / whole
        noise = float((own.square().sum(1) * beside).sum())
        out.append((scale, noise**0.5 / information if noise > 0 else information**-0.5))
    return out


def motions(samples: Samples) -> list[tuple[tuple[str, float, float], slice]]:
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
