"""`torchid init`: a project file of what is given."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from torchid.app import options as opt
from torchid.app.inputs import RECORDED, WRITTEN
from torchid.app.output import Output
from torchid.app.project import read
from torchid.app.signature import Fields, Switch, command
from torchid.errors import TorchidError
from torchid.files import write_text
from torchid.project.file import NAME, project_text


def init(
    *,
    logs: Annotated[list[Path] | None, typer.Argument(metavar="[LOG...]"), RECORDED] = None,
    robot: opt.RobotOption = None,
    part: Annotated[opt.Part, Fields("tip root lock")],
    reading: Annotated[opt.Reading, Fields("columns topic gain")],
    held_out: opt.LogFiles = None,
    out: Annotated[str, typer.Option(metavar="DIR")] = "results",
    save: Annotated[Path, typer.Option("--save", "--to", metavar="FILE"), WRITTEN] = Path(NAME),
    force: Switch = False,
    output: Annotated[Output, Fields("quiet")],
) -> None:
    """Write a project file, so that every other command needs only what differs.

    It says what is given here; lines for the rest stand in it as comments.

    Example: `torchid init run1.csv run2.csv --held-out run3.csv --robot my_arm.urdf`

    Args:
        logs: Logs.
        robot: Built-in name, or a torchid .yaml, .urdf or .xml (MJCF) file.
        held_out: Logs to hold out.
        out: Folder for results.
        save: The project file.
        force: Replace the project file that is there.
    """
    if save.exists() and not force:
        raise TorchidError(f"'{save}' is there already.", hint="--force replaces it; or edit it")

    def beside(path: str | Path) -> str:
        return Path(os.path.relpath(path, save.parent)).as_posix()

    gain, columns = reading.gain, reading.columns
    entries: Mapping[str, Any] = {
        "robot": beside(robot) if robot and os.path.isfile(robot) else robot,
        "tip": part.tip,
        "root": part.root,
        "lock": dict(part.choice.lock),
        "columns": beside(columns) if columns and "=" not in columns else columns,
        "topic": reading.topic,
        "gain": gain and opt.numbers("--gain", gain, gain.count(",") + 1),
        "logs": list(map(beside, logs or ())),
        "held_out": list(map(beside, held_out or ())),
        "out": out,
    }
    output.put(save, lambda path: write_text(path, project_text(entries)))
    output.finish()  # it is read below
    read(save)
    output.say("next: torchid log show, torchid log doctor, torchid identify, torchid gap")


init_command = command(init, project=False)
