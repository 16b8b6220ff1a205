"""Where a command's results go: the terminal, JSON, a folder, a page."""

import logging
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

from torchid.app.signature import Fields
from torchid.errors import TorchidError
from torchid.json_data import write_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from torchid.report.page.document import InputFile, Origin, Page

Progress = Callable[[str, int, int], None]
"""Takes stage, done, total."""


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
        """Print for people, one after another, unless quiet."""
        for one in () if self.quiet else objects:
            self.console.print(in_options(one) if isinstance(one, str) else one)

    def verdict(self, text: str) -> None:
        """Print the answer, which stands out."""
        self.say(f"[bold]{escape(text)}[/]\n")

    def warn(self, warnings: Iterable[str]) -> None:
        """Print warnings, one a line."""
        for warning in warnings:
            self.say(f"[yellow]![/] {escape(warning)}")

    def draw(
        self, make: "Callable[[], Mapping[str, Figure]]", *files: str, old: Sequence[str] = ()
    ) -> list[str]:
        """Write figures into DIR, if it is given, and say what is there: other files, and they.

        Args:
            make: the figures by name.
            files: that were written before.
            old: patterns of pictures that an earlier run may have left under other names.

        Returns:
            Names of the pictures.
        """
        if self.folder is None:
            return []
        from torchid.report.panels import save

        for pattern in old:
            for file in self.folder.glob(pattern):
                file.unlink()
        drawn = [save(figure, self.folder / f"{name}.png").name for name, figure in make().items()]
        if files:
            self.say(f"written to {self.folder}: {', '.join((*files, *drawn))}")
        return drawn


@dataclass(frozen=True)
class Results:
    """Options that say where results go.

    Attributes:
        json_file: Write the result as JSON; - for standard output, alone.
        out: Folder for JSON, tables and figures.
        report: Write one self-contained page: verdict, pictures, tables, how it was obtained
            (needs torchid's extra `report`).
        quiet: Print errors only.
        threads: Threads of torch and BLAS (default 1: fastest on shared machines).
    """

    json_file: Annotated[Path | None, typer.Option("--json", metavar="FILE")] = None
    out: Annotated[Path | None, typer.Option(metavar="DIR")] = None
    report: Annotated[Path | None, typer.Option(metavar="FILE.html")] = None
    quiet: Annotated[bool, typer.Option("--quiet", "-q")] = False
    threads: Annotated[int | None, typer.Option(min=1)] = None

    def open(self) -> Output:
        """Check that results can be written before any work is done, and set torch's threads.

        Raises:
            TorchidError: a folder that does not exist or cannot be written; a page that is no
                .html.
            MissingExtraError: a page is asked for, and what makes it is not installed.
        """
        import torch

        started = time.monotonic()
        json_file, quiet = self.json_file, self.quiet
        if str(json_file) == "-":
            json_file, quiet = Path("/dev/stdout"), True
        if self.out is not None:
            try:
                self.out.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise TorchidError(
                    f"the output folder '{self.out}' cannot be made: {error.strerror or error}."
                ) from error
            _probe(self.out)
        _check_file("--json", json_file)
        if self.report is not None:
            if json_file is not None and self.report.resolve() == json_file.resolve():
                raise TorchidError("--report and --json name the same file.", got=self.report)
            _check_file("--report", self.report)
            if self.report.suffix.lower() not in (".html", ".htm"):
                raise TorchidError(
                    "--report writes an HTML page.",
                    got=self.report,
                    expected="FILE.html",
                    hint="a browser prints it as PDF",
                )
            from torchid.report.page.document import require_templates

            require_templates()
        torch.set_num_threads(self.threads or 1)
        logging.basicConfig(level=logging.ERROR if quiet else logging.WARNING, format="%(message)s")
        # As wide as the terminal; wide enough for the tables where there is none.
        console = _Console(highlight=False)
        if not console.is_terminal:
            console = _Console(highlight=False, width=120)
        return Output(json_file, self.out, quiet, console, self.report, started)


_ARGUMENT = re.compile(r"""`(\w+)=(\.\.\.|True|\d[\d.]*|"[^`]*"|'[^`]*')`""")


def in_options(text: str) -> str:
    """A message of the library in the words of the command line.

    The library writes an argument as Python has it, between backquotes: `rows="all"`, `force=True`,
    and `columns=...` for any value. Here these are --rows all, --force and --columns. What is no
    option of any command stays.
    """

    def option(found: re.Match[str]) -> str:
        name, value = option_names().get(found[1]), found[2]
        if name is None:
            return found[0]
        if value in ("...", "True"):
            return name
        bare = re.fullmatch(r"""["']?([^\s;&|*?<>$"']+)["']?""", value)
        return f"{name} {bare[1] if bare else value}"

    return _ARGUMENT.sub(option, text)


@cache
def option_names() -> dict[str, str]:
    """Options of all commands, by the names of their arguments in Python."""
    from torchid.app.commands import app

    found, todo = {}, [typer.main.get_command(app)]
    while todo:
        one = todo.pop()
        todo += getattr(one, "commands", {}).values()
        for option in one.params:
            if option.name is not None and option.opts[0].startswith("--"):
                found[option.name] = option.opts[0]
    return found


Printed = Annotated[Results, Fields("json_file", "quiet")]
Kept = Annotated[Results, Fields("json_file", "out", "quiet")]
Computed = Annotated[Results, Fields("json_file", "out", "quiet", "threads")]


def _check_file(option: str, path: Path | None) -> None:
    if path is None:
        return
    if path.is_dir():
        raise TorchidError(f"{option} needs a file, and '{path}' is a folder.")
    if not path.parent.is_dir():
        raise TorchidError(f"the folder of '{path}' does not exist.")
    _probe(path.parent)


class _Console(Console):
    """Falls silent when its reader has left (`| head`), where rich ends the program: files that
    were asked for are still written."""

    def on_broken_pipe(self) -> None:
        with suppress(SystemExit):
            super().on_broken_pipe()


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


@contextmanager
def progress_bar(output: Output, *, lines: bool = False) -> Iterator[Progress | None]:
    """A callback (stage, done, total) that draws one bar; None when there is no terminal or with
    `--quiet`.

    Args:
        output: of the command.
        lines: without a terminal write one line a stage to standard error, for a log file or a
            program that waits.
    """
    if output.quiet or not output.console.is_terminal:
        yield _line_a_stage(output.started) if lines and not output.quiet else None
        return
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bars

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Bars(*columns, TimeElapsedColumn(), console=output.console, transient=True) as bars:
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


def of(progress: Progress | None, name: str) -> Progress | None:
    """A callback whose stages are those of one of several things, with its name before them."""
    if progress is None:
        return None
    return lambda stage, done, total: progress(f"{name}: {stage}", done, total)


def stage(progress: Progress | None, name: str) -> Callable[[int, int], None] | None:
    """A callback (done, total) of one stage."""
    if progress is None:
        return None
    return lambda done, total: progress(name, done, total)


def hashed(output: Output, named: Sequence[tuple[str, str, Path]]) -> "tuple[InputFile, ...]":
    """Sizes and hashes of inputs (role, name to show, path), before they are used; nothing if no
    page is asked for.

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
