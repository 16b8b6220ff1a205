"""Where a command's results go: the terminal, JSON, a folder, a page."""

import logging
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape

from torchid.errors import TorchidError
from torchid.json_data import write_json


@dataclass(frozen=True)
class Output:
    """Where a command's results go.

    Attributes:
        json_file: from --json.
        folder: from --out.
        quiet: from --quiet.
        console: for people, on standard output.
        page_file: from --report.
        started: of `time.monotonic`.
    """

    json_file: Path | None
    folder: Path | None
    quiet: bool
    console: Console
    page_file: Path | None = None
    started: float = field(default_factory=time.monotonic)

    def write_json(self, data: dict[str, Any], name: str) -> None:
        """To --json and to DIR/name, whichever were given."""
        for target in (self.json_file, None if self.folder is None else self.folder / name):
            if target is not None:
                with suppress(BrokenPipeError):  # standard output, whose reader has left
                    write_json(data, target)

    def say(self, *objects: Any) -> None:
        """Print for people, unless quiet."""
        if not self.quiet:
            self.console.print(*objects)

    def warn(self, warnings: tuple[str, ...]) -> None:
        """Print warnings, one a line."""
        for warning in warnings:
            self.say(f"[yellow]![/] {escape(warning)}")


def open_output(
    json_file: Path | None,
    folder: Path | None,
    quiet: bool,
    threads: int | None = None,
    page_file: Path | None = None,
) -> Output:
    """Check that results can be written before any work is done, and set torch's threads.

    Raises:
        TorchidError: a folder that does not exist or cannot be written; a page that is no .html.
        MissingExtraError: a page is asked for, and what makes it is not installed.
    """
    started = time.monotonic()
    if str(json_file) == "-":
        json_file, quiet = Path("/dev/stdout"), True
    if folder is not None:
        _make_folder(folder)
    _check_file("--json", json_file)
    if page_file is not None:
        _check_page(page_file, json_file)
    _set_torch_threads(threads)
    logging.basicConfig(level=logging.ERROR if quiet else logging.WARNING, format="%(message)s")
    return Output(json_file, folder, quiet, _console(), page_file, started)


def _check_file(option: str, path: Path | None) -> None:
    if path is None:
        return
    if path.is_dir():
        raise TorchidError(f"{option} needs a file, and '{path}' is a folder.")
    if not path.parent.is_dir():
        raise TorchidError(f"the folder of '{path}' does not exist.")
    _probe(path.parent)


def _check_page(page_file: Path, json_file: Path | None) -> None:
    if json_file is not None and page_file.resolve() == json_file.resolve():
        raise TorchidError("--report and --json name the same file.", got=page_file)
    _check_file("--report", page_file)
    if page_file.suffix.lower() not in (".html", ".htm"):
        raise TorchidError(
            "--report writes an HTML page.",
            got=page_file,
            expected="FILE.html",
            hint="a browser prints it as PDF",
        )
    from torchid.report.page.render import require_templates

    require_templates()


class _Console(Console):
    """Falls silent when its reader has left (`| head`), where rich ends the program: files that
    were asked for are still written."""

    def on_broken_pipe(self) -> None:
        with suppress(SystemExit):
            super().on_broken_pipe()


def _console() -> Console:
    """As wide as the terminal; wide enough for the tables where there is none."""
    console = _Console(highlight=False)
    return console if console.is_terminal else _Console(highlight=False, width=120)


def _set_torch_threads(threads: int | None) -> None:
    import torch

    torch.set_num_threads(threads or 1)


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TorchidError(
            f"the output folder '{folder}' cannot be made: {error.strerror or error}."
        ) from error
    _probe(folder)


def _probe(folder: Path) -> None:
    """A file really written and removed: permission bits say nothing to root or of a full disk."""
    probe = folder / ".torchid-write-test"
    try:
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise TorchidError(
            f"the folder '{folder}' cannot be written: {error.strerror or error}."
        ) from error


Progress = Callable[[str, int, int], None]


@contextmanager
def progress_bar(output: Output, *, lines: bool = False) -> Iterator[Progress | None]:
    """A callback (stage, done, total) that draws one bar; None when there is no terminal or with
    `--quiet`.

    Args:
        output: of the command.
        lines: without a terminal write one line a stage to standard error, for a log file or a
            program that waits.
    """
    if output.quiet:
        yield None
    elif output.console.is_terminal:
        with _bar(output.console) as report:
            yield report
    else:
        yield _line_a_stage(output.started) if lines else None


@contextmanager
def _bar(console: Console) -> Iterator[Progress]:
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bars

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Bars(*columns, TimeElapsedColumn(), console=console, transient=True) as bars:
        task = bars.add_task("", total=None)

        def report(stage: str, done: int, total: int) -> None:
            bars.update(task, description=stage, completed=done, total=total)

        yield report


def _line_a_stage(started: float) -> Progress:
    """Seconds since the command started, and the stage, when it is met for the first time.

    In the first stage bad input is found, and then the error is all that is said: its line waits
    for the second stage's.
    """
    met: dict[str, str] = {}

    def report(stage: str, done: int, total: int) -> None:
        if stage in met:
            return
        met[stage] = f"[{time.monotonic() - started:5.0f} s] {stage}\n"
        if len(met) == 1:
            return
        lines = list(met.values())
        with suppress(OSError):  # whoever read it has left; the work goes on
            sys.stderr.write("".join(lines) if len(lines) == 2 else lines[-1])
            sys.stderr.flush()

    return report
