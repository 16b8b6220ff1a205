"""Where a command's results go: JSON, a folder, a page, and then the terminal."""

import logging
import os
import re
import secrets
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.text import Text

from torchid.app import allow_interrupts
from torchid.app.inputs import PLACE, WRITTEN, Suffix
from torchid.app.progress import ProgressBars, ProgressLines
from torchid.app.signature import OPTIONS, Fields, Switch
from torchid.errors import TorchidError, visible
from torchid.files import (
    Staged,
    discard,
    file_hash,
    make_folder,
    put_in_place,
    remove_empty,
    require_folder,
    staged,
)
from torchid.json_data import read_json, write_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from torchid.report.page.document import InputFile, Origin, Page
    from torchid.report.table import Report
    from torchid.results.answer import Answer, Diagnosis


@dataclass(frozen=True)
class Output:
    """Where a command's results go: files first, all or none of them, and only then what is
    printed, so that nothing is lost where it cannot be.

    Attributes:
        json_file: Write the result as JSON; - for standard output, alone.
        out: Folder for the result as JSON, and for the files that belong to it.
        pictures: Draw pictures of the result into --out, too: .png.
        report: Write one self-contained page: verdict, pictures, tables, how it was obtained
            (needs torchid's extra `report`).
        verbose: Print every table, too: what the answer rests on.
        overwrite: Write over the results that --out or a file of a model holds already.
        quiet: Print errors only.
        threads: Threads of torch and BLAS (default 1: fastest on shared machines).
        started: of `time.monotonic`.
        begun: by the clock of files.
        written: files, in the order in which they were written.
        answers: those of them that are the command's JSON.
        done: those of them that have their names.
        staged: those of them that have not, and files of an earlier run that go when these come.
        entered: what lasts as long as the command: all that it writes is staged.
        unsaid: why standard output took no more.
    """

    json_file: Annotated[Path | None, typer.Option("--json", metavar="FILE"), WRITTEN] = None
    out: Annotated[Path | None, typer.Option(metavar="DIR"), PLACE] = None
    pictures: Switch = False
    report: Annotated[
        Path | None,
        typer.Option(metavar="FILE.html"),
        WRITTEN,
        Suffix((".html", ".htm"), "a browser prints it as PDF"),
    ] = None
    verbose: Annotated[bool, typer.Option("--verbose", "-v")] = False
    overwrite: Switch = False
    quiet: Annotated[bool, typer.Option("--quiet", "-q")] = False
    threads: Annotated[int | None, typer.Option(min=1, max=1024)] = None
    started: float = field(default_factory=time.monotonic, init=False)
    begun: float = field(default_factory=time.time, init=False)
    written: list[Path] = field(default_factory=list, init=False)
    answers: set[Path] = field(default_factory=set, init=False)
    done: set[Path] = field(default_factory=set, init=False)
    staged: Staged = field(default_factory=dict, init=False)
    entered: ExitStack = field(default_factory=ExitStack, init=False)
    unsaid: list[OSError] = field(default_factory=list, init=False)

    def __enter__(self) -> "Output":
        """Check that results can be written before any work is done.

        Raises:
            TorchidError: a folder that cannot be made or written, or pictures without one.
        """
        if self.pictures and self.out is None:
            raise TorchidError("--pictures draws into a folder, and needs --out DIR.")
        if self.out is not None:
            require_folder(self.out)
        level = logging.ERROR if self.silent else logging.WARNING
        logging.basicConfig(level=level, format="%(message)s")
        self.entered.enter_context(staged(self.staged))
        return self

    def begin(self) -> None:
        """From now on there may be results: torch is loaded, the folder is made, and Ctrl-C ends in
        good order what was begun. `progress` and `put` do it, too.

        Raises:
            MissingExtraError: a page is asked for, and what makes it is not installed.
        """
        _ = self._made

    @cached_property
    def _made(self) -> list[Path]:
        """Folders that were made."""
        import torch

        if self.report is not None:
            from torchid.report.page.document import require_page

            require_page(self.report)
        allow_interrupts()
        torch.set_num_threads(self.threads or 1)
        return [] if self.out is None else make_folder(self.out)

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Give files their names, and say which there are; of a command that failed, remove files
        and folders that are empty.

        Raises:
            TorchidError: what was said could not be printed, or as `finish`.
        """
        self.entered.close()
        if error is not None:
            discard(self.staged)
            remove_empty(self.__dict__.get("_made", ()))
            return
        self.finish()
        others = [str(f) for f in self.written if f.parent != self.out]
        inside = _few([f.name for f in self.written if f.parent == self.out])
        files = "; ".join([*others, *([f"{inside} in {self.out}"] if inside else [])])
        self.say(*([f"written: {files}"] if files else []))
        if self.unsaid:
            raise TorchidError(
                f"what is printed could not be: {self.unsaid[0].strerror or self.unsaid[0]}.",
                hint=f"written: {files}" if files else "--json FILE, or --out DIR",
            )

    def finish(self) -> None:
        """Give all files that were written so far their names, at once.

        Raises:
            TorchidError: another run has put results there since this one began, whose are kept
                beside them; or a file cannot be renamed.
        """
        # The command's own JSON is the last.
        files = {p: self.staged[p] for p in sorted(self.staged, key=self.answers.__contains__)}
        self.staged.clear()
        named = {Path(os.path.realpath(p)) for p in (self.json_file, self.report) if p is not None}
        self._hash(files)
        taken = [
            target
            for target, temporary in files.items()
            if temporary is not None and not self.overwrite and target not in named
            and target.exists() and target.stat().st_ctime > self.begun
            and target not in self.done
        ]  # fmt: skip
        if taken:
            place = Path(f"{taken[0].parent}-{secrets.token_hex(3)}")
            place.mkdir()
            put_in_place({place / target.name: temporary for target, temporary in files.items()})
            raise TorchidError(
                "another run has put its results there meanwhile, and they are kept.",
                got=", ".join(map(str, taken)),
                hint=f"those of this run are in {place}",
            )
        put_in_place(files)
        self.done.update(files)

    def _hash(self, files: Staged) -> None:
        """Into the command's JSON SHA-256 of each file beside it, by its name."""
        new = {target: temporary for target, temporary in files.items() if temporary is not None}
        hashes = {p.name: file_hash(new[p]) for p in new if p not in self.answers}
        with staged(None):
            for target in self.answers & new.keys() if hashes else ():
                data = read_json(new[target], "the command's own")
                write_json({**data, "hashes": hashes}, new[target])

    @property
    def silent(self) -> bool:
        """Whether nothing is printed for people."""
        return self.quiet or str(self.json_file) == "-"

    @cached_property
    def console(self) -> Console:
        """For people, on standard output: as wide as the terminal, wide enough for the tables where
        there is none."""
        console = _Console(highlight=False)
        return console if console.is_terminal else _Console(highlight=False, width=120)

    @contextmanager
    def kept_so_far(
        self, watcher: "ProgressLines | ProgressBars | None"
    ) -> "Iterator[Callable[[Answer], None] | None]":
        """What takes answers so far, and shows them; where Ctrl-C stops the work, the last one is
        written to so_far.json in DIR, or beside --json FILE, and printed: an answer that is whole
        stays."""
        if watcher is None:
            yield None
            return
        stood: list[Answer] = []

        def watch(answer: "Answer") -> None:
            stood[:] = [answer]
            watcher.so_far(answer)

        try:
            yield watch
        except KeyboardInterrupt as stop:
            if not stood:
                raise
            from torchid.results.record import as_plain

            answer = {"schema": SO_FAR, "answer": as_plain(stood[0])}
            place = self.out
            if place is None and self.json_file is not None and str(self.json_file) != "-":
                place = self.json_file.parent
            self.put(place and place / "so_far.json", partial(write_json, answer))
            self.say(stood[0].headline)
            files = [str(file) for file in self.written]
            raise KeyboardInterrupt(
                *([f"the answer so far is in {', '.join(files)}"] if files else [])
            ) from stop

    def write_json(self, data: Mapping[str, Any], name: str | None) -> None:
        """To --json and to DIR/name, whichever were given; without a name to --json alone."""
        own = None if self.out is None or name is None else self.out / name
        self.answers.update(
            Path(os.path.realpath(p)) for p in (self.json_file, own) if p is not None
        )
        if str(self.json_file) == "-":
            with suppress(BrokenPipeError):  # whoever reads standard output has left
                write_json(data, Path("/dev/stdout"))
        else:
            self.put(self.json_file, partial(write_json, data))
        self.put(own, partial(write_json, data))

    def put(self, path: Path | None, write: Callable[[Path], object]) -> None:
        """Write a file, if it is asked for."""
        if path is not None:
            self.begin()
            write(path)
            self.written.append(path)

    def give(self, result: Any, name: str, show: "Callable[[Any], Report]", **about: Any) -> None:
        """Write a result, and then print it; see `keep`."""
        self.tell(self.keep(result, name, show, **about))

    def keep(
        self,
        result: Any,
        name: str,
        show: "Callable[[Any], Report]",
        *,
        seed: int | None = None,
        old: Sequence[str] = (),
        files: "Sequence[InputFile]" = (),
        settings: Mapping[str, object] | None = None,
    ) -> "Report":
        """Write a result: its JSON, its pictures into DIR, its page, whichever are asked for.

        Args:
            result: that can be `plain`, or is plain already.
            name: of the JSON in DIR.
            show: what there is to see of the result; asked when its JSON is safe.
            seed: stands in the JSON and on the page.
            old: patterns of pictures that an earlier run may have left under other names.
            files, settings: what the result was made of, for the page.

        Returns:
            What is left to print.
        """
        data = dict(result if isinstance(result, Mapping) else result.plain())
        data |= {} if seed is None else {"seed": seed}
        try:
            shown = show(result)
            if shown.screen is not None:
                # What `torchid explain` prints again, without any computation.
                data["explanation"] = shown.plain()
        finally:
            self.write_json(data, name)  # is safe, whatever fails in what is shown of it
        if self.out is not None:
            # Of an earlier run, whose result this one takes the place of.
            names = [*old, *(f"{picture}.png" for picture in shown.figures)]
            if (self.out / name).exists():
                self.staged.update((file, None) for one in names for file in self.out.glob(one))
            if self.pictures:
                self._draw(shown.figures, self.out)
        if shown.page is not None:
            about = {"seeds": {"seed": seed}, "settings": settings or {}}
            self.write_page(shown.page, self.report, files=files, **about)
        return shown

    def _draw(self, figures: "Mapping[str, Callable[[], Figure | None]]", folder: Path) -> None:
        """Write pictures, by the names of their files."""
        from torchid.report.panels import save

        for picture, draw in figures.items():
            if (figure := draw()) is not None:
                self.put(folder / f"{picture}.png", partial(save, figure))

    def write_page(
        self,
        build: "Callable[[Origin], Page]",
        file: Path | None,
        *,
        files: "Sequence[InputFile]",
        seeds: Mapping[str, object],
        settings: Mapping[str, object],
    ) -> None:
        """Write the page that `build` makes of the result's origin, if one is asked for."""
        if file is None:
            return
        from torchid.report.page.document import origin, write_page

        made = origin(
            arguments=sys.argv, started=self.started, seeds=seeds, settings=settings, files=files
        )
        self.put(file, partial(write_page, build(made)))

    def hashed(self, named: Sequence[tuple[str, str, Path]]) -> "tuple[InputFile, ...]":
        """Sizes and hashes of inputs (role, name to show, path), before they are used; nothing if
        no page is asked for.

        Raises:
            TorchidError: an input cannot be read.
        """
        if self.report is None:
            return ()
        from torchid.report.page.document import input_files

        return input_files(named)

    def tell(self, shown: "Report") -> None:
        """Print all that there is to say of a result; of one that has a screen no more, unless all
        is asked for."""
        if shown.screen is not None:
            self.say(replace(shown.screen, in_words=in_options))
            if not self.verbose:
                return
        elif shown.verdict:
            self.verdict(shown.verdict)
        self.say(*shown.parts)
        self.warn(shown.warnings)
        if shown.last and shown.screen is None:
            self.say(f"\n{shown.last}")

    def say(self, *objects: Any) -> None:
        """Print for people, one after another, unless quiet: texts as they are, without markup."""
        self.finish()
        for one in () if self.silent or self.unsaid else objects:
            try:
                self.console.print(as_text(one) if isinstance(one, str) else one)
            except OSError as error:  # a full disk; the work goes on
                self.unsaid.append(error)
                return

    def verdict(self, text: str) -> None:
        """Print the answer, which stands out."""
        self.say(as_text(f"{text}\n", "bold"))

    def warn(self, warnings: Iterable[str]) -> None:
        """Print warnings, one a line."""
        for warning in warnings:
            self.say(as_text("! ", "yellow") + as_text(warning))

    @contextmanager
    def progress(self, first: str = "") -> "Iterator[ProgressLines | ProgressBars | None]":
        """What takes (stage, done, total) and an answer so far, and shows both on standard error:
        one bar, and two lines above it; where that is no terminal, one line a stage, when it is
        over, with the seconds that it took. Both say for how much longer, where that can be told.
        None, and nothing is said, with --quiet.

        Args:
            first: what is running until it is called.
        """
        self.begin()
        console = Console(stderr=True)
        if self.silent:
            yield None
            return
        watcher = ProgressBars(first, console) if console.is_terminal else ProgressLines(first)
        with watcher:
            yield watcher


SO_FAR = "torchid.so_far/1"
"""Schema of an answer that stood when a command was stopped; no other command reads it."""


def settings_of(result: "Diagnosis", servo: str | None) -> dict[str, object]:
    """What a diagnosis was made with, for its page."""
    data = result.plain()
    if "settings" not in data:
        return {"servo": servo or "not given"}
    used = {k: v for k, v in data["settings"].items() if k not in ("seed", "only")}
    used |= {"band of the report [Hz]": data["band_hz"], "cut-off [Hz]": data["cutoff_hz"]}
    return used | {"effects": used["effects"] or "all"}


def _few(names: Sequence[str]) -> str:
    """Names of files; many pictures are counted."""
    pictures = [name for name in names if name.endswith(".png")]
    if len(pictures) <= 2:
        return ", ".join(names)
    others = [name for name in names if name not in pictures]
    return " and ".join([*([", ".join(others)] if others else []), f"{len(pictures)} pictures"])


Printed = Annotated[Output, Fields("json_file", "quiet")]
Kept = Annotated[Output, Fields("json_file", "out", "overwrite", "quiet")]
Computed = Annotated[Output, Fields("json_file", "out", "overwrite", "quiet", "threads")]
Drawn = Annotated[Output, Fields("json_file out pictures overwrite quiet threads")]
Reported = Annotated[Output, Fields("json_file out pictures report overwrite quiet threads")]
Diagnosed = Annotated[
    Output, Fields("json_file out pictures report verbose overwrite quiet threads")
]

_ARGUMENT = re.compile(r"""`(\w+)=(\.\.\.|True|\d[\d.]*|"[^`]*"|'[^`]*')`""")


def as_text(text: str, style: str = "") -> Text:
    """A text of the library for the terminal."""
    return Text(visible(in_options(text)), style)


def in_options(text: str) -> str:
    """A message of the library in the words of the command line.

    The library writes an argument as Python has it, between backquotes: `rows="all"`, `force=True`,
    and `columns=...` for any value. Here these are --rows all, --force and --columns. What is no
    option of any command stays.
    """

    def option(match: re.Match[str]) -> str:
        name, value = option_names().get(match[1]), match[2]
        if name is None:
            return match[0]
        if value in ("...", "True"):
            return name
        bare = re.fullmatch(r"""["']?([^\s;&|*?<>(){}[\]$"']+)["']?""", value)
        return f"{name} {bare[1] if bare else value}"

    return _ARGUMENT.sub(option, text)


def option_names() -> dict[str, str]:
    """Options of all commands, by the names of their arguments in Python."""
    every = (option for options in OPTIONS.values() for option in options)
    return {option.name: option.shown for option in every if option.has_name}


class _Console(Console):
    """Falls silent when its reader has left (`| head`), where rich ends the program: files that
    were asked for are still written."""

    def on_broken_pipe(self) -> None:
        with suppress(SystemExit):
            super().on_broken_pipe()
