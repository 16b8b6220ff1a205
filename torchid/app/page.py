"""`--report`: the page of a result, and what it says about where the result comes from."""

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from torchid.app.output import Output
from torchid.errors import TorchidError

if TYPE_CHECKING:
    from torchid.report.page.document import InputFile, Origin, Page

Named = tuple[str, str, Path]
"""Role, name to show, path."""


def robot_input(robot: str) -> Named:
    """The robot as an input: its own file, or the built-in one's."""
    from torchid.robot.library import robot_file

    return "robot", robot, robot_file(robot)


def log_inputs(logs: Sequence[Path], held_out: Sequence[Path] | None) -> list[Named]:
    """Logs as inputs; of one that is a folder, the files in it."""
    out = []
    for role, paths in (("log", logs), ("held-out log", held_out or ())):
        for path in paths:
            inside = sorted(f for f in path.rglob("*") if f.is_file()) if path.is_dir() else []
            out += [(role, str(file), file) for file in inside or [path]]
    return out


def hashed(output: Output, named: Sequence[Named]) -> "tuple[InputFile, ...]":
    """Sizes and hashes of the inputs, before they are used; nothing if no page is asked for.

    Raises:
        TorchidError: an input cannot be read, or the page would take its place.
    """
    if output.page_file is None:
        return ()
    for role, name, path in named:
        if path.resolve() == output.page_file.resolve():
            raise TorchidError(f"--report would overwrite the {role} '{name}'.")
    from torchid.report.page.document import input_files

    return input_files(named)


def write_report(
    output: Output,
    build: "Callable[[Origin], Page]",
    *,
    files: "Sequence[InputFile]",
    seeds: Mapping[str, object],
    settings: Mapping[str, object],
) -> None:
    """Write the page that `build` makes of the result's origin, if one is asked for."""
    if output.page_file is None:
        return
    from torchid.report.page.document import origin, write_page

    made = origin(
        arguments=sys.argv, started=output.started, seeds=seeds, settings=settings, files=files
    )
    write_page(build(made), output.page_file)
    output.say(f"report written to {output.page_file}")
