"""From logs to data: checked, resampled, differentiated and filtered before anything is sought."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise

import torch

from torchid.design.bands import (
    ATTENUATED,
    CUTOFF,
    bands,
    position_noise,
    report_band,
    resolved,
    reversal_speed,
    sharp_direction,
)
from torchid.design.columns import Columns
from torchid.design.held import held_ages_of
from torchid.design.motion import HARDLY, Measurement, measurements, moves
from torchid.design.resonance import Swing, swings
from torchid.design.segments import (
    EDGE,
    Samples,
    Segment,
    moving_samples,
    segments_of,
    still_joints,
)
from torchid.design.signal import DRIVE_GAIN, from_current, without_signal
from torchid.errors import LogError
from torchid.gap.rows import STRETCH, spread_out
from torchid.gap.settings import GapSettings
from torchid.identification.logs import prepared, refuse_repeated
from torchid.log.model import Log
from torchid.log.sampling import at_rate
from torchid.robot.model import Robot, joint_list
from torchid.typing import Bool, Float, Int, Tensor

LONGEST = 2_100.0
"""Seconds of motion times joints that are searched: five minutes of seven joints, whose intervals
are far below what is worth a name. The search keeps the columns of all candidates there."""


SHORTEST = 4 * EDGE
"""Length of the shortest segment, in periods of the cut-off: both edges, and as much between."""


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
        silent: joints, from 0, whose measured torque follows nothing of the motion.
        band: of the report [Hz].
        gain_std: how well the scale of each joint's torque is known, as a share of it.
        gain_said: whether somebody says so: the user, or torque that is current times a gain. A
            sensor that nobody vouches for may have any scale.
        positions: (n,) noise that they bring into the model's torque in that band [N m; N].
        warnings: sentences for the user.
        lag: (n, N) by which links are behind their motors [rad; m]; None without encoders of the
            links.
        swings: links that swing on their joints' gears, by joint from 0.
    """

    samples: Samples
    keep: Bool[Tensor, "n N"]
    slides: Bool[Tensor, " n"]
    missing: frozenset[str]
    still: tuple[int, ...]
    silent: tuple[int, ...]
    band: float
    gain_std: float
    positions: Float[Tensor, " n"]
    warnings: tuple[str, ...]
    lag: Float[Tensor, "n N"] | None = None
    gain_said: bool = False
    swings: Mapping[int, Swing] = field(default_factory=dict)

    @property
    def segments(self) -> tuple[Segment, ...]:
        """Trajectories in the wide band."""
        return self.samples.segments

    @property
    def stands(self) -> bool:
        """Whether no joint moves in all of the log: at rest friction holds any torque, so that all
        it may show is a push."""
        return len(self.still) == self.keep.shape[0]

    def require_motion(self) -> None:
        """Raise unless something moves.

        Raises:
            LogError: nothing does.
        """
        if self.stands:
            raise LogError(
                "the arm stands still: a log without motion tells no cause of a gap.",
                got=f"{len(self.still)} joints that travel less than 0.001 rad (m)",
                expected="a log in which joints move, or in which the standing arm is pushed",
            )

    @property
    def end(self) -> float:
        """Time at which the last segment ends [s]."""
        return float(self.segments[-1].motion.require("t", "the end")[-1])

    @property
    def seconds(self) -> float:
        """Length of all samples together [s]."""
        return len(self.samples) * self.samples.interval

    def without_silent(self, columns: Columns, parts: Int[Tensor, " N"]) -> "Data":
        """These data; of joints whose torque holds no signal no sample counts.

        Args:
            columns: at the model as given.
            parts: (N,) stretch of every sample, from 1; 0 of those between stretches.
        """
        torque = self.samples.of([s.tau.T for s in self.segments])
        silent = without_signal(columns, torque, columns.gap, self.keep, parts)
        # What holds a base that moves is nothing, whatever its motion.
        silent[list(columns.model.robot.free)] = False
        if not bool(silent.any()):
            return self
        joints = tuple(silent.nonzero().flatten().tolist())
        said = (
            f"Caution: {joint_list(joints)}: neither the model nor any rigid body with "
            "friction predicts the measured torque better than its mean does, so no cause is "
            "sought there, and all of the gap there counts as noise."
        )
        keep = self.keep & ~silent.unsqueeze(1)
        return replace(self, keep=keep, silent=joints, warnings=(*self.warnings, said))

    def with_swings(self, columns: Columns) -> "Data":
        """These data, with the links that are seen to swing above the fit's band.

        Args:
            columns: at the model as given.
        """
        # Encoders of the links say more; a model that has elastic joints swings by itself.
        if self.lag is not None or any(effect.elastic for effect, _ in columns.model.effects):
            return self
        # 0.01: level of a false link that swings, among all joints
        return replace(self, swings=swings(columns, self.keep, 0.01))


def spread_over(log: Log, seconds: float) -> tuple[Log, tuple[str, ...]]:
    """So many seconds of a longer log, in stretches evenly spread over all of it, and that this is
    so.

    Args:
        log: on a uniform grid.
        seconds: how much is kept.
    """
    total = sum(log.duration)
    if total <= seconds:
        return log, ()
    stretches: list[tuple[str, slice]] = []
    for name, rows, held in zip(log.names, log.slices(), log.duration, strict=True):
        count = max(1, round(held / STRETCH))
        ends = [rows.start + (rows.stop - rows.start) * k // count for k in range(count + 1)]
        names = [name] if count == 1 else [f"{name} part {k + 1}" for k in range(count)]
        stretches += [(n, slice(a, b)) for n, (a, b) in zip(names, pairwise(ends), strict=True)]
    chosen = spread_out(stretches, seconds, total)
    parts = [log.select(rows).replace(names=(name,), warnings=()) for name, rows in chosen]
    kept = Log.concatenate(parts).replace(source=log.source, warnings=log.warnings)
    return kept, (
        f"Caution: of {total:.0f} s of motion {sum(kept.duration):.0f} s are searched, "
        f"{kept.samples} of {log.samples} rows: {len(parts)} stretches spread over all of it.",
    )


def prepare(
    robot: Robot,
    log: Log,
    cutoff: float | None,
    clock: float = 0.0,
    widest: float = math.inf,
    gain_std: float | None = None,
    rate: float = math.inf,
    force: bool = False,
) -> Data:
    """Check, resample, differentiate and filter logs.

    Args:
        robot: the logs' arm.
        log: one or several trajectories.
        cutoff: [Hz]; None for the default.
        clock: time at which the log begins [s], at the earliest: held-out logs come afterwards.
        widest: band of the report at most [Hz].
        gain_std: how well the scale of each joint's torque is known, as a share of it; None for the
            default.
        rate: to which faster trajectories are resampled [Hz]; that of the slowest at most.
        force: whether units that look wrong are said, and not refused.

    Raises:
        LogError: what `torchid.identification.logs.prepared` refuses.
    """
    even, warnings = prepared(log, robot, standing=True, force=force)
    even = at_rate(even, min(rate, *even.rates))
    warnings = tuple(dict.fromkeys([*warnings, *even.warnings]))
    even, spread = spread_over(even, LONGEST / log.n)
    # Differentiated in a wide band, from which all is filtered later.
    noise = position_noise(even, robot)
    highest = resolved(even, noise, robot.free)
    narrow, wide = bands(even, cutoff, highest)
    measured = measurements(even, wide)
    segments = _segments(even, measured, wide, clock)
    # Trajectories that the filter's edges leave something of.
    long = [s for s in segments if s.length > SHORTEST * s.rate / narrow]
    if not long:
        longest = max(s.length / s.rate for s in segments)
        raise LogError(
            "every trajectory is too short for the diagnosis.",
            got=f"{longest:.3g} s",
            expected=f"more than {SHORTEST / narrow:.3g} s at a cut-off of {narrow:g} Hz",
            hint=f"`cutoff={1.1 * SHORTEST / longest:.2g}` takes it, and more of the noise",
        )
    # Joints that never move.
    still = still_joints(long)
    said = [*warnings, *spread, *(w for m in measured for w in m.warnings)]
    if still:
        said.append(
            f"Next time: move {joint_list(still)}: at rest in all of this log, so no cause can be "
            "found there."
        )
    if highest < CUTOFF:
        said.append(
            f"above {highest:.2g} Hz noise of the positions, twice differentiated, is more than "
            f"{ATTENUATED:.0%} of a joint's torque: the gap is "
            + ("fitted and " if cutoff is None else "")
            + "reported below it"
        )
    left_out = [s.name for s in segments if s not in long]
    if left_out:
        said.append("left out, too short for the filter: " + ", ".join(left_out))
    # Torques that are currents times a gain are only as good as the gain.
    if gain_std is None and from_current(log):
        gain_std = DRIVE_GAIN
        said.append(
            "Caution: torque is computed from current. Its gain is assumed known to "
            f"{DRIVE_GAIN:.0%} (`gain_std=...`); every ± includes that."
        )
    samples = Samples(long, narrow)
    # What the log cannot show: joints that hardly slide, velocities and ages it does not hold.
    sliding = torch.cat([moves(s.motion, s.moving) for s in long]).double().mean(0)
    there = {"velocity": all(s.own_velocity for s in long)}
    there["age"] = all(s.motion.age is not None for s in long)
    missing = frozenset(name for name, holds in there.items() if not holds)
    keep, slides = moving_samples(samples), sliding >= HARDLY
    keep[list(robot.free)] = True
    band = report_band(samples, min(widest, highest))
    positions = noise * band**2.5
    lags = [s.motion.lag.T for s in long if s.motion.lag is not None]
    lag = samples.of(lags) if lags else None
    # 0.01: how well the scale of a measured torque is known: makers of joint torque sensors promise
    # half a per cent to one, and a model whose shape is right leaves as much
    known = 0.01 if gain_std is None else gain_std
    return Data(
        samples, keep, slides, missing, still, (), band, known, positions, tuple(said), lag,
        gain_said=gain_std is not None,
    )  # fmt: skip


def _segments(log: Log, measured: list[Measurement], wide: float, clock: float) -> list[Segment]:
    """Trajectories in the wide band, with the ages of torques that a logger repeats, and the
    direction of motion, sharper than the filter has it."""
    segments = segments_of(measured, wide, clock)
    ages = held_ages_of(log, segments)
    if any(bool(age.any()) for age in ages):
        pairs = zip(segments, ages, strict=True)
        segments = [replace(s, motion=s.motion._replace(age=age)) for s, age in pairs]
    threshold = reversal_speed(measured)
    return [
        replace(s, motion=s.motion._replace(direction=sharp_direction(s, threshold)))
        for s in segments
    ]


def read(
    robot: Robot, log: Log, held_out: Log | None, settings: GapSettings, force: bool = False
) -> tuple[Data, Data | None]:
    """The logs as data: the one searched, and the one held out.

    Raises:
        LogError: logs that do not fit the robot or each other.
    """
    if log.tau is not None and (held_out is None or held_out.tau is not None):
        refuse_repeated(log, held_out)
    cutoff = None if settings.cutoff == "auto" else settings.cutoff
    data = prepare(robot, log, cutoff, 0.0, settings.report_band, settings.gain_std, force=force)
    if held_out is None:
        return data, None
    # What is held out is read as what is searched is, at its rate at most.
    judged = prepare(
        robot, held_out, data.samples.cutoff, data.end + 1.0, data.band, data.gain_std,
        data.samples.rate, force,
    )  # fmt: skip
    return data, judged
