"""Values of base parameters, wherever they are from, and what is known of their accuracy."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchid.effects.base import Effect, JointEffect
from torchid.effects.registry import COLUMN_KINDS, nominal_columns
from torchid.errors import TorchidError
from torchid.identification.base_parameters import BaseParameters, base_parameters, nominal_values
from torchid.identification.result import Identification
from torchid.robot.model import Robot
from torchid.typing import Bool, Float, Tensor


@dataclass(frozen=True, eq=False)
class BaseValues:
    """Values of base parameters, and what is known of their accuracy.

    Attributes:
        base, effects: which they are.
        values: (B,).
        known: (B,) those that the log determined.
        covariance: (B, B), or None where the values are exact.
        factor: (B + 1, B + 1) of the fit, or None where there was none.
    """

    base: BaseParameters
    effects: tuple[Effect, ...]
    values: Float[Tensor, " B"]
    known: Bool[Tensor, " B"]
    covariance: Float[Tensor, "B B"] | None
    factor: Float[Tensor, "C C"] | None


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
    """The base parameters of the robot's nominal parameters and effects, exact.

    Raises:
        RobotError: the robot has no nominal parameters.
    """
    effects = tuple(effect for effect, _ in nominal_columns(robot))
    base = base_parameters(robot, effects)
    known = torch.ones(len(base), dtype=torch.bool)
    return BaseValues(base, effects, nominal_values(robot, base), known, None, None)


def identified_base(result: Identification) -> BaseValues:
    """The base parameters of an identification; what bodies or the log hold at zero stays known
    unless the log did not determine it."""
    unknown = set(result.undetermined)
    known = torch.tensor([name not in unknown for name in result.base.names])
    return BaseValues(
        result.base, result.effects, result.values, known, result.covariance, result.factor
    )
