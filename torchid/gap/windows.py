"""Windows of time in which a force at the tool explains most of a residual."""

from collections.abc import Sequence

import torch

from torchid.typing import Float, Tensor

MOST_WINDOWS = 8


def best_windows(
    columns: Float[Tensor, "C n N"], r: Float[Tensor, "n N"], bounds: Sequence[slice]
) -> list[tuple[int, int]]:
    """Rows (first, last + 1) of the windows in which the columns explain most, one a length and
    overlap. Sums over windows are differences of running sums."""
    found: list[tuple[float, int, int]] = []
    products = (columns.unsqueeze(0) * columns.unsqueeze(1)).sum(2)
    pulls = (columns * r).sum(1)
    running = [torch.nn.functional.pad(x.cumsum(-1), (1, 0)) for x in (products, pulls)]
    for rows in bounds:
        for length in _lengths(rows):
            starts = torch.arange(rows.start, rows.stop - length + 1, max(1, length // 2))
            gram = (running[0][..., starts + length] - running[0][..., starts]).permute(2, 0, 1)
            pull = (running[1][:, starts + length] - running[1][:, starts]).T.unsqueeze(-1)
            inner = torch.linalg.pinv(gram, rtol=1e-6, hermitian=True)
            gain = (pull.transpose(1, 2) @ inner @ pull).flatten() - 4.0 * columns.shape[0]
            top = gain.argsort(descending=True)[:MOST_WINDOWS].tolist()
            found += [(float(gain[k]), int(starts[k]), int(starts[k]) + length) for k in top]
    found.sort(reverse=True)
    return [(a, b) for _, a, b in found[:MOST_WINDOWS]]


def _lengths(rows: slice) -> list[int]:
    """Lengths of windows [rows]: from three rows up to a quarter of the trajectory."""
    most = max(3, (rows.stop - rows.start) // 4)
    return [k for k in (3, 6, 12, 24, 48, 96, 192) if k <= most]
