"""Does the answer depend on which of the sets with one torque is the arm?

The torque cannot tell them apart, so every feasible set may be the true one. Each is taken for the
truth in turn.
"""

from dataclasses import dataclass

import numpy as np

from torchid.study.equal_torque.statistics import THIRDS
from torchid.wrenches.resampling import Array, cliffs_delta, spearman

Range = tuple[float, float, float]
"""Median over the truths, and the range of 95 % of them."""


@dataclass(frozen=True)
class OtherTruths:
    """The same question if another feasible set of equal torque were the arm.

    Every feasible set of the family is taken for the truth in turn.

    Attributes:
        kind: compared with the feasible sets.
        ratio: median error of the kind over that of the feasible sets.
        better: share of pairs of a set of the kind and a feasible set in which the infeasible one
            is nearer to the truth.
    """

    kind: str
    ratio: Range
    better: Range


@dataclass(frozen=True)
class FirmTruths:
    """Spearman's rho of degree and error among feasible sets, by how firm the truth is.

    Attributes:
        third: of the truths by their own degree, see `THIRDS`.
        rho: over these truths.
    """

    third: str
    rho: Range


def other_truths(
    kind: Array, degree: Array, distances: Array
) -> tuple[tuple[OtherTruths, ...], tuple[FirmTruths, ...]]:
    """Comparisons for every feasible set as the truth.

    Args:
        kind: (K,).
        degree: (K,).
        distances: (F, K) force error of each set if feasible set f, in their order, is the truth.
    """
    feasible = np.flatnonzero(kind == "feasible")
    others = distances[:, feasible]
    bare = others[~np.eye(len(feasible), dtype=bool)].reshape(len(feasible), -1)
    own = np.median(bare, 1)
    compared = []
    for name in dict.fromkeys(kind.tolist()):
        if name == "feasible":
            continue
        errors = distances[:, kind == name]
        ratio = np.median(errors, 1) / own
        better = [(1 - cliffs_delta(e, b)) / 2 for e, b in zip(errors, bare, strict=True)]
        compared.append(OtherTruths(name, _middle(ratio), _middle(np.array(better))))
    ranks = np.argsort(degree[feasible], kind="stable")
    firm = []
    for third, rows in zip(THIRDS, np.array_split(ranks, 3), strict=True):
        rho = []
        for k in rows:
            rest = np.delete(np.arange(len(feasible)), k)
            rho.append(spearman(degree[feasible][rest], others[k, rest]))
        firm.append(FirmTruths(third, _middle(np.array(rho))))
    return tuple(compared), tuple(firm)


def _middle(values: Array) -> Range:
    low, middle, high = np.nanpercentile(values, [2.5, 50, 97.5]).tolist()
    return middle, low, high
