"""Whether a law is the same everywhere: by which factor each part of the data wants it.

Only the part of the effect's torque is looked at that nothing else which is fitted can make; see
`torchid.results.replication`.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchid.design.columns import Columns
from torchid.design.segments import Samples
from torchid.gap.search.evidence import prior_of
from torchid.gap.search.solve import Solution
from torchid.results.replication import MotionScale, Replication, replication_of
from torchid.statistics.odds import Factors
from torchid.typing import Bool, Float, Tensor

PART = 10.0
"""Length of a part of a longer trajectory [s]: several motions of a joint, and many of the
residual's correlation times."""


@dataclass(frozen=True, eq=False)
class OwnTorque:
    """Torque of a term that nothing else which is fitted can make, and what the model leaves; both
    in units in which what an independent sample leaves is one.

    Attributes:
        torque, left: (n, N).
    """

    torque: Float[Tensor, "n N"]
    left: Float[Tensor, "n N"]

    def factors(self, parts: Sequence[Bool[Tensor, " N"] | slice]) -> Factors:
        """Of each part of the data; of those that hold nothing of the term infinitely unsure."""
        out = []
        for rows in parts:
            torque = self.torque[:, rows]
            information = max(float(torque.square().sum()), 1e-300)
            scale = 1 + float((torque * self.left[:, rows]).sum()) / information
            out.append((scale, information**-0.5))
        return out

    def own_factors(self, parts: Sequence[slice]) -> Factors:
        """The same, as unsure as what each part leaves at its own factor, not at that of all."""
        whole = self.left.square().mean(1).clamp(min=1e-300)
        out = []
        for rows, (scale, std) in zip(parts, self.factors(parts), strict=True):
            torque = self.torque[:, rows]
            left = (self.left[:, rows] - (scale - 1) * torque).square().mean(1) / whole
            noise = float((torque.square().sum(1) * left).sum())
            out.append((scale, std**2 * noise**0.5 if noise > 0 else std))
        return out


def own_torque(solution: Solution, *numbers: int) -> OwnTorque:
    """Of some terms of a solution together, by their numbers."""
    # Their coefficients, and less of the others' what they would make in their place.
    x = torch.zeros(len(solution.a), dtype=torch.float64)
    others = torch.ones(len(x), dtype=torch.bool)
    for k in numbers:
        x[solution.at(k)] = solution.values[k]
        others[solution.at(k)] = False
    rest = [t for i, t in enumerate(solution.terms) if i not in numbers]
    if rest:
        gram, right = solution.products[others], solution.products[others][:, ~others]
        x[others] = -prior_of(rest).solve(gram[:, others], right @ x[~others]).x
    weight = solution.weight.sqrt().unsqueeze(1)
    return OwnTorque(torch.tensordot(x, solution.a, 1) * weight, solution.left * weight)


def replication(own: OwnTorque, solution: Solution, k: int, samples: Samples) -> Replication | None:
    """By which factor each motion wants a term of a solution; None of what happened once or changes
    with time, and where fewer than two parts can tell.

    Args:
        own: torque of the term.
        solution: with k the number of the term among its terms.
        samples: of the log.
    """
    term = solution.terms[k]
    if term.inertial or any(e.event or e.family == "time" for e in term.effects):
        return None
    places = motions(samples)
    factors = own.own_factors([rows for _, rows in places])
    return replication_of(
        [MotionScale(*name, *f) for (name, _), f in zip(places, factors, strict=True)]
    )


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


def regimes(
    columns: Columns, joint: int, keep: Bool[Tensor, " N"]
) -> list[list[Bool[Tensor, " N"]]]:
    """The samples in parts, in several ways: thirds of a joint's travel, of its speed, of its load
    and of the time, and its two directions.

    Args:
        columns: at the model whose load counts.
        joint: from 0.
        keep: samples that count.
    """
    samples = columns.samples
    parts = [
        torch.stack([m.q[:, joint], m.dq[:, joint], m.require("torque", "a load")[:, joint]])
        for m in columns.motions
    ]
    q, dq, load = samples.of(parts)
    keep = keep if bool(keep.any()) else torch.ones_like(keep)
    out = [[dq < 0, dq > 0]]
    for x in (q, dq.abs(), load.abs(), samples.t):
        low, high = torch.quantile(x[keep], torch.tensor([1 / 3, 2 / 3], dtype=x.dtype))
        out.append([x <= low, (x > low) & (x <= high), x > high])
    return out
