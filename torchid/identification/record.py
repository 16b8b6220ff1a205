"""An identification as its JSON has it: the schema torchid.identification/1."""

from typing import TYPE_CHECKING, Annotated

import torch
from msgspec import UNSET, UnsetType, field

from torchid.effects.base import Effect
from torchid.effects.registry import effect_from_record, effect_kind, on_every_joint
from torchid.errors import TorchidError
from torchid.identification.base_parameters import BaseParameters, all_units, coefficient_names
from torchid.identification.model import BaseParameter, Blocks, IdentifiedModel
from torchid.identification.settings import Rows, Settings
from torchid.results.record import (
    FINITE,
    Model,
    Part,
    Real,
    RobotRecord,
    Values,
    recorded,
)
from torchid.results.record import Rows as Table
from torchid.robot.inertia import PARAMETERS_PER_LINK, parameter_names
from torchid.robot.knowledge import Knowledge, from_mapping
from torchid.robot.model import Basis, JointType, Robot
from torchid.typing import Bool, Float, Tensor


class EffectRecord(Part, frozen=True, kw_only=True):
    """A kind of effect over the joints (from 1) on which a coefficient is a base parameter of its
    own; one that is part of a sum is null here, and in `combined` or `absorbed`.

    Attributes:
        effect: name.
        joints: from 1.
        parameters, std: a list a coefficient.
        places: of effects that are not on every joint, or have shapes: joints and shapes.
    """

    effect: str
    joints: tuple[int, ...]
    parameters: dict[str, tuple[float | None, ...]]
    std: dict[str, tuple[float | None, ...]]
    places: tuple[Values, ...] | UnsetType = UNSET


class CutoffRecord(Part, frozen=True):
    """What was tried for the cut-off.

    Attributes:
        candidates: [Hz] (None: no filter).
        scores: cross-validated relative error of unfiltered torque, mean over joints [%]; inf for
            those not tried because lower ones had already become worse.
    """

    candidates: tuple[float | None, ...] = field(name="candidates_hz")
    scores: tuple[Real, ...] = field(name="cross_validated_error_percent")


class Errors(Part, frozen=True):
    """Prediction errors per joint.

    Attributes:
        trajectories: names of the trajectories.
        rmse: (n,) of the filtered torque, all rows [N m; N].
        relative_percent: (n,) 100 ||tau - tau_hat|| / ||tau||, filtered torque, all rows.
        relative_percent_moving: (n,) the same over rows whose own joint moves; nan if none does.
        relative_percent_raw: (n,) the same for unfiltered torque, all rows.
        standstill_fraction: (n,) share of the rows in which the joint does not move.
        standstill_error_share: (n,) their share of the squared error.
    """

    trajectories: tuple[str, ...]
    rmse: Float[Tensor, " n"]
    relative_percent: Float[Tensor, " n"] = field(name="relative_error_percent")
    relative_percent_moving: Float[Tensor, " n"] = field(name="relative_error_percent_moving")
    relative_percent_raw: Float[Tensor, " n"] = field(name="relative_error_percent_raw")
    standstill_fraction: Float[Tensor, " n"]
    standstill_error_share: Float[Tensor, " n"]

    def judged(self, rows: Rows) -> Float[Tensor, " n"]:
        """Relative errors (n,) over the rows that the fit used [%]; nan where there are none."""
        return self.relative_percent_moving if rows == "moving" else self.relative_percent


class Grouping(Part, frozen=True, kw_only=True):
    """Base parameters as sums of physical ones (B, P)."""

    parameter_names: tuple[str, ...] = field(name="parameters")
    grouping: Annotated[Float[Tensor, "B P"], FINITE] = field(name="matrix")


class FittedRows(Part, frozen=True):
    """What one second of such a log tells: rows of the least squares and their weights.

    Attributes:
        seconds: length of the log that was fitted.
        per_second: instants a second, after the filter and decimation.
        whitening: (n, n) upper triangular, of the rows of the joints [1/(N m); 1/N].
        inflation: (B,) of each base parameter the standard deviation that this log alone gives over
            that of rows with independent errors; None in older files.
    """

    seconds: float
    per_second: float
    whitening: Annotated[Float[Tensor, "n n"], FINITE]
    inflation: Float[Tensor, " B"] | None = None


class StatisticsRecord(Blocks, Part, frozen=True, kw_only=True):
    """How the standard deviations were found.

    Attributes:
        method: how they were found.
        blocks: number of blocks.
        block_seconds: their length.
        correlation_seconds: integrated autocorrelation time of the residuals, largest over joints.
        quantile95: half of the interval in standard deviations.
    """

    method: str
    blocks: int
    block_seconds: float
    correlation_seconds: float
    quantile95: float


if TYPE_CHECKING:
    SettingsRecord = Settings
else:
    SettingsRecord = recorded(Settings, ("basis", "force"), error_cutoff="error_cutoff_hz")


class IdentificationRecord(
    IdentifiedModel, RobotRecord, frozen=True, kw_only=True, tag="torchid.identification/1"
):
    """An identification as its JSON has it; B base parameters.

    Attributes:
        robot_base: fixed or moving.
        n_base: how many parameters are rigid.
        basis: report or conditioned.
        parameters, effects, combined: rigid ones, coefficients of effects, and sums led by one.
        condition_number, scaled_condition_number: of the regressor.
        cutoff: [Hz], or None. cutoff_choice: what was tried.
        reversal: (n,) [rad/s; m/s].
        fit, held_out: torque errors.
        bounded, wrong_sign, undetermined, dropped, absorbed: names.
        rank_gap: singular values on both sides of the rank.
        grouping: how base parameters are sums.
        base_names, base_values, covariance, factor: of all of them.
        rows, statistics, settings: how they were found.
        warnings: sentences for the user.
        model: the robot.
        sure: how sure it is, as a robot's yaml has it; None in older files.
        seed: from a command.
    """

    robot_base: str | UnsetType = UNSET
    n_base: int
    basis: Basis = "report"
    parameters: tuple[BaseParameter, ...]
    effects: tuple[EffectRecord, ...]
    combined: tuple[BaseParameter, ...]
    condition_number: Real
    scaled_condition_number: Real
    cutoff: float | None = field(name="cutoff_hz")
    cutoff_choice: CutoffRecord | None
    reversal: Annotated[Float[Tensor, " n"], FINITE] = field(name="reversal_speed")
    fit: Errors
    held_out: Errors | None
    bounded: tuple[str, ...]
    wrong_sign: tuple[str, ...]
    undetermined: tuple[str, ...]
    dropped: tuple[str, ...]
    absorbed: tuple[str, ...]
    rank_gap: tuple[Real, Real]
    grouping: Grouping
    base_names: tuple[str, ...]
    values: Annotated[Float[Tensor, " B"], FINITE] = field(name="base_values")
    covariance: Annotated[Float[Tensor, "B B"], FINITE]
    factor: Annotated[Float[Tensor, "C C"], FINITE]
    rows: FittedRows | None = None
    statistics: StatisticsRecord
    settings: SettingsRecord
    warnings: tuple[str, ...]
    model: Model | None = None
    sure: dict[str, list[str]] | None = field(name="knowledge", default=None)
    seed: int | UnsetType = UNSET

    def __post_init__(self) -> None:
        super().__post_init__()
        b = len(self.values)
        if (len(self.base_names), len(self.grouping.grouping), len(self.factor)) != (b, b, b + 1):
            raise ValueError("base_names, grouping and factor do not fit the base_values")
        strange = set(self.undetermined) - set(self.base_names)
        if strange:
            raise ValueError(f"undetermined: there is no base parameter {min(strange)}")

    @property
    def table(self) -> Table[BaseParameter]:
        """The rigid base parameters."""
        return Table(self.parameters)

    @property
    def uncertainty(self) -> StatisticsRecord:
        """How the standard deviations were found, by the name that `Identification` has for it."""
        return self.statistics

    @property
    def free(self) -> Bool[Tensor, " B"]:
        """(B,) estimated; the others are 0."""
        held = {*self.bounded, *self.undetermined, *self.dropped}
        return torch.tensor([name not in held for name in self.base_names])

    @property
    def knowledge(self) -> Knowledge | None:
        """Base parameters and coefficients with their covariance; None in older files."""
        where = f"an identification of '{self.robot}'"
        return None if self.sure is None else from_mapping(self.sure, len(self.reversal), where)

    @property
    def placed(self) -> tuple[Effect, ...]:
        """The effects, in the order of their coefficients."""
        if any(entry.places for entry in self.effects):
            return self.placed_on(self._robot)
        return tuple(on_every_joint(self.settings.effects, len(self.reversal)))

    def placed_on(self, robot: Robot) -> tuple[Effect, ...]:
        """The effects on a robot, in the order of their coefficients.

        Raises:
            TorchidError: an unknown effect, or a place that the robot does not have.
        """
        if not any(entry.places for entry in self.effects):
            return tuple(on_every_joint(self.settings.effects, robot.n))
        out: list[Effect] = []
        for entry in self.effects:
            if not entry.places:
                out += on_every_joint([entry.effect], robot.n)
                continue
            zeros = {c.name: 0.0 for c in effect_kind(entry.effect).coefficients}
            for place in entry.places:
                out.append(effect_from_record({"effect": entry.effect, **zeros, **place}, robot)[0])
        return tuple(out)

    @property
    def base(self) -> BaseParameters:
        """The base parameters' structure, as recorded: the first of each sum stands for it; in
        older files, which do not hold the robot, units are those of revolute joints.

        Raises:
            TorchidError: the record contradicts itself.
        """
        names, n, effects = self.grouping.parameter_names, len(self.reversal), self.placed
        links = n if self.model is None else self.model.n_links
        rigid = PARAMETERS_PER_LINK * links
        if list(names) != parameter_names(links) + coefficient_names(effects):
            raise _incomplete("the parameters' names do not fit the effects")
        matrix = self.grouping.grouping
        leading = [text.partition(" ")[0] for text in self.base_names]
        if strange := set(leading) - set(names):
            raise _incomplete(f"there is no parameter '{min(strange)}'")
        independent = [names.index(name) for name in leading]
        if not torch.equal(matrix[:, independent], torch.eye(len(matrix), dtype=matrix.dtype)):
            raise _incomplete("a base parameter of the grouping has no column of its own")
        types = [JointType.REVOLUTE] * n if self.model is None else self.model.joint_types
        units = all_units(links, types, effects)
        return BaseParameters(
            names=self.base_names,
            units=tuple(units[k] for k in independent),
            parameter_names=names,
            independent=tuple(independent),
            dependent=tuple(sorted(set(range(len(names))) - set(independent))),
            grouping=matrix,
            basis=self.basis,
            rank_gap=self.rank_gap,
            n_rigid_parameters=rigid,
            n_rigid=sum(k < rigid for k in independent),
            warnings=(),
        )


def _incomplete(what: str) -> TorchidError:
    return TorchidError(
        "this is not a complete identification.",
        got=what,
        hint="write it again: torchid identify ROBOT LOG... --json FILE",
    )
