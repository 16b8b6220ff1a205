"""Fits whose truth is known: autocorrelated noise and columns of a given correlation time."""

import math
from collections.abc import Iterable

import torch
from scipy.signal import lfilter

from torchid.statistics.autocorrelation import integrated_time
from torchid.statistics.blocks import block_length, block_numbers
from torchid.statistics.jackknife import Jackknife, fit_statistics
from torchid.typing import Tensor

COLUMNS = 44
"""43 base parameters of a 7R arm, and one effect beside them."""


def correlation_time(keep: float) -> float:
    """Of AR(1) noise [rows]."""
    return (1 + keep) / (1 - keep)


def ar1(*shape: int, keep: float, seed: int) -> Tensor:
    """Unit-variance AR(1) noise, stationary from its first row."""
    generator = torch.Generator().manual_seed(seed)
    white = torch.randn(*shape[:-1], shape[-1] + 500, generator=generator, dtype=torch.float64)
    driven = lfilter([math.sqrt(1 - keep**2)], [1.0, -keep], white.numpy(), axis=-1)
    return torch.from_numpy(driven[..., 500:].copy())


def smooth(count: int, rows: int, keep: float, seed: int) -> Tensor:
    """Columns (rows, count) as a motion gives them: sums of four sines, from one to twelve times
    as slow as the noise's correlation time."""
    generator = torch.Generator().manual_seed(seed)
    u, phase, size = torch.rand(3, count, 4, 1, generator=generator, dtype=torch.float64).unbind()
    period = correlation_time(keep) * torch.exp(math.log(12) * u)
    t = torch.arange(rows)
    waves = (2 * size - 1) * torch.sin(2 * math.pi * (t / period + phase))
    return waves.sum(1).T.contiguous()


def fitted(
    keep: float, blocks: int, seed: int, kind: str = "as the noise", own_blocks: bool = False
) -> tuple[Tensor, Jackknife]:
    """Coefficients of noise on columns, all truly zero, and their statistics.

    Args:
        keep: of the noise.
        blocks: of four correlation times of the noise each.
        seed: of columns and noise.
        kind: of columns, `as the noise` or `smooth`.
        own_blocks: whether the residual's own correlation time makes the blocks.
    """
    rows = blocks * math.ceil(4 * correlation_time(keep))
    if kind == "smooth":
        columns = smooth(COLUMNS, rows, keep, seed)
    else:
        columns = ar1(COLUMNS, rows, keep=keep, seed=seed).T.contiguous()
    noise = ar1(rows, keep=keep, seed=seed + 1_000_000)
    x = torch.linalg.lstsq(columns, noise.unsqueeze(1)).solution[:, 0]
    residual = noise - columns @ x
    block = torch.arange(rows) * blocks // rows
    if own_blocks:
        whole = [slice(0, rows)]
        block = block_numbers(whole, block_length(rows, float(integrated_time(residual))))
    return x, fit_statistics(columns, residual, block)


def coverage(seeds: Iterable[int], *args: object, **settings: object) -> float:
    """Share of 95 % intervals, of all columns of a fit a seed, that hold the truth [%]."""
    inside = []
    for seed in seeds:
        x, found = fitted(*args, seed=seed, **settings)  # type: ignore[arg-type, misc]
        low, high = found.interval(x).unbind(-1)
        inside.append(((low <= 0) & (high >= 0)).double().mean())
    return 100 * float(torch.stack(inside).mean())
