"""Rows that say nothing, taken out of whitened rows.

At rest static friction holds any torque, and at a reversal a joint may stick for a moment: there
the measured torque is not what any law of motion says. Those rows are missing data. Whitening mixes
a row into the ones after it, so zeroing them is not enough: an unknown impulse at every missing row
is projected out of everything, which is generalised least squares on the rows that are left. An
impulse reaches as far as the whitener remembers, so impulses form short clusters.
"""

from dataclasses import dataclass

import torch

from torchid.gap.whitener import Whitener
from torchid.typing import Bool, Float, Tensor


@dataclass(frozen=True)
class Cluster:
    """Rows that some impulses reach, and an orthonormal basis of those impulses."""

    rows: slice
    basis: Float[Tensor, "R m"]


class WhiteRows:
    """Whitens rows and leaves out those that do not count.

    Args:
        whitener: of the noise.
        keep: (n, N) rows that count.
    """

    def __init__(self, whitener: Whitener, keep: Bool[Tensor, "n N"]):
        self._whitener = whitener
        self._clusters = [_clusters(whitener, j, own) for j, own in enumerate(keep)]

    def __call__(self, x: Float[Tensor, "*batch N"], joint: int) -> Float[Tensor, "*batch N"]:
        """Whitened rows of a joint, orthogonal to any impulse at a row that does not count."""
        out = self._whitener.apply(x, joint)
        for cluster in self._clusters[joint]:
            part = out[..., cluster.rows]
            out[..., cluster.rows] = part - (part @ cluster.basis) @ cluster.basis.T
        return out


def _clusters(whitener: Whitener, joint: int, keep: Bool[Tensor, " N"]) -> list[Cluster]:
    """Clusters of the missing rows of one joint, trajectory by trajectory."""
    out = []
    for bounds in whitener.bounds:
        missing = (torch.nonzero(~keep[bounds]).flatten() + bounds.start).tolist()
        group: list[int] = []
        for row in [*missing, None]:
            if group and (row is None or row > group[-1] + whitener.order):
                out.append(_cluster(whitener, joint, group, bounds))
                group = []
            if row is not None:
                group.append(row)
    return out


def _cluster(whitener: Whitener, joint: int, group: list[int], bounds: slice) -> Cluster:
    rows = slice(group[0], min(group[-1] + whitener.order + 1, bounds.stop))
    # The whitener's start matters where the cluster begins with its trajectory.
    first = max(bounds.start, rows.start - whitener.order)
    local = whitener.on((slice(0, rows.stop - first),))
    impulses = torch.zeros(len(group), rows.stop - first, dtype=torch.float64)
    impulses[torch.arange(len(group)), torch.tensor(group) - first] = 1.0
    white = local.apply(impulses, joint)[:, rows.start - first :]
    return Cluster(rows, torch.linalg.qr(white.T).Q)
