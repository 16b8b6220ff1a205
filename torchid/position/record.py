"""What a diagnosis of commands and positions answers, as its JSON has it: schema
torchid.position_gap/1. The parts of the JSON are the parts of the answer."""

import math
from typing import Annotated, Self

import msgspec
from msgspec import UNSET, UnsetType

from torchid.results.agreement import Replication
from torchid.results.answer import DiagnosisRecord, NotTestable
from torchid.results.cause import Cause, JudgedOn, Size
from torchid.results.record import FINITE, Col, Ends, Joint, Part, Real, Rows, Values
from torchid.statistics.proportion import HALF_95
from torchid.typing import Float, Tensor

FITTED = JudgedOn(how="fitted")
"""Windows that effects of servos are judged on: they are fitted to them."""


def error_words(of_file: bool) -> str:
    """What the first number of an answer is of."""
    return (
        "the error of the file's servos" if of_file else "a plain servo's error (the file has none)"
    )


class JointRecord(Part, frozen=True, kw_only=True):
    """One joint: errors of whole motions [mrad of the log's unit], of the file's servos null where
    it has none; its gain [N m/rad], null where torques are known as shares of it alone
    (`ratio_only`); missing in files of older versions: its name, what is too little to look for a
    cause, and the step of its encoder, as the log shows it [mrad], and the 90 % interval of its
    noise, null where no repeat of a motion tells it."""

    joint: Annotated[Joint, Col()]
    name: Annotated[str, Col()] = ""
    commanded_mrad: Annotated[Real, Col("command", ".1f")]
    plain_mrad: Annotated[Real, Col("plain servo", ".1f")]
    answered_mrad: Annotated[Real, Col("corrected", ".1f")]
    file_mrad: Annotated[Real, Col("file", ".1f")] = math.nan
    kp: Real
    kp_ci95: Ends
    ratio_only: bool
    never_moves: bool
    unseen_mrad: Real = math.nan
    resolution_mrad: Real = math.nan
    noise_mrad: Ends = (math.nan, math.nan)

    @property
    def gain(self) -> Annotated[float | str, Col("kp", ".1f")]:
        """kp [N m/rad], or that torques are known as shares of it alone."""
        return "ratio" if self.ratio_only and not self.never_moves else self.kp


class RegimeRecord(Part, frozen=True, kw_only=True):
    """Errors of one joint in one regime, before of the file's servos, or of a plain one where it
    has none [mrad of the log's unit]."""

    joint: Joint
    regime: str
    before_mrad: Real
    answered_mrad: Real


class WhereRecord(Part, frozen=True, kw_only=True):
    """Where command and position part."""

    joints: tuple[JointRecord, ...]
    regimes: tuple[RegimeRecord, ...]


class PositionFinding(Part, frozen=True, kw_only=True):
    """One effect on one joint.

    Attributes:
        effect, family: names.
        joints: at which; none for a plane or a load, which all joints feel.
        ambiguous_with: effects that do as well in its place.
        parameters, unit, ci95: its numbers by name, with 95 % intervals: motions as clusters, and
            no less than noise allows.
        error_without, error_with: position error of the joint (of all joints, for those) in windows
            of 2 s without it and with it, the others refitted [mrad of the log's unit]; of what the
            robot's file has, with the file's number and with this one.
        was: numbers that the robot's file has.
        replication: whether it is the same in every motion; None of what acts at the ends of the
            travel, and of what all joints feel.
        how_sure: probability of it, or of the set with what does as well.
        meaning, remedy: one sentence each.
    """

    effect: str
    family: str
    joints: tuple[Joint, ...]
    ambiguous_with: tuple[str, ...]
    parameters: dict[str, Real]
    unit: dict[str, str] = msgspec.field(default_factory=dict)
    ci95: dict[str, Ends]
    was: dict[str, Real] = msgspec.field(default_factory=dict)
    error_without: Real = msgspec.field(name="error_without_mrad")
    error_with: Real = msgspec.field(name="error_with_mrad")
    replication: Replication | None = None
    how_sure: float | None = None
    meaning: str
    remedy: str

    @property
    def joint(self) -> int | None:
        """Counted from 1; None for a plane or a load, which all joints feel."""
        return self.joints[0] + 1 if self.joints else None

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Its numbers, as the answer has them."""
        return self.cause.sizes

    @property
    def cause(self) -> Cause:
        """As the answer has it; it closes its share of the error of its joint. Its standard
        deviations are as if its numbers were normal variables, null where an interval has no end.
        """
        left = self.error_with / self.error_without if self.error_without > 0 else 1.0
        halves = {name: (high - low) / 2 for name, (low, high) in self.ci95.items()}
        return Cause(
            effect=self.effect, family=self.family, joints=self.joints, how_sure=self.how_sure,
            parameters=dict(self.parameters), unit=self.unit, file=self.was,
            std={name: h / HALF_95 if math.isfinite(h) else None for name, h in halves.items()},
            ambiguous_with=self.ambiguous_with, share=1.0 - left, remedy=self.remedy,
            replication=self.replication, meaning=self.meaning, judged=FITTED,
        )  # fmt: skip


class Accuracy(Part, frozen=True, eq=False, kw_only=True):
    """RMS position errors of one way to predict a log [mrad of the log's unit].

    A joint that never moves is NaN: to predict it is neither a success nor a failure.

    Attributes:
        whole_mrad, windows_2s_mrad: mean of the joints that move, of both.
        whole: (n,) whole motions from their measured start.
        windows: (n,) windows of 2 s.
    """

    whole_mrad: Real
    windows_2s_mrad: Real
    whole: Float[Tensor, " n"] = msgspec.field(name="whole_per_joint")
    windows: Float[Tensor, " n"] = msgspec.field(name="windows_per_joint")

    @classmethod
    def of_joints(cls, whole: Float[Tensor, " n"], windows: Float[Tensor, " n"]) -> Self:
        """Of errors of joints, with their means."""
        means = float(whole.nanmean()), float(windows.nanmean())
        return cls(whole_mrad=means[0], windows_2s_mrad=means[1], whole=whole, windows=windows)


class MotionRecord(Part, frozen=True, kw_only=True):
    """Errors of one motion, joint by joint [mrad]."""

    motion: str
    answered_mrad: Float[Tensor, " n"]


class HeldOutRecord(Part, frozen=True, kw_only=True):
    """Errors of logs that took part in nothing: of the answer, mean of the joints [mrad]; in no
    older file: their names, and all errors of the servos before and of the answer."""

    whole_mrad: Real
    windows_2s_mrad: Real
    on: tuple[str, ...] = ()
    before: Accuracy | UnsetType = UNSET
    answered: Accuracy | UnsetType = UNSET


class HowFarRecord(Part, frozen=True, kw_only=True):
    """How far the command, the file's servos (missing where it has none), a plain servo that is
    refitted to the log, and the answer predict motions left out."""

    commanded: Accuracy
    plain: Accuracy
    answered: Accuracy
    closed: Real
    file: Accuracy | UnsetType = UNSET
    per_motion: tuple[MotionRecord, ...]


class ServosRecord(Part, frozen=True, kw_only=True):
    """The answered servos; see `simulation.servo.Servos`. Joints from 1."""

    joints: tuple[dict[str, float], ...]
    repeated_command_ends_profile: bool
    plane: Values | None = None


class NominalRecord(Part, frozen=True, kw_only=True):
    """What a joint's servo is said to be; see `position.nominal.NominalServo`."""

    joint: Joint
    servo: str
    values: dict[str, Real]
    counts: Real
    register_units: dict[str, Real]


class ChangeRecord(Part, frozen=True, kw_only=True):
    """One number of a joint's servo beside what the robot's file says of it.

    Attributes:
        joint, parameter, unit: which; torques as shares of kp where they are known so.
        was, now: values; null where it had or has no effect.
        std: standard deviation of now, of a logarithm where it is searched so.
        state: `as known`, `changed`, `open` (the log does not say), `new`, or `gone`.
    """

    joint: Annotated[Joint, Col()]
    parameter: Annotated[str, Col("value")]
    unit: str
    was: Annotated[Real, Col("in the file", unit_of="unit")]
    now: Annotated[Real, Col("found", unit_of="unit")]
    std: Real
    state: Annotated[str, Col()]


class KnownRecord(Part, frozen=True, kw_only=True):
    """What the log told of one joint's servo: names of K parameters, and the covariance of their
    values, or of the values' logarithms where they are searched so (`PARAMETERS`)."""

    joint: Joint
    names: tuple[str, ...]
    covariance: Annotated[Float[Tensor, "_ _"], FINITE]


class PositionRecord(
    DiagnosisRecord, frozen=True, eq=False, kw_only=True, tag="torchid.position_gap/1"
):
    """Where command and position part, what causes it, and how far it goes.

    Attributes:
        robot: its name. motions: how many.
        status: `explained`, `partly_explained`, `detected_unexplained` or `no_gap`.
        where, which, how_far: the answer.
        servos: its model; the torques of a joint with `ratio_only` are one choice of many.
        log_scale: (n,) from the log's unit to rad or m.
        warnings: sentences for the user.
        seconds: that it took.
        held_out: errors of a log that took part in nothing.
        nominal: what the servos are said to be.
        changes: the servos beside those of the robot's file; missing where that has none.
        not_testable: effects that the motions would not have shown.
        known: how well the servos are, joint by joint, of those that move; missing in files of
            older versions.
        seed: from a command.
    """

    robot: str
    motions: int
    status: str
    where: WhereRecord
    which: tuple[PositionFinding, ...]
    how_far: HowFarRecord
    servos: ServosRecord
    log_scale: Float[Tensor, " n"]
    warnings: tuple[str, ...]
    seconds: float
    seed: int | UnsetType = UNSET
    held_out: HeldOutRecord | UnsetType = UNSET
    nominal: tuple[NominalRecord, ...] | UnsetType = UNSET
    known: tuple[KnownRecord, ...] | UnsetType = UNSET
    changes: tuple[ChangeRecord, ...] | UnsetType = UNSET
    not_testable: tuple[NotTestable, ...] = ()

    @property
    def table(self) -> Rows[PositionFinding]:
        """The effects."""
        return Rows(self.which)

    effects = table
