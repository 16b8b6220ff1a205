"""A log as the doctor's model checks take it: smooth, on a coarse grid, in blocks of time."""

from dataclasses import dataclass

import numpy as np
import torch

from torchid.log.checks import NO_TORQUE
from torchid.log.filtering import ZeroPhaseFilter, central_difference
from torchid.log.model import Log
from torchid.typing import Bool, Float, Int, Tensor

BLOCKS = 8
"""Blocks of time that are held out in turn; longer than any filter's or friction's memory."""
MOVING = 0.5
"""Smoothed direction of motion from which a joint moves [1]."""
LOOPS = tuple(0.4 / 4**k for k in range(6))
"""Shares of half a joint's range over which friction builds up after a reversal: from what gears
wind up by to what a joint goes within the filter's time; what lies between is made of two."""
_CUTOFF_HZ = (2.0, 12.0)
_PER_PERIOD = 6.0


@dataclass(frozen=True)
class Stretch:
    """One trajectory, low-passed and decimated.

    Attributes:
        t: (T,) [s].
        motion: (T, n, 4 + K) q, dq, ddq, direction of motion and K loops over position, smoothed.
        moving: (T, n) whether each joint moves: at rest, static friction holds any torque.
        tau: (T, n) smoothed torque (or current).
        inside: samples at either end that a shift of the torque may use and rows may not.
    """

    t: Float[Tensor, " T"]
    motion: Float[Tensor, "T n 4"]
    moving: Bool[Tensor, "T n"]
    tau: Float[Tensor, "T n"]
    inside: slice

    def torque(self, late: float) -> Float[Tensor, "T n"]:
        """Torque of the rows, read `late` seconds later than their motion."""
        if late == 0.0:
            return self.tau[self.inside]
        from scipy.interpolate import CubicSpline

        t = self.t.numpy()
        spline = CubicSpline(t, self.tau.numpy())
        return torch.from_numpy(spline(t[self.inside] + late))


@dataclass(frozen=True)
class Samples:
    """Rows of all trajectories of a log.

    Attributes:
        log: that they are of.
        stretches: one a trajectory, or a part of one between two long gaps.
        motion, moving: (T, n, 4), (T, n) rows of all of them.
        block: (T,) block of each row, 0..BLOCKS-1.
        run: (T,) trajectory of the log that each row is of, from 0.
        reach: how far torque may be shifted [s].
        step: of the log on its uniform grid [s].
    """

    log: Log
    stretches: tuple[Stretch, ...]
    motion: Float[Tensor, "T n 4"]
    moving: Bool[Tensor, "T n"]
    block: Int[Tensor, " T"]
    run: Int[Tensor, " T"]
    reach: float
    step: float

    def torque(self, late: float = 0.0) -> Float[Tensor, "T n"]:
        """Torque of the rows, read `late` seconds later than their motion."""
        return torch.cat([s.torque(late) for s in self.stretches])


def samples(log: Log) -> Samples | str:
    """Rows for the model checks, or in words why there are none: no torque, or too short a log.

    The cut-off is four times the frequency below which 98 % of the motion's velocity lies.
    """
    torque = log.tau if log.tau is not None else log.current
    if torque is None or float(torque.abs().max()) < NO_TORQUE:
        return "there is no torque"
    even = log.even
    parts = zip(even.trajectories(), even.rates, log.even_runs, strict=True)
    fewest = 40
    usable = [(p, rate, run) for p, rate, run in parts if p.samples > fewest]
    if not usable:
        return f"no trajectory has more than {fewest} samples"
    cutoff = max(_cutoff(p, rate) for p, rate, _ in usable)
    total = sum(p.samples / rate for p, rate, _ in usable)
    extent, ways = even.q.amax(0) - even.q.amin(0), even.least_way
    # 1600: samples kept, spread evenly
    made = [(_stretch(p, rate, cutoff, 1600 / total, extent, ways), run) for p, rate, run in usable]
    kept = [s for s, _ in made if s is not None]
    runs = [torch.full_like(s.t[s.inside], run) for s, run in made if s]
    count = sum(len(s.t[s.inside]) for s in kept)
    if count < 10 * BLOCKS:
        # The length that the rows of all blocks and the ends of a trajectory need.
        least = 10 * BLOCKS / (_PER_PERIOD * cutoff) + 2 * max(1.0 / cutoff, 0.25)
        return (
            f"the log lasts {total:.3g} s; of motion as slow as this it takes {least:.2g} s at "
            "least, better 20 s, with all joints moving"
        )
    return Samples(
        log,
        tuple(kept),
        torch.cat([s.motion[s.inside] for s in kept]),
        torch.cat([s.moving[s.inside] for s in kept]),
        block=torch.arange(count) * BLOCKS // count,
        run=torch.cat(runs).long() if runs else torch.zeros(0).long(),
        reach=min(float(s.t[s.inside.start] - s.t[0]) for s in kept),
        step=1.0 / max(rate for _, rate, _ in usable),
    )


def _cutoff(log: Log, rate: float) -> float:
    dq = central_difference(log.q.T, rate)
    power = torch.fft.rfft(dq - dq.mean(-1, keepdim=True)).abs() ** 2
    frequency = torch.fft.rfftfreq(dq.shape[-1], 1.0 / rate, dtype=dq.dtype)
    # 15.0: no arm's motion is faster [Hz]
    power = power[:, frequency < min(15.0, 0.3 * rate)]
    share = power / power.sum(-1, keepdim=True).clamp(min=1e-300)
    # 0.98: share of the motion's power that lies below the edge
    top = float(frequency[int((share.mean(0).cumsum(0) < 0.98).sum())])
    low, high = _CUTOFF_HZ
    return min(max(4.0 * top, low), high, 0.2 * rate)


def _stretch(
    log: Log, rate: float, cutoff: float, most_per_second: float, widest: Tensor, least: Tensor
) -> Stretch | None:
    low, torque = ZeroPhaseFilter(rate, cutoff), log.tau if log.tau is not None else log.current
    assert torque is not None
    q = low.apply(log.q.T)
    dq = central_difference(q, rate)
    wide = min(5.0 * cutoff, 0.4 * rate)
    smooth = ZeroPhaseFilter(rate, wide).apply(log.q.T)
    sharp = central_difference(smooth, rate)
    sign = low.apply(direction_of(sharp))
    extent = q.amax(-1, keepdim=True) - q.amin(-1, keepdim=True)
    moving = (sign.abs() > MOVING) & (extent > least[:, None])
    every = max(1, int(rate / max(_PER_PERIOD * cutoff, 0.0)), int(rate / most_per_second))
    # Torque is interpolated between kept samples, which must not be sparser than its band.
    fine = max(1, int(rate / (_PER_PERIOD * cutoff)))
    every = fine if every < 2 * fine else every
    picked = slice(0, None, every)
    edge = max(round(rate / cutoff), round(0.25 * rate))
    edge = -(-min(edge, log.samples // 6) // every)
    loops = low.apply(_loops(smooth, 0.5 * widest))
    motion = torch.stack([q, dq, central_difference(dq, rate), sign, *loops], -1)
    motion, moving, tau = (
        x.transpose(0, 1)[picked].contiguous() for x in (motion, moving, low.apply(torque.T))
    )
    count = len(motion)
    if count < 2 * edge + 10:
        return None
    return Stretch(log.t[picked], motion, moving, tau, slice(edge, count - edge))


def direction_of(dq: Tensor, dim: int = -1) -> Tensor:
    """Direction of motion, -1 to 1, from velocities [rad/s or m/s] along a dimension."""
    fast = torch.quantile(dq.abs(), 0.95, dim=dim, keepdim=True)
    # 1e-3: the direction of motion is taken seriously from here [rad/s or m/s]
    return torch.tanh(dq / (0.02 * fast).clamp(min=1e-3))


def _loops(q: Float[Tensor, "n T"], half: Float[Tensor, " n"]) -> Float[Tensor, "K n T"]:
    """What follows each joint's position within -1 and 1, over each of the lengths, and stays
    there while it moves on: elements of a friction that builds up after a reversal (Maxwell slip;
    presliding, play, gears that wind up).

    Args:
        q: positions [rad or m].
        half: half of each joint's range.
    """
    lengths = torch.tensor(LOOPS).double()[:, None] * half.clamp(min=1e-9)
    steps = (q.diff(dim=-1, prepend=q[:, :1]) / lengths.unsqueeze(-1)).permute(2, 0, 1).numpy()
    loops, z = np.empty_like(steps), np.zeros(steps.shape[1:])
    for step, out in zip(steps, loops, strict=True):
        z = np.minimum(np.maximum(z + step, -1.0), 1.0, out=out)
    return torch.from_numpy(loops).permute(1, 2, 0)
