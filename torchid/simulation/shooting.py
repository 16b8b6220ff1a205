"""Starts of short simulations along a log, and the measured signals from each of them on."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchid.design.segments import Segment
from torchid.typing import Float, Int, Tensor


@dataclass(frozen=True)
class Starts:
    """B starts.

    Attributes:
        passage: (B,) number of the passage.
        first: (B,) sample of it.
        length: (B,) samples from there to the passage's end, its edge left out.
    """

    passage: Int[Tensor, " B"]
    first: Int[Tensor, " B"]
    length: Int[Tensor, " B"]


@dataclass(frozen=True)
class Windows:
    """Measured signals from each start on; the passage's last sample stands for later ones.

    Attributes:
        dt: between samples [s].
        q, dq, tau: (B, T, n) measured positions, velocities and torques, the first at the start.
        t0: (B,) [s].
        steps: (B,) number of the last sample that the passage has.
    """

    dt: float
    q: Float[Tensor, "B T n"]
    dq: Float[Tensor, "B T n"]
    tau: Float[Tensor, "B T n"]
    t0: Float[Tensor, " B"]
    steps: Int[Tensor, " B"]


def _edge_of(passage: Segment) -> int:
    """Samples at the ends of a passage that its filter has spoilt."""
    # 4.0: periods of the wide band left out at the ends of a passage
    return math.ceil(4.0 * passage.rate / passage.band)


def starts_of(passages: Sequence[Segment], shortest: float, most: int, seed: int) -> Starts:
    """One start at random in each of equal shares of the time where the shortest horizon fits."""
    edges = [_edge_of(p) for p in passages]
    room = torch.tensor(
        [
            max(0, p.length - 2 * edge - math.ceil(shortest * p.rate))
            for p, edge in zip(passages, edges, strict=True)
        ]
    )
    total = int(room.sum())
    count = min(most, total)
    generator = torch.Generator().manual_seed(seed)
    jitter = torch.rand(count, generator=generator, dtype=torch.float64)
    place = ((torch.arange(count) + jitter) * (total / max(1, count))).long().clamp(max=total - 1)
    ends = room.cumsum(0)
    passage = torch.searchsorted(ends, place, right=True)
    edge, samples = torch.tensor(edges), torch.tensor([p.length for p in passages])
    first = place - (ends - room)[passage] + edge[passage]
    return Starts(passage, first, samples[passage] - edge[passage] - 1 - first)


def windows_of(passages: Sequence[Segment], starts: Starts, longest: float) -> Windows:
    """Signals from all starts on, for the longest horizon [s]."""
    rates = {p.rate for p in passages}
    assert len(rates) == 1, "passages are resampled to one rate"
    rate = rates.pop()
    # 4e-3: between samples, at most, where the passage has as many [s]
    step = max(1, int(4e-3 * rate * (1 + 1e-9)))
    steps = starts.length // step
    count = min(round(longest * rate / step), int(steps.max()))
    # All passages one after the other.
    offset = torch.tensor([0, *(p.length for p in passages)]).cumsum(0)[starts.passage]
    begin = offset + starts.first
    index = begin[:, None] + step * torch.minimum(torch.arange(count + 1), steps[:, None])
    times = [p.motion.require("t", "a simulation") for p in passages]
    return Windows(
        dt=step / rate,
        q=torch.cat([p.motion.q for p in passages])[index],
        dq=torch.cat([p.motion.dq for p in passages])[index],
        tau=torch.cat([p.tau for p in passages])[index],
        t0=torch.cat(times)[begin],
        steps=steps,
    )
