"""What a page consists of: the verdict, pictures, tables, and how all of it was obtained; and the
page as HTML: one file, nothing to load, and no script but one that sorts the tables of a page with
many rows."""

import hashlib
import platform
import shlex
import time
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

import torchid
from torchid.errors import MissingExtraError, TorchidError
from torchid.files import atomic_write
from torchid.report.page.svg import inline_svg
from torchid.report.panels import Picture
from torchid.report.table import Table, printable

if TYPE_CHECKING:
    from jinja2 import Environment


MOST_BYTES = 3_000_000
"""Of a page, and more than any of them needs."""
_WORDS_AND_TABLES = 400_000
"""Bytes of it that figures leave free."""
_PACKAGES = ("numpy", "scipy", "scikit-learn", "pytorch-kinematics", "clarabel", "matplotlib")


@dataclass(frozen=True)
class InputFile:
    """A file as it was when it was read.

    Attributes:
        role: `robot`, `log`, `held-out log`, ...
        name: as the user gave it.
        size: [bytes].
        sha256: hexadecimal.
    """

    role: str
    name: str
    size: int
    sha256: str


@dataclass(frozen=True)
class Origin:
    """What is needed to obtain a result again.

    Attributes:
        command: the command line, or empty for a result of the library.
        finished: date and time, in UTC.
        seconds: taken, reading and figures included.
        versions: (package, version).
        seeds, settings: (name, value).
        files: inputs.
    """

    command: str
    finished: str
    seconds: float
    versions: tuple[tuple[str, str], ...]
    seeds: tuple[tuple[str, str], ...]
    settings: tuple[tuple[str, str], ...]
    files: tuple[InputFile, ...]


@dataclass(frozen=True)
class Page:
    """A whole page; what is empty is left out.

    Attributes:
        title: what was done to what: `Sim-to-real gap of panda`.
        verdict: one sentence.
        facts: (label, value) the few numbers beside it.
        origin: how to repeat it.
        pictures, findings, tables: the figures, what they say, and the numbers.
        notes: what to bear in mind, one sentence each.
        sortable: whether its tables can be sorted by a click.
        block: text to copy.
    """

    title: str
    verdict: str
    facts: Sequence[tuple[str, str]]
    origin: Origin
    pictures: Sequence[Picture]
    tables: Sequence[Table]
    notes: Sequence[str]
    findings: Sequence[str] = ()
    sortable: bool = False
    block: str = ""


def require_templates() -> None:
    """See before any work whether a page can be made.

    Raises:
        MissingExtraError: Jinja2 is not installed.
    """
    _environment()


def render(page: Page) -> str:
    """The page as HTML.

    Figures are inline SVG whose colours follow the reader's light or dark theme. Pictures beyond
    `MOST_BYTES` are left out, and the page says so.

    Raises:
        MissingExtraError: Jinja2 is not installed.
    """
    template = _environment().get_template("page.html.j2")
    room, drawn = MOST_BYTES - _WORDS_AND_TABLES, {}
    for picture in page.pictures:
        svg = inline_svg(picture)
        room -= len(svg.encode())
        if room < 0:
            break
        drawn[picture.name] = svg
    script = template.environment.get_template("sort.js").render() if page.sortable else ""
    # The page allows this script by its hash, and no other.
    digest = b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return template.render(page=page, drawn=drawn, script=script, script_hash=digest)


def write_page(page: Page, path: str | Path) -> Path:
    """Write the page atomically.

    Raises:
        TorchidError: the file cannot be written, or Jinja2 is not installed.
    """
    text = render(page)
    with atomic_write(path) as stream:
        stream.write(text)
    return Path(path)


def _environment() -> "Environment":
    try:
        from jinja2 import Environment, PackageLoader, StrictUndefined
    except ModuleNotFoundError as error:
        raise MissingExtraError("jinja2", "report", "A page") from error
    made = Environment(
        loader=PackageLoader("torchid.report.page", "templates"),
        autoescape=True,  # names of robots and files come from anywhere
        # What a macro or the figures' writer made is markup, and stays.
        finalize=lambda value: printable(value) if type(value) is str else value,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["thousands"] = lambda k: f"{k:,}".replace(",", "\u202f")
    return made


def origin(
    *,
    arguments: Sequence[str],
    started: float,
    seeds: Mapping[str, object],
    settings: Mapping[str, object],
    files: Sequence[InputFile],
) -> Origin:
    """The origin of a result obtained just now.

    Args:
        arguments: of the command line, the program's name first; empty in a library.
        started: of `time.monotonic`.
        seeds, settings: by name.
        files: by `input_files`, before the result was computed.
    """
    return Origin(
        command=shlex.join(["torchid", *arguments[1:]]) if arguments else "",
        finished=datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S UTC"),
        seconds=time.monotonic() - started,
        versions=versions(),
        seeds=tuple((name, setting_words(value)) for name, value in seeds.items()),
        settings=tuple((_label(name), setting_words(value)) for name, value in settings.items()),
        files=tuple(files),
    )


def input_files(named: Iterable[tuple[str, str, Path]]) -> tuple[InputFile, ...]:
    """Sizes and hashes; of a folder, those of every file in it.

    Args:
        named: (role, name to show, path).

    Raises:
        TorchidError: a file that cannot be read.
    """
    out = []
    for role, name, path in named:
        files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
        for file in files:
            shown = name if file == path else f"{name}/{file.relative_to(path).as_posix()}"
            try:
                with open(file, "rb") as stream:
                    digest = hashlib.file_digest(stream, "sha256").hexdigest()
                out.append(InputFile(role, shown, file.stat().st_size, digest))
            except OSError as error:
                raise TorchidError(
                    f"'{file}' cannot be read: {error.strerror or error}."
                ) from error
    return tuple(out)


def versions() -> tuple[tuple[str, str], ...]:
    """torchid, Python, torch, other packages that the numbers depend on, and the machine's kind."""
    found = [
        ("torchid", torchid.__version__),
        ("Python", platform.python_version()),
        ("torch", torch.__version__),
    ]
    for name in _PACKAGES:
        try:
            found.append((name, version(name)))
        except PackageNotFoundError:
            continue
    return (*found, ("system", f"{platform.system()} {platform.machine()}"))


def setting_words(value: object) -> str:
    """A setting as people write it."""
    if isinstance(value, Mapping):
        return ", ".join(f"{_label(k)} {setting_words(v)}" for k, v in value.items()) or "none"
    if isinstance(value, list | tuple):
        return ", ".join(setting_words(v) for v in value) or "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    return "none" if value is None else str(value)


def _label(name: Any) -> str:
    return str(name).replace("_", " ")
