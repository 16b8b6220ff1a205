"""From a resampled log to motion that can be put into a regressor, trajectory by trajectory."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from torchid.effects.base import Motion
from torchid.effects.friction_laws import RESTING
from torchid.errors import LogError
from torchid.log.columns import column_names
from torchid.log.filtering import ZeroPhaseFilter, central_difference, low_passed
from torchid.log.model import Log
from torchid.log.sampling import sampling_rate
from torchid.typing import Bool, Float, Int, Tensor

MOVING = RESTING
"""A joint moves when its own |dq| exceeds this [rad/s or m/s]; slower, static friction can hold
any torque and the sign of dq is noise."""

WIDE = 5.0
"""The direction of motion is taken from velocity filtered at this multiple of the cut-off, so that
a reversal stays sharp until the common filter smooths it like the torque."""

ROUNDED = 1e-9
"""Share of a joint's largest speed below which it is rounding."""

FEWEST = 10
"""Samples that a trajectory must have left when the filter's edges are cut."""

_AGREE = 0.02
_VELOCITY_AGREES = 0.15
_LAG_WORTH_SAYING = 2e-3


@dataclass(frozen=True)
class Measurement:
    """One trajectory, uniformly sampled and differentiated.

    Attributes:
        name: of the trajectory.
        rate: sampling rate [Hz].
        cutoff: of the motion's filter [Hz], or None for the log as it is.
        t: (T,) [s].
        motion: q, dq, ddq, each (T, n), filtered at the cut-off, and the direction of each joint.
        tau: (T, n) measured torque, unfiltered.
        own_velocity: whether dq was measured, not differentiated from q.
        warnings: sentences for the user.
    """

    name: str
    rate: float
    cutoff: float | None
    t: Float[Tensor, " T"]
    motion: Motion
    tau: Float[Tensor, "T n"]
    own_velocity: bool = False
    warnings: tuple[str, ...] = ()

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.t.shape[0]

    @property
    def moving(self) -> Bool[Tensor, "T n"]:
        """Whether each joint moves."""
        return self.motion.dq.abs() > MOVING

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
    parts = list(zip(log.trajectories(), sampling_rate(log), strict=True))
    long = [p for p in parts if p[0].samples >= _needed(p[1], cutoff)]
    if not long:
        raise _too_short(*max(parts, key=lambda p: p[0].samples / p[1]), cutoff)
    out = [_measurement(part, rate, cutoff, threshold) for part, rate in long]
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
    gains = "give gains: Log.with_torque, `gain=...`, or `drive_gain` in the robot's yaml"
    return LogError(
        f"log '{log.source}' has no torque.",
        got=", ".join(column_names(log)),
        expected="columns tau1.., or i1.. and drive gains; `torchid gap` takes commands u1.., too",
        hint=None if log.current is None else gains,
    )


def _edge(rate: float, cutoff: float | None) -> int:
    return 0 if cutoff is None else round(rate / cutoff)


def _needed(rate: float, cutoff: float | None) -> int:
    """Samples a trajectory must have."""
    return 2 * _edge(rate, cutoff) + FEWEST


def _too_short(log: Log, rate: float, cutoff: float | None) -> LogError:
    filtered = "" if cutoff is None else f" to be filtered at {cutoff:g} Hz"
    return LogError(
        f"trajectory '{log.names[0]}' is too short{filtered}.",
        got=f"{log.samples} samples at {rate:.4g} Hz",
        expected=f"at least {_needed(rate, cutoff)}",
    )


def fast_speed(measured: list[Measurement]) -> Float[Tensor, " n"]:
    """Speed that each joint exceeds in one of a hundred samples."""
    speeds = torch.cat([m.motion.dq.abs() for m in measured])
    return torch.quantile(speeds[:: max(1, len(speeds) // 100_000)], 0.99, dim=0)


def direction(dq: Float[Tensor, "T n"], threshold: Float[Tensor, " n"]) -> Int[Tensor, "T n"]:
    """Direction of motion, -1, 0 or 1, with hysteresis: the sign of the last velocity above the
    threshold, so that a joint at rest keeps the direction it came from; 0 before the first one.

    Friction does not reverse at the instant the velocity does: asperities and gear teeth first
    spring back (presliding), and velocity noise at standstill is no motion at all.
    """
    columns = zip(dq.unbind(-1), threshold.to(dq).unbind(), strict=True)
    return torch.stack([_held_sign(x, limit) for x, limit in columns], -1)


def _held_sign(dq: Float[Tensor, " T"], threshold: Tensor) -> Int[Tensor, " T"]:
    index = torch.arange(len(dq), device=dq.device)
    speed = dq.abs()
    # At exact rest rounding has a sign too, another one in another file of the same log.
    least = torch.maximum(threshold, ROUNDED * speed.max())
    last = torch.cummax(torch.where(speed > least, index, -1), 0).values
    sign = torch.sign(dq).to(torch.int8)[last.clamp(min=0)]
    return torch.where(last >= 0, sign, torch.zeros_like(sign))


def _measurement(log: Log, rate: float, cutoff: float | None, threshold: Tensor) -> Measurement:
    assert log.tau is not None
    q = log.q.T
    dq, ddq, own, warnings = _derivatives(log, rate, cutoff)
    sharp = dq
    if cutoff is not None:
        sharp = low_passed(dq, rate, WIDE * cutoff)
        q, dq, ddq = (low_passed(x, rate, cutoff) for x in (q, dq, ddq))
    q, dq, ddq = (x.T.contiguous() for x in (q, dq, ddq))
    # Without a filter and a reversal speed the log is taken at its word, rest included.
    literal = cutoff is None and not bool(threshold.any())
    lag = None
    if log.ql is not None:
        lag = log.q - log.ql
        lag = lag if cutoff is None else low_passed(lag.T, rate, cutoff).T.contiguous()
    sign = None if literal else direction(sharp.T, threshold)
    motion = Motion(q, dq, ddq, sign, lag=lag)
    return Measurement(log.names[0], rate, cutoff, log.t, motion, log.tau, own, tuple(warnings))


def _derivatives(
    log: Log, rate: float, cutoff: float | None
) -> tuple[Tensor, Tensor, bool, list[str]]:
    """dq and ddq (n, T), whether that dq is a measured one, and what was noticed about it."""
    warnings: list[str] = []
    derivative = central_difference(log.q.T, rate)
    dq = derivative if log.dq is None else log.dq.T
    own, measured = central_difference(dq, rate), log.dq is not None
    if log.dq is not None and cutoff is not None:
        lag, difference = _lag(derivative, dq, rate, cutoff)
        if difference > _VELOCITY_AGREES:
            warnings.append(
                f"{log.names[0]}: measured dq differs from the derivative of q by "
                f"{100 * difference:.0f} % (lag {lag * 1e3:.0f} ms), so the derivative is used"
            )
            dq, own, measured = derivative, central_difference(derivative, rate), False
        elif abs(lag) > _LAG_WORTH_SAYING:
            word = "lags" if lag > 0 else "leads"
            warnings.append(
                f"{log.names[0]}: measured dq {word} the derivative of q by {abs(lag) * 1e3:.1f} ms"
            )
    if log.ddq is None:
        return dq, own, measured, warnings
    if cutoff is None:
        return dq, log.ddq.T, measured, warnings
    lag, difference = _lag(own, log.ddq.T, rate, cutoff)
    if difference < _AGREE:
        return dq, log.ddq.T, measured, warnings
    warnings.append(
        f"{log.names[0]}: the log's ddq differs from the derivative of dq by "
        f"{100 * difference:.1f} % (lag {lag * 1e3:.0f} ms), so the derivative is used"
    )
    return dq, own, measured, warnings


def _lag(reference: Tensor, signal: Tensor, rate: float, cutoff: float) -> tuple[float, float]:
    """Median lag [s] of `signal` behind `reference` (n, T), and their relative difference, the
    largest over joints (relative to 1 % of the fastest joint's reference, at least).

    reference(t) = signal(t + lag) to first order; both low-passed, edges left out.
    """
    low_pass = ZeroPhaseFilter(rate, min(cutoff, 0.4 * rate))
    edge = min(round(rate / cutoff), reference.shape[-1] // 4)
    middle = slice(edge, reference.shape[-1] - edge)
    a, b = low_pass.apply(reference), low_pass.apply(signal)
    slope = central_difference(b, rate)[..., middle]
    gap = (a - b)[..., middle]
    size = a[..., middle].norm(dim=-1)
    difference = gap.norm(dim=-1) / size.clamp(min=max(1e-300, 0.01 * float(size.max())))
    energy = (slope * slope).sum(-1)
    active = energy > 1e-6 * energy.max()
    if not bool(active.any()):
        return 0.0, float(difference.max())
    lag = (gap * slope).sum(-1)[active] / energy[active]
    return float(lag.median()), float(difference.max())
