"""A diagnosis as its JSON has it: the schema torchid.gap/2."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec
import torch

from torchid.gap.settings import GapSettings
from torchid.results.answer import DiagnosisRecord, NotTestable
from torchid.results.cause import Cause, How
from torchid.results.friction import FrictionLaw
from torchid.results.record import (
    FINITE,
    Col,
    Ends,
    Joint,
    Model,
    Part,
    Real,
    Rows,
    face,
)
from torchid.results.words import digits, effect_words, listed, span
from torchid.robot.model import Robot
from torchid.robot.writer import write_robot
from torchid.simulators.nearest_fields import NearestFields
from torchid.statistics.criteria import MOVED_STD
from torchid.typing import Float, Tensor

if TYPE_CHECKING:
    from torchid.next_motion.separating_motion import Separation

Status = Literal[
    "no_gap",
    "negligible",
    "parametric_only",
    "explained",
    "detected_unexplained",
    "not_testable",
]
"""Of a gap: `negligible` is there, with causes that are smaller than what was asked for, or with an
error that is no noise and small beside the torque."""

Regime = Literal["rest", "slow", "fast", "reversal"]
"""Of a joint's motion: each a part of the time."""

Interval = tuple[float, float]


class JointGap(Part, frozen=True):
    """Gap of the model as given on one joint."""

    joint: Joint
    gap_rms: Real
    noise_floor_rms: Ends
    share: Real


class RegimeGap(Part, frozen=True):
    """Excess of the squared gap in one regime of one joint over the rest of its rows.

    Attributes:
        joint, regime: where.
        excess: share of the joint's squared gap above the noise floor that lies in the regime
            beyond what the regime's share of time would hold.
        ci95: its interval, over blocks.
        p: corrected for the maximum over all joints and regimes.
    """

    joint: Joint
    regime: Regime
    excess: Real
    ci95: Ends
    p: Real


class Where(Part, frozen=True):
    """Joints, and kinds of motion."""

    joints: tuple[JointGap, ...]
    regimes: tuple[RegimeGap, ...]


class KnownCoefficient(Part, frozen=True, kw_only=True):
    """A known coefficient of the model before the log and after it.

    Attributes:
        name: e.g. `viscous_friction Fv3`.
        unit: of it.
        before, before_std: as the model knew it, the time between two sessions included.
        after, after_std: with this log.
        changed: whether it is another one than was known, beyond what was left open.
    """

    name: str
    unit: str
    before: Annotated[Real, Col("known before", spread="before_std", unit_of="unit")]
    before_std: float | None
    after: Annotated[Real, Col("with this log", spread="after_std", unit_of="unit")]
    after_std: float | None
    changed: bool = False

    @property
    def words(self) -> Annotated[str, Col("coefficient")]:
        """`viscous friction Fv3`."""
        effect, _, place = self.name.rpartition(" ")
        return f"{effect_words(effect)} {place}"


class Open(Part, frozen=True, kw_only=True):
    """Torque that a model left open on the motions of a log.

    Attributes:
        joint: which.
        added_rms: of the correction within what was known, which this log asks for [N m; N].
        hides: whether a cause as large as is worth a name may be hidden in it, and not be told
            from what was open.
        motion: what to drive to know it.
    """

    joint: Annotated[Joint, Col()]
    added_rms: Real
    hides: bool
    motion: Annotated[str, Col("to be sure")] = ""


class Known(Part, frozen=True, kw_only=True):
    """What was known of the model, and what this log adds.

    Attributes:
        sources: of what was known; none of a model that does not say how sure it is.
        coefficients: of effects, whose values or standard deviations this log changes.
        joints: where corrections are, within what was known.
        between_sessions: how much friction is taken to change by itself between sessions, as a
            standard deviation relative to its value; None where sessions have shown it, or nothing
            was known before.
        notes: sentences.
    """

    sources: tuple[str, ...]
    coefficients: tuple[KnownCoefficient, ...] = ()
    joints: tuple[Open, ...] = ()
    between_sessions: float | None = None
    notes: tuple[str, ...] = ()

    @property
    def moved(self) -> tuple[str, ...]:
        """Coefficients, not named, that are others than they were by more than `MOVED_STD` of what
        was left open: suspects at least."""
        return tuple(
            c.name
            for c in self.coefficients
            if not c.changed and abs(c.after - c.before) > MOVED_STD * (c.before_std or math.inf)
        )


class JointRms(Part, frozen=True):
    """Torque error of one joint before and after, and the noise."""

    joint: Annotated[Joint, Col()]
    before: Annotated[Real, Col("as given", words=digits)]
    after: Annotated[Real, Col("corrected", words=digits)]
    noise_floor_rms: Annotated[Ends, Col("noise", words=span)]


class FarRecord(Part, frozen=True, kw_only=True):
    """How far; over all joints as root of the sum of the joints' mean squares [N m; N], on data
    that are named as those of `Error` are."""

    rms_before: Real
    rms_after: Real
    on: tuple[str, ...] = ()
    how: How = "left out in turn"
    noise_floor_rms: Ends
    closed: float | None
    closed_ci95: tuple[float, float] | None
    per_joint: tuple[JointRms, ...]


class Budget(Part, frozen=True):
    """Shares of the gap: what refitted base parameters close, what effects close, what is left."""

    parametric: Real
    structural: Real
    unexplained: Real


class Coefficient(Part, frozen=True, kw_only=True):
    """One coefficient of a fit.

    Attributes:
        effect: name; `link_inertia` of bodies.
        names: of the coefficient with its joint, e.g. `Fc2`; several where joints share it.
    """

    effect: str
    names: tuple[str, ...]


class Covariance(Part, frozen=True, kw_only=True):
    """How well the coefficients of all causes are known, which were fitted together.

    Attributes:
        coefficients: K of them.
        matrix: covariance of their values, 1.96 of its standard deviations being half a 95 %
            interval.
    """

    coefficients: tuple[Coefficient, ...]
    matrix: Annotated[Float[Tensor, "K K"], FINITE]


class Residual(Part, frozen=True, kw_only=True):
    """What the corrected model leaves of one joint's torque on data it was not fitted on.

    Attributes:
        joint: which.
        levels, sizes: share of the instants, and the size [N m; N] that the error stays below
            there.
        correlation: how long it lasts, its integrated autocorrelation [s].
    """

    joint: Joint
    levels: tuple[float, ...]
    sizes: tuple[Real, ...]
    correlation: Real = msgspec.field(name="correlation_s")


class Informative(Part, frozen=True, kw_only=True):
    """The stretch of a log in which two explanations differ most, and its share of all of it."""

    trajectory: str
    from_s: float
    to_s: float
    share: float

    @property
    def words(self) -> str:
        """`run1 from 3.2 to 4.1 s`."""
        return f"{self.trajectory} from {self.from_s:.1f} to {self.to_s:.1f} s"


class Experiment(Part, frozen=True, kw_only=True):
    """What would separate the largest ambiguity.

    Attributes:
        separates: the two names.
        joint: where, if anywhere.
        do: what to do, from the effects' own descriptions.
        most_informative: where this log comes closest.
        seconds_of_the_same_motion: that would make the odds; None where no length would.
    """

    separates: Annotated[tuple[str, ...], Col(words=lambda x: listed(map(effect_words, x)))]
    joint: Annotated[Joint | None, Col()]
    do: Annotated[str, Col("what to do")]
    most_informative: Annotated[Informative, Col(words=lambda one: one.words)]
    seconds_of_the_same_motion: Annotated[float | None, Col("or as now for", ".4g", "s")]


class NoiseFloor(Part, frozen=True):
    """RMS of the noise in the band of the report.

    Attributes:
        low, high: (n,) interval, as repeats of a motion tell it; without them what is noise at
            least, and what a flexible predictor leaves of the residual, which may be misfit as well
            and is no bound [N m; N].
        source: `repeats` or `bracket`.
        notes: sentences for the user.
    """

    low: Annotated[Float[Tensor, " n"], FINITE]
    high: Annotated[Float[Tensor, " n"], FINITE]
    source: Literal["repeats", "bracket"]
    notes: tuple[str, ...] = ()

    @property
    def ends(self) -> Float[Tensor, "n 2"]:
        """The interval of each joint [N m; N], open (NaN) at its upper end without repeats."""
        high = self.high if self.source == "repeats" else torch.full_like(self.high, torch.nan)
        return torch.stack([self.low, high], 1)

    @property
    def total(self) -> Interval:
        """The error over all joints, as root of the sum of squares."""
        low, high = self.ends.norm(dim=0).tolist()
        return low, high


@dataclass(frozen=True)
class GapSettingsRecord(GapSettings):
    """The settings, and whether base parameters were fitted with everything."""

    refitted: bool = field(kw_only=True)

    def __post_init__(self) -> None:
        """Settings of an answer are not judged again: an older file may name other effects."""


class GapRecord(DiagnosisRecord, frozen=True, eq=False, kw_only=True, tag="torchid.gap/2"):
    """A diagnosis as its JSON has it.

    Attributes:
        robot: its name.
        status: the verdict.
        where: joints and regimes.
        which: causes that have a name: effects, and links whose inertial parameters changed. The
            answer has all base parameters beside them, and causes without a name.
        how_far, budget: how far.
        not_testable: effects these data cannot show.
        next_experiment: what would separate an ambiguity, or None.
        noise_floor: in the band of the report.
        trajectories: names of those that were judged.
        band_hz, cutoff_hz: of the report and of the fit.
        settings: how it was searched.
        warnings: sentences for the user.
        model, corrected: the robot as given, and with what was found.
        friction: the law of each joint that has friction, in the model or found.
        covariance: of the coefficients of all causes that last; null where nothing was fitted.
        residual: what is left, joint by joint.
        knowledge: what was known before, and what this log adds.
        nearest_fields: for effects of `corrected` that an MJCF or URDF has no field for.
        since: the earlier log that causes are held against; absent without one.
        seed: of everything random, from a command.
    """

    robot: str
    status: Status
    where: Where
    which: tuple[Cause, ...]
    how_far: FarRecord
    budget: Budget
    not_testable: tuple[NotTestable, ...]
    next_experiment: Experiment | None
    noise_floor: NoiseFloor
    trajectories: tuple[str, ...] = ()
    band_hz: float
    cutoff_hz: float
    settings: GapSettingsRecord
    warnings: tuple[str, ...] = ()
    model: Model
    corrected: Model
    friction: tuple[FrictionLaw, ...] = ()
    covariance: Covariance | None = None
    residual: tuple[Residual, ...] = ()
    knowledge: Known | None = None
    nearest_fields: tuple[NearestFields, ...] = ()
    since: str | msgspec.UnsetType = msgspec.UNSET
    seed: int | msgspec.UnsetType = msgspec.UNSET

    @property
    def effects(self) -> Rows[Cause]:
        """What was found, as a table."""
        return Rows(self.which)

    table = effects

    def __repr__(self) -> str:
        effects = ", ".join(f.effect for f in self.which) or "no effects"
        closed = self.how_far.closed
        share = "" if closed is None else f", {100 * closed:.0f} % closed"
        return f"GapRecord('{self.robot}', {self.status}: {effects}{share})"

    def write_corrected(self, path: str | Path) -> None:
        """Write the corrected robot with its effects as a .yaml.

        Raises:
            TorchidError: it cannot be written.
        """
        write_robot(self.corrected, path)

    def next_motion(self, robot: Robot | None = None, **settings: Any) -> "Separation":
        """The motion that separates what this diagnosis cannot tell apart; see `excite_for`."""
        return face("excite_for")(self, robot, **settings)
