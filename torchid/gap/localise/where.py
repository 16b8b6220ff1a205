"""Where the gap lies: joints, and regimes of each joint's motion."""

from collections.abc import Sequence
from typing import get_args

import numpy as np
import torch

from torchid.gap.diagnosis import Trace
from torchid.gap.localise.regimes import Pool, begins, masked_look, masks, pooled, reversal_look
from torchid.gap.localise.resampling import Draws, Look, corrected
from torchid.gap.localise.signatures import (
    drift_look,
    high_frequency_look,
    periodic_look,
    remainder,
    transient_look,
)
from torchid.gap.record import JointGap, NoiseFloor, Regime, RegimeGap, Window
from torchid.results.record import by_joint
from torchid.statistics.blocks import FEWEST_BLOCKS
from torchid.statistics.resampling import DRAWS, LEVEL, bootstrap_weights, tails
from torchid.typing import Float, Tensor

LEAST_ABOVE = 0.1
"""Share of a joint's squared gap that counts as above the floor at least, so that a joint at its
floor does not show arbitrarily large excesses."""


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
    joints = joint_gaps(traces, floor)
    pool = pooled(traces, band)
    # Fewer than ten instants a block tell of no regime.
    if pool.t.numel() < 10 * FEWEST_BLOCKS:
        return joints, tuple(
            RegimeGap(j, regime, 0.0, (0.0, 0.0), 1.0)
            for j in range(len(joints))
            for regime in get_args(Regime)
        )
    return joints, regime_gaps(pool, floor, seed, band, begins(traces))


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


def regime_gaps(
    pool: Pool, floor: NoiseFloor, seed: int, band: float, starts: Sequence[tuple[str, float]]
) -> tuple[RegimeGap, ...]:
    """All regimes of all joints, p corrected for the maximum over them; `starts`: name and first
    time of each trajectory."""
    # Every regime's statistic, with the same draws.
    draws = Draws.of(pool.blocks, seed)
    rest = remainder(pool)
    parts = masks(pool)
    transients = transient_look(pool, rest, draws)
    looks: dict[Regime, Look] = {
        "velocity_reversal": reversal_look(pool, draws),
        "low_speed": masked_look(pool, parts["low_speed"], draws),
        "high_speed": masked_look(pool, parts["high_speed"], draws),
        "high_acceleration": masked_look(pool, parts["high_acceleration"], draws),
        "gravity_load": masked_look(pool, parts["gravity_load"], draws),
        "position_periodic": periodic_look(pool, rest, draws, band),
        "high_frequency": high_frequency_look(pool, draws, band),
        "slow_drift": drift_look(pool, rest, draws),
        "transient": transients.look,
    }
    # Windows of transients on their trajectories' own time.
    times = [
        tuple(
            Window(name, start - begin, end - begin)
            for start, end in own
            for name, begin in [max((b for b in starts if b[1] <= start), key=lambda b: b[1])]
        )
        for own in transients.times
    ]
    # One correction for everything that was looked at.
    p = corrected(list(looks.values()))
    shares = [_excess(pool, floor, look, seed) for look in looks.values()]
    return tuple(
        RegimeGap(
            joint=j,
            regime=regime,
            excess=float(shares[k][0][j]),
            ci95=(float(shares[k][1][j]), float(shares[k][2][j])),
            p=float(p[k, j]),
            times=times[j] if regime == "transient" and p[k, j] < 1 - LEVEL else (),
        )
        for j in range(pool.error.shape[-1])
        for k, regime in enumerate(looks)
    )


def _excess(
    pool: Pool, floor: NoiseFloor, look: Look, seed: int
) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"], Float[Tensor, " n"]]:
    """Excess of a regime on each joint, and its interval by resampling blocks; 0 where the data
    do not allow the look."""
    # What the blocks hold, and what of it is noise.
    whole = pool.error.square().sum(1)
    noise = pool.error.shape[1] * floor.low.square().to(whole)

    def share(weights: Float[Tensor, "R K"]) -> Float[Tensor, "R n"]:
        total = weights @ whole
        above = (weights @ (whole - noise)).maximum(LEAST_ABOVE * total).clamp(min=1e-300)
        return torch.where(look.possible, look.energy(weights) / above, 0.0).clamp(-1.0, 1.0)

    # Its interval: the same share of resampled blocks.
    weights = bootstrap_weights(pool.blocks, DRAWS, np.random.default_rng(seed))
    spread = share(torch.from_numpy(weights))
    low, high = (spread.quantile(end, 0) for end in tails())
    return share(torch.ones(1, pool.blocks, dtype=torch.float64))[0], low, high
