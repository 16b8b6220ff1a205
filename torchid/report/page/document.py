"""A page as HTML: one file, and nothing to load. Without scripts it is whole; with its one script,
which is allowed by its hash alone, the tables of a page with many rows sort.

A figure is SVG inside the page: transparent, its colours those of the page's theme. The house
colours become CSS variables (templates/style.css gives them for light and dark), text takes the
page's font, coordinates are rounded to a tenth of a point, and what cannot be seen is left out.
"""

import hashlib
import io
import platform
import re
import shlex
import time
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from operator import contains
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from lxml import etree

import torchid
from torchid.errors import MissingExtraError, TorchidError
from torchid.files import file_hash, write_text
from torchid.report.colours import AFTER, BEFORE, BLUE, GREEN, GREY, GRID, INK, ORANGE, RED
from torchid.report.page.answer import cause_line, no_own_cause
from torchid.report.panels import Picture, plain_texts, printable
from torchid.report.table import Code, InputFile, Origin, Page, Table
from torchid.results.words import digits, span, value_words

if TYPE_CHECKING:
    from jinja2 import Environment


_PACKAGES = ("numpy", "scipy", "pytorch-kinematics", "clarabel", "matplotlib")


def require_page(file: Path) -> None:
    """See before any work whether a page can be made.

    Raises:
        TorchidError: the file is no .html.
        MissingExtraError: Jinja2 is not installed.
    """
    if file.suffix.lower() not in (".html", ".htm"):
        raise TorchidError(
            "`report=...` writes an HTML page.",
            got=file,
            expected="FILE.html",
            hint="a browser prints it as PDF",
        )
    environment()


def render(page: Page) -> str:
    """The page as HTML.

    Figures are inline SVG whose colours follow the reader's light or dark theme.

    Raises:
        MissingExtraError: Jinja2 is not installed.
    """
    templates = environment()
    drawn = {}
    for picture in page.pictures:
        svg = inline_svg(picture)
        if picture.narrow is not None:
            # The style sheet shows one of the two, by the width of the screen.
            own = replace(picture, name=f"{picture.name}_narrow", draw=picture.narrow)
            svg = f'<div class="wide">{svg}</div><div class="narrow">{inline_svg(own)}</div>'
        drawn[picture.name] = svg
    script = templates.get_template("sort.js").render() if page.sortable else ""
    digest = hashlib.sha256(script.encode()).digest()
    return templates.get_template("page.html.j2").render(
        page=page, drawn=drawn, script=script, hash=b64encode(digest).decode()
    )


def _marked(text: Any) -> Any:
    """Commands between backquotes as code; the text is escaped."""
    return type(text)(_COMMAND.sub(r"<code>\1</code>", str(text)))


def _kind(part: object) -> str:
    """What a part of a section is, for the template."""
    kinds = {Table: "table", Picture: "picture", Code: "code"}
    return kinds.get(type(part), "sentences")


def write_page(page: Page, path: str | Path) -> Path:
    """Write the page atomically.

    Raises:
        TorchidError: the file cannot be written, or Jinja2 is not installed.
    """
    write_text(path, render(page))
    return Path(path)


def environment() -> "Environment":
    """The environment of the pages' templates.

    Raises:
        MissingExtraError: Jinja2 is not installed.
    """
    try:
        from jinja2 import Environment, PackageLoader, StrictUndefined
        from markupsafe import escape
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
    made.filters |= {"kind": _kind, "cause_line": cause_line, "digits": digits, "span": span}
    made.filters["no_own_cause"] = no_own_cause
    made.tests["holds"] = contains
    made.filters["marked"] = lambda text: _marked(escape(printable(text)))
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
        seeds=tuple((name, value_words(value)) for name, value in seeds.items()),
        settings=tuple((k.replace("_", " "), value_words(v)) for k, v in settings.items()),
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
                out.append(InputFile(role, shown, file.stat().st_size, file_hash(file)))
            except OSError as error:
                raise TorchidError(
                    f"'{file}' cannot be read: {error.strerror or error}."
                ) from error
    return tuple(out)


def versions() -> tuple[tuple[str, str], ...]:
    """torchid, Python, torch, other packages that the numbers depend on, and the machine's kind."""
    installed = [
        ("torchid", torchid.__version__),
        ("Python", platform.python_version()),
        ("torch", torch.__version__),
    ]
    for name in _PACKAGES:
        try:
            installed.append((name, version(name)))
        except PackageNotFoundError:
            continue
    return (*installed, ("system", f"{platform.system()} {platform.machine()}"))


THEME = {
    INK: "ink", "#000000": "ink", GREY: "grey", GRID: "grid", "#ffffff": "paper", BLUE: "blue",
    ORANGE: "orange", GREEN: "green", RED: "red", BEFORE: "before", AFTER: "after",
}  # fmt: skip
"""Variable of the style sheet for every house colour, black and white."""

_SVG = "{http://www.w3.org/2000/svg}"
_HREF = "{http://www.w3.org/1999/xlink}href"
_COMMAND = re.compile(r"`([^`]+)`")
_COLOUR = re.compile(r"#[0-9a-f]{6}\b")
_NUMBER = re.compile(r"-?\d+\.\d+")
_FONT = re.compile(r"font: (?:(?:normal|italic|oblique) )?(\d+ )?([\d.]+px) [^;]*")
_FAMILY = re.compile(r"font-family: [^;]*;? ?")
_REFERENCE = re.compile(r"url\(#([^)]+)\)")


def inline_svg(picture: Picture) -> str:
    """The picture as an `svg` element for a page.

    Ids are prefixed with the picture's name, because a page holds several.
    """
    import matplotlib

    # 0.4: pixels by which a curve may differ from its data
    settings: Any = {
        "svg.fonttype": "none",
        "svg.hashsalt": picture.name,
        "path.simplify_threshold": 0.4,
    }
    with matplotlib.rc_context(settings):
        figure = picture.draw()
        plain_texts(figure)
        stream = io.BytesIO()
        # 144: of parts that are drawn as pixels: scatters of many points
        figure.savefig(stream, format="svg", transparent=True, dpi=144, metadata={"Date": None})
    width = 96 * figure.get_figwidth()
    figure.clear()
    root = etree.fromstring(stream.getvalue(), etree.XMLParser(huge_tree=True))
    # What is not seen goes: metadata, comments, outlines without a line, and the style sheet, which
    # would hold for the whole page.
    for element in list(root.iter(etree.Comment, f"{_SVG}metadata", f"{_SVG}style", f"{_SVG}path")):
        if element.tag != f"{_SVG}path" or element.get("style") == "fill: none":
            element.getparent().remove(element)
    for name in ("width", "height", "version"):
        root.attrib.pop(name, None)
    _prefix(root, picture.name)
    for element in root.iter():
        _themed(element)
    root.set("role", "img")
    root.set("aria-label", printable(picture.alt))
    root.set("style", f"--width:{width:.0f}px")
    etree.cleanup_namespaces(root)
    text: str = etree.tostring(root, encoding="unicode")
    return text


def _prefix(root: Any, name: str) -> None:
    """Ids that are referred to, unique on the page; the others go."""
    values = [value for e in root.iter() for value in e.attrib.values()]
    used = {reference for value in values for reference in _REFERENCE.findall(value)}
    used |= {e.get(_HREF)[1:] for e in root.iter() if e.get(_HREF, "").startswith("#")}
    short = {own: f"{name}-{k}" for k, own in enumerate(sorted(used))}
    for element in root.iter():
        own = element.attrib.pop("id", None)
        if own in used:
            element.set("id", short[own])
        target = element.attrib.pop(_HREF, None)
        if target is not None:
            element.set("href", f"#{short[target[1:]]}" if target[0] == "#" else target)
        for key, value in element.attrib.items():
            if "url(#" in value:
                element.set(key, _REFERENCE.sub(lambda m: f"url(#{short[m[1]]})", value))


def _themed(element: Any) -> None:
    """Colours, font and rounded coordinates."""
    for key in ("fill", "stroke"):
        if key in element.attrib:
            # A presentation attribute cannot hold a variable; a style can.
            own = f"{key}: {element.attrib.pop(key)}"
            element.set("style", "; ".join(filter(None, (element.get("style"), own))))
    if "style" in element.attrib:
        style = _FONT.sub(_font, _FAMILY.sub("", element.get("style")))
        style = _COLOUR.sub(lambda m: f"var(--{THEME[m[0]]})" if m[0] in THEME else m[0], style)
        element.set("style", style.replace(": ", ":").replace("; ", ";"))
    if element.get("transform", "").startswith("rotate(-0 "):
        del element.attrib["transform"]
    if "d" in element.attrib:
        element.set("d", " ".join(_rounded(element.get("d")).split()))
    if element.tag != f"{_SVG}image":
        for key in ("x", "y", "width", "height"):
            if key in element.attrib:
                element.set(key, _rounded(element.get(key)))


def _font(match: re.Match[str]) -> str:
    weight = f";font-weight:{match[1].strip()}" if match[1] else ""
    return f"font-size:{match[2]}{weight}"


def _rounded(text: str) -> str:
    return _NUMBER.sub(lambda m: f"{float(m[0]):.1f}".removesuffix(".0"), text)
