"""How wide to randomise a simulator: what a randomisation holds, of torques or of servos."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from torchid.effects.registry import Valued
from torchid.errors import TorchidError
from torchid.export.dynamics import records
from torchid.export.record import RandomisationRecord, RangeRow, ResidualBand, Share
from torchid.results.record import Result
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.simulation.servo import Servos
from torchid.typing import Float, Int, Tensor


@dataclass(frozen=True, eq=False)
class Draws:
    """D draws of a robot.

    Attributes:
        which: (D,) number of the explanation that each is of.
        pi: (D, n, 10) bodies, all of them feasible.
        effects: per draw, with coefficients drawn and physical signs.
        nearest: how many draws belong to no body and have the nearest one; then none is drawn anew.
        anew: share of the points that no body has, and that were drawn anew.
    """

    which: Int[Tensor, " D"]
    pi: Float[Tensor, "D n 10"]
    effects: tuple[tuple[Valued, ...], ...]
    nearest: int
    anew: float


@dataclass(frozen=True, eq=False)
class Randomisation(Result):
    """How wide to randomise.

    Attributes:
        name: of the robot.
        level: share of what is drawn that lies in a range.
        draws: of the robot's bodies and effects; of positions its servos (D, n, K), whose plane is
            that of the answer.
        ranges: per field of a joint or a link, and per coefficient without a field, of which the
            draws differ.
        robot: the centre: the diagnosed robot with bodies; of positions the robot that was given.
        joint_names: of the robot, or numbers.
        residual: torque that stays unexplained, joint by joint.
        explanations: that were drawn from, with how many draws each has.
        warnings: sentences for the user.
    """

    name: str
    level: float
    draws: Draws | Servos
    ranges: tuple[RangeRow, ...]
    robot: Robot | None
    joint_names: tuple[str, ...]
    residual: tuple[ResidualBand, ...] = ()
    explanations: tuple[Share, ...] = ()
    warnings: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"Randomisation('{self.name}', {len(self)} draws, {len(self.ranges)} ranges)"

    def __len__(self) -> int:
        drawn = self.draws
        return len(drawn.joint if isinstance(drawn, Servos) else drawn.which)

    @cached_property
    def record(self) -> RandomisationRecord:
        """As the JSON has it."""
        return RandomisationRecord(
            robot=self.name,
            level=self.level,
            draws=len(self),
            ranges=self.ranges,
            residual=self.residual,
            explanations=self.explanations,
            warnings=self.warnings,
        )

    def write(self, folder: Path | str, name: str | None = None) -> list[Path]:
        """Write the ranges, NAME_ranges.csv, and what has the draws: NAME_draws.npz, NAME_mjlab.py
        and NAME_isaaclab.py; of servos NAME_servo_draws.npz. Return the files; see
        `torchid.export.write_randomised`."""
        from torchid.export.write_randomised import write_randomised

        return write_randomised(self, folder, name)

    def one(self, k: int) -> Robot:
        """The robot of a draw, with its effects.

        Raises:
            TorchidError: draws of servos.
        """
        if self.robot is None or isinstance(self.draws, Servos):
            raise TorchidError("these are draws of servos.", hint="`draws.joint[k]`")
        robot = self.robot.with_parameters(InertialParameters(self.draws.pi[k]))
        return replace(robot, effects=records(self.draws.effects[k]))
