"""All commands, and what happens when one fails."""

import re
import sys
from collections.abc import Callable, Sequence
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from torchid import __version__
from torchid.app.calibrate import calibrate_command
from torchid.app.check import check_command
from torchid.app.compare import compare_command
from torchid.app.demo import demo_command
from torchid.app.excite import excite_command
from torchid.app.export import correct_command, export_command
from torchid.app.extract import atlas_command, extract_command
from torchid.app.faults import flush, print_plainly, report
from torchid.app.fleet import FLEET
from torchid.app.gap import gap_command
from torchid.app.help import show_beginning, show_command, show_group
from torchid.app.identify import identify_command, payload_command
from torchid.app.log import LOG
from torchid.app.output import in_options
from torchid.app.pair import pair_command
from torchid.app.show import effects_command, explain_command, robot_command
from torchid.app.signature import OPTIONS, Debug
from torchid.app.simulate import simulate_command
from torchid.errors import TorchidError
from torchid.other_packages import COMMANDS, loaded

GONE = {
    "gap --simulated": "torchid pair --simulated SIM --real REAL [ROBOT]",
    "gap --real": "torchid pair --simulated SIM --real REAL [ROBOT]",
    "gap --to": "torchid correct ROBOT LOG... --to FORMAT",
    "gap --for": "torchid correct ROBOT LOG... --to FORMAT",
    "gap --calibrate": "torchid calibrate ROBOT LOG... --causes N",
    "study --no-figures": "nothing is drawn into --out; --report has a picture",
    "effects --out": "--json FILE",
}
"""Options that the release before had last, and what replaces them."""


class Group(TyperGroup):
    """The program, or a group of commands."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print it."""
        # Of what a command does the first paragraph, up to its first mark.
        about = {name: _in_short(one.help or "") for name, one in self.commands.items()}
        show_group(ctx.command_path, self.help or "", about)


class Command(TyperCommand):
    """A command whose help has panels."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print it."""
        show_command(ctx.command_path, self.help or "", OPTIONS[_path(ctx)])

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Raise where an option is gone."""
        for option in (arg.partition("=")[0] for arg in args):
            gone = f"{_path(ctx)} {option}"
            if gone in GONE and not ctx.resilient_parsing:  # a shell that completes shows no error
                raise TorchidError(f"`{gone}` is gone.", hint=GONE[gone])
        return super().parse_args(ctx, args)


def _path(ctx: Any) -> str:
    """The name of a command with its group's: `log show`."""
    names: list[str] = []
    while ctx.parent is not None:
        names.insert(0, ctx.info_name)
        ctx = ctx.parent
    return " ".join(names)


def _in_short(text: str) -> str:
    """The beginning of a command's description."""
    return re.split(r"[:;.]\s|\n\n", " ".join(text.split("\n")) + " ")[0].rstrip(". ") + "."


def _group(name: str, about: str, commands: Sequence[Callable[..., None]]) -> typer.Typer:
    """A group of commands."""
    made = typer.Typer(name=name, no_args_is_help=True, help=about, cls=Group)
    for one in commands:
        _add(made, one, f"{name} ")
    return made


def _add(to: typer.Typer, one: Any, above: str = "") -> None:
    """A command by the name of its function: `next_motion_command` is `next-motion`.

    Args:
        to: the program or a group.
        one: a function with the options that `command` gave it.
        above: the name of the group and a blank.
    """
    name = one.__name__.removesuffix("_command").replace("_", "-")
    OPTIONS[above + name] = one.options
    to.command(name, cls=Command)(one)


app = typer.Typer(
    name="torchid",
    cls=Group,
    invoke_without_command=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)
log_app = _group("log", "What a log is, before anything is computed from it.", LOG)
fleet_app = _group(
    "fleet", "Many units of one robot type: the type, its spread, the odd ones.", FLEET
)
withheld_app = _group(
    "withheld",
    "Check the diagnosis on data whose cause was withheld from it.",
    [loaded(COMMANDS[f"withheld {name}"]) for name in ("make", "run", "score")],
)
for _one in (
    robot_command, excite_command, simulate_command, log_app, identify_command,
    extract_command, check_command, atlas_command, loaded(COMMANDS["wrenches"]), payload_command,
    gap_command, pair_command, correct_command, calibrate_command, explain_command,
    effects_command, export_command, compare_command, loaded(COMMANDS["study"]), fleet_app,
    withheld_app, demo_command,
):  # fmt: skip
    if isinstance(_one, typer.Typer):
        app.add_typer(_one, name=_one.info.name)
    else:
        _add(app, _one)


def _version(asked: bool) -> bool:
    if asked:
        typer.echo(f"torchid {__version__}")
        raise typer.Exit
    return asked


@app.callback()
def _root(
    ctx: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
    debug: Debug = False,
) -> None:
    """What a robot arm's dynamics really are, and why the simulator disagrees with the arm."""
    if ctx.invoked_subcommand is None:
        show_beginning()


def run() -> None:
    """Run the command line: exit code 0; 1 and one message for a TorchidError, 2 for wrong usage,
    70 and one line for a fault of torchid, 130 for Ctrl-C."""
    print_plainly()
    try:
        app()
    except SystemExit:
        flush()
        raise
    except Exception as error:
        code = report(error, in_options)
        flush()
        sys.exit(code)
