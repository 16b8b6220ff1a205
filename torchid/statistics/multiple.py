"""Many tests at once."""

import torch
from scipy.special import stdtr

from torchid.typing import Float, Tensor


def benjamini_hochberg(p: Float[Tensor, " D"]) -> Float[Tensor, " D"]:
    """p-values adjusted for the share of false ones among those found (Benjamini and Hochberg
    1995).

    >>> benjamini_hochberg(torch.tensor([0.01, 0.5, 0.02])).tolist()
    [0.029999999329447746, 0.5, 0.029999999329447746]
    """
    order = torch.argsort(p, descending=True)
    rank = torch.arange(len(p), 0, -1, dtype=p.dtype)
    lowered = torch.cummin(p[order] * len(p) / rank, 0).values.clamp(max=1.0)
    out = torch.empty_like(p)
    out[order] = lowered
    return out


def two_sided(
    t: Float[Tensor, "*batch"], freedom: Float[Tensor, "*batch"]
) -> Float[Tensor, "*batch"]:
    """p-values of Student's t."""
    return torch.from_numpy(2 * stdtr(freedom.numpy(), -t.abs().numpy()))
