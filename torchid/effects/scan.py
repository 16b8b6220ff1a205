"""Recursions along time without a loop over instants, for effects with a memory.

Each step of the recursion is an affine map of the state, whose compositions are affine, and
composition is associative. So neighbouring steps are composed in pairs, the half as long sequence
is scanned, and the instants between are filled in: 2 log2(T) passes over all signals and shape
values at once, and about 2 T compositions (Blelloch 1990, Prefix Sums and Their Applications,
section 1.4).
"""

import torch
from torch import Tensor

from torchid.typing import Float

Maps = tuple[Tensor, Tensor]
"""Maps of the state, one an instant: two numbers each (..., T, n)."""


def affine_scan(a: Tensor, b: Tensor, initial: Tensor) -> Float[Tensor, "*batch T n"]:
    """States z[0] .. z[T-1] (..., T, n) of z[k] = a[k] z[k-1] + b[k] with z[-1] = initial.

    With |a| <= 1 rounding does not grow: the error is that of the plain loop.

    Args:
        a, b: (..., T, n), broadcast with each other.
        initial: (..., n), or () for the same state everywhere.
    """
    slope, constant = _scan(torch.broadcast_tensors(a, b))
    return slope * (initial.unsqueeze(-2) if initial.ndim else initial) + constant


def _after(first: Maps, second: Maps) -> Maps:
    """a2 (a1 z + b1) + b2."""
    (a1, b1), (a2, b2) = first, second
    return a2 * a1, a2 * b1 + b2


def _scan(maps: Maps) -> Maps:
    """Compositions of the maps from the first instant to each."""
    length = maps[0].shape[-2]
    if length < 2:
        return maps
    even, odd = (_part(maps, slice(start, None, 2)) for start in (0, 1))
    pairs = odd[0].shape[-2]
    to_odd = _scan(_after(_part(even, slice(pairs)), odd))
    # Instants 2, 4, ..: all before them, and their own map.
    later = even[0].shape[-2] - 1
    to_even = _after(_part(to_odd, slice(later)), _part(even, slice(1, later + 1)))
    out = tuple(torch.empty_like(x, memory_format=torch.contiguous_format) for x in maps)
    for whole, own, at_odd, at_even in zip(out, maps, to_odd, to_even, strict=True):
        whole[..., :1, :] = own[..., :1, :]
        whole[..., 1::2, :] = at_odd
        whole[..., 2::2, :] = at_even
    return out[0], out[1]


def _part(maps: Maps, instants: slice) -> Maps:
    return maps[0][..., instants, :], maps[1][..., instants, :]
