"""Values of base parameters, wherever they are from, and what is known of their accuracy."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from torchid.effects.base import Effect, JointEffect
from torchid.effects.registry import (
    COLUMN_KINDS,
    nominal_columns,
)
from torchid.errors import TorchidError
from torchid.identification.base_parameters import BaseParameters, base_parameters, nominal_values
from torchid.identification.knowledge import (
    inflation,
    known_before,
    of_base_parameters,
    pooled,
)
from torchid.identification.record import IdentificationRecord
from torchid.identification.result import Identification
from torchid.results.files import read_as
from torchid.robot.knowledge import Knowledge, from_mapping
from torchid.robot.model import Robot
from torchid.typing import Bool, Float, Tensor


@dataclass(frozen=True, eq=False)
class BaseValues:
    """Values of base parameters, and what is known of their accuracy.

    Attributes:
        base, effects: which they are.
        values: (B,).
        known: (B,) those that the log determined.
        covariance: (B, B), 0 of those that are not known; or None where the values are exact.
        factor: (B + 1, B + 1) of the fit, or None where there was none.
        knowledge: of links and coefficients, as a robot has it.
    """

    base: BaseParameters
    effects: tuple[Effect, ...]
    values: Float[Tensor, " B"]
    known: Bool[Tensor, " B"]
    covariance: Float[Tensor, "B B"] | None
    factor: Float[Tensor, "C C"] | None
    knowledge: Knowledge | None = None

    @property
    def held(self) -> tuple[str, ...]:
        """Names of those that the fit held, which have no variance and are not sure for that."""
        if self.covariance is None:
            return ()
        return self.base.named((self.covariance.diagonal() == 0) & self.known)

    @property
    def uncertainty(self) -> Float[Tensor, "B B"] | None:
        """The covariance, infinite for what the log did not determine; None where all is exact."""
        if self.covariance is None:
            return None
        covariance = self.covariance.clone()
        covariance[~self.known, ~self.known] = float("inf")
        return covariance


def plain_effects(effects: Sequence[Effect], what: str) -> tuple[JointEffect, ...]:
    """The effects of an identification, for what knows no others than those of a joint's own motion
    without shapes.

    Raises:
        TorchidError: it has others.
    """
    plain = tuple(e for e in effects if isinstance(e, JointEffect) and e.name in COLUMN_KINDS)
    if len(plain) < len(effects):
        others = dict.fromkeys(e.name for e in effects if e.name not in COLUMN_KINDS)
        raise TorchidError(
            f"{what} takes no identification with effects that have shapes, a memory or a load.",
            got=", ".join(others),
            available=list(COLUMN_KINDS),
            hint="identify again without them; `torchid export` takes all effects",
        )
    return plain


def nominal_base(robot: Robot) -> BaseValues:
    """The base parameters of the robot's nominal parameters and effects: as sure as its model says
    that they are, exact where it does not say.

    Raises:
        RobotError: the robot has no nominal parameters.
    """
    effects = tuple(effect for effect, _ in nominal_columns(robot))
    base = base_parameters(robot, effects)
    values = known_values(robot, base, effects, later=False)
    if values is not None:
        return values
    known = torch.ones(len(base), dtype=torch.bool)
    return BaseValues(base, effects, nominal_values(robot, base), known, None, None)


def known_values(
    robot: Robot, base: BaseParameters, effects: Sequence[Effect], *, later: bool = True
) -> BaseValues | None:
    """Base parameters of a model that says how sure it is; None of another.

    Their factor is that of rows which nobody measured: the distance of other values from these, in
    the metric of what is known.

    Args:
        robot: with its knowledge.
        base, effects: which base parameters.
        later: on the day of another session; else on that of the last one.
    """
    knowledge = known_before(robot, base, effects, later=later)
    if knowledge is None:
        return None
    root, expected = knowledge
    values, covariance, known = pooled(root, expected, root[:0], expected)
    rows = torch.cat([root, root @ expected.unsqueeze(1)], 1)
    factor = torch.linalg.qr(torch.cat([rows, rows.new_zeros(rows.shape[1], rows.shape[1])])).R
    values = torch.where(known, values, expected)
    return BaseValues(base, tuple(effects), values, known, covariance, factor, robot.knowledge)


def identified_base(result: Identification) -> BaseValues:
    """The base parameters of an identification; what bodies or the log hold at zero stays known
    unless the log did not determine it."""
    return BaseValues(
        result.base,
        result.effects,
        result.values,
        ~result.base.mask(result.undetermined),
        result.covariance,
        result.factor,
        result.knowledge,
    )


def read_base(path: Path, robot: Robot) -> BaseValues:
    """The result of `torchid identify ... --json PATH`, for the same robot.

    Raises:
        TorchidError: not such a file, or another robot's.
    """
    return recorded_base(read_identification(path), robot, str(path))


def read_identification(path: Path) -> IdentificationRecord:
    """The result of `torchid identify ... --json PATH`.

    Raises:
        TorchidError: not such a file, with the place of the fault.
    """
    hint = "torchid identify ROBOT LOG... --json FILE"
    return read_as(path, IdentificationRecord, "a result of an identification", hint)


def recorded_base(record: IdentificationRecord, robot: Robot, source: str) -> BaseValues:
    """The base parameters of an identification's record.

    Args:
        record: the record.
        robot: the same robot as was identified.
        source: what the record is called in errors.

    Raises:
        TorchidError: another robot's.
    """
    effects = record.placed_on(robot)
    base = base_parameters(robot, effects, basis=record.basis)
    if base.names != record.base_names:
        differing = [n for n in record.base_names if n not in base.names]
        raise TorchidError(
            f"'{source}' holds base parameters of another robot.",
            got=f"{len(record.base_names)} of '{record.robot}'"
            + (f", e.g. {differing[0]}" if differing else ""),
            expected=f"the {len(base)} of '{robot.name}', e.g. {base.names[0]}",
            hint="of the same robot by an older torchid: identify again",
        )
    known, data = ~base.mask(record.undetermined), record.sure
    sure = None if data is None else from_mapping(data, robot.n, source)
    return BaseValues(base, effects, record.values, known, record.covariance, record.factor, sure)


@dataclass(frozen=True, eq=False)
class Prior:
    """What an identification knows, for the design of the next motion.

    Attributes:
        base, effects, values: its base parameters (B,).
        known: (B,) those that the log determined.
        std: (B,) standard deviations; 0 where held or unknown.
        information: (B, B) of all that is known, in units of rows with independent errors: R'R of
            the weighted rows of a first log.
        inflation: (B,) standard deviation over that of white residuals; where nothing was
            estimated, the median of the others.
        whitening: (n, n) weights of the joints' rows.
        per_second: rows a second and joint.
    """

    base: BaseParameters
    effects: tuple[JointEffect, ...]
    values: Float[Tensor, " B"]
    known: Bool[Tensor, " B"]
    std: Float[Tensor, " B"]
    information: Float[Tensor, "B B"]
    inflation: Float[Tensor, " B"]
    whitening: Float[Tensor, "n n"]
    per_second: float


def prior_of(result: IdentificationRecord, robot: Robot, source: str) -> Prior:
    """What an identification knows; for the same robot.

    Args:
        result: its record.
        robot: the same robot as was identified.
        source: what the record is called in errors.

    Raises:
        TorchidError: another robot's, or one without the rows' weights, of an older torchid.
    """
    base = recorded_base(result, robot, source)
    if result.rows is None:
        raise TorchidError(
            f"'{source}' does not say how its rows were weighted.",
            hint="write it again: torchid identify ROBOT LOG... --json FILE",
        )
    r, std = result.factor[:, :-1], result.covariance.diagonal().clamp(min=0).sqrt()
    wider = result.rows.inflation
    if wider is None or base.knowledge is None:  # of an older torchid: of this log alone
        wider, information = inflation(result.covariance, result.factor), r.T @ r
    else:
        # What all sessions know, in units of rows with independent errors.
        root = of_base_parameters(base.knowledge, base.base, base.effects) * wider
        information = root.T @ root
    return Prior(
        base.base,
        plain_effects(base.effects, "the design of the next motion"),
        base.values,
        base.known,
        std,
        information,
        wider,
        result.rows.whitening,
        result.rows.per_second,
    )
