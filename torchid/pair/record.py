"""What a simulator's log and the arm's are told to differ by, as JSON has it: torchid.pair/2."""

from typing import Annotated, Literal

from msgspec import UNSET, UnsetType

from torchid.gap.record import NoiseFloor, RegimeGap
from torchid.results.cause import Cause
from torchid.results.record import Col, Joint, Part, Real, Record, Rows
from torchid.results.words import joints_words, regime_words, within

Side = Literal["simulator", "arm"]

FaultName = Literal[
    "joint_order",
    "sign",
    "time_step",
    "clipped",
    "held_control",
    "gain_units",
    "servo_gain",
    "gravity_compensation",
]
"""In the order in which they are to be mended: what stands later cannot be judged before."""


class ClockRecord(Part, frozen=True):
    """Time of the simulator's log for a time of the arm's: start + rate t, both from their first
    sample.

    Attributes:
        trajectory: of the arm's log.
        rate: [1].
        start_s: [s].
        likeness: mean correlation of what both were aligned by.
        by: commands `u`, or motion `q`.
    """

    trajectory: str
    rate: Real
    start_s: Real
    likeness: Real
    by: str


class Difference(Part, frozen=True):
    """What one joint's signals differ by.

    Attributes:
        joint: which.
        rms: of the arm's less the simulator's.
        noise: what of it is noise.
        relative_percent: rms over that of the arm's signal; of positions about their mean.
    """

    joint: Annotated[Joint, Col()]
    rms: Annotated[Real, Col("RMS")]
    noise: Annotated[Real, Col(digits=".2g")]
    relative_percent: Annotated[Real, Col("of the arm's", unit="%")]


class WherePair(Part, frozen=True):
    """Where a signal differs.

    Attributes:
        joints: each joint.
        regimes: kinds of motion that hold more than their share.
    """

    joints: tuple[Difference, ...]
    regimes: tuple[RegimeGap, ...]


class Fault(Part, frozen=True):
    """A fault of the set-up.

    Attributes:
        fault: its name.
        joints: that show it; none of one that is the whole arm's.
        side: where it is, as far as that can be told.
        value: a number that says how large it is.
        unit: of the value.
        meaning: what was seen.
        remedy: what to do.
    """

    fault: Annotated[FaultName, Col(words=regime_words)]
    joints: tuple[Joint, ...]
    side: Side | None
    value: Real
    unit: str
    meaning: Annotated[str, Col("what was seen")]
    remedy: Annotated[str, Col("what to do")]

    @property
    def where(self) -> Annotated[str, Col()]:
        """`simulator, joint 2`."""
        joints = joints_words(self.joints) if self.joints else ""
        return ", ".join(filter(None, (self.side, joints)))


class OneSided(Cause, frozen=True, kw_only=True):
    """An effect that one of both has more of: a cause whose `parameters` are the arm's, and whose
    `file` is what the simulator has of them, zero of none.

    Attributes:
        more: which side has more of it.
        only: whether the other one has none.
    """

    more: Annotated[Side, Col("has more")]
    only: Annotated[bool, Col("alone")]


class ServoDifference(Part, frozen=True):
    """One parameter of a joint's servo on either side.

    Attributes:
        joint: which.
        parameter: of `torchid.effects.servo.PARAMETERS`.
        unit: of the values.
        per_kp: whether the values are shares of the gain kp, because the logs leave a common factor
            of all torques open.
        simulated, real: values; without effect on a side that does not have the parameter.
        simulated_ci95, real_ci95: 95 % intervals; None on a side that does not have the parameter.
        differs: whether the 95 % interval of the difference excludes zero and the difference is at
            least 5 %; of what one side has alone, whether its motions need it.
    """

    joint: Annotated[Joint, Col()]
    parameter: str
    unit: str
    per_kp: bool
    simulated: Real
    simulated_ci95: tuple[Real, Real] | None
    real: Real
    real_ci95: tuple[Real, Real] | None
    differs: Annotated[bool, Col()]

    @property
    def number(self) -> Annotated[str, Col("parameter")]:
        """`damping / kp`."""
        return self.parameter + " / kp" * self.per_kp

    @property
    def simulator(self) -> Annotated[str, Col()]:
        """The simulator's value with its interval; a side without one does not have it."""
        ends = self.simulated_ci95
        return "-" if ends is None else within(self.simulated, ends, self.unit)

    @property
    def arm(self) -> Annotated[str, Col()]:
        """The arm's, likewise."""
        ends = self.real_ci95
        return "-" if ends is None else within(self.real, ends, self.unit)


class PairRecord(Record, frozen=True, kw_only=True, tag="torchid.pair/2"):
    """A simulator's log against the arm's.

    Attributes:
        robot: the model's name; None where none was given.
        simulated, real: the logs.
        clocks: that took the trajectories together.
        torque: where the torques differ; None where a log has none.
        position: where the motions differ.
        torque_noise: of the torque's difference, None likewise.
        faults: of the set-up, in the order in which to mend them.
        which: effects that one of both has more of, most of the gap first; None where it was not
            asked, for a reason that stands in the warnings.
        both: effects that the robot's file lacks of either.
        servos: parameters of both sides' servos, from commands and positions; None where logs have
            torques, where no robot was given, or where the set-up comes first.
        warnings: sentences for the user.
        seed: from a command.
    """

    robot: str | None
    simulated: str
    real: str
    clocks: tuple[ClockRecord, ...]
    torque: WherePair | None
    position: WherePair
    torque_noise: NoiseFloor | None
    faults: tuple[Fault, ...]
    which: tuple[OneSided, ...] | None
    both: tuple[Cause, ...] = ()
    servos: tuple[ServoDifference, ...] | None = None
    warnings: tuple[str, ...] = ()
    seed: int | UnsetType = UNSET

    @property
    def table(self) -> Rows[Fault]:
        """Faults, as a table."""
        return Rows(self.faults)

    def __repr__(self) -> str:
        names = [f.fault for f in self.faults] + [w.effect for w in self.which or ()]
        names += [f"{s.parameter} of joint {s.joint + 1}" for s in self.servos or () if s.differs]
        return f"PairRecord({self.simulated!r}, {self.real!r}: {', '.join(names) or 'nothing'})"
