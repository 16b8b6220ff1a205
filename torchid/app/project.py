"""Commands whose options may stand in a project file (`torchid.project.file`)."""

import os
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from contextvars import ContextVar
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption

from torchid.app.help import show_command, show_group
from torchid.app.signature import Option
from torchid.project.file import Project, Taken, find_project, read_project
from torchid.robot.config_files import names_robot

_FITTED = ("identify", "payload", "excite")
"""Commands whose `--effects` are what the arm has; elsewhere it is what is searched over."""
OPTIONS: dict[str, list[Option]] = {}
"""The options of every command that was added, by its name with its group's: `log show`."""
_CURRENT: ContextVar[Project | None] = ContextVar("project", default=None)


def current() -> Project:
    """The project of the command that is running; without one, an empty one."""
    return _CURRENT.get() or Project()


def read(file: Path) -> Project:
    """A project file, with the options of all commands."""
    return read_project(file, _commands())


def group(name: str, about: str, commands: Sequence[Callable[..., None]]) -> typer.Typer:
    """A group of commands."""
    made = typer.Typer(name=name, no_args_is_help=True, help=about, cls=Group)
    for one in commands:
        add(made, one, f"{name} ")
    return made


class Group(TyperGroup):
    """The program, or a group of commands."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print it."""
        # Of what a command does the first paragraph, up to its first mark.
        about = {name: _in_short(one.help or "") for name, one in self.commands.items()}
        show_group(ctx.command_path, self.help or "", about)


def _in_short(text: str) -> str:
    """The beginning of a command's description."""
    return re.split(r"[:;.]\s|\n\n", " ".join(text.split("\n")) + " ")[0].rstrip(". ") + "."


def add(to: typer.Typer, one: Any, above: str = "") -> None:
    """A command by the name of its function: `next_motion_command` is `next-motion`.

    Args:
        to: the program or a group.
        one: a function with the options that `command` gave it.
        above: the name of the group and a blank.
    """
    name = one.__name__.removesuffix("_command").replace("_", "-")
    OPTIONS[above + name] = one.options
    to.command(name, cls=ProjectCommand)(one)


class ProjectCommand(TyperCommand):
    """A command whose options may stand in a project file, and whose help has panels."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print it."""
        show_command(ctx.command_path, self.help or "", OPTIONS[_path(ctx)])

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put what the project file says in the place of what is not given."""
        _CURRENT.set(None)
        named = {param.name: param for param in self.params}
        if "project_file" in named and not ctx.resilient_parsing:
            given = self.make_parser(ctx).parse_args(args=list(args))[0]
            asked = "none" if given.get("help") else given.get("project_file")
            project = find_project(asked, _commands())
            if project is not None:
                if not given.get("quiet"):
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
            own = value is not None if first.name == "params" else names_robot(value)
            own = own or (not first.required and given.get("result") is not None)
            whole = not own
            if not own:  # what came first is a log, or another argument
                args = [project.robot, *args]
                given = self.make_parser(ctx).parse_args(args=list(args))[0]
        elif self.name == "show" and project.robot:
            whole = given.get("robot") is None
        defaults: dict[str, Any] = dict(project.options.get(_path(ctx), {}))
        if whole:
            defaults |= {"robot": project.robot, "tip": project.tip, "root": project.root}
            defaults["lock"] = list(project.lock) or None
        if self.name in _FITTED:
            defaults.setdefault("effects", project.effects)
        defaults.setdefault("background", project.background)
        if project.out is not None:
            defaults.setdefault("out", os.path.join(project.out, str(self.name)))
        if "logs" in named:
            # A log with the payload is none without it.
            with_it = {os.path.realpath(log) for log in given.get("loaded") or ()}
            without = [log for log in project.logs if os.path.realpath(log) not in with_it]
            defaults.setdefault("logs", without or None)
        if not given.get("held_out_fraction"):
            taken = {os.path.realpath(log) for log in given.get("logs") or ()}
            apart = [log for log in project.held_out if os.path.realpath(log) not in taken]
            defaults.setdefault("held_out", apart or None)
        ctx.default_map = {k: v for k, v in defaults.items() if k in named and v is not None}
        _CURRENT.set(project if whole else replace(project, limits={}, payload=None))
        return args


def _path(ctx: Any) -> str:
    """The name of a command with its group's: `log show`."""
    names: list[str] = []
    while ctx.parent is not None:
        names.insert(0, ctx.info_name)
        ctx = ctx.parent
    return " ".join(names)


@cache
def _commands() -> dict[str, dict[str, Taken]]:
    """The options of each command that takes a project file, by their names without dashes."""
    return {
        command: {
            name.lstrip("-"): Taken(option.name, *option.takes)
            for option in options
            for name in (option.shown, *option.aliases)
            if option.name not in ("project_file", "debug")
        }
        for command, options in OPTIONS.items()
        if any(option.name == "project_file" for option in options)
    }
