"""The project file `torchid.toml`: what is the same in every command about one robot.

    robot = "arm.urdf"              # built-in name or file
    tip = "wrist_3"                 # URDF, MJCF: last link of a chain, alone
    root = "torso"                  # URDF, MJCF: the base of what is read
    lock = {wheel = 0.0}            # URDF, MJCF: joints that are held, and where [rad or m]
    columns = "t=ms ms,q=pos_{j} deg,i=amp_{j}"     # of logs that have no columns of our names
    gain = [11.4, 11.4, 8.2]        # N m/A, for logs without torque
    logs = ["run1.csv", "run2.csv"]
    held-out = ["run3.csv"]
    effects = ["viscous_friction", "coulomb_friction"]
    out = "results"                 # results/COMMAND for each

    [payload]                       # on the last link, in its frame, while the logs were recorded
    mass = 1.2
    com = [0, 0, 0.05]

    [limits]                        # in place of the robot's
    acceleration = 5

    [gap]                           # any options of one command
    cutoff = 6

The command line goes before it. It is sought in the working directory and above; paths in it are
relative to it. What belongs to the robot (tip, root, lock, limits, payload) holds for the robot
that it names.
"""

import json
import math
import os
import re
import tomllib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchid.errors import TorchidError
from torchid.robot.config_files import built_in_robots, filled_template

if TYPE_CHECKING:
    from torchid.robot.model import Robot

NAME = "torchid.toml"
TEXTS = ("robot", "tip", "root", "columns", "topic", "gain", "effects", "background", "out")
LISTS = ("logs", "held-out")
LIMITS = ("position", "velocity", "acceleration", "torque")
_LONGEST = 80
"""Letters of a list on one line."""


@dataclass(frozen=True)
class Taken:
    """What an option takes.

    Attributes:
        name: in Python.
        files: whether it takes paths.
        several: whether it may be given several times.
    """

    name: str
    files: bool
    several: bool


Commands = Mapping[str, Mapping[str, Taken]]
"""Options by the names of commands (`log show`) and their own, without dashes."""


@dataclass(frozen=True)
class Project:
    """What a project file says; as it is without one, nothing.

    Attributes:
        file: the project file.
        robot: built-in name or file.
        tip, root, columns, topic, gain, effects, background: as the options of these names.
        out: folder of results.
        logs, held_out: files.
        lock: joints that are held, as --lock has them.
        payload: mass [kg], com (3,) [m], inertia (6,) about it [kg m^2], as `Robot.with_payload`.
        limits: by name, as `Robot.with_limits`.
        options: of one command, by its name and theirs.
    """

    file: Path | None = None
    robot: str | None = None
    tip: str | None = None
    root: str | None = None
    lock: tuple[str, ...] = ()
    columns: str | None = None
    topic: str | None = None
    gain: str | None = None
    effects: str | None = None
    background: str | None = None
    out: str | None = None
    logs: tuple[str, ...] = ()
    held_out: tuple[str, ...] = ()
    payload: Mapping[str, Any] | None = None
    limits: Mapping[str, Any] = field(default_factory=dict)
    options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def on(self, robot: "Robot") -> "Robot":
        """The robot with the limits, and with the payload where it has parameters."""
        robot = robot.with_limits(**self.limits)
        return robot.with_payload(**self.payload) if self.payload and robot.parameters else robot


def find_project(asked: str | None, commands: Commands) -> Project | None:
    """The project file that is asked for, or the nearest one; None where there is none, or `none`
    is asked for.

    Args:
        asked: a file, or `none`.
        commands: whose options may stand in it.

    Raises:
        TorchidError: the file that is asked for does not exist, or one that is not right.
    """
    if asked == "none":
        return None
    if asked is not None:
        return read_project(Path(asked), commands)
    here = Path.cwd()
    found = next((f for folder in (here, *here.parents) if (f := folder / NAME).is_file()), None)
    return None if found is None else read_project(Path(_shown(found)), commands)


def project_text(entries: Mapping[str, Any]) -> str:
    """A project file; keys without a value are comments.

    Args:
        entries: texts, lists of texts or numbers, and tables of numbers, by their keys: robot, tip,
            root, lock, columns, topic, gain, logs, held_out and out. Paths are relative to it.
    """
    lines = {}
    for name, value in entries.items():
        key = name.replace("_", "-")
        # Texts and lists of TOML are those of JSON.
        text = json.dumps(value, ensure_ascii=False)
        if isinstance(value, dict):
            held = (f"{json.dumps(k, ensure_ascii=False)} = {x!r}" for k, x in value.items())
            text = f"{{{', '.join(held)}}}"
        elif isinstance(value, list) and len(text) > _LONGEST:
            text = json.dumps(value, ensure_ascii=False, indent=4)
        lines[name] = f"{key} = {text}" if value else f"# {key} = .."
    return filled_template("project.toml", **lines)


def _shown(path: Path) -> str:
    """A path from the working directory, where there is a way."""
    with suppress(ValueError):
        return os.path.relpath(path)
    return str(path)


def read_project(file: Path, commands: Commands) -> Project:
    """A project file.

    Args:
        file: its path.
        commands: whose options may stand in it.

    Raises:
        TorchidError: it cannot be read; or a key that there is not, or a value that it cannot have,
            with its place.
    """
    try:
        text = file.read_text(encoding="utf-8")
        data = tomllib.loads(text)
    except (OSError, ValueError, RecursionError) as error:
        raise TorchidError(f"the project file '{file}' cannot be read.", got=error) from error
    page = _Page(file, text)
    own = (*TEXTS, *LISTS, "lock", "payload", "limits")
    # `torchid robot` and `torchid payload` have no table: these names mean what they name.
    groups = [g for g in dict.fromkeys(name.partition(" ")[0] for name in commands) if g not in own]
    page.require(data, (*own, *groups))
    found: dict[str, Any] = {name: page.text(data, name) for name in TEXTS if name in data}
    for name in ("robot", "out", "columns"):
        is_file = name != "columns" or "=" not in found.get(name, "=")
        if name in ("robot", "out") and not isinstance(data.get(name, ""), str):
            raise page.wrong(name, "", f"{name} names a file.", got=data[name])
        if name in found and is_file and not (name == "robot" and found[name] in built_in_robots()):
            found[name] = page.beside(found[name])
    for name in LISTS:
        if name in data:
            found[name.replace("-", "_")] = page.paths(data, name)
    if "lock" in data:
        held = data["lock"]
        if not isinstance(held, dict) or any(isinstance(v, list) for v in held.values()):
            raise page.wrong("lock", "", "lock is a table of joints and positions.", got=held)
        found["lock"] = tuple(f"{k}={v}" for k, v in page.numbers(held, "lock").items())
    for name, keys in (("payload", ("mass", "com", "inertia")), ("limits", LIMITS)):
        if name in data:
            page.require(data[name], keys, name)
            found[name] = page.numbers(data[name], name)
    if "mass" not in found.get("payload", {"mass": 0}):
        raise page.wrong("payload", "", "[payload] has no mass.", got=found["payload"])
    options: dict[str, dict[str, Any]] = {}
    for group in (group for group in groups if group in data):
        inside = [name.partition(" ")[2] for name in commands if name.startswith(f"{group} ")]
        if inside:
            page.require(data[group], inside, group)
            for name, table in data[group].items():
                whole = f"{group} {name}"
                options[whole] = page.options(table, commands[whole], f"{group}.{name}")
        else:
            options[group] = page.options(data[group], commands[group], group)
    return Project(file, **found, options=options)


def _endless(value: Any) -> bool:
    """Whether a value is a number that is none, or beyond all numbers."""
    return isinstance(value, float) and not math.isfinite(value)


@dataclass(frozen=True)
class _Page:
    """A project file as text, for values and the places of what is wrong with them."""

    file: Path
    content: str

    def wrong(self, key: str, header: str, problem: str, **parts: Any) -> TorchidError:
        """An error with the line of a key."""
        table, place = "", ""
        for number, line in enumerate(self.content.splitlines(), 1):
            if match := re.match(r"\s*\[+\s*([^\]]*?)\s*\]", line):
                table = match[1].replace('"', "")
                found = table == ".".join(filter(None, (header, key)))
            else:
                begins = re.match(rf"""\s*["']?{re.escape(key)}\b""", line)
                found = table == header and begins is not None
            if found:
                place = f", line {number}"
                break
        return TorchidError(f"{self.file}{place}: {problem}", **parts)

    def require(self, table: Any, keys: Iterable[str], header: str = "") -> None:
        """That a table has no other keys."""
        where = f"[{header}]" if header else "a project file"
        if not isinstance(table, dict):
            raise self.wrong(header, "", f"{where} is a table.", got=table)
        for key in table:
            if key not in keys:
                raise self.wrong(key, header, f"{where} has no key '{key}'.", available=list(keys))

    def text(self, table: Mapping[str, Any], key: str, header: str = "") -> str:
        """A value as an option writes it: lists and tables separated by commas."""
        value = table[key]
        if isinstance(value, dict) and key == "columns":
            value = [f"{k}={v}" for k, v in value.items()]
        parts = value if isinstance(value, list) else [value]
        if not parts or any(isinstance(v, bool | dict | list) or _endless(v) for v in parts):
            raise self.wrong(key, header, f"{key} cannot be this.", got=value, expected="text")
        return ",".join(str(part) for part in parts)

    def numbers(self, table: Mapping[str, Any], header: str) -> Mapping[str, Any]:
        """A table of numbers, and lists of them; as it is."""
        for key, value in table.items():
            rest = [value]
            while rest:
                one = rest.pop()
                if isinstance(one, list):
                    rest += one
                elif isinstance(one, bool) or not isinstance(one, int | float) or _endless(one):
                    raise self.wrong(key, header, f"{key} is a number, or a list.", got=value)
        return table

    def paths(self, table: Mapping[str, Any], key: str, header: str = "") -> tuple[str, ...]:
        """Files, from the working directory."""
        value = table[key]
        names = value if isinstance(value, list) else [value]
        if not all(isinstance(name, str) for name in names):
            raise self.wrong(key, header, f"{key} names files.", got=value)
        return tuple(self.beside(name) for name in names)

    def beside(self, path: str) -> str:
        """A path that is relative to the project file, from the working directory."""
        folder = self.file.parent
        return path if folder == Path() else _shown(folder / path)

    def options(self, table: Any, options: Mapping[str, Any], header: str) -> dict[str, Any]:
        """Values of a command's options by their names in Python."""
        self.require(table, options, header)
        found: dict[str, Any] = {}
        for key, value in table.items():
            option = options[key]
            if option.files:
                named = self.paths(table, key, header)
                found[option.name] = list(named) if option.several else named[0]
            elif isinstance(value, bool) or (option.several and isinstance(value, list)):
                found[option.name] = value
            else:
                text = self.text(table, key, header)
                found[option.name] = [text] if option.several else text
        return found
