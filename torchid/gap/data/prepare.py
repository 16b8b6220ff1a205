"""From logs to data: checked, resampled, differentiated and filtered before anything is sought."""

import math
from dataclasses import dataclass, replace

import torch

from torchid.design.motion import MOVING, Measurement, direction, fast_speed, measurements
from torchid.design.segments import (
    HARDLY,
    Samples,
    Segment,
    moving_samples,
    segments_of,
    still_joints,
    widened,
)
from torchid.errors import LogError
from torchid.gap.data.held import held_ages_of
from torchid.identification.identify import prepared
from torchid.log.model import Log
from torchid.log.sampling import sampling_rate
from torchid.robot.model import Robot
from torchid.typing import Bool, Float, Tensor

CUTOFF = 8.0
"""Default cut-off [Hz]. Higher ones let in columns that differentiate again (elasticity, backlash)
and share the encoder's noise with the residual."""

WIDE_BAND = 40.0
"""Band [Hz] of the motion from which columns are computed, at the default cut-off."""

REVERSAL = 0.004
"""Speed at which a reversal counts, as a fraction of the joint's 99 % speed; noise can raise it."""

SAME_RATE = 0.02
"""Relative difference of two sampling rates that count as one."""

SHORTEST = 12.0
"""Length of the shortest segment, in periods of the cut-off."""

DWELL = 0.2
"""Time below the reversal speed from which a joint counts as dwelling [s]."""


@dataclass(frozen=True, eq=False)
class Data:
    """Logs ready for a search.

    Attributes:
        samples: of the segments.
        keep: (n, N) samples that count: those whose own joint moves, at rest static friction holds
            any torque; all of them where it hardly ever does.
        slides: (n,) joints that move more than hardly ever.
        missing: what effects may need and the log does not hold: `velocity`, `age`.
        still: joints, from 0, that never move.
        warnings: sentences for the user.
    """

    samples: Samples
    keep: Bool[Tensor, "n N"]
    slides: Bool[Tensor, " n"]
    missing: frozenset[str]
    still: tuple[int, ...]
    warnings: tuple[str, ...]

    @property
    def segments(self) -> tuple[Segment, ...]:
        """Trajectories in the wide band."""
        return self.samples.segments

    @property
    def end(self) -> float:
        """Time at which the last segment ends [s]."""
        return float(self.segments[-1].motion.require("t", "the end")[-1])

    @property
    def seconds(self) -> float:
        """Length of all samples together [s]."""
        return len(self.samples) * self.samples.interval


def bands(log: Log, cutoff: float | None) -> tuple[float, float]:
    """Cut-off and wide band [Hz] that the log allows: by default 8 Hz, and five times as much.

    Raises:
        LogError: trajectories at different rates, or a cut-off that the log cannot hold.
    """
    rates = sampling_rate(log)
    rate = min(rates)
    if max(rates) > (1 + SAME_RATE) * rate:
        listed = ", ".join(f"{n} {r:.4g} Hz" for n, r in zip(log.names, rates, strict=True))
        raise LogError(
            "the logs have different sampling rates.",
            got=listed,
            expected="one rate",
            hint="diagnose them one by one, or resample them to the lowest rate",
        )
    chosen = min(CUTOFF, rate / 6) if cutoff is None else cutoff
    if chosen > 0.4 * rate:
        raise LogError(
            "the cut-off is outside the log's band.",
            got=f"{chosen:g} Hz",
            expected=f"below {0.4 * rate:.4g} Hz at {rate:.4g} Hz",
        )
    return chosen, min(max(WIDE_BAND / CUTOFF * chosen, 20.0), 0.4 * rate)


def prepare(robot: Robot, log: Log, cutoff: float | None, clock: float = 0.0) -> Data:
    """Check, resample, differentiate and filter logs.

    Args:
        robot: the logs' arm.
        log: one or several trajectories.
        cutoff: [Hz]; None for the default.
        clock: time at which the log begins [s], at the earliest: held-out logs come afterwards.

    Raises:
        LogError: what `torchid.identification.identify.prepared` refuses; different rates; a log
            in which nothing moves.
    """
    even, warnings = prepared(log, robot)
    narrow, wide = bands(even, cutoff)
    measured = measurements(even, wide)
    segments = segments_of(measured, wide, clock)
    # Torques that a logger repeats, and the direction of motion, sharper than the filter has it.
    ages = held_ages_of(even, segments)
    if any(bool(age.any()) for age in ages):
        pairs = zip(segments, ages, strict=True)
        segments = [replace(s, motion=s.motion._replace(age=age)) for s, age in pairs]
    threshold = reversal_speed(measured)
    segments = [
        replace(s, motion=s.motion._replace(direction=sharp_direction(s, threshold)))
        for s in segments
    ]
    long = [s for s in segments if s.length > SHORTEST * s.rate / narrow]
    if not long:
        raise LogError(
            "every trajectory is too short for the diagnosis.",
            got=f"{max(s.length / s.rate for s in segments):.3g} s",
            expected=f"more than {SHORTEST / narrow:.3g} s at a cut-off of {narrow:g} Hz",
        )
    still = still_joints(long)
    if len(still) == robot.n:
        raise LogError(
            "the arm stands still: a log without motion tells no cause of a gap.",
            got=f"{robot.n} joints that travel less than 0.001 rad (m)",
            expected="a log in which joints move",
        )
    said = [*warnings, *(w for m in measured for w in m.warnings)]
    if still:
        names = ", ".join(str(j + 1) for j in still)
        said.append(f"joint {names} never moves: its friction and inertia cannot be told")
    left_out = [s.name for s in segments if s not in long]
    if left_out:
        said.append("left out, too short for the filter: " + ", ".join(left_out))
    samples = Samples(long, narrow)
    moves = torch.cat([s.motion.dq.abs() > MOVING for s in long]).double().mean(0)
    own_velocity = all(s.own_velocity for s in long)
    missing = frozenset() if own_velocity else frozenset({"velocity"})
    if any(s.motion.age is None for s in long):
        missing |= {"age"}
    return Data(samples, moving_samples(samples), moves >= HARDLY, missing, still, tuple(said))


def sharp_direction(s: Segment, threshold: Float[Tensor, " n"]) -> Float[Tensor, "T n"]:
    """Direction of motion (T, n), from -1 to 1.

    Where a joint turns without stopping, the mean of its sign over a sampling interval, which puts
    the reversal between two samples where it belongs; where it dwells (slower than the threshold
    for more than `DWELL`), the direction it came from: velocity noise is no motion.
    """
    dq, ddq = s.motion.dq, s.motion.ddq
    turning = (dq / (ddq.abs() * 0.5 / s.rate).clamp(min=1e-12)).clamp(-1, 1)
    slow = (dq.abs() < threshold).double()
    inner = 1 - widened(1 - slow, 0.5 * DWELL * s.rate)
    dwells = widened(inner, 0.5 * DWELL * s.rate) > 0.5
    return torch.where(dwells, direction(dq, threshold).to(dq), turning)


def reversal_speed(measured: list[Measurement]) -> Float[Tensor, " n"]:
    """Speed (n,) that is neither noise nor much of the joint's own: four standard deviations of
    the velocity's noise, taken from its fastest changes, or 0.4 % of its 99 % speed."""
    speed = fast_speed(measured)
    rough = torch.cat([m.motion.dq.diff(dim=0).diff(dim=0) for m in measured])
    noise = 1.4826 * rough.abs().median(0).values / math.sqrt(6.0)
    return torch.maximum(REVERSAL * speed, torch.minimum(4 * noise, 0.05 * speed))


def report_band(samples: Samples, wanted: float) -> float:
    """Band of the report [Hz]: wider than the fit's, as far as the segments go."""
    return max(samples.cutoff, min(wanted, 0.8 * samples.segments[0].band))
