"""`torchid excite`: trajectories that make the parameters visible."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import torchid
from torchid.app import options as opt
from torchid.app.inputs import ROBOT
from torchid.app.output import Drawn, Output
from torchid.app.signature import Fields, Parsed, command
from torchid.errors import TorchidError
from torchid.files import write_text
from torchid.json_data import write_json
from torchid.next_motion.settings import MotionSettings, Room

if TYPE_CHECKING:
    from torchid.next_motion.planned import Planned
    from torchid.position.record import PositionRecord

_BOX = "XMIN,XMAX,YMIN,YMAX,ZMIN,ZMAX"


def _box(text: str) -> tuple[float, ...]:
    """--workspace."""
    return tuple(opt.number("--workspace", part, _BOX) for part in text.split(","))


@dataclass(frozen=True, kw_only=True)
class _Controllers:
    """Files for robot controllers.

    Attributes:
        ros2: ROS 2 JointTrajectory message, as JSON (which `ros2 topic pub` takes as YAML).
        urscript: Program for an arm of Universal Robots (choose --rate 125, or 500 on
            e-Series).
    """

    ros2: opt.Written = None
    urscript: opt.Written = None

    def check(self, robot: "torchid.Robot", count: int) -> None:
        """Refuse what the asked files cannot hold.

        Raises:
            TorchidError: several motions, or a robot that no URScript program moves.
        """
        from torchid.excitation.controllers import require_six_joints

        if count != 1 and (self.ros2 or self.urscript):
            raise TorchidError("--ros2 and --urscript hold one motion.", got=count)
        if self.urscript:
            require_six_joints(robot)

    def write(self, planned: "Planned", output: Output) -> None:
        """Write what is asked for."""
        from torchid.excitation.controllers import joint_trajectory, urscript

        robot, first = planned.robot, planned.motions[0].sample(planned.rate)
        output.put(self.ros2, lambda path: write_json(joint_trajectory(robot, first), path))
        output.put(self.urscript, lambda path: write_text(path, urscript(robot, first)))


@command
def excite_command(
    *,
    robot: Annotated[str | None, typer.Argument(metavar="[ROBOT]"), ROBOT] = None,
    motion: Annotated[
        MotionSettings,
        Fields(
            "kind criterion basis duration rate usage speed",
            result=Annotated[Path | None, typer.Option("--for", metavar="RESULT")],
            count=opt.Count,
            effects=opt.FittedEffects,
            harmonics=Annotated[int, typer.Option(min=1, max=100)],
            restarts=opt.Count,
            seed=opt.Seed,
            device_name=opt.Device,
        ),
    ],
    room: Annotated[
        Room,
        Fields(
            "clearance",
            floor=Annotated[float | None, typer.Option(min=-100, max=100)],
            workspace=Annotated[
                tuple[float, ...] | None, typer.Option(metavar="BOX"), Parsed(_box)
            ],
        ),
    ],
    save: opt.Saved = None,
    files: _Controllers,
    max_velocity: opt.Velocities = None,
    max_acceleration: opt.Accelerations = None,
    part: opt.Part,
    output: Annotated[Drawn, "excitation.json"],
) -> None:
    """Design an exciting trajectory within the robot's limits, at rest at both ends.

    Torque limits are kept by the robot's parameters, or those that RESULT holds, if there are any;
    the links of a URDF or MJCF are kept apart.

    Example: `torchid excite kuka_lwr4 --out motion`

    Example: `torchid excite arm.urdf --max-acceleration 5 --floor 0 --ros2 first.json --speed 0.1`

    Example: `torchid excite --for result/identification.json --max-acceleration 5 --out next`

    Args:
        robot: Built-in name, or a torchid .yaml, .urdf or .xml (MJCF) file; with --for, the one
            that the result records if absent.
        save: Trajectory file (.csv, .parquet, .npz).
        max_velocity: Velocity limits, in place of the robot's.
        max_acceleration: Acceleration limits, in place of the robot's (a URDF has none).
    """
    target = save or (output.out and output.out / "trajectory.csv")
    if not (target or output.json_file or files.ros2 or files.urscript):
        raise TorchidError(
            "nowhere to write the trajectory.",
            expected="--save FILE, --out DIR, --ros2 FILE, --urscript FILE or --json FILE",
        )
    if robot is None and motion.result is None:
        raise TorchidError("which robot?", expected="torchid excite ROBOT, or --for RESULT")
    from torchid.next_motion.design import read_asking
    from torchid.next_motion.planned import plan
    from torchid.position.record import PositionRecord
    from torchid.report.motion import report_of_design, report_of_motion

    asking = None if motion.result is None else read_asking(motion.result)
    recorded = None if isinstance(asking, PositionRecord) or asking is None else asking.model
    moved = recorded if robot is None else opt.load(robot, part)
    if moved is None:
        raise TorchidError(
            f"'{motion.result}' does not record its robot.",
            expected=f"torchid excite ROBOT --for {motion.result}",
        )
    if isinstance(asking, PositionRecord):
        if files.ros2 or files.urscript or motion.speed != 1:
            raise TorchidError("commands of servos are written with --save, at full speed.")
        arm = opt.with_limits(moved, max_velocity, max_acceleration)
        _commands(asking, arm, motion, room, target, output)
        return
    moved.require_fixed_base("the design of motions")
    arm = opt.with_limits(moved, max_velocity, max_acceleration)
    files.check(arm, 3 if motion.kind == "paper" else motion.count)
    with output.progress() as progress:
        planned = plan(arm, motion, room, progress=progress)
    output.put(target, partial(torchid.write_log, planned.log))
    files.write(planned, output)
    data = planned.plain(None if target is None else target.name)
    said = output.keep(data, "excitation.json", lambda _: report_of_motion(planned))
    output.tell(report_of_design(planned))
    output.tell(said)


def _commands(
    asking: "PositionRecord",
    robot: "torchid.Robot",
    motion: MotionSettings,
    room: Room,
    target: Path | None,
    output: Output,
) -> None:
    """Commands for an arm that logs no torque: written, and what they would show."""
    from torchid.next_motion.planned import clearance_of
    from torchid.position.next_motion import NextCommands
    from torchid.report.position import report_of_commands

    clearance, unknown = clearance_of(robot, room, motion.usage)
    with output.progress() as progress:
        made = torchid.excite_for(
            asking, robot, duration=motion.duration, rate=motion.rate, usage=motion.usage,
            clearance=clearance, progress=progress,
        )  # fmt: skip
    assert isinstance(made, NextCommands)
    output.put(target, partial(torchid.write_log, made.log))
    output.give(made.plain(), "excitation.json", lambda _: report_of_commands(made, unknown))
