"""A diagnosis as its JSON has it: the schema torchid.gap/1."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec
import torch

from torchid.errors import TorchidError
from torchid.gap.settings import GapSettings
from torchid.results.answer import Cause, DiagnosisRecord, NotTestable, Size
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
    Values,
    face,
)
from torchid.results.replication import Replication
from torchid.results.words import effect_words
from torchid.robot.model import Robot
from torchid.robot.writer import write_robot
from torchid.simulators.nearest_fields import NearestFields
from torchid.statistics.criteria import MOVED_STD, SET_MASS
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
"""Of a gap: `negligible` is there, with causes that are smaller than what was asked for."""

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


class JointGap(Part, frozen=True):
    """Gap of the model as given on one joint."""

    joint: Joint
    gap_rms: Real
    noise_floor_rms: Ends
    share: Real


class Window(Part, frozen=True):
    """A stretch of a trajectory [s]."""

    trajectory: str
    from_s: float
    to_s: float


class RegimeGap(Part, frozen=True):
    """Excess of the squared gap in one regime of one joint over the rest of its rows.

    Attributes:
        joint, regime: where.
        excess: share of the joint's squared gap above the noise floor that lies in the regime
            beyond what the regime's share of time would hold.
        ci95: its interval, over blocks.
        p: corrected for the maximum over all joints and regimes.
        times: windows of a transient.
    """

    joint: Joint
    regime: Regime
    excess: Real
    ci95: Ends
    p: Real
    times: tuple[Window, ...] = ()


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


class FoundEffect(Part, frozen=True, kw_only=True):
    """An accepted effect; of inertial parameters those of one link.

    Attributes:
        effect, family, branch: which, and of what kind in the tree of causes.
        joints: at it; of one that belongs to the whole arm those whose torque it changes.
        common: whether one coefficient is common to all joints.
        located: joints that it acts at; none of one that belongs to the whole arm.
        ambiguous_with: names of effects the data do not separate it from.
        parameters: coefficients, shapes and places.
        main: the coefficient that makes most of its torque in these logs.
        p_value, how_sure, branch_sure, one_of_a_set, share, alone, removes: as Finding's.
        std, unit: of the coefficients, and units of shapes too.
        shape, places: which of the parameters are shapes, and which places.
        changed: coefficients that the model knew otherwise; none of an effect that is new.
        replication: whether it is the same in every motion; None of what is asked no such thing.
        meaning, remedy, source: of the effect, in words.
        notes: sentences.
    """

    effect: str
    family: str
    branch: str = ""
    joints: tuple[Joint, ...]
    common: bool = False
    located: tuple[Joint, ...] = ()
    ambiguous_with: tuple[str, ...]
    parameters: Values
    p_value: float | None
    how_sure: float | None = None
    branch_sure: float | None = None
    one_of_a_set: bool = False
    std: dict[str, float | None]
    unit: dict[str, str]
    shape: tuple[str, ...]
    places: tuple[str, ...]
    main: str = ""
    share: float | None = None
    alone: float | None = None
    removes: tuple[Real, ...] = ()
    changed: tuple[KnownCoefficient, ...] = ()
    replication: Replication | None = None
    meaning: str = ""
    remedy: str = ""
    source: str | None = None
    notes: tuple[str, ...] = ()

    @property
    def cause(self) -> Cause:
        """As an answer has it: of what the model knew otherwise, what has changed."""
        changed = tuple(
            Size(name=c.name, unit=c.unit, value=c.after, std=c.after_std, was=c.before)
            for c in self.changed
        )
        # The deepest node of the tree of causes that is sure enough is the name.
        sure, of_branch = self.how_sure or 0.0, self.branch_sure or 0.0
        wide = (self.one_of_a_set or sure < SET_MASS) and of_branch >= SET_MASS
        return Cause(
            effect=self.effect,
            branch=self.branch if wide else "",
            joints=self.located,
            sizes=changed or _sizes(self),
            how_sure=of_branch if wide else self.how_sure,
            ambiguous_with=self.ambiguous_with,
            closes=math.nan if self.share is None else self.share,
            alone=math.nan if self.alone is None else self.alone,
            remedy=self.remedy,
        )


class UnnamedEffect(Part, frozen=True, kw_only=True):
    """An effect that gets no name: of a size below what was asked for, or not sure enough.

    Attributes:
        effect, family, joints, parameters, main, std, unit: as FoundEffect's.
        how_sure, replication: likewise.
        closes_rms: error that it takes away, as a root of the fall of the mean square while the
            joint moves, on the joint where that is most [N m; N].
        settles: what would settle whether it is there.
        share: of the error that it takes away, where the corrected model holds it without a name:
            the data need it, and cannot say that it is this; else null.
    """

    effect: str
    family: str
    joints: tuple[Joint, ...]
    parameters: Values
    main: str = ""
    std: dict[str, float | None]
    unit: dict[str, str]
    closes_rms: Real
    how_sure: float
    replication: Replication | None = None
    settles: str = ""
    share: Real = math.nan

    @property
    def cause(self) -> Cause:
        """As an answer has it."""
        return Cause(
            effect=self.effect,
            joints=self.joints,
            sizes=_sizes(self),
            how_sure=self.how_sure,
            closes=self.share,
            remedy=self.settles,
        )


def _sizes(of: FoundEffect | UnnamedEffect) -> tuple[Size, ...]:
    """Coefficients as numbers of a cause, that which makes most torque first."""
    return tuple(
        Size(name=name, unit=of.unit[name], value=float(value), std=std)
        for name, std in sorted(of.std.items(), key=lambda item: item[0] != of.main)
        if isinstance(value := of.parameters[name], float | int)
    )


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


class Parametric(Part, frozen=True):
    """Inertial parameters that had to be changed: of one link, or all base parameters.

    Attributes:
        links: empty for all base parameters.
        share, p_value, how_sure, branch_sure, alone, removes: as Finding's; None where the
            parameters are always refitted.
        ambiguous_with: names of effects.
        all_base_parameters: whether there is no link.
        change: mass, centre of mass and inertia of the link before and after, one sentence that
            says what to set; empty of all base parameters.
    """

    links: tuple[Joint, ...]
    share: float
    p_value: float | None
    ambiguous_with: tuple[str, ...] = ()
    how_sure: float | None = None
    alone: float | None = None
    removes: tuple[Real, ...] = ()
    branch_sure: float | None = None
    all_base_parameters: bool = False
    change: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        msgspec.structs.force_setattr(self, "all_base_parameters", not self.links)


class JointRms(Part, frozen=True):
    """Torque error of one joint before and after, and the noise."""

    joint: Joint
    before: Real
    after: Real
    noise_floor_rms: Ends


class FarRecord(Part, frozen=True, kw_only=True):
    """How far; over all joints as root of the sum of the joints' mean squares [N m; N]."""

    rms_before: Real
    rms_after: Real
    noise_floor_rms: Ends
    closed: float | None
    closed_ci95: tuple[float, float] | None
    per_joint: tuple[JointRms, ...]


class Budget(Part, frozen=True):
    """Shares of the gap: what refitted base parameters close, what effects close, what is left."""

    parametric: Real
    structural: Real
    unexplained: Real


class Fitted(Part, frozen=True, kw_only=True):
    """One coefficient of a joint fit.

    Attributes:
        effect: name; `link_inertia` of bodies.
        names: of the coefficient with its joint, e.g. `Fc2`; several where joints share it.
        value: fitted [its unit]: what was added to the model as given.
    """

    effect: str
    names: tuple[str, ...]
    value: Real


class JointFit(Part, frozen=True, kw_only=True):
    """An explanation, all its coefficients fitted together.

    Attributes:
        weight: probability of it among those listed.
        words: what stands in whose place; empty of what is told.
        coefficients: K of them.
        covariance: of their values, 1.96 of its standard deviations being half a 95 % interval.
        corrected: the model with it; None of what is told, whose model the diagnosis holds.
    """

    weight: Real
    words: str
    coefficients: tuple[Fitted, ...]
    covariance: Annotated[Float[Tensor, "K K"], FINITE]
    corrected: Model | None = None


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


class Experiment(Part, frozen=True, kw_only=True):
    """What would separate the largest ambiguity.

    Attributes:
        separates: the two names.
        joint: where, if anywhere.
        do: what to do, from the effects' own descriptions.
        most_informative: where this log comes closest.
        seconds_of_the_same_motion: that would make the odds; None where no length would.
    """

    separates: tuple[str, ...]
    joint: Joint | None
    do: str
    most_informative: Informative
    seconds_of_the_same_motion: float | None


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
        """The same over all joints, as root of the sum of squares."""
        low, high = self.ends.norm(dim=0).tolist()
        return low, high


@dataclass(frozen=True)
class GapSettingsRecord(GapSettings):
    """The settings, and whether base parameters were refitted; older files do not say it."""

    refitted: bool | None = None

    def __post_init__(self) -> None:
        """Settings of an answer are not judged again: an older file may name other effects."""

    @property
    def free(self) -> bool:
        """Whether base parameters were fitted with everything."""
        if self.refitted is not None:
            return self.refitted
        return self.parameters == "free" or bool(self.background)


class GapRecord(DiagnosisRecord, frozen=True, eq=False, kw_only=True, tag="torchid.gap/1"):
    """A diagnosis as its JSON has it.

    Attributes:
        robot: its name.
        status: the verdict.
        where: joints and regimes.
        which: accepted effects, and links whose inertial parameters changed.
        parametric: changed inertial parameters.
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
        joint_fits: what is told with the covariance of all its coefficients, then what cannot be
            told from it; none in older files.
        residual: what is left, joint by joint; none in older files.
        small: effects that are there and below what was asked for.
        suspects: the likeliest causes that are not sure enough to be named, the likeliest first.
        knowledge: what was known before, and what this log adds.
        nearest_fields: for effects of `corrected` that an MJCF or URDF has no field for; none in
            older files.
        seed: of everything random, from a command.
    """

    robot: str
    status: Status
    where: Where
    which: tuple[FoundEffect, ...]
    parametric: tuple[Parametric, ...] = ()
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
    model: Model | None = None
    corrected: Model | None = None
    friction: tuple[FrictionLaw, ...] = ()
    joint_fits: tuple[JointFit, ...] = ()
    residual: tuple[Residual, ...] = ()
    small: tuple[UnnamedEffect, ...] = ()
    suspects: tuple[UnnamedEffect, ...] = ()
    knowledge: Known | None = None
    nearest_fields: tuple[NearestFields, ...] = ()
    seed: int | msgspec.UnsetType = msgspec.UNSET

    @property
    def effects(self) -> Rows[FoundEffect]:
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
            TorchidError: a file of an older version, which does not hold it, or one that cannot be
                written.
        """
        if self.corrected is None:
            raise TorchidError("the diagnosis does not hold the corrected model.")
        write_robot(self.corrected, path)

    def next_motion(self, robot: Robot | None = None, **settings: Any) -> "Separation":
        """The motion that separates what this diagnosis cannot tell apart; see `excite_for`."""
        return face("excite_for")(self, robot, **settings)
