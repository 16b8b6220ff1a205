"""What a planned motion keeps clear of, and the files that it goes into."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import typer

import torchid
from torchid.app import options as opt
from torchid.app.output import Output
from torchid.errors import MissingExtraError, TorchidError
from torchid.excitation.settings import CLEARANCE
from torchid.files import write_text
from torchid.json_data import write_json

if TYPE_CHECKING:
    from torchid.excitation.clearance import Clearance
    from torchid.excitation.given import Motions

_BOX = "XMIN,XMAX,YMIN,YMAX,ZMIN,ZMAX"


@dataclass(frozen=True, kw_only=True)
class Room:
    """What a motion keeps clear of.

    Attributes:
        clearance: Distance that the links keep from each other, the floor and the workspace's
            sides [m].
        floor: Height of a floor, in the base frame [m].
        workspace: Box that no moving link leaves, in the base frame [m].
    """

    clearance: float = CLEARANCE
    floor: Annotated[float | None, typer.Option(min=-100, max=100)] = None
    workspace: Annotated[str | None, typer.Option(metavar=_BOX)] = None

    def of(
        self, robot: "torchid.Robot", usage: float
    ) -> "tuple[Clearance | None, tuple[str, ...]]":
        """What the robot's motions are checked for, None where there is nothing; and what is not
        checked for want of knowledge, one sentence each.

        Raises:
            MissingExtraError: a floor or a workspace is asked for, and MuJoCo is not installed.
            TorchidError: numbers that are none.
        """
        from torchid.excitation.clearance import motion_clearance

        box = None
        if self.workspace is not None:
            parts = self.workspace.split(",")
            box = [opt.number("--workspace", part, _BOX) for part in parts]
        try:
            found = motion_clearance(
                robot, clearance=self.clearance, floor=self.floor, workspace=box, usage=usage
            )
        except MissingExtraError as error:
            if self.floor is not None or box is not None:
                raise
            return None, (f"collisions were not checked: {error.problem} {error.hint}",)
        return (found if len(found.pairs) else None), found.warnings


@dataclass(frozen=True, kw_only=True)
class Controllers:
    """Files for robot controllers.

    Attributes:
        ros2: ROS 2 JointTrajectory message, as JSON (which `ros2 topic pub` takes as YAML).
        urscript: Program for an arm of Universal Robots (choose --rate 125, or 500 on
            e-Series).
    """

    ros2: opt.Written = None
    urscript: opt.Written = None

    def check(self, robot: "torchid.Robot", count: int) -> None:
        """That the files can hold what is asked for.

        Raises:
            TorchidError: several motions, or a robot that no URScript program moves.
        """
        from torchid.excitation.controllers import require_six_joints

        if count != 1 and (self.ros2 or self.urscript):
            raise TorchidError("--ros2 and --urscript hold one motion.", got=count)
        if self.urscript:
            require_six_joints(robot)

    def write(self, robot: "torchid.Robot", made: "Motions", rate: float, output: Output) -> None:
        """Write what is asked for."""
        from torchid.excitation.controllers import joint_trajectory, urscript

        first = made[0].sample(rate)
        output.put(self.ros2, lambda path: write_json(joint_trajectory(robot, first), path))
        output.put(self.urscript, lambda path: write_text(path, urscript(robot, first)))
