"""`torchid init`: a project file, guessed from what lies in the folder, and asked for."""

import json
import os
import re
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from torchid.app import options as opt
from torchid.app.output import Output
from torchid.app.project import NAME, read_project
from torchid.app.signature import WRITTEN, Fields, Switch, command
from torchid.errors import RobotError, TorchidError
from torchid.files import atomic_write

if TYPE_CHECKING:
    from torchid.log.model import Log
    from torchid.log.table import Request
    from torchid.robot.model import Robot

_APART = re.compile(r"(?:^|[^a-z])(?:held|hold|test|val|check|eval)", re.IGNORECASE)
"""Names of logs that are meant to be held out."""
_TEXT = """\
# What is the same in every torchid command about this robot. The command line goes before it, and
# --project none leaves it aside. Paths are relative to this file.

robot = {robot}
{tip}
# Logs: which columns are what (--columns) where they have other names than t, q1.., dq1.., tau1..
{columns}
{gain}
{logs}
{apart}

# Folder of results: each command has its own in it.
out = {out}

# Effects that `identify` fits beside the rigid body, and what the simulator of `gap` has already:
# effects = ["viscous_friction", "coulomb_friction", "torque_offset", "rotor_inertia"]
# background = ["viscous_friction", "coulomb_friction"]

# In place of the robot's own, one number or one a joint [rad or m; per s; per s^2; N m or N]:
[limits]
{limits}

# What the last link carries while the logs are recorded, in its frame [kg, m, kg m^2]:
# [payload]
# mass = 1.2
# com = [0.0, 0.0, 0.05]
# inertia = [0.001, 0.0, 0.0, 0.001, 0.0, 0.001]    # xx, xy, xz, yy, yz, zz about com

# Any option of one command, in a table of its name:
# [gap]
# cutoff = 6
"""


def init(
    *,
    logs: Annotated[list[Path] | None, typer.Argument(metavar="[LOG...]")] = None,
    robot: opt.RobotOption = None,
    tip: opt.Tip = None,
    reading: opt.Reading,
    held_out: opt.LogFiles = None,
    out: str = "results",
    to: Annotated[Path, typer.Option(metavar="FILE"), WRITTEN] = Path(NAME),
    ask: bool = True,
    force: Switch = False,
    output: Annotated[Output, Fields("quiet")],
) -> None:
    """Write a project file, so that every other command needs only what differs.

    What is not given is guessed from the robots and logs in the working directory and from the
    columns of the logs, or asked for on a terminal.

    Example: `torchid init run1.csv run2.csv --held-out run3.csv --robot my_arm.urdf`

    Args:
        logs: Logs; those in the folder if absent.
        robot: Built-in name, or a .yaml (ours), .urdf or .xml (MJCF) file.
        held_out: Logs to hold out; those whose names say so (test, val, check) if absent.
        out: Folder for results.
        to: The project file.
        ask: Ask for what cannot be guessed, on a terminal.
        force: Replace the project file that is there.
    """
    from torchid.log.readers import is_log

    if to.exists() and not force:
        raise TorchidError(f"'{to}' is there already.", hint="--force replaces it; or edit it")
    asking = ask and not output.silent and sys.stdin.isatty() and sys.stdout.isatty()
    name, arm = _robot(robot, tip, asking)
    given = [*(logs or []), *(held_out or [])]
    found = given if logs else [p for p in sorted(Path().iterdir()) if is_log(p)]
    read, columns, warnings = _read(
        list(dict.fromkeys([*found, *given])), reading.request(arm.joint_names), arm.n, given
    )
    measured = [path for path, log in read.items() if not (log.tau is None and log.current is None)]
    for path in [path for path in read if measured and path not in (*measured, *given)]:
        warnings.append(f"left out, as it has neither torque nor currents: {path}")
        del read[path]
    if columns is not None and reading.columns is None:
        warnings.append(f"columns are guessed, their signs and units too: {columns}")
    apart = held_out or [path for path in read if _APART.search(path.stem)]
    fitted = [path for path in read if path not in apart]
    if not fitted:
        fitted, apart = apart, []
    gain = _gain(reading.gain, list(read.values()), arm, asking, warnings)
    unlimited = [k for k in ("velocity", "acceleration") if getattr(arm.limits, k) is None]
    text = _TEXT.format(
        robot=_quoted(_from(name, to) if os.path.isfile(name) else name),
        tip=f"tip = {_quoted(arm.tip)}" if arm.tip else "# tip = ...",
        columns=f"columns = {_quoted(columns)}" if columns else "# columns = ...",
        gain=f"gain = {gain}" if gain else "# gain = [..]    # N m/A, for logs of currents",
        logs=f"logs = {_files(fitted, to)}" if fitted else "# logs = [..]",
        apart=f"held-out = {_files(apart, to)}"
        if apart
        else "# held-out = [..]    # whole runs that take part in no choice",
        out=_quoted(out),
        limits="\n".join(f"# {limit} = ..    # the robot says none" for limit in unlimited)
        or "# acceleration = ..",
    )
    with atomic_write(to) as file:
        file.write(text)
    output.written.append(to)
    read_project(to)
    output.say(
        f"robot: {escape(name)}, {arm.n} joints",
        f"logs: {', '.join(map(str, fitted)) or 'none'}",
        f"held out: {', '.join(map(str, apart)) or 'none'}",
    )
    output.warn(warnings)
    output.say("next: torchid log show, torchid log doctor, torchid identify, torchid gap")


init_command = command(init, project=False)


def _quoted(text: str) -> str:
    """A string of TOML, whose escapes are those of JSON."""
    return json.dumps(text, ensure_ascii=False)


def _from(path: str | Path, to: Path) -> str:
    """A path as the project file has it."""
    return Path(os.path.relpath(path, to.parent)).as_posix()


def _files(paths: Sequence[Path], to: Path) -> str:
    return f"[{', '.join(_quoted(_from(path, to)) for path in paths)}]"


def _chosen(question: str, choices: Sequence[str]) -> str:
    """One of several, which the user types."""
    typer.echo(f"{question}: {', '.join(choices)}")
    while (answer := typer.prompt("which").strip()) not in choices:
        typer.echo(f"not one of them: {answer}")
    return answer


def _robot(asked: str | None, tip: str | None, asking: bool) -> "tuple[str, Robot]":
    """The robot that is asked for, or the one in the folder.

    Raises:
        TorchidError: there is none, or there are several and nobody to choose.
    """
    from torchid.robot.library import built_in_robots, load_robot

    def loaded(name: str) -> "Robot | RobotError":
        try:
            return load_robot(name, tip=tip if name.endswith((".urdf", ".xml")) else None)
        except RobotError as error:
            return error

    names = [asked] if asked else [
        path.name
        for path in sorted(Path().iterdir())
        if path.suffix.lower() in (".urdf", ".xml", ".yaml", ".yml")
    ]  # fmt: skip
    robots = {name: loaded(name) for name in names}
    # One that branches into several chains is a robot, too.
    branching = {n for n, r in robots.items() if "as tip" in str(getattr(r, "expected", ""))}
    fit = [n for n, r in robots.items() if n in branching or not isinstance(r, RobotError)]
    if asked is None and len(fit) != 1:
        if not (fit and asking):
            raise TorchidError(
                "which robot? There are several here." if fit else "there is no robot here.",
                expected="--robot ROBOT",
                available=fit or built_in_robots(),
            )
        fit = [_chosen("robots", fit)]
    name = fit[0] if fit else names[0]
    found = robots[name]
    if isinstance(found, RobotError) and found.available and name in branching and asking:
        tip = _chosen("it branches; last links of its chains", [str(t) for t in found.available])
        found = loaded(name)
    if isinstance(found, RobotError):
        raise found
    return name, found


def _read(
    paths: Sequence[Path], request: "Request", n: int, given: Sequence[Path]
) -> "tuple[dict[Path, Log], str | None, list[str]]":
    """Logs of n joints, the mapping that they need, guessed from the first that needs one, and why
    others are left out.

    Raises:
        TorchidError: a log that was given cannot be read, or is of another robot.
    """
    from torchid.log.mapping import read_mapping
    from torchid.log.readers import open_log, proposed_columns

    request = replace(request, spare=True)
    text = None if request.columns is None else request.columns.text
    found: dict[Path, Log] = {}
    warnings = []
    for path in paths:
        try:
            if text is None and (guessed := proposed_columns(path, request)) is not None:
                text = guessed[0]
                request = replace(request, columns=read_mapping(text))
            _, log = open_log(path, request)
            if log.n != n:
                raise TorchidError(
                    f"'{path}' is of another robot.", got=f"{log.n} joints", expected=n
                )
            found[path] = log
        except TorchidError as error:
            if path in given:
                raise
            warnings.append(f"left out: {error.problem}")
    return found, text, warnings


def _gain(
    given: str | None, logs: "Sequence[Log]", arm: "Robot", asking: bool, warnings: list[str]
) -> str | None:
    """Drive gains as a list of TOML, where the logs need some; else None."""
    need = any(log.tau is None and log.current is not None for log in logs)
    if given is None and need and arm.drive_gain is None:
        said = "the logs hold currents and no torque"
        if asking:
            question = f"{said}: drive gains [N m/A] of {arm.n} joints, or Enter"
            given = typer.prompt(question, default="", show_default=False) or None
        if given is None:
            warnings.append(f"{said}: give the drive gains [N m/A] as `gain` in the file")
    if any(log.tau is None and log.current is None for log in logs):
        warnings.append("the logs have neither torque nor currents")
    return None if given is None else str(opt.numbers("--gain", given, arm.n))
