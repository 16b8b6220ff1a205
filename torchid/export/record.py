"""What was exported or corrected, as JSON: schemas torchid.export/1 and torchid.correction/1."""

import math
from typing import Annotated

import msgspec
from msgspec import UNSET, UnsetType

from torchid.export.checks import Comparison
from torchid.results.record import Col, Joint, Part, Real, Record, Rows, Values
from torchid.results.words import effect_words, joints_or_arm
from torchid.typing import Float, Tensor


class Places(Part, frozen=True, kw_only=True):
    """Effects that are in the file, beside it and nowhere, in words."""

    in_file: tuple[str, ...]
    beside: tuple[str, ...]
    left_out: tuple[str, ...]


class ExportRecord(Record, frozen=True, kw_only=True, tag="torchid.export/1"):
    """What was written.

    Attributes:
        robot: its name. what, result: kind and title of what was exported.
        format, files, original: as of `export.export.Export`.
        feasible, reasons: of the physical parameters.
        checks: by reader.
        effects: where they are.
        warnings: what must not be overlooked.
        seed: of the states, from a command.
    """

    robot: str
    what: str
    result: str
    format: str
    files: tuple[str, ...]
    original: str | None
    feasible: bool | None
    reasons: tuple[str, ...]
    checks: tuple[Comparison, ...]
    effects: Places
    warnings: tuple[str, ...]
    seed: int | UnsetType = UNSET

    @property
    def table(self) -> Rows[Comparison]:
        """The readers."""
        return Rows(self.checks)


_ERRORS = {"claim": "file_claimed", "engine": "file_in_engine", "run_time": "with_effects"}


class Errors(Part, frozen=True, kw_only=True, rename=_ERRORS):
    """Errors of each joint: of torque in percent of it, while the joint moves and below the
    report's band; of positions in mrad, begun anew at the measured position every 10 s.

    Attributes:
        nominal: (n,) of the robot as given; of positions, of the command itself; nan of joints
            whose torque holds no signal.
        full: (n,) of all that was diagnosed, by torchid.
        claim: (n,) of the file, by its own numbers.
        engine: (n,) of the file, by the engine that runs it.
        run_time: (n,) of a file with the effects that are added to it at run time.
    """

    nominal: Float[Tensor, " n"]
    full: Float[Tensor, " n"]
    claim: Float[Tensor, " n"]
    engine: Float[Tensor, " n"]
    run_time: Float[Tensor, " n"]


class Forward(Part, frozen=True, rename={"horizon": "horizon_s", "engine": "file_in_engine"}):
    """Where the arm is after a while, given the measured torque.

    Attributes:
        horizon: [s].
        starts: number of simulations.
        nominal, full: (n,) RMS error [rad; m] of the robot as given and of the diagnosed one, by
            torchid; None where no trajectory is as long.
        engine: (n,) of the file; None where MuJoCo refuses it.
    """

    horizon: float
    starts: int
    nominal: Float[Tensor, " n"] | None
    full: Float[Tensor, " n"] | None
    engine: Float[Tensor, " n"] | None


class JudgedRecord(
    Part, frozen=True, kw_only=True, rename={"held_out": "on", "by": "engine", "band": "band_hz"}
):
    """What a file is worth; see `export.correction.Judged`."""

    held_out: str
    by: str
    band: float | None
    torque_error_percent: Errors | UnsetType = UNSET
    position_error_mrad: Errors | UnsetType = UNSET
    forward: tuple[Forward, ...]


class Kept(Part, frozen=True, rename={"share": "kept", "field": "by"}):
    """What the file keeps of an effect that it has no field for.

    Attributes:
        effect, joints: its name, and joints from 0 (none: of the whole arm).
        share: what of its torque the refitted fields take over, 1 - lost / made.
        field, joint, value: the field that carries most of it (`damping`, ..., `bodies`), of which
            joint from 0, and what it has become there [its unit] (of a curve of damping the part in
            proportion to speed); None of bodies.
        made, lost: RMS of its torque while joints move, and of what the fields leave of it, all of
            it where they come no nearer; of several joints as root of the sum of their mean squares
            [N m; N].
    """

    effect: Annotated[str, Col(words=effect_words)]
    joints: Annotated[tuple[Joint, ...], Col(words=joints_or_arm)]
    share: Real
    field: str
    joint: Joint | None
    value: float | None
    made: Real = math.nan
    lost: Real = math.nan


class BodiesRecord(Part, frozen=True, kw_only=True):
    """Bodies in the file, and names of the effects that it says; see `export.projection`."""

    believable: bool
    price: Real
    believable_price: Real
    mass: Float[Tensor, " n"]
    com: Float[Tensor, "n 3"]
    inertia_about_com: Float[Tensor, "n 6"]
    fields: tuple[Values, ...]


class UnsaidRow(Part, frozen=True, kw_only=True):
    """A parameter of servos that the file has no field for."""

    parameter: Annotated[str, Col()]
    joints: Annotated[tuple[Joint, ...], Col(words=joints_or_arm)]


class CorrectionRecord(Record, frozen=True, kw_only=True, tag="torchid.correction/1"):
    """A corrected file, by torques or by positions.

    Attributes:
        robot: name of the robot as given. to: format of the file.
        judged: what it is worth.
        no_field: what it keeps of effects that it has no field for.
        bodies: that are in it; None by positions.
        servos_without: parameters of servos that it does not say.
        exports: what was written.
        warnings: sentences for the user.
        seed: of the states at which it was compared, from a command.
    """

    robot: str
    to: str
    judged: JudgedRecord
    no_field: tuple[Kept, ...] = ()
    bodies: BodiesRecord | None = None
    servos_without: tuple[UnsaidRow, ...] | UnsetType = UNSET
    exports: tuple[ExportRecord, ...]
    warnings: tuple[str, ...]
    seed: int | UnsetType = UNSET

    @property
    def table(self) -> Rows[Kept]:
        """Effects that the file has no field for."""
        return Rows(self.no_field)


class RangeRow(Part, frozen=True, kw_only=True):
    """One range.

    Attributes:
        field: `damping`, `friction`, `armature`, `stiffness`, `offset` of a joint; `mass`,
            `com_x`, ... of a link, in its frame; else the name of an effect.
        name: of the joint or link; of an effect's coefficient itself.
        unit: of the numbers.
        low, high: between them lies the asked share of the draws.
        centre: median of the draws of what is told.
        why: one sentence.
    """

    field: Annotated[str, Col()]
    name: Annotated[str, Col("of")]
    unit: Annotated[str, Col()]
    low: Annotated[Real, Col(digits=".4g")]
    high: Annotated[Real, Col(digits=".4g")]
    centre: Real
    why: Annotated[str, Col()]


class ResidualBand(Part, frozen=True, kw_only=True):
    """Torque of one joint that stays unexplained.

    Attributes:
        joint: which.
        low, high: between them lies the asked share of the instants [N m; N].
        rms: of all of it, on data that was not fitted.
        noise: what of it may be the sensor's.
        unexplained: RMS of the rest, which acts on the arm.
        correlation: how long it lasts [s].
        why: one sentence.
    """

    joint: Annotated[Joint, Col()]
    low: Annotated[Real, Col()]
    high: Annotated[Real, Col()]
    rms: Real
    noise: Real
    unexplained: Real
    correlation: Real = msgspec.field(name="correlation_s")
    why: Annotated[str, Col()]


class RandomisationRecord(Record, frozen=True, kw_only=True, tag="torchid.randomisation/1"):
    """How wide to randomise.

    Attributes:
        robot: its name.
        level: share of the draws in each range.
        draws: how many.
        ranges: of all fields and coefficients in which draws differ.
        residual: by joint.
        files: what was written, from a command.
        warnings: sentences for the user.
        seed: of the draws, from a command.
    """

    robot: str
    level: float
    draws: int
    ranges: tuple[RangeRow, ...]
    residual: tuple[ResidualBand, ...]
    files: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    seed: int | UnsetType = UNSET

    @property
    def table(self) -> Rows[RangeRow]:
        """The ranges."""
        return Rows(self.ranges)
