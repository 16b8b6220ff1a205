"""What a planned motion has to keep beyond its joints' own limits, and how it is made to.

Such a restriction (torque, clearance) couples the joints, and some motions break it however small
they are, so a motion is not scaled joint by joint. A search pays a penalty for breaking it, and
what the search leaves is shrunk towards a posture at rest that keeps the restriction with the most
room: along q_r + s (q - q_r) position, velocity and acceleration stay within their limits too for
s in [0, 1], and for small s nothing is left but that posture.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import torch

from torchid.errors import RobotError
from torchid.excitation.fourier import FourierTrajectory
from torchid.excitation.limits import motion_limits
from torchid.excitation.trajectories import Sinusoid
from torchid.robot.model import Robot
from torchid.typing import Bool, Float, Tensor

_WIDTHS = (1.0, 0.3, 0.1, 0.03, 0.01)  # of the range, around the best posture so far

Planned = TypeVar("Planned", FourierTrajectory, Sinusoid, FourierTrajectory | Sinusoid)


class Restriction(ABC):
    """What a motion has to keep at every instant.

    Attributes:
        robot: with the limits within which postures lie.
        usage: share of those limits that may be used.
    """

    robot: Robot
    usage: float

    @abstractmethod
    def penalty(self, trajectory: FourierTrajectory) -> Float[Tensor, "*batch"]:
        """What a search pays for breaking it; differentiable, 0 where it is kept."""

    @abstractmethod
    def fits(self, trajectory: FourierTrajectory | Sinusoid) -> Bool[Tensor, "*batch"]:
        """Whether each motion keeps it at every instant."""

    @abstractmethod
    def strain(self, q: Float[Tensor, "K n"]) -> Float[Tensor, " K"]:
        """How near an arm at rest in postures is to breaking it; above 1 it does."""

    @abstractmethod
    def impossible(self, q: Float[Tensor, " n"]) -> RobotError:
        """The error that even the best posture q breaks the restriction."""

    def within(self, trajectory: Planned) -> Planned:
        """Each motion itself if it keeps the restriction at every instant, else the largest found
        that does between it and rest.

        Raises:
            RobotError: no posture keeps it.
        """
        fits = self.fits(trajectory)
        if bool(fits.all()):
            return trajectory
        low, high = fits.double(), torch.ones(fits.shape, dtype=torch.float64)
        # 12: halvings, which find a scale to 1 in 4000
        for _ in range(12):
            middle = (low + high) / 2
            inside = fits | self.fits(trajectory.towards(self.rest, middle))
            low, high = torch.where(inside, middle, low), torch.where(inside, high, middle)
        low = torch.where(fits, 1.0, low)
        if not bool((low > 0).all()):
            raise self.impossible(self.rest)
        return trajectory.towards(self.rest, low)

    @cached_property
    def rest(self) -> Float[Tensor, " n"]:
        """The posture (n,) with the least strain.

        Raises:
            RobotError: even that breaks the restriction.
        """
        bounds = motion_limits(self.robot, usage=self.usage).position
        lower, upper = bounds.unbind(-1)
        generator = torch.Generator().manual_seed(0)
        best = bounds.mean(-1)
        for width in _WIDTHS:
            # 2048: postures of the whole range
            drawn = torch.rand((2048, self.robot.n), generator=generator, dtype=torch.float64)
            near = (best + width * (upper - lower) * (drawn - 0.5)).clamp(lower, upper)
            tried = torch.cat([best.unsqueeze(0), near])
            best = tried[self.strain(tried).argmin()]
        if bool((self.strain(best.unsqueeze(0)) > 1).any()):
            raise self.impossible(best)
        return best


@dataclass(frozen=True, eq=False)
class AllOf(Restriction):
    """Several restrictions of one robot at once, or none.

    Attributes:
        robot, usage: as of each part.
        parts: which.
    """

    robot: Robot
    usage: float
    parts: tuple[Restriction, ...]

    @classmethod
    def of(cls, robot: Robot, usage: float, *parts: Restriction | None) -> "AllOf":
        """All restrictions that there are, as one."""
        return cls(robot, usage, tuple(part for part in parts if part is not None))

    def penalty(self, trajectory: FourierTrajectory) -> Float[Tensor, "*#batch"]:
        """The sum of all penalties."""
        return sum((part.penalty(trajectory) for part in self.parts), torch.zeros(()).double())

    def fits(self, trajectory: FourierTrajectory | Sinusoid) -> Bool[Tensor, "*#batch"]:
        """Whether all are kept; a part is asked only while some motion keeps those before it."""
        fits = torch.tensor(True)
        for part in self.parts:
            if bool(fits.any()):
                fits = fits & part.fits(trajectory)
        return fits

    def strain(self, q: Float[Tensor, "K n"]) -> Float[Tensor, " K"]:
        """The largest strain of all restrictions."""
        return torch.stack([part.strain(q) for part in self.parts]).amax(0)

    def impossible(self, q: Float[Tensor, " n"]) -> RobotError:
        """The error of the part that posture q breaks most."""
        return max(self.parts, key=lambda part: float(part.strain(q.unsqueeze(0)))).impossible(q)
