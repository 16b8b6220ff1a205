"""Which columns of a matrix are independent, from left to right."""

import torch

from torchid.typing import Bool, Float, Tensor


def independent_columns(
    matrix: Float[Tensor, "R C"], tolerance: float
) -> tuple[Bool[Tensor, " C"], Float[Tensor, " C"]]:
    """Columns that are not combinations of independent columns before them.

    Plain QR decides by the diagonal of R, but the entries behind a dependent column cannot be
    trusted: what rounding (or a twist of 1.5708) leaves of that column takes up a direction that a
    later column needs. So the first dependent column is removed and the rest factorised again. A
    column that is itself no more than such a residue must not be scaled up to a column of its own.

    Args:
        matrix: (R, C); columns are scaled to length one here.
        tolerance: distance, relative to a column's length, below which it counts as dependent; and
            length, relative to the longest column, below which it counts as zero.

    Returns:
        mask: (C,) independent columns.
        distance: (C,) relative distance of each column from the span of those kept before it; 0
            for one that counts as zero.
    """
    length = torch.linalg.vector_norm(matrix, dim=0)
    mask = length > tolerance * length.max().clamp(min=1e-300)
    distance = torch.zeros_like(length)
    columns = mask.nonzero().flatten()
    rest = torch.linalg.qr(matrix[:, columns] / length[columns], mode="r").R
    while len(columns):
        diagonal = columns.new_zeros(len(columns), dtype=length.dtype)
        diagonal[: len(rest)] = rest.diagonal().abs()
        bad = (diagonal < tolerance).nonzero().flatten()
        k = int(bad[0]) if len(bad) else len(columns) - 1
        distance[columns[: k + 1]] = diagonal[: k + 1]
        if len(bad):
            mask[columns[k]] = False
        kept_rows = k if len(bad) else k + 1
        columns, rest = columns[k + 1 :], rest[kept_rows:, k + 1 :]
        if len(columns):
            rest = torch.linalg.qr(rest, mode="r").R if len(rest) else rest
    return mask, distance
