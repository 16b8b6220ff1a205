"""`torchid init`: a project file, guessed from what lies in the folder."""

from pathlib import Path
from typing import Annotated

import typer

from torchid.app import options as opt
from torchid.app.inputs import RECORDED, WRITTEN
from torchid.app.output import Output
from torchid.app.project import read
from torchid.app.signature import Fields, Switch, command
from torchid.errors import TorchidError
from torchid.files import write_text
from torchid.project.file import NAME


def init(
    *,
    logs: Annotated[list[Path] | None, typer.Argument(metavar="[LOG...]"), RECORDED] = None,
    robot: opt.RobotOption = None,
    part: opt.Part,
    reading: opt.Reading,
    held_out: opt.LogFiles = None,
    out: Annotated[str, typer.Option(metavar="DIR")] = "results",
    save: Annotated[Path, typer.Option("--save", "--to", metavar="FILE"), WRITTEN] = Path(NAME),
    force: Switch = False,
    output: Annotated[Output, Fields("quiet")],
) -> None:
    """Write a project file, so that every other command needs only what differs.

    What is not given is guessed from the robot and the logs in the working directory and from the
    columns of the logs.

    Example: `torchid init run1.csv run2.csv --held-out run3.csv --robot my_arm.urdf`

    Args:
        logs: Logs; those in the folder if absent.
        robot: Built-in name, or a torchid .yaml, .urdf or .xml (MJCF) file.
        held_out: Logs to hold out; those whose names say so (test, val, check) if absent.
        out: Folder for results.
        save: The project file.
        force: Replace the project file that is there.
    """
    if save.exists() and not force:
        raise TorchidError(f"'{save}' is there already.", hint="--force replaces it; or edit it")
    from torchid.project.guess import guess
    from torchid.results.words import count

    found = guess(robot, part.choice, logs or (), held_out or (), reading.request(None))
    said, given, n = "the logs hold currents and no torque", reading.gain, found.robot.n
    gains = None if given is None else opt.numbers("--gain", given, n)
    output.put(save, lambda path: write_text(path, found.text(path, out, gains)))
    read(save)
    output.say(
        f"robot: {found.name}, {count(n, 'joint')}",
        f"logs: {', '.join(map(str, found.logs)) or 'none'}",
        f"held out: {', '.join(map(str, found.held_out)) or 'none'}",
    )
    output.warn(found.warnings)
    if gains is None and found.needs_gains:
        output.warn((f"{said}: give the drive gains [N m/A] as `gain` in the file",))
    output.say("next: torchid log show, torchid log doctor, torchid identify, torchid gap")


init_command = command(init, project=False)
