"""A project file from what lies in a folder: which robot, which logs, what their columns are."""

import json
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from torchid.errors import RobotError, TorchidError
from torchid.log.mapping import read_mapping
from torchid.log.model import Log
from torchid.log.readers import is_log, open_log, proposed_columns
from torchid.log.table import Request
from torchid.robot.config_files import ROBOT_FILES, URDF_FILES, built_in_robots, filled_template
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.robot.tree import Choice

APART = re.compile(r"(?:^|[^a-z])(?:held|hold.?out|test|val|check|eval)", re.IGNORECASE)
"""Names of logs that are meant to be held out."""


@dataclass(frozen=True)
class Guess:
    """What a project file may say.

    Attributes:
        name: of the robot, or its file.
        robot: as it was read.
        logs, held_out: files.
        columns: mapping of the logs' columns, if they need one.
        needs_gains: whether logs hold currents, which nothing turns into torque.
        warnings: what was left out or guessed, one sentence each.
    """

    name: str
    robot: Robot
    logs: tuple[Path, ...]
    held_out: tuple[Path, ...]
    columns: str | None
    needs_gains: bool
    warnings: tuple[str, ...]

    def text(self, to: Path, out: str, gain: Sequence[float] | None = None) -> str:
        """The project file.

        Args:
            to: where it will lie; paths are relative to it.
            out: folder of results.
            gain: (n,) drive gains [N m/A], if they are known.
        """

        def path(given: str | Path) -> str:
            return _quoted(Path(os.path.relpath(given, to.parent)).as_posix())

        def paths(given: Sequence[Path]) -> str:
            line = ", ".join(map(path, given))
            return (
                f"[{line}]"
                if len(line) < 80
                else "[\n    " + ",\n    ".join(map(path, given)) + "\n]"
            )

        limits = self.robot.limits
        unknown = [k for k in ("velocity", "acceleration") if getattr(limits, k) is None]
        apart = "# held-out = [..]    # whole runs that take part in no choice"
        return filled_template(
            "project.toml",
            robot=path(self.name) if os.path.isfile(self.name) else _quoted(self.name),
            part="\n".join(self._part()) or "# tip = ..",
            columns=f"columns = {_quoted(self.columns)}" if self.columns else "# columns = ..",
            gain=f"gain = {list(gain)}" if gain else "# gain = [..]    # N m/A, of currents",
            logs=f"logs = {paths(self.logs)}" if self.logs else "# logs = [..]",
            apart=f"held-out = {paths(self.held_out)}" if self.held_out else apart,
            out=_quoted(out),
            limits="\n".join(f"# {k} = ..    # the robot says none" for k in unknown)
            or "# acceleration = ..",
        )

    def _part(self) -> Iterator[str]:
        """What chooses the part of a URDF or MJCF."""
        if self.robot.tip:
            yield f"tip = {_quoted(self.robot.tip)}"
        if self.robot.root:
            yield f"root = {_quoted(self.robot.root)}"
        if self.robot.locked:
            held = ", ".join(f"{_quoted(k)} = {v!r}" for k, v in self.robot.locked.items())
            yield f"lock = {{{held}}}"


def _quoted(text: str) -> str:
    """A string of TOML, whose escapes are those of JSON."""
    return json.dumps(text, ensure_ascii=False)


def guess(
    robot: str | None,
    choice: Choice,
    logs: Sequence[Path],
    held_out: Sequence[Path],
    request: Request,
) -> Guess:
    """What a project file in the working directory may say.

    Args:
        robot: built-in name or file; the one in the folder if None.
        choice: of its part.
        logs: those in the folder if there are none.
        held_out: those whose names say so if there are none.
        request: how the logs are read.

    Raises:
        TorchidError: no robot, or one of several; a log that was given cannot be read, or is of
            another robot.
    """
    name, arm = _robot(robot, choice)
    given = [*logs, *held_out]
    paths = given if logs else [p for p in sorted(Path().iterdir()) if is_log(p)] + given
    asked = replace(request, joints=arm.joint_names, spare=True)
    read, columns, warnings = _read(tuple(dict.fromkeys(paths)), asked, arm.n, given)
    measured = [path for path, log in read.items() if not (log.tau is None and log.current is None)]
    for path in [path for path in read if measured and path not in (*measured, *given)]:
        warnings.append(f"left out, as it has neither torque nor currents: {path}")
        del read[path]
    if read and not measured:
        warnings.append("the logs have neither torque nor currents")
    if columns is not None and request.columns is None:
        warnings.append(f"columns are guessed, their signs and units too: {columns}")
    apart = tuple(held_out) or tuple(path for path in read if APART.search(path.stem))
    fitted = tuple(path for path in read if path not in apart)
    currents = any(log.tau is None and log.current is not None for log in read.values())
    needs_gains = currents and arm.drive_gain is None
    fitted, apart = (fitted, apart) if fitted else (apart, ())
    return Guess(name, arm, fitted, apart, columns, needs_gains, tuple(warnings))


def _robot(asked: str | None, choice: Choice) -> tuple[str, Robot]:
    """The robot that is asked for, or the one in the folder.

    Raises:
        TorchidError: there is none, or there are several.
    """

    def loaded(name: str) -> Robot | RobotError:
        branches = name.endswith((*URDF_FILES, ".xml"))
        try:
            return load_robot(name, **(choice if branches else Choice()).options)
        except RobotError as error:
            return error

    files = [path.name for path in sorted(Path().iterdir()) if path.suffix.lower() in ROBOT_FILES]
    robots = {name: loaded(name) for name in ([asked] if asked else files)}
    fit = [name for name, robot in robots.items() if not isinstance(robot, RobotError)]
    if asked is None and len(fit) != 1:
        raise TorchidError(
            "which robot? There are several here." if fit else "there is no robot here.",
            expected="`robot=...`",
            available=fit or built_in_robots(),
        )
    name = asked or fit[0]
    found = robots[name]
    if isinstance(found, RobotError):
        raise found
    return name, found


def _read(
    paths: Sequence[Path], request: Request, n: int, given: Sequence[Path]
) -> tuple[dict[Path, Log], str | None, list[str]]:
    """Logs of n joints, the mapping that they need, guessed from the first that needs one, and why
    others are left out.

    Raises:
        TorchidError: a log that was given cannot be read, or is of another robot.
    """
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
