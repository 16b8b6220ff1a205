"""The project file `torchid.toml`: what is the same in every command about one robot.

    robot = "arm.urdf"              # built-in name or file
    tip = "wrist_3"                 # URDF, MJCF: last link of the chain
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
relative to it. What belongs to the robot (tip, limits, payload) holds for the robot that it names.
"""

import os
import re
import sys
import tomllib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from typer.core import TyperCommand, TyperOption

from torchid.errors import TorchidError
from torchid.robot.config_files import config_folder

if TYPE_CHECKING:
    from torchid.robot.model import Robot

NAME = "torchid.toml"
TEXTS = ("robot", "tip", "columns", "topic", "gain", "effects", "background", "out")
LISTS = ("logs", "held-out")
LIMITS = ("position", "velocity", "acceleration", "torque")
_FITTED = ("identify", "payload", "excite")
"""Commands whose `--effects` are what the arm has; elsewhere it is what is searched over."""


@dataclass(frozen=True)
class Project:
    """What a project file says; as it is without one, nothing.

    Attributes:
        file: the project file.
        robot: built-in name or file.
        tip, columns, topic, gain, effects, background: as the options of these names.
        out: folder of results.
        logs, held_out: files.
        payload: mass [kg], com (3,) [m], inertia (6,) about it [kg m^2], as `Robot.with_payload`.
        limits: by name, as `Robot.with_limits`.
        options: of one command, by its name and theirs.
    """

    file: Path | None = None
    robot: str | None = None
    tip: str | None = None
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


_CURRENT: ContextVar[Project | None] = ContextVar("project", default=None)


def current() -> Project:
    """The project of the command that is running; without one, an empty one."""
    return _CURRENT.get() or Project()


class ProjectCommand(TyperCommand):
    """A command whose options may stand in a project file."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put what the project file says in the place of what is not given."""
        _CURRENT.set(None)
        named = {param.name: param for param in self.params}
        if "project_file" in named and not ctx.resilient_parsing:
            given = self.make_parser(ctx).parse_args(args=list(args))[0]
            project = None if given.get("help") else find(given.get("project_file"))
            if project is not None:
                if not (given.get("quiet") or "-q" in args):
                    with suppress(OSError):
                        sys.stderr.write(f"project: {project.file}\n")
                args = self._completed(project, ctx, given, args)
        return super().parse_args(ctx, args)

    def _completed(
        self, project: Project, ctx: Any, given: Mapping[str, Any], args: list[str]
    ) -> list[str]:
        """The arguments with the project's robot, where they name none; options as defaults."""
        named = {param.name: param for param in self.params}
        first = next((p for p in self.params if not isinstance(p, TyperOption)), None)
        whole = False
        if first is not None and first.name in ("robot", "params") and project.robot:
            value = given.get(first.name)
            # A result that a motion is designed for (excite --for) names its robot itself.
            own = value is not None if first.name == "params" else _is_robot(value)
            own = own or (not first.required and given.get("result") is not None)
            whole = not own
            if not own:  # what came first is a log, or another argument
                args = [project.robot, *args]
                given = self.make_parser(ctx).parse_args(args=list(args))[0]
        elif self.name == "show" and project.robot:
            whole = given.get("robot") is None
        defaults: dict[str, Any] = dict(project.options.get(_path(ctx), {}))
        if whole:
            defaults |= {"robot": project.robot, "tip": project.tip}
        if self.name in _FITTED:
            defaults.setdefault("effects", project.effects)
        defaults.setdefault("background", project.background)
        if project.out is not None:
            defaults.setdefault("out", os.path.join(project.out, str(self.name)))
        if "logs" in named:
            defaults.setdefault("logs", list(project.logs) or None)
        if not given.get("held_out_fraction"):
            taken = {os.path.realpath(log) for log in given.get("logs") or ()}
            apart = [log for log in project.held_out if os.path.realpath(log) not in taken]
            defaults.setdefault("held_out", apart or None)
        # A file that `log show` writes is not the folder of results.
        if "out" in named and named["out"].metavar != "DIR":
            defaults.pop("out", None)
        ctx.default_map = {k: v for k, v in defaults.items() if k in named and v is not None}
        _CURRENT.set(project if whole else replace(project, limits={}, payload=None))
        return args


def _is_robot(name: str | None) -> bool:
    """Whether an argument names a robot, as `torchid.robot.library.is_robot` without torch."""
    if name is None:
        return False
    suffix = Path(name).suffix.lower()
    return suffix in (".yaml", ".yml", ".urdf", ".xml") or _built_in(name)


def _built_in(name: str) -> bool:
    return os.path.isfile(config_folder("robots") / f"{name}.yaml")


def _path(ctx: Any) -> str:
    """The name of a command with its group's: `log show`."""
    names: list[str] = []
    while ctx.parent is not None:
        names.insert(0, ctx.info_name)
        ctx = ctx.parent
    return " ".join(names)


def find(asked: str | None) -> Project | None:
    """The project file that is asked for, or the nearest one; None where there is none, or `none`
    is asked for.

    Raises:
        TorchidError: the file that is asked for does not exist, or one that is not right.
    """
    if asked == "none":
        return None
    if asked is not None:
        return read_project(Path(asked))
    here = Path.cwd()
    found = next((f for folder in (here, *here.parents) if (f := folder / NAME).is_file()), None)
    return None if found is None else read_project(Path(_shown(found)))


def _shown(path: Path) -> str:
    """A path from the working directory, where there is a way."""
    with suppress(ValueError):
        return os.path.relpath(path)
    return str(path)


def read_project(file: Path) -> Project:
    """A project file.

    Raises:
        TorchidError: it cannot be read; or a key that there is not, or a value that it cannot have,
            with its place.
    """
    try:
        text = file.read_text(encoding="utf-8")
        data = tomllib.loads(text)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise TorchidError(f"the project file '{file}' cannot be read.", got=error) from error
    page = _Page(file, text)
    commands = _commands()
    own = (*TEXTS, *LISTS, "payload", "limits")
    # `torchid robot` and `torchid payload` have no table: these names mean what they name.
    groups = [g for g in dict.fromkeys(name.partition(" ")[0] for name in commands) if g not in own]
    page.require(data, (*own, *groups))
    found: dict[str, Any] = {name: page.text(data, name) for name in TEXTS if name in data}
    for name in ("robot", "out", "columns"):
        is_file = name != "columns" or "=" not in found.get(name, "=")
        if name in found and is_file and not (name == "robot" and _built_in(found[name])):
            found[name] = page.beside(found[name])
    for name in LISTS:
        if name in data:
            found[name.replace("-", "_")] = page.paths(data, name)
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


@cache
def _commands() -> dict[str, dict[str, Any]]:
    """The options of each command that takes a project file, by their names without dashes."""
    from torchid.app.commands import app

    found: dict[str, dict[str, Any]] = {}
    todo: list[tuple[str, Any]] = [("", app)]
    while todo:
        above, group = todo.pop()
        todo += [(f"{above}{sub.name} ", sub.typer_instance) for sub in group.registered_groups]
        for one in group.registered_commands:
            options = getattr(one.callback, "options", ())
            if any(option.name == "project_file" for option in options):
                name = one.name or one.callback.__name__.removesuffix("_command")
                found[above + name] = {
                    option.shown.lstrip("-"): option
                    for option in options
                    if option.name not in ("project_file", "debug")
                }
    return found


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
        if not parts or any(isinstance(v, bool | dict | list) for v in parts):
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
                elif isinstance(one, bool) or not isinstance(one, int | float):
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
            files, several = option.takes
            if files:
                named = self.paths(table, key, header)
                found[option.name] = list(named) if several else named[0]
            elif isinstance(value, bool) or (several and isinstance(value, list)):
                found[option.name] = value
            else:
                text = self.text(table, key, header)
                found[option.name] = [text] if several else text
        return found
