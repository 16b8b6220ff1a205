"""Blocks of the gap beside the motion, and the regimes that are parts of the time.

A regime that is a part of the time (low speed, high load, ...) holds an excess when the squared gap
is larger inside than outside. A gap that only changes its sign, as that of Coulomb friction, is as
large before a reversal as after it: reversals are also looked at for a jump, the difference of
straight lines through the gap on either side.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchid.design.segments import REACH
from torchid.gap.diagnosis import Trace
from torchid.gap.localise.resampling import (
    Draws,
    Look,
    best_of,
    flipped,
    linear,
    permuted,
    quadratic,
)
from torchid.log.filtering import low_passed
from torchid.statistics.autocorrelation import CORRELATION_TIMES, correlation_instants
from torchid.statistics.blocks import FEWEST_BLOCKS
from torchid.typing import Bool, Float, Tensor

MOST_BLOCKS = 80
"""Of more, a block is so short that a single transient may look like a regime."""

SAMPLES = 3.0
"""Instants kept a period of the band's edge."""

STILL, SLOWER = 0.02, 0.1
"""99 % speed below which a joint did not move [rad/s or m/s], or the share [1] of the fastest
joint's if that is less."""

BRIEF = 0.25
"""Seconds after a reversal that count as one, at most; of each straight line of a jump; and of a
transient's window."""

CRAWL, SLOW, FAST = 0.01, 0.15, 0.7
"""As good as zero, low and high, as fractions of the 99 % speed (acceleration, torque)."""

RARE = 0.02
"""Share of time below which a regime is too rare to be compared with the rest."""

_FEWEST_REVERSALS = 6


@dataclass(frozen=True)
class Pool:
    """Valid instants of all trajectories in K blocks of L instants.

    Attributes:
        rate: [Hz].
        correlation: integrated autocorrelation time of the gap in block lengths, the largest over
            the joints.
        t: (K, L) [s].
        error: (K, L, n) measured torque less that of the model as given.
        upper: (K, L, n) its part above half the band.
        q, dq, ddq, load: (K, L, n); load is the model's torque.
        sign: (K, L, n) direction of motion.
        since: (K, L, n) seconds since the own reversal; inf before the first.
        jump: (K, L, n) at the instant of a reversal, half the jump of the gap in the direction of
            motion; else 0.
    """

    rate: float
    correlation: float
    t: Tensor
    error: Tensor
    upper: Tensor
    q: Tensor
    dq: Tensor
    ddq: Tensor
    load: Tensor
    sign: Tensor
    since: Tensor
    jump: Tensor

    @property
    def blocks(self) -> int:
        """K."""
        return self.error.shape[0]

    def flat(self, name: str) -> Float[Tensor, "N n"]:
        """One of the signals, blocks joined."""
        return getattr(self, name).flatten(0, 1)

    def high(self, name: str) -> Float[Tensor, " n"]:
        """99 % quantile of the size of a signal, joint by joint."""
        return largest(self.flat(name))


def largest(x: Float[Tensor, "N n"]) -> Float[Tensor, " n"]:
    """Size of a signal, joint by joint, that only 1 % of the instants exceed."""
    return x.abs().quantile(0.99, 0)


def pooled(traces: Sequence[Trace], band: float) -> Pool:
    """Blocks of several correlation times, as many as the tests need, of instants decimated to
    three a period of the band's edge (the traces are band-limited)."""
    parts: list[dict[str, Tensor]] = []
    clock = 0.0
    for trace in traces:
        parts.append(_signals(trace, band, clock))
        clock += len(trace.valid) / trace.rate
    rows = {name: torch.cat([p[name] for p in parts]) for name in parts[0]}
    total = len(rows["t"])
    # A slow trend is no correlation: the gap less a parabola in time.
    t = rows["t"] - rows["t"].mean()
    phase = t / t.abs().max().clamp(min=1e-9)
    basis = torch.linalg.qr(torch.stack([torch.ones_like(t), phase, phase.square()], -1)).Q
    correlation = correlation_instants(rows["error"] - basis @ (basis.T @ rows["error"]))
    # Blocks of several correlation times, and as many as the tests need; the last instants that
    # fill none are left out.
    count = int(total // (CORRELATION_TIMES * correlation))
    blocks = max(1, min(max(count, FEWEST_BLOCKS), MOST_BLOCKS, total))
    length = total // blocks
    cut = {k: v[: blocks * length].unflatten(0, (blocks, length)) for k, v in rows.items()}
    rate = max(trace.rate / _step(trace.rate, band) for trace in traces)
    return Pool(rate=rate, correlation=correlation / length, **cut)


def begins(traces: Sequence[Trace]) -> list[tuple[str, float]]:
    """Name of each trajectory, and its first time [s] in the pool."""
    out, clock = [], 0.0
    for trace in traces:
        t = trace.motion.t
        out.append((trace.name, clock if t is None else float(t[0])))
        clock += len(trace.valid) / trace.rate
    return out


def _step(rate: float, band: float) -> int:
    return max(1, int(rate / (SAMPLES * band)))


def _signals(trace: Trace, band: float, clock: float) -> dict[str, Tensor]:
    """The pool's signals on the valid instants of one trajectory."""
    # Decimated; the gap is bridged where it does not count, so that it can be filtered.
    step = _step(trace.rate, band)
    rate = trace.rate / step
    valid = trace.valid[::step].cpu()
    motion = trace.motion.to("cpu").part(slice(None, None, step))
    error = (trace.measured - trace.before)[::step].cpu()
    t = torch.arange(len(error), dtype=torch.float64) / rate + clock
    error = bridged(error, valid)
    sign = direction(motion.dq if motion.direction is None else motion.direction, motion.dq)
    since, jump = reversals(sign, error, rate, band)
    upper = error if len(error) < 4 else error - low_passed(error.T, rate, 0.5 * band).T
    signals = {
        "t": t if motion.t is None else motion.t, "error": error, "upper": upper,
        "q": motion.q, "dq": motion.dq, "ddq": motion.ddq, "load": trace.before[::step].cpu(),
        "sign": sign, "since": since, "jump": jump,
    }  # fmt: skip
    return {name: x[valid] for name, x in signals.items()}


def bridged(x: Float[Tensor, "T n"], valid: Tensor) -> Float[Tensor, "T n"]:
    """Invalid instants filled in from the nearest valid one before (or after, at the start)."""
    if bool(valid.all()) or not bool(valid.any()):
        return x
    places = torch.arange(len(x))
    last = torch.where(valid, places, -torch.ones_like(places)).cummax(0).values
    first = int(valid.nonzero()[0])
    return x[torch.where(last < 0, torch.full_like(last, first), last)]


def direction(sign: Float[Tensor, "T n"], dq: Float[Tensor, "T n"]) -> Float[Tensor, "T n"]:
    """Direction of motion, kept from before where a joint crawls."""
    slow = dq.abs() < CRAWL * largest(dq)
    places = torch.arange(len(dq)).unsqueeze(-1).expand_as(dq)
    last = torch.where(slow, torch.zeros_like(places), places).cummax(0).values
    return torch.sign(sign).gather(0, last)


def reversals(
    sign: Float[Tensor, "T n"], error: Float[Tensor, "T n"], rate: float, band: float
) -> tuple[Float[Tensor, "T n"], Float[Tensor, "T n"]]:
    """Seconds since each joint's last reversal, and half the jumps of the gap at reversals that
    stand alone, in the direction of motion."""
    since = torch.full_like(error, torch.inf)
    jump = torch.zeros_like(error)
    # As far as the filter carries what happens at a reversal no sample counts.
    width, skip = max(4, round(BRIEF * rate)), max(1, round(REACH * rate / band))
    # Weights of samples whose sum is their straight line's value at the reversal, which is half a
    # sample before the first one in the new direction.
    x = skip + 0.5 + torch.arange(width, dtype=torch.float64)
    ahead = torch.linalg.pinv(torch.stack([torch.ones_like(x), x], -1))[0].to(error)
    reach = width + skip
    for j in range(error.shape[1]):
        # Time since the last reversal.
        turns = (sign[1:, j] * sign[:-1, j] < 0).nonzero().flatten() + 1
        places = torch.arange(len(error))
        marks = torch.full((len(error),), -1).index_fill(0, turns, 0)
        marks[turns] = turns
        last = marks.cummax(0).values
        since[:, j] = torch.where(last < 0, torch.inf, (places - last) / rate)
        # Jumps at those that no other one is near to.
        gaps = torch.diff(turns, prepend=turns.new_tensor([-reach]))
        after = torch.diff(turns, append=turns.new_tensor([len(error) + reach]))
        alone = (gaps > reach) & (after > reach) & (turns >= reach) & (turns < len(error) - reach)
        for turn in turns[alone].tolist():
            right = ahead @ error[turn + skip : turn + reach, j]
            left = ahead @ error[turn - reach : turn - skip, j].flip(0)
            jump[turn, j] = 0.5 * sign[turn, j] * (right - left)
    return since, jump


def reversal_look(pool: Pool, draws: Draws) -> Look:
    """A larger gap just after reversals, or a jump at them."""
    return best_of(
        [masked_look(pool, masks(pool)["velocity_reversal"], draws), _jumps(pool, draws)]
    )


def masks(pool: Pool) -> dict[str, Tensor]:
    """Parts of the time (K, L, n), by regime."""
    speed, acceleration, load = pool.dq.abs(), pool.ddq.abs(), pool.load.abs()
    fast = pool.high("dq")
    moved = fast > min(STILL, SLOWER * float(fast.max()))
    # Just after a reversal: a quarter of the time at most.
    recent = pool.flat("since").quantile(0.25, 0, interpolation="lower").clamp(max=BRIEF)
    return {
        "velocity_reversal": (pool.since <= recent) & moved,
        "low_speed": (speed < SLOW * fast) & moved,
        "high_speed": (speed > FAST * fast) & moved,
        "high_acceleration": (acceleration > FAST * pool.high("ddq")) & moved,
        "gravity_load": (load > FAST * pool.high("load"))
        & ((acceleration < 0.5 * pool.high("ddq")) | ~moved),
    }


def regime_instants(traces: Sequence[Trace], band: float) -> list[dict[str, Bool[Tensor, "T n"]]]:
    """Parts of the time of each trajectory (T, n), by regime, as `masks` has them; none at instants
    that do not count."""
    parts = [_signals(trace, band, 0.0) for trace in traces]
    rows = {name: torch.cat([p[name] for p in parts]).unsqueeze(0) for name in parts[0]}
    inside = masks(Pool(rate=0.0, correlation=0.0, **rows))
    lengths, out = [len(p["t"]) for p in parts], []
    pieces = {name: mask[0].split(lengths) for name, mask in inside.items()}
    for k, trace in enumerate(traces):
        step = _step(trace.rate, band)
        own = {}
        for name, mask in pieces.items():
            kept = torch.zeros(len(trace.valid[::step]), mask[k].shape[1], dtype=torch.bool)
            kept[trace.valid[::step].cpu()] = mask[k]
            # Each instant that was kept stands for those until the next.
            own[name] = kept.repeat_interleave(step, 0)[: len(trace.valid)]
        out.append(own)
    return out


def masked_look(pool: Pool, mask: Tensor, draws: Draws) -> Look:
    """A larger squared gap inside a part of the time than outside."""
    share = mask.to(torch.float64).mean((0, 1))
    # Covariance of being inside with the squared gap.
    inside = mask.to(torch.float64) - share
    squared = pool.error.square()
    observed, null = permuted(inside, squared - squared.mean((0, 1)), draws)
    possible = (share > RARE) & (share < 1 - RARE)
    return Look(observed, null, linear((inside * squared).sum(1)), possible)


def _jumps(pool: Pool, draws: Draws) -> Look:
    """The mean jump at reversals; its energy is that of a gap which flips by as much each time."""
    turned = pool.jump != 0
    count = turned.sum((0, 1)).clamp(min=1)
    parts = pool.jump.sum(1)
    observed, null = flipped(parts, draws, two_sided=True)
    total = math.prod(pool.error.shape[:2])
    return Look(
        observed, null, quadratic(parts, total / count.square()),
        turned.any(1).sum(0) >= _FEWEST_REVERSALS,
    )  # fmt: skip
