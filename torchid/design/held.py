"""Held torque: samples that a log repeats because the new one did not arrive.

Equal consecutive values have three causes. A hold ends in a jump, which catches up with what the
torque did meanwhile. A coarse quantiser repeats values while the torque moves slowly, but then the
next value is the neighbouring step. A saturated drive repeats its limit, the log's largest or
smallest value. So a hold is a run of equal values, not at an extreme, while the arm moves, that
ends in a jump of several quanta and is longer than the share of equal pairs elsewhere explains.
"""

import math
from collections.abc import Sequence

import torch

from torchid.design.segments import Segment
from torchid.log.filtering import ZeroPhaseFilter, central_difference
from torchid.log.model import Log
from torchid.typing import Bool, Float, Int, Tensor


def held_ages(log: Log) -> Float[Tensor, "T n"]:
    """By how much each torque is older than its stamp (T, n) [s]: 0 where it is not held.

    A hold's first value is new, so a run of k equal values has ages 0, 1, ..., k - 1 steps. Values
    held once only (runs of two), and a logger that holds all values (torque at a lower rate than
    the log: a constant delay on average), are not reported.

    Args:
        log: on a uniform grid. Resampling leaves holds as they are but for their ends (less than a
            step), because torque is interpolated linearly: between equal values it is exact.
    """
    assert log.tau is not None
    ages, moving = torch.zeros_like(log.tau), float(log.moving_speed.min())
    for rows, rate in zip(log.slices(), log.rates, strict=True):
        speed = central_difference(log.q[rows].T, rate).abs().amax(0)
        for j in range(log.n):
            ages[rows, j] = _ages(log.tau[rows, j], speed > moving) / rate
    return ages


def held_ages_of(log: Log, segments: Sequence[Segment]) -> list[Float[Tensor, "_ n"]]:
    """Ages (T, n) [s] on the grid of each segment.

    Where a segment is decimated they are low-passed first, as its torque is.

    Args:
        log: uniform, the one that the segments come from.
        segments: its trajectories in order; some may have been left out as too short.
    """
    ages = held_ages(log)
    parts = iter(zip(log.names, log.slices(), log.rates, strict=True))
    out = []
    for segment in segments:
        # The segment's trajectory is the next one of this name and length.
        for name, rows, rate in parts:
            step = round(rate / segment.rate)
            if (
                name == segment.name
                and math.ceil((rows.stop - rows.start) / step) == segment.length
            ):
                break
        else:
            raise ValueError(f"segment '{segment.name}' is not of this log, or out of order.")
        x = ages[rows]
        if step > 1 and bool(x.any()):
            cutoff = min(1.5 * segment.band, 0.4 * rate / step)
            x = ZeroPhaseFilter(rate, cutoff).apply(x.T).T
        out.append(x[::step].contiguous())
    return out


def _ages(tau: Float[Tensor, " T"], moves: Bool[Tensor, " T"]) -> Float[Tensor, " T"]:
    """Age of each sample of one joint [steps], while the arm moves."""
    starts, lengths = _runs(tau)
    held = _held(tau, moves, starts, lengths)
    run = torch.repeat_interleave(torch.arange(len(starts), device=tau.device), lengths)
    since = torch.arange(len(tau), device=tau.device) - starts[run]
    return torch.where(held[run], since, 0).to(tau)


def _runs(x: Float[Tensor, " T"]) -> tuple[Int[Tensor, " R"], Int[Tensor, " R"]]:
    """First index and length of each run of equal values."""
    new = torch.nn.functional.pad(x.diff() != 0, (1, 0), value=True)
    starts = torch.nonzero(new).flatten()
    lengths = torch.cat([starts, starts.new_tensor([len(x)])]).diff()
    return starts, lengths


def _held(
    tau: Float[Tensor, " T"],
    moves: Bool[Tensor, " T"],
    starts: Int[Tensor, " R"],
    lengths: Int[Tensor, " R"],
) -> Bool[Tensor, " R"]:
    """Which runs of equal values a logger held, and did not measure."""
    if len(starts) < 3:
        return torch.zeros_like(starts, dtype=torch.bool)
    values = tau[starts]
    steps = values.diff().abs()
    # 0.01: quantile of non-zero steps: one quantum, or next to nothing without a quantiser
    quantum = torch.quantile(steps[:: max(1, len(steps) // 100_000)], 0.01)
    # The last run has no end.
    # 3.0: quanta by which the value after a hold must differ
    jumps = torch.nn.functional.pad(steps > 3.0 * quantum, (0, 1), value=False)
    extreme = (values == tau.max()) | (values == tau.min())
    total = torch.nn.functional.pad(moves.cumsum(0), (1, 0))
    moving = 2 * (total[starts + lengths] - total[starts]) > lengths
    # 3: equal values in a run; two in a row cannot be told from chance
    candidate = (lengths >= 3) & jumps & ~extreme & moving
    probability = _equal_by_chance(tau, starts, lengths, candidate)
    expected = len(tau) * probability ** (lengths - 1)
    # 1e-3: expected number of runs as long as this by chance, in a joint's whole trajectory
    return candidate & (expected < 1e-3)


def _equal_by_chance(
    tau: Float[Tensor, " T"],
    starts: Int[Tensor, " R"],
    lengths: Int[Tensor, " R"],
    candidate: Bool[Tensor, " R"],
) -> Float[Tensor, " R"]:
    """Probability that two neighbours are equal without a hold, at each run: the larger share of
    the whole trajectory and of the run's neighbourhood, candidates left out."""
    run = torch.repeat_interleave(torch.arange(len(starts), device=tau.device), lengths)
    usual = ~candidate[run][1:]
    equal = (tau.diff() == 0) & usual
    whole = (equal.sum() + 1) / (usual.sum() + 2)
    sums = [torch.nn.functional.pad(x.cumsum(0), (1, 0)) for x in (equal, usual)]
    # pairs on either side in which equal ones are counted
    neighbours = 100
    low = (starts - neighbours).clamp(min=0)
    high = (starts + lengths + neighbours).clamp(max=len(tau) - 1)
    near = (sums[0][high] - sums[0][low]) / (sums[1][high] - sums[1][low]).clamp(min=1)
    return torch.maximum(near.to(tau), whole.to(tau))
