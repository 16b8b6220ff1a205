"""Where the gap lies: joints, and regimes of each joint's motion.

A regime holds an excess where the squared gap is larger inside than outside. The gap is
autocorrelated, so whole blocks of several correlation times are what is resampled: permuted, for
without any connection the blocks of the gap may stand in any order beside those of the motion. The
same draws serve all joints and regimes, in units of their mean and spread; the largest of them,
draw by draw, is the null distribution of every one (Westfall and Young 1993, max-T).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import get_args

import numpy as np
import torch

from torchid.gap.diagnosis import Trace
from torchid.gap.record import JointGap, NoiseFloor, Regime, RegimeGap
from torchid.results.record import by_joint
from torchid.statistics.autocorrelation import CORRELATION_TIMES, correlation_instants
from torchid.statistics.blocks import FEWEST_BLOCKS
from torchid.statistics.resampling import DRAWS, bootstrap_weights, tails
from torchid.typing import Bool, Float, Int, Tensor

MOST_BLOCKS = 80
"""Of more, a block is so short that a single transient may look like a regime."""

REST, SLOW, FAST = 0.01, 0.15, 0.7
"""As good as zero, low and high, as fractions of the 99 % speed [1]."""


@dataclass(frozen=True, eq=False)
class Instants:
    """Valid instants of all trajectories, decimated to three a period of the band's edge (the
    traces are band-limited).

    Attributes:
        error: (N, n) measured torque less that of the model as given.
        inside: (R, N, n) whether each is in each regime.
    """

    error: Float[Tensor, "N n"]
    inside: Bool[Tensor, "R N n"]

    @classmethod
    def of(cls, traces: Sequence[Trace], band: float) -> "Instants":
        """Errors of traces at the instants that are kept, and the regimes that these are in."""
        inside = regime_instants(traces, band)
        kept = [_kept(t, band) for t in traces]
        pairs = list(zip(traces, kept, strict=True))
        error = torch.cat([(t.measured - t.before)[k] for t, k in pairs]).cpu()
        parts = zip(inside, kept, strict=True)
        masks = [torch.stack([own[name] for name in get_args(Regime)])[:, k] for own, k in parts]
        return cls(error, torch.cat(masks, 1))

    def blocks(self) -> Int[Tensor, " N"]:
        """Block of each: several correlation times of the gap long, as many as the tests need; -1
        of the last instants that fill none."""
        total = len(self.error)
        # A slow trend is no correlation: the gap less a parabola in time.
        t = torch.linspace(-1, 1, total, dtype=torch.float64)
        basis = torch.linalg.qr(torch.stack([torch.ones_like(t), t, t.square()], -1)).Q
        correlation = correlation_instants(self.error - basis @ (basis.T @ self.error))
        count = int(total // (CORRELATION_TIMES * correlation))
        blocks = max(1, min(max(count, FEWEST_BLOCKS), MOST_BLOCKS, total))
        block = torch.arange(total) // (total // blocks)
        return torch.where(block < blocks, block, -1)


def where(
    traces: Sequence[Trace], floor: NoiseFloor, seed: int = 0, *, band: float
) -> tuple[tuple[JointGap, ...], tuple[RegimeGap, ...]]:
    """The map of the gap of the model as given (`before`), from valid instants.

    Args:
        traces: torque in the band of the report, on trajectories or blocks used for no fit.
        floor: of the noise in that band.
        seed: of the resamplings.
        band: of the report [Hz].
    """
    return joint_gaps(traces, floor), regime_gaps(Instants.of(traces, band), floor, seed)


def joint_gaps(traces: Sequence[Trace], floor: NoiseFloor) -> tuple[JointGap, ...]:
    """RMS of the gap on each joint, and its share of the squares above the noise floor (mean square
    of the bracket's ends)."""
    # At the instants that count, as how far the gap closes has them.
    counting = torch.cat([t.counting.cpu() for t in traces])
    squared = torch.cat([(t.measured - t.before).square().cpu() for t in traces]) * counting
    gap = squared.sum(0) / counting.sum(0).clamp(min=1)
    noise = 0.5 * (floor.low.square() + floor.high.square()).to(gap)
    above = (gap - noise).clamp(min=0)
    share = above / above.sum() if float(above.sum()) > 0 else above
    return by_joint(JointGap, gap_rms=gap.sqrt(), noise_floor_rms=floor.ends, share=share)


def regime_gaps(instants: Instants, floor: NoiseFloor, seed: int) -> tuple[RegimeGap, ...]:
    """All regimes of all joints, p corrected for the largest of them."""
    joints, names = range(instants.error.shape[1]), get_args(Regime)
    # Fewer than ten instants a block tell of no regime.
    if len(instants.error) < 10 * FEWEST_BLOCKS:
        return tuple(RegimeGap(j, name, 0.0, (0.0, 0.0), 1.0) for j in joints for name in names)
    block = instants.blocks()
    count, kept = int(block.max()) + 1, block >= 0
    squared = instants.error[kept].square().unflatten(0, (count, -1))
    inside = instants.inside[:, kept].double().unflatten(1, (count, -1))
    share = inside.mean((1, 2))  # (R, n)
    # Share of time below which a regime is too rare to be compared with the rest, or the rest
    rare = 0.02
    possible = (share > rare) & (share < 1 - rare)
    inside = inside - share[:, None, None]
    # Each block of a regime with each block of the gap; an order picks one of each.
    products = torch.einsum("rkln,mln->rkmn", inside, squared - squared.mean((0, 1)))
    g = torch.Generator().manual_seed(seed)
    # Orders of the blocks that are drawn
    orders = 499
    order = torch.rand(orders, count, generator=g).argsort(-1)
    places = torch.arange(count)
    null = torch.stack([products[:, places, own].sum(1) for own in order])  # (D, R, n)
    mean, std = null.mean(0), null.std(0)
    there = possible & (std > 0)
    unit = torch.where(there, std, 1.0)
    observed = torch.where(there, (products[:, places, places].sum(1) - mean) / unit, -torch.inf)
    largest = torch.where(there, (null - mean) / unit, -torch.inf).amax((1, 2))
    p = (1 + (largest[:, None, None] >= observed).sum(0)) / (1 + orders)
    p = torch.where(there, p.double(), 1.0)
    # Of the squares above the noise the share that is in the regime beyond its share of the time.
    held, whole = (inside * squared).sum(2), squared.sum(1)
    noise = squared.shape[1] * floor.low.square().to(whole)

    def excess(weights: Float[Tensor, "D K"]) -> Float[Tensor, "D R n"]:
        # 0.1: share of a joint's squared gap that counts as above the floor at least, so that a
        # joint at its floor does not show arbitrarily large excesses
        above = (weights @ (whole - noise)).maximum(0.1 * (weights @ whole))
        found = torch.einsum("dk,rkn->drn", weights, held) / above.clamp(min=1e-300).unsqueeze(1)
        return torch.where(possible, found, 0.0).clamp(-1.0, 1.0)

    drawn = excess(torch.from_numpy(bootstrap_weights(count, DRAWS, np.random.default_rng(seed))))
    low, high = (drawn.quantile(end, 0) for end in tails())
    value = excess(torch.ones(1, count, dtype=torch.float64))[0]
    return tuple(
        RegimeGap(
            joint=j,
            regime=name,
            excess=float(value[r, j]),
            ci95=(float(low[r, j]), float(high[r, j])),
            p=float(p[r, j]),
        )
        for j in joints
        for r, name in enumerate(names)
    )


def regime_instants(traces: Sequence[Trace], band: float) -> list[dict[str, Bool[Tensor, "T n"]]]:
    """Parts of the time of each trajectory (T, n), by regime; none at instants that do not
    count."""
    motions = [t.motion.to("cpu") for t in traces]
    signs = [m.dq if m.direction is None else m.direction for m in motions]
    pick = [_kept(t, band) for t in traces]
    speed = torch.cat([m.dq[k].abs() for m, k in zip(motions, pick, strict=True)])
    fast = speed.quantile(0.99, 0)
    since = [
        _since_reversal(sign, m.dq, t.rate, REST * fast)
        for sign, m, t in zip(signs, motions, traces, strict=True)
    ]
    # Just after a reversal: a quarter of the time at most.
    some = torch.cat([x[k] for x, k in zip(since, pick, strict=True)])
    # 0.25: seconds after a reversal that count as one, at most
    recent = some.quantile(0.25, 0, interpolation="lower").clamp(max=0.25)
    out = []
    for trace, motion, own in zip(traces, motions, since, strict=True):
        dq, valid = motion.dq.abs(), trace.valid.cpu().unsqueeze(1)
        moves = dq >= REST * fast
        masks = {
            "rest": ~moves,
            "slow": moves & (dq < SLOW * fast),
            "fast": dq > FAST * fast,
            "reversal": own <= recent,
        }
        out.append({name: mask & valid for name, mask in masks.items()})
    return out


def _kept(trace: Trace, band: float) -> Bool[Tensor, " T"]:
    """Instants that are looked at."""
    kept = torch.zeros_like(trace.valid)
    # 3.0: instants kept a period of the band's edge
    kept[:: max(1, int(trace.rate / (3.0 * band)))] = True
    return (kept & trace.valid).cpu()


def _since_reversal(
    sign: Float[Tensor, "T n"], dq: Float[Tensor, "T n"], rate: float, slow: Float[Tensor, " n"]
) -> Float[Tensor, "T n"]:
    """Seconds since each joint last turned, whose direction is that from before while it crawls;
    inf before the first time."""
    places = torch.arange(len(dq)).unsqueeze(1).expand(dq.shape)
    last = torch.where(dq.abs() < slow, 0, places).cummax(0).values
    way = torch.sign(sign).gather(0, last)
    turned = torch.nn.functional.pad(way[1:] * way[:-1] < 0, (0, 0, 1, 0))
    since = torch.where(turned, places, -1).cummax(0).values
    return torch.where(since < 0, torch.inf, (places - since) / rate)
