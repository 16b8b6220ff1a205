"""All commands, and what happens when one fails."""

import sys
from typing import Annotated

import typer

from torchid import __version__
from torchid.app.check import check_command
from torchid.app.compare import compare_command
from torchid.app.correct import correct_command
from torchid.app.demo import demo_command
from torchid.app.excite import excite_command
from torchid.app.export import export_command
from torchid.app.extract import atlas_command, extract_command
from torchid.app.gap import gap_command
from torchid.app.identify import identify_command
from torchid.app.log import log_app
from torchid.app.output import in_options
from torchid.app.payload import payload_command
from torchid.app.show import effects_command, robot_command
from torchid.app.simulate import simulate_command
from torchid.app.study import study_command
from torchid.app.withheld import withheld_app
from torchid.app.wrenches import wrenches_command
from torchid.errors import TorchidError

app = typer.Typer(
    name="torchid",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)
for _one in (
    robot_command, excite_command, simulate_command, log_app, identify_command, extract_command,
    check_command, atlas_command, wrenches_command, payload_command, gap_command, effects_command,
    correct_command, export_command, compare_command, study_command, withheld_app, demo_command,
):  # fmt: skip
    if isinstance(_one, typer.Typer):
        app.add_typer(_one, name=_one.info.name)
    else:
        app.command(_one.__name__.removesuffix("_command"))(_one)


def _version(asked: bool) -> bool:
    if asked:
        typer.echo(f"torchid {__version__}")
        raise typer.Exit
    return asked


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """What a robot arm's dynamics really are, and why the simulator disagrees with the arm."""


def run() -> None:
    """Run the command line; a TorchidError is one message on stderr and exit code 1."""
    try:
        app()
    except TorchidError as error:
        sys.stderr.write(f"error: {in_options(str(error))}\n")
        sys.exit(1)
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        sys.exit(130)
