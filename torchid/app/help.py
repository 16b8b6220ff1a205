"""What `--help` shows: options in panels, all names and values whole at 80 columns; and what
`torchid` shows alone."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from rich.console import Console, RenderableType
from rich.markdown import Markdown
from rich.padding import Padding
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from torchid.app.signature import Option

GROUPS = {
    "Begin here": ("log", "identify", "gap", "pair", "correct", "explain", "demo"),
    "Model and experiment": ("robot", "effects", "excite", "simulate", "export"),
    "Physical parameters": ("payload", "check", "extract", "atlas", "wrenches", "study"),
    "Many robots, and checks": ("compare", "fleet", "calibrate", "withheld"),
}
"""All commands, in panels."""
_FIRST = {
    "log doctor": "what is wrong with a log, and what to change",
    "identify": "base parameters and friction, with intervals",
    "gap": "what makes the arm differ from its simulator",
    "correct": "the simulator's file, corrected and tried",
}
"""Commands to begin with."""
_ANYWAY = {
    "--version": "Print the version.",
    "--install-completion": "Install completion for the current shell.",
    "--show-completion": "Show it, to copy or change it.",
    "--debug": "Show the traceback of a fault of torchid itself.",
}
_Rows = Iterable[tuple[str, str]]


def show_beginning() -> None:
    """Print the commands to begin with, an example, and where the others are."""
    rows = [(f"torchid {name}", text) for name, text in _FIRST.items()]
    _print(
        Text("What a robot arm's dynamics really are, and why its simulator disagrees.\n"),
        _panel("Begin here", rows),
        Text("\nExample: torchid gap my_arm.urdf run1.csv run2.csv --out result"),
        Text("torchid demo shows it on a simulated arm; torchid --help lists all commands,"),
        Text("torchid gap --help the options of one."),
    )


def show_group(path: str, text: str, commands: Mapping[str, str]) -> None:
    """Print the help of the program or of a group.

    Args:
        path: how it is called.
        text: what it is for.
        commands: what each is for, by name.
    """
    parts = [_usage(path, ["COMMAND ..."]), Text(f"{text}\n")]
    if set(commands) != {name for names in GROUPS.values() for name in names}:
        parts.append(_panel("Commands", list(commands.items())))
    else:
        for title, names in GROUPS.items():
            parts.append(_panel(title, [(name, commands[name]) for name in names]))
        parts.append(_panel("Options", list(_ANYWAY.items())))
    _print(*parts)


def show_command(path: str, text: str, options: "Sequence[Option]") -> None:
    """Print the help of a command.

    Args:
        path: how it is called.
        text: its description and examples, in Markdown.
        options: all of them, in order.
    """
    arguments = [option for option in options if not option.has_name]
    panels: dict[str, list[tuple[str, str]]] = {"Arguments": []} if arguments else {}
    for option in options:
        title = option.place[1] if option.has_name else "Arguments"
        panels.setdefault(title, []).append((option.written, option.about))
    width = max(len(option.written) for option in options)
    _print(
        _usage(path, ["[OPTIONS]", *(option.written for option in arguments)]),
        Padding(Markdown(text), (0, 1, 1, 1)),
        *(_panel(title, rows, width) for title, rows in panels.items()),
    )


def _usage(path: str, words: Sequence[str]) -> RenderableType:
    return Padding(Text(" ".join(["Usage:", path, *words]), style="bold"), 1)


def _panel(title: str, rows: _Rows, width: int | None = None) -> Panel:
    table = Table.grid(padding=(0, 1), expand=True)
    table.add_column(no_wrap=True, style="bold cyan", width=width)
    table.add_column(ratio=1, overflow="fold")
    for left, right in rows:
        table.add_row(left, Text(right))
    return Panel(table, title=title, title_align="left", border_style="dim")


def _print(*parts: RenderableType) -> None:
    console = Console(highlight=False)
    for part in parts:
        console.print(part)
