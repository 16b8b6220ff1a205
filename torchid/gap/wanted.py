"""What settings look for on a robot, and the model that the search starts from."""

from dataclasses import dataclass, replace

import torch

from torchid.design.columns import Model
from torchid.effects.friction import TorqueOffset
from torchid.effects.registry import KINDS
from torchid.effects.transient import Contact
from torchid.errors import TorchidError
from torchid.gap.settings import GapSettings
from torchid.identification.base_parameters import BaseParameters, base_parameters
from torchid.identification.knowledge import known_later
from torchid.robot.inertia import PARAMETERS_PER_LINK, InertialParameters
from torchid.robot.knowledge import Knowledge
from torchid.robot.model import Robot

BASE = "all_base"
"""Name of a correction of all base parameters; that of one link is `LINK`."""


@dataclass(frozen=True)
class Wanted:
    """What a search looks for.

    Attributes:
        names: effects.
        free: whether base parameters are always fitted.
        background: effects that are always fitted with them, on every joint.
        inertial: whether corrections of the links' parameters compete.
        base: rigid base parameters of the robot.
        knowledge: how sure the model as given is; None where it does not say.
    """

    names: tuple[str, ...]
    free: bool
    background: tuple[str, ...]
    inertial: bool
    base: BaseParameters
    knowledge: Knowledge | None = None

    def asks(self, name: str) -> bool:
        """Whether an effect of this name is looked for."""
        return name == BASE or name in self.names


def wanted_of(robot: Robot, settings: GapSettings) -> Wanted:
    """What the settings look for on a robot.

    Raises:
        TorchidError: a background on a robot whose parameters are given and trusted.
    """
    free = settings.parameters == "free" or robot.parameters is None
    if settings.background and not free:
        raise TorchidError(
            "a background is fitted with the base parameters, and this robot's are given.",
            got=", ".join(settings.background),
            hint="list them as `effects` of the robot, or refit: `parameters='free'`",
        )
    return Wanted(
        names=tuple(KINDS) if settings.effects is None else settings.effects,
        free=free,
        background=settings.background,
        inertial=settings.parameters != "trusted",
        base=base_parameters(robot, basis="report"),
        knowledge=known_later(robot) if settings.parameters == "auto" else None,
    )


def pushes_alone(wanted: Wanted) -> Wanted:
    """Of an arm that stands in one pose nothing but a push: whatever else its torque is, gravity
    and what friction holds, is an offset that is fitted with it."""
    names = tuple(name for name in wanted.names if name == Contact.name)
    return replace(
        wanted, names=names, free=False, background=(TorqueOffset.name,), inertial=False,
        knowledge=None,
    )  # fmt: skip


def start_of(robot: Robot) -> Model:
    """The model as given; where it has no parameters, without inertia."""
    if robot.parameters is None:
        zero = torch.zeros(robot.n_links, PARAMETERS_PER_LINK, dtype=torch.float64)
        robot = robot.with_parameters(InertialParameters(zero))
    return Model.of(robot)
