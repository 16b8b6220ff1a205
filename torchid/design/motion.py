"""From a resampled log to motion that can be put into a regressor, trajectory by trajectory."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import torch

from torchid.design.in_parts import MotionInParts, held_sign
from torchid.effects.base import Motion
from torchid.errors import LogError
from torchid.log.assemble import OTHER_NAMES
from torchid.log.columns import column_names
from torchid.log.filtering import central_difference, lateness
from torchid.log.model import Log
from torchid.log.movement import RESTING, SLOW
from torchid.statistics.robust import column_quantile
from torchid.typing import Bool, Float, Int, Tensor

YIELDS = 0.02
"""A joint that is held gives way to a push by less than this [rad or m]."""

HARDLY = 0.1
"""Share of the time below which a joint hardly moves: what holds it is then most of what is known
about it, and all its samples count."""

LONG = 20_000_000
"""Values of a signal, samples times joints, from which on a log is filtered a part at a time."""

ENOUGH = 2_000_000
"""Samples of a trajectory that tell whether its velocities and accelerations can be used."""


_LAG_WORTH_SAYING = 2e-3


@dataclass(frozen=True)
class Measurement:
    """One trajectory, uniformly sampled and differentiated.

    Attributes:
        name: of the trajectory.
        rate: sampling rate [Hz].
        cutoff: of the motion's filter [Hz], or None for the log as it is.
        t: (T,) [s].
        motion: q, dq, ddq, each (T, n), filtered at the cut-off, and the direction of each joint;
            of a long log made when a part of it is asked for.
        tau: (T, n) measured torque, unfiltered.
        own_velocity: whether dq was measured, not differentiated from q.
        warnings: sentences for the user.
        moving: (n,) speed above which joints move, by all of the log (`Log.moving_speed`).
    """

    name: str
    rate: float
    cutoff: float | None
    t: Float[Tensor, " T"]
    motion: Motion | MotionInParts
    tau: Float[Tensor, "T n"]
    own_velocity: bool = False
    warnings: tuple[str, ...] = ()
    moving: Float[Tensor, " n"] | float = RESTING

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.t.shape[0]

    @property
    def whole(self) -> Motion:
        """The whole motion, in memory."""
        return self.motion.part(slice(None))

    @property
    def edge(self) -> int:
        """Samples to leave out at each end: one period of the cut-off."""
        return _edge(self.rate, self.cutoff)


def measurements(
    log: Log, cutoff: float | None, reversal: Float[Tensor, " n"] | None = None
) -> list[Measurement]:
    """Filter and differentiate every trajectory of a resampled log that has torques.

    Measured velocity is used where the log has one that agrees with positions, otherwise the
    central difference of position; acceleration is the central difference of velocity, unless the
    log gives one that agrees with it. With a cut-off all are low-passed with zero phase.

    Args:
        log: on a uniform grid.
        cutoff: [Hz], or None for no filter.
        reversal: (n,) speed a joint must reach before its direction counts as reversed; 0 if None.

    Raises:
        LogError: no torque in the log, or every trajectory is too short for the filter.
    """
    if log.tau is None:
        raise no_torque(log)
    threshold = torch.zeros(log.n, dtype=torch.float64) if reversal is None else reversal
    parts = list(zip(log.trajectories(), log.rates, strict=True))
    long = [p for p in parts if p[0].samples >= _needed(p[1], cutoff)]
    if not long:
        raise _too_short(*max(parts, key=lambda p: p[0].samples / p[1]), cutoff)
    in_parts, moving = log.samples * log.n > LONG, log.moving_speed
    out = [_measurement(part, rate, cutoff, threshold, in_parts, moving) for part, rate in long]
    left_out = [part.names[0] for part, rate in parts if part.samples < _needed(rate, cutoff)]
    if left_out:
        said = "left out, too short for the filter: " + ", ".join(left_out)
        out[0] = replace(out[0], warnings=(*out[0].warnings, said))
    return out


def timed(
    measured: Sequence[Measurement], origin: float | None = None, clock: float = 0.0
) -> list[Measurement]:
    """Trajectories whose motion has t, seconds since the first of them began.

    The clock runs on from one trajectory to the next where the log's own does not.

    Args:
        measured: in the order in which they were driven.
        origin: instant of the log from which t counts [s]; the first of these if None.
        clock: t at which they begin [s], at the earliest.
    """
    out = []
    for m in measured:
        t = m.t - (measured[0].t[0] if origin is None else origin)
        # Files whose clocks all start at zero follow one another, as far as anyone knows.
        t = t + max(0.0, clock - float(t[0]))
        clock = float(t[-1]) + 1 / m.rate
        out.append(replace(m, motion=m.motion._replace(t=t)))
    return out


def no_torque(log: Log) -> LogError:
    """The error of a log without torque, which may have currents."""
    each = ",".join(f"K{j + 1}" for j in range(log.n))
    gains = f'give the drive gains [N m/A]: `gain="{each}"`, or `drive_gain` in the robot\'s yaml'
    named = next((w for w in log.warnings if OTHER_NAMES in w), None)
    return LogError(
        f"log '{log.source}' has no torque.",
        got=", ".join(column_names(log)),
        expected="columns tau1.., or i1.. and drive gains; `torchid gap` takes commands u1.., too",
        hint=gains
        if log.current is not None
        else named or 'name its columns: `columns="tau=NAME_{j} Nm"`',
    )


def _edge(rate: float, cutoff: float | None) -> int:
    return 0 if cutoff is None else round(rate / cutoff)


def _needed(rate: float, cutoff: float | None) -> int:
    """Samples a trajectory must have."""
    # 10: samples that a trajectory must have left when the filter's edges are cut
    return 2 * _edge(rate, cutoff) + 10


def _too_short(log: Log, rate: float, cutoff: float | None) -> LogError:
    filtered = "" if cutoff is None else f" to be filtered at {cutoff:g} Hz"
    return LogError(
        f"trajectory '{log.names[0]}' is too short{filtered}.",
        got=f"{log.samples} samples at {rate:.4g} Hz",
        expected=f"at least {_needed(rate, cutoff)}",
    )


def resting_speed(
    motion: Motion, moving: Float[Tensor, " n"] | float = RESTING
) -> Float[Tensor, " n"]:
    """Speed (n,) above which each joint moves: that of the log, or a share of its own where it is
    slower in nearly all of the motion and yet goes farther than a push moves a joint that is held.

    Args:
        motion: of a trajectory.
        moving: speed above which joints of its log move (`Log.moving_speed`).
    """
    speed = motion.dq.abs()
    most = torch.as_tensor(moving).to(speed).expand(speed.shape[1])
    fast = column_quantile(speed[:: max(1, len(speed) // 100_000)], 0.99)
    slow = (speed > most).double().mean(0) < HARDLY
    slow &= motion.q.amax(0) - motion.q.amin(0) > YIELDS
    return torch.where(slow, torch.minimum(SLOW * fast, most), most)


def moves(motion: Motion, moving: Float[Tensor, " n"] | float = RESTING) -> Bool[Tensor, "T n"]:
    """Whether each joint moves; arguments as of `resting_speed`."""
    return motion.dq.abs() > resting_speed(motion, moving)


def fast_speed(measured: Sequence[Measurement]) -> Float[Tensor, " n"]:
    """Speed that each joint exceeds in one of a hundred samples."""
    total = sum(m.samples for m in measured)
    step = max(1, total // 100_000)
    # Every so many samples of all trajectories one after another.
    speeds, before = [], 0
    for m in measured:
        rows = slice(-before % step, None, step)
        motion = m.motion.part(rows) if isinstance(m.motion, Motion) else m.motion.undirected(rows)
        speeds.append(motion.dq.abs())
        before += m.samples
    return column_quantile(torch.cat(speeds), 0.99)


def direction(dq: Float[Tensor, "T n"], threshold: Float[Tensor, " n"]) -> Int[Tensor, "T n"]:
    """Direction of motion, -1, 0 or 1, with hysteresis: the sign of the last velocity above the
    threshold, so that a joint at rest keeps the direction it came from; 0 before the first one.

    Friction does not reverse at the instant the velocity does: asperities and gear teeth first
    spring back (presliding), and velocity noise at standstill is no motion at all.
    """
    columns = zip(dq.unbind(-1), threshold.to(dq).unbind(), strict=True)
    return torch.stack([held_sign(x, limit) for x, limit in columns], -1)


def _measurement(
    log: Log, rate: float, cutoff: float | None, threshold: Tensor, in_parts: bool, moving: Tensor
) -> Measurement:
    assert log.tau is not None
    own_velocity, own_acceleration, warnings = _measured(log, rate, cutoff)
    motion = MotionInParts(log, rate, cutoff, threshold, own_velocity, own_acceleration)
    return Measurement(
        log.names[0], rate, cutoff, log.t, motion if in_parts else motion.whole(), log.tau,
        own_velocity, tuple(warnings), moving,
    )  # fmt: skip


def _measured(log: Log, rate: float, cutoff: float | None) -> tuple[bool, bool, list[str]]:
    """Whether the log's velocities and accelerations are used, else those of positions; and what
    was noticed about them."""
    warnings: list[str] = []
    if cutoff is None:
        return log.dq is not None, log.ddq is not None, warnings
    own_velocity = log.dq is not None
    if log.dq is not None:
        lag, difference = velocity_lag(log.q, log.dq, rate, cutoff)
        # 0.15: relative difference from the derivative of q from which on that is used
        if difference > 0.15:
            warnings.append(
                f"{log.names[0]}: measured dq differs from the derivative of q by "
                f"{100 * difference:.0f} % (lag {lag * 1e3:.0f} ms), so the derivative is used"
            )
            own_velocity = False
        elif abs(lag) > _LAG_WORTH_SAYING:
            word = "lags" if lag > 0 else "leads"
            warnings.append(
                f"{log.names[0]}: measured dq {word} the derivative of q by {abs(lag) * 1e3:.1f} ms"
            )
    if log.ddq is None:
        return own_velocity, False, warnings
    columns = (log.dq if log.dq is not None and own_velocity else log.q)[:ENOUGH].T
    once = (x if own_velocity else central_difference(x, rate) for x in columns)
    references = (central_difference(x, rate) for x in once)
    lag, difference = _lag(zip(references, log.ddq[:ENOUGH].T, strict=True), rate, cutoff)
    agree = 0.02
    if difference >= agree:
        warnings.append(
            f"{log.names[0]}: the log's ddq differs from the derivative of dq by "
            f"{100 * difference:.1f} % (lag {lag * 1e3:.0f} ms), so the derivative is used"
        )
    return own_velocity, difference < agree, warnings


def velocity_lag(
    q: Float[Tensor, "T n"], dq: Float[Tensor, "T n"], rate: float, cutoff: float
) -> tuple[float, float]:
    """By how much measured velocities are behind the derivative of positions [s], the median of the
    joints, and their relative difference, the largest of them."""
    references = (central_difference(x, rate) for x in q[:ENOUGH].T)
    return _lag(zip(references, dq[:ENOUGH].T, strict=True), rate, cutoff)


def _lag(
    pairs: Iterable[tuple[Float[Tensor, " T"], Float[Tensor, " T"]]], rate: float, cutoff: float
) -> tuple[float, float]:
    """Median lag [s] of signals behind their references, a pair a joint, and their relative
    difference, the largest over joints (relative to 1 % of the fastest joint's reference, at
    least)."""
    sums = [lateness(*pair, rate, min(cutoff, 0.4 * rate)) for pair in pairs]
    along, energy, size, apart = torch.stack(sums, -1)
    difference = apart.sqrt() / size.sqrt().clamp(min=max(1e-300, 0.01 * float(size.max()) ** 0.5))
    active = energy > 1e-6 * energy.max()
    if not bool(active.any()):
        return 0.0, float(difference.max())
    lag = along[active] / energy[active]
    return float(lag.median()), float(difference.max())
