"""All commands, and what happens when one fails."""

import sys
from typing import Annotated

import typer

from torchid import __version__
from torchid.app.check import check_command
from torchid.app.compare import compare_command
from torchid.app.demo import demo_command
from torchid.app.excite import excite_command
from torchid.app.export import correct_command, export_command
from torchid.app.extract import atlas_command, extract_command
from torchid.app.faults import flush, print_plainly, report
from torchid.app.fleet import fleet_app
from torchid.app.gap import gap_command
from torchid.app.help import show_beginning
from torchid.app.identify import identify_command, payload_command
from torchid.app.init import init_command
from torchid.app.log import log_app
from torchid.app.output import in_options
from torchid.app.project import Group, add, group
from torchid.app.show import effects_command, explain_command, robot_command
from torchid.app.signature import Debug
from torchid.app.simulate import simulate_command
from torchid.other_packages import COMMANDS, loaded

app = typer.Typer(
    name="torchid",
    cls=Group,
    invoke_without_command=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)
withheld_app = group(
    "withheld",
    "Check the diagnosis on data whose cause was withheld from it.",
    [loaded(COMMANDS[f"withheld {name}"]) for name in ("make", "run", "score")],
)
for _one in (
    init_command, robot_command, excite_command, simulate_command, log_app, identify_command,
    extract_command, check_command, atlas_command, loaded(COMMANDS["wrenches"]), payload_command,
    gap_command, correct_command, explain_command, effects_command, export_command,
    compare_command, loaded(COMMANDS["study"]), fleet_app, withheld_app, demo_command,
):  # fmt: skip
    if isinstance(_one, typer.Typer):
        app.add_typer(_one, name=_one.info.name)
    else:
        add(app, _one)


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
