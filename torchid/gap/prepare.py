"""From logs to passages: checked, resampled, differentiated and filtered before the search."""

import math
from dataclasses import dataclass, replace

import torch

from torchid.errors import LogError
from torchid.gap.held import passage_ages
from torchid.gap.passages import REACH, Passage, Rows, passages_of, row_masks, widened
from torchid.identification.identify import prepared
from torchid.identification.motion import Measurement, direction, fast_speed, measurements
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
"""Length of the shortest passage, in periods of the cut-off."""

DWELL = 0.2
"""Time below the reversal speed from which a joint counts as dwelling [s]."""


@dataclass(frozen=True)
class Prepared:
    """Logs ready for a search.

    Attributes:
        rows: of the passages.
        moving: (n, N) rows whose own joint moves; all of them where it hardly ever does.
        turning: (n, N) rows that a reversal of the own joint reaches.
        reach: (n,) how far it does, in periods of the cut-off.
        own_velocity: whether dq was measured on its own in every passage.
        age: whether held samples were found.
        still: joints, from 0, that never move.
        warnings: sentences for the user.
    """

    rows: Rows
    moving: Bool[Tensor, "n N"]
    turning: Bool[Tensor, "n N"]
    reach: Float[Tensor, " n"]
    own_velocity: bool
    age: bool
    still: tuple[int, ...]
    warnings: tuple[str, ...]

    @property
    def end(self) -> float:
        """Time at which the last passage ends [s]."""
        t = self.rows.passages[-1].motion.t
        assert t is not None
        return float(t[-1])

    def counting(self, noise_is_known: bool) -> Bool[Tensor, "n N"]:
        """Rows (n, N) that count.

        At a reversal a joint may stick, and no law says with which torque. Where the noise is known
        from repeats such rows would stand out as a gap of their own; where it is not, tests look at
        the spread between blocks and can bear them, and presliding shows there.
        """
        return self.moving & ~self.turning if noise_is_known else self.moving

    def reaching(self, reach: Float[Tensor, " n"]) -> "Prepared":
        """The same, where reversals reach so many periods of the cut-off."""
        moving, turning, _ = row_masks(self.rows, reach)
        return replace(self, moving=moving, turning=turning, reach=reach)


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


def prepare(robot: Robot, log: Log, cutoff: float | None, clock: float = 0.0) -> Prepared:
    """Check, resample, differentiate and filter logs.

    Args:
        robot: the logs' arm.
        log: one or several trajectories.
        cutoff: [Hz]; None for the default.
        clock: time at which the log begins [s], at the earliest: held-out logs come afterwards.

    Raises:
        LogError: what `torchid.identification.identify.prepared` refuses; different rates.
    """
    even, warnings = prepared(log, robot)
    narrow, wide = bands(even, cutoff)
    measured = measurements(even, wide)
    passages = _with_ages(passages_of(measured, wide, clock), even)
    threshold = reversal_speed(measured)
    passages = [
        replace(p, motion=p.motion._replace(direction=sharp_direction(p, threshold)))
        for p in passages
    ]
    long = [p for p in passages if p.samples > SHORTEST * p.rate / narrow]
    if not long:
        raise LogError(
            "every trajectory is too short for the diagnosis.",
            got=f"{max(p.samples / p.rate for p in passages):.3g} s",
            expected=f"more than {SHORTEST / narrow:.3g} s at a cut-off of {narrow:g} Hz",
        )
    rows = Rows(long, narrow)
    moving, turning, still = row_masks(rows)
    return Prepared(
        rows,
        moving,
        turning,
        torch.full((robot.n,), REACH, dtype=torch.float64),
        all(p.own_velocity for p in long),
        any(p.motion.age is not None for p in long),
        still,
        (*warnings, *(w for m in measured for w in m.warnings), *_said(still, passages, long)),
    )


def _with_ages(passages: list[Passage], even: Log) -> list[Passage]:
    """Passages that know the age of held torques, where any are held."""
    ages = passage_ages(even, passages)
    if not any(bool(age.any()) for age in ages):
        return passages
    pairs = zip(passages, ages, strict=True)
    return [replace(p, motion=p.motion._replace(age=age)) for p, age in pairs]


def sharp_direction(p: Passage, threshold: Float[Tensor, " n"]) -> Float[Tensor, "T n"]:
    """Direction of motion (T, n), from -1 to 1.

    Where a joint turns without stopping, the mean of its sign over a sampling interval, which puts
    the reversal between two samples where it belongs; where it dwells (slower than the threshold
    for more than `DWELL`), the direction it came from: velocity noise is no motion.
    """
    dq, ddq = p.motion.dq, p.motion.ddq
    turning = (dq / (ddq.abs() * 0.5 / p.rate).clamp(min=1e-12)).clamp(-1, 1)
    slow = (dq.abs() < threshold).double()
    inner = 1 - widened(1 - slow, 0.5 * DWELL * p.rate)
    dwells = widened(inner, 0.5 * DWELL * p.rate) > 0.5
    return torch.where(dwells, direction(dq, threshold).to(dq), turning)


def reversal_speed(measured: list[Measurement]) -> Float[Tensor, " n"]:
    """Speed (n,) that is neither noise nor much of the joint's own: four standard deviations of
    the velocity's noise, taken from its fastest changes, or 0.4 % of its 99 % speed."""
    speed = fast_speed(measured)
    rough = torch.cat([m.motion.dq.diff(dim=0).diff(dim=0) for m in measured])
    noise = 1.4826 * rough.abs().median(0).values / math.sqrt(6.0)
    return torch.maximum(REVERSAL * speed, torch.minimum(4 * noise, 0.05 * speed))


def _said(still: tuple[int, ...], passages: list[Passage], kept: list[Passage]) -> list[str]:
    said = []
    if still:
        names = ", ".join(str(j + 1) for j in still)
        said.append(f"joint {names} never moves: its friction and inertia cannot be told")
    left_out = [p.name for p in passages if p not in kept]
    if left_out:
        said.append("left out, too short for the filter: " + ", ".join(left_out))
    return said


def report_band(rows: Rows, wanted: float) -> float:
    """Band of the report [Hz]: wider than the fit's, as far as the passages go."""
    return max(rows.cutoff, min(wanted, 0.8 * rows.passages[0].band))
