"""The answer: where the gap lies, which effects cause it, how far it shrinks."""

import itertools
from dataclasses import dataclass
from typing import Any, Literal

from torchid.effects.base import Effect, Motion
from torchid.effects.registry import Valued
from torchid.robot.model import Robot
from torchid.typing import Bool, Float, Tensor

Status = Literal["no_gap", "parametric_only", "explained", "detected_unexplained", "not_testable"]

Regime = Literal[
    "velocity_reversal",
    "low_speed",
    "high_speed",
    "high_acceleration",
    "gravity_load",
    "position_periodic",
    "high_frequency",
    "slow_drift",
    "transient",
]

Interval = tuple[float, float]

OFTEN = 0.8
"""Share of draws in which a cause must be told to count as one that is found."""


@dataclass(frozen=True)
class Trace:
    """One trajectory's torque in the band of the report, before and after, none of it fitted on
    this trajectory (or block).

    Attributes:
        name: of the trajectory.
        rate: [Hz].
        motion: q, dq, ddq, t.
        measured, before, after: (T, n) torque [N m; N]: measured; of the model as given; of the
            model with the accepted effects, selected and fitted on other trajectories or blocks.
        valid: (T,) instants that count (edges and gaps between blocks do not).
        moving: (T, n) instants at which each joint moves, and does not reverse where the noise is
            known: only those count for how far the gap closes. None: all.
    """

    name: str
    rate: float
    motion: Motion
    measured: Float[Tensor, "T n"]
    before: Float[Tensor, "T n"]
    after: Float[Tensor, "T n"]
    valid: Bool[Tensor, " T"]
    moving: Bool[Tensor, "T n"] | None = None

    @property
    def counting(self) -> Bool[Tensor, "T n"]:
        """Instants of each joint that count for how far the gap closes."""
        every = self.valid.unsqueeze(1).expand_as(self.measured)
        return every if self.moving is None else every & self.moving


@dataclass(frozen=True)
class NoiseFloor:
    """RMS of the noise in the band of the report.

    Attributes:
        low, high: (n,) bracket [N m; N].
        source: `repeats` or `bracket`.
        notes: sentences for the user.
    """

    low: Float[Tensor, " n"]
    high: Float[Tensor, " n"]
    source: Literal["repeats", "bracket"]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class JointGap:
    """Gap of the model as given on one joint (from 0)."""

    joint: int
    gap_rms: float
    noise_floor_rms: Interval
    share: float


@dataclass(frozen=True)
class RegimeGap:
    """Excess of the squared gap in one regime of one joint (from 0) over the rest of its rows.

    Attributes:
        joint, regime: where.
        excess: share of the joint's squared gap above the noise floor that lies in the regime
            beyond what the regime's share of time would hold.
        ci95: its interval, over blocks.
        p: corrected for the maximum over all joints and regimes.
        times: trajectory, and start and end [s] in it, of the windows of a transient.
    """

    joint: int
    regime: Regime
    excess: float
    ci95: Interval
    p: float
    times: tuple[tuple[str, float, float], ...] = ()


@dataclass(frozen=True)
class Planted:
    """What this log would show of a cause and of R - 1 others in its place, if what the answer
    leaves were noise: shares of draws.

    Attributes:
        names: (R,) the cause first.
        told: (R, R + 1) with each of them planted, which is told; none, last.
        found: by size, as a share of the fitted one, how often the cause is told.
    """

    names: tuple[str, ...]
    told: tuple[tuple[float, ...], ...]
    found: tuple[tuple[float, float], ...]

    @property
    def smallest(self) -> float | None:
        """The size, as a share of the fitted one, from which on the cause is told in four of five
        draws, between sizes by interpolation; None if there is none."""
        for (a, low), (b, high) in itertools.pairwise(((0.0, 0.0), *self.found)):
            if high >= OFTEN:
                return a + (b - a) * (OFTEN - low) / (high - low)
        return None


@dataclass(frozen=True)
class Finding:
    """An accepted effect.

    Attributes:
        effect, values: which, and its coefficients; of an effect common to all joints, that of the
            first.
        joints: from 0; of a global effect those whose torque it changes beyond noise.
        ambiguous_with: names of effects the data do not separate it from.
        std: block-robust standard deviations of the coefficients.
        p_value: family-wise, by the test that judged it.
        how_sure: probability of it, against nothing and against what it cannot be told from.
        share: of the closable gap that it closes in its turn: at every turn that cause joins which
            closes most, all refitted, so that the shares add up to one.
        first: of the closable gap that it closes alone.
        notes: sentences, e.g. a coefficient that is not determined.
        common: whether one coefficient is common to all joints.
        planted: what the log would show of it and of its likeliest alternatives.
    """

    effect: Effect
    values: tuple[float, ...]
    joints: tuple[int, ...]
    ambiguous_with: tuple[str, ...]
    std: tuple[float, ...]
    p_value: float
    how_sure: float
    share: float
    first: float
    notes: tuple[str, ...] = ()
    common: bool = False
    planted: Planted | None = None

    @property
    def located(self) -> tuple[int, ...]:
        """Joints that the effect is at, from 0; none where it belongs to the whole arm."""
        return () if self.common else self.effect.joints

    @property
    def valued(self) -> Valued:
        """Effect and coefficients, for a model."""
        return self.effect, list(self.values)


@dataclass(frozen=True)
class Parametric:
    """Inertial parameters that had to be changed: of one link, or all base parameters.

    Attributes:
        links: from 0; empty for all base parameters.
        share, p_value, how_sure: as Finding's; None where the parameters are always refitted.
        ambiguous_with: names of effects.
    """

    links: tuple[int, ...]
    share: float
    p_value: float | None
    ambiguous_with: tuple[str, ...] = ()
    how_sure: float | None = None


@dataclass(frozen=True)
class HowFar:
    """RMS over all joints in the band of the report, each joint divided by nothing: N m (or N).

    Attributes:
        rms_before, rms_after: (n,) on data used for no choice, while the joint moves: at rest, and
            where it may stick, friction can be anything.
        closed: closed fraction of the closable gap, (L0 - L*) / (L0 - Ln), joints weighted by
            their noise; None where the gap's interval holds zero.
        closed_ci95: over blocks of whole trajectories or contiguous stretches.
        rollout: see torchid.gap.rollout, or None.
    """

    rms_before: Float[Tensor, " n"]
    rms_after: Float[Tensor, " n"]
    closed: float | None
    closed_ci95: Interval | None
    rollout: dict[str, Any] | None = None


@dataclass(frozen=True)
class Budget:
    """Shares of the gap: what refitted base parameters close, what effects close, what is left."""

    parametric: float
    structural: float
    unexplained: float


@dataclass(frozen=True)
class NotTestable:
    """An effect these data could not show.

    Attributes:
        effect: name.
        joints: from 0; none for a global effect.
        smallest_detectable: coefficient that would have been detected, in `unit`; None where no
            size would: its columns vanish or are exactly those of base parameters.
        unit: of the first coefficient.
        reason: one sentence.
    """

    effect: str
    joints: tuple[int, ...]
    smallest_detectable: float | None
    unit: str
    reason: str


@dataclass(frozen=True)
class Diagnosis:
    """All of it.

    Attributes:
        robot: the model as given (with fitted parameters, where it had none).
        corrected: the robot with accepted effects and corrected parameters.
        status: the verdict.
        joints, regimes: where.
        findings, parametric: which.
        how_far, budget: how far.
        floor: noise in the band of the report.
        not_testable: effects these data cannot show, with the smallest size that could be seen.
        next_experiment: what would separate an ambiguity, or None.
        traces: held-out torque before and after, trajectory by trajectory.
        band, cutoff: of the report and of the fit [Hz].
        settings: as a record.
        warnings: sentences for the user.
    """

    robot: Robot
    corrected: Robot
    status: Status
    joints: tuple[JointGap, ...]
    regimes: tuple[RegimeGap, ...]
    findings: tuple[Finding, ...]
    parametric: tuple[Parametric, ...]
    how_far: HowFar
    budget: Budget
    floor: NoiseFloor
    not_testable: tuple[NotTestable, ...]
    next_experiment: dict[str, Any] | None
    traces: tuple[Trace, ...]
    band: float
    cutoff: float
    settings: dict[str, Any]
    warnings: tuple[str, ...]

    def __repr__(self) -> str:
        effects = ", ".join(f.effect.name for f in self.findings) or "no effects"
        closed = (
            "" if self.how_far.closed is None else f", {100 * self.how_far.closed:.0f} % closed"
        )
        return f"Diagnosis('{self.robot.name}', {self.status}: {effects}{closed})"
