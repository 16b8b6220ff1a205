"""What the samples of a log tell of its motion, before any model is asked: how far and how fast a
joint goes where it moves, how noisy positions are, and whether dq is the rate of q.

A `Log` asks each of these once, and keeps the answer: `log.least_way`, `log.moving_speed`,
`log.noise_density` and `log.agreements`. What is filtered is not kept: the doctor smooths to the
band of the motion, a fit to its own cut-off, and servos take rows as they were sent, for a command
that is low-passed is no longer one.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch

from torchid.statistics.robust import column_quantile, white_variance
from torchid.statistics.spectrum import density
from torchid.typing import Float, Tensor

if TYPE_CHECKING:
    from torchid.log.model import Log

MOVING = 1e-2
"""A joint that varies more moves, in every log [rad or m]."""

RESTING = 0.02
"""A joint moves when its own |dq| exceeds this [rad/s or m/s], or less in a log that is slow in all
of it; slower, static friction can hold any torque and the sign of dq is noise."""

SLOW = 0.1
"""Share of the fast speed of a joint, or of a log, that is slow in all of it, below which it is at
rest."""

_LOOK_S, _ENOUGH_STEPS = 0.1, 20_000


@dataclass(frozen=True)
class Agreement:
    """How the measured dq of one joint relates to the change of its q.

    Attributes:
        joint: from 0.
        ratio: dq over the derivative of q, in size.
        correlation: of q with the integral of dq.
    """

    joint: int
    ratio: float
    correlation: float


def agreements_of(log: "Log") -> Iterator[Agreement]:
    """One record a joint that moves; none without dq.

    The integral of dq is compared with q, not dq with a derivative: encoder noise, quantisation
    and dropped packets matter little there.
    """
    if log.dq is None:
        return
    # Joint by joint: of a long log nothing is copied whole.
    for k, least in enumerate(log.least_way.tolist()):
        integrals, positions = [], []
        for rows in log.slices():
            t, q = log.t[rows], log.q[rows, k]
            integral = torch.zeros_like(q)
            integral[1:] = torch.cumulative_trapezoid(log.dq[rows, k], t)
            integrals.append(integral - integral.mean())
            positions.append(q - q.mean())
        moved, q = torch.cat(integrals), torch.cat(positions)
        a, b = float(moved.norm()), float(q.norm())
        if float(q.max() - q.min()) > least and a > 0.0:
            yield Agreement(k, a / b, float(moved @ q) / (a * b))


def least_way_of(log: "Log") -> Float[Tensor, " n"]:
    """How much each joint (n,) varies at least where it moves, as far as this log tells [rad or m]:
    its own motions and its resolution say so, in a log of small motions."""
    # 0.1: in one whose motions are smaller, a share of the farthest joint's way
    farthest = 0.1 * float((log.q.amax(0) - log.q.amin(0)).max())
    least = torch.full((log.n,), min(MOVING, farthest), dtype=torch.float64)
    if not farthest < MOVING:
        return least
    for k, q in enumerate(log.q.unbind(1)):
        parts = [q[rows].double() for rows in log.slices()]
        noise = white_variance(parts).sqrt()
        # An encoder's count is the smallest step.
        jumps = torch.cat([x.diff() for x in parts]).abs()
        count = jumps[jumps > 0].amin() if bool((jumps > 0).any()) else noise
        # 20.0: and many times what its positions resolve
        least[k] = max(float(least[k]), min(MOVING, 20.0 * float(max(noise, count))))
    return least


def noise_density_of(log: "Log") -> Float[Tensor, " n"]:
    """One-sided power density (n,) that the positions' spectra end with [rad^2/Hz or m^2/Hz], each
    trajectory's by its length (Welch 1967)."""
    level = torch.zeros(log.n, dtype=torch.float64)
    for rows, rate in zip(log.slices(), log.rates, strict=True):
        q = log.q[rows].double().numpy()
        frequency, power = density(q, rate, min(len(q), round(4 * rate)))
        top = (frequency > 0.375 * rate) & (frequency < 0.475 * rate)
        if top.any():
            level += len(q) / log.samples * torch.from_numpy(power[top]).median(0).values
    return level


def moving_speed_of(log: "Log") -> Float[Tensor, " n"]:
    """Speed (n,) above which joints move [rad/s or m/s]: `RESTING`, or a share of the log's fastest
    joint's if that is less, as far as noise of the positions does not make such speeds.

    That noise is of third differences of a log's beginning, not `Log.noise_density`: every fit asks
    for this speed, and of an hour of log a spectrum takes as long as the fit of a minute.
    """
    speeds, noise = [], torch.zeros(log.n, dtype=torch.float64)
    for rows, rate in zip(log.slices(), log.rates, strict=True):
        step, count = max(1, round(_LOOK_S * rate)), rows.stop - rows.start
        last = max(rows.start, rows.stop - step)
        begun = torch.arange(rows.start, last, max(1, count // _ENOUGH_STEPS))
        speeds.append((log.q[begun + step] - log.q[begun]).abs() * (rate / step))
        noise = torch.maximum(noise, white_variance([log.q[rows][:_ENOUGH_STEPS]]).cpu() / rate)
    all_speeds = torch.cat(speeds).double().cpu()
    fastest = float(column_quantile(all_speeds, 0.99).max()) if len(all_speeds) else RESTING / SLOW
    # 3900.0: velocities that noise of positions makes in the widest band, 40 Hz, three times: of
    # white noise s at a rate r it is 3 s sqrt(2 (2 pi)^2 40^3 / (3 r)), about this times s /
    # sqrt(r) [Hz^1.5]
    return (3900.0 * noise.sqrt()).clamp(min=SLOW * fastest).clamp(max=RESTING)
