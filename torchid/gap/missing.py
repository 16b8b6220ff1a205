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

LONGEST = 64
"""Missing rows in a row beyond which the earlier ones are forgotten."""


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
        size: (n, N) of the noise at each row, relative to the whitener's.
    """

    def __init__(
        self,
        whitener: Whitener,
        keep: Bool[Tensor, "n N"],
        size: Float[Tensor, "n N"] | None = None,
    ):
        self._whitener = whitener
        self._size = size
        self._clusters = [_clusters(whitener, j, own) for j, own in enumerate(keep)]

    def __call__(self, x: Float[Tensor, "*batch N"], joint: int) -> Float[Tensor, "*batch N"]:
        """Whitened rows of a joint, orthogonal to any impulse at a row that does not count."""
        out = self._whitener.apply(x, joint)
        if self._size is not None:
            out /= self._size[joint]
        for rows in self._clusters[joint].silent:
            out[..., rows] = 0.0
        for cluster in self._clusters[joint].clusters:
            part = out[..., cluster.rows]
            out[..., cluster.rows] = part - (part @ cluster.basis) @ cluster.basis.T
        return out


@dataclass(frozen=True)
class Missing:
    """What is missing of one joint: clusters, and the insides of long rests, which are zero."""

    clusters: tuple[Cluster, ...]
    silent: tuple[slice, ...]


def _clusters(whitener: Whitener, joint: int, keep: Bool[Tensor, " N"]) -> Missing:
    """Clusters of the missing rows of one joint, trajectory by trajectory.

    Of a long rest only the last rows matter for what follows: the whitener's memory fades.
    """
    out, silent = [], []
    for bounds in whitener.bounds:
        missing = []
        for run in _runs((torch.nonzero(~keep[bounds]).flatten() + bounds.start).tolist()):
            if len(run) > LONGEST:
                silent.append(slice(run[0], run[-LONGEST]))
            missing += run[-LONGEST:]
        group: list[int] = []
        for row in [*missing, None]:
            if group and (row is None or row > group[-1] + whitener.order):
                out.append(_cluster(whitener, joint, group, bounds))
                group = []
            if row is not None:
                group.append(row)
    return Missing(tuple(out), tuple(silent))


def _runs(rows: list[int]) -> list[list[int]]:
    """Contiguous stretches."""
    out: list[list[int]] = []
    for row in rows:
        if out and row == out[-1][-1] + 1:
            out[-1].append(row)
        else:
            out.append([row])
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
