"""What an MJCF makes MuJoCo do, looked at before it is parsed: copies, and the files that it names.

MuJoCo itself has no bound on copies, follows a model that attaches itself until the process dies,
and waits for ever on a pipe.
"""

from collections.abc import Iterator
from math import prod
from pathlib import Path
from typing import Any

from torchid.errors import RobotError
from torchid.robot.xml_numbers import parse_xml, require_regular

_MOST = 10_000
"""Copies of elements, and keyframes: MuJoCo's time grows with their square, to ten seconds here."""
_MOST_NUMBERS = 10**8
"""Of a height field or a texture."""
_BOUNDS = {"size": (("nkey",), _MOST), "hfield": (("nrow", "ncol"), _MOST_NUMBERS)}
_BOUNDS["texture"] = (("width", "height"), _MOST_NUMBERS)
_FOLDERS = ("meshdir", "texturedir", "assetdir")


def require_end(path: Path) -> None:
    """Refuse an MJCF that MuJoCo would not come to an end with, whatever it and the files that it
    includes say.

    Raises:
        RobotError: more copies or numbers than any robot has, a file that includes or attaches
            itself, one that is no regular file, or XML that cannot be read.
    """
    _elements(path, (), {})


def _elements(path: Path, above: tuple[Path, ...], known: dict[Path, int]) -> int:
    """How many elements MuJoCo makes of a file, and of what it includes and attaches.

    Args:
        path: the file.
        above: files that include or attach it, the first one first.
        known: elements of the files that were looked at; more are added.
    """
    own = path.resolve()
    if own in above:
        way = " > ".join(file.name for file in (*above[above.index(own) :], own))
        raise RobotError(f"'{above[0]}': a file includes or attaches itself.", got=way)
    if own in known:
        return known[own]
    root, above = parse_xml(path), (*above, own)
    inside: dict[Any, int] = {}
    models: dict[str | None, int] = {}
    for element, file in _named_files(root, {path.parent, above[0].parent}):
        if element.tag in ("include", "model"):
            inside[element] = _elements(file, above, known)
            models[element.get("name", file.stem)] = inside[element]
    copied = 0.0
    for element in root.iter():
        copies = prod(_size(e, "count") for e in (element, *element.iterancestors()))
        attached = models.get(element.get("model"), 1) if element.tag == "attach" else 1
        copied += copies * attached * inside.get(element, 1) - 1
        keys, most = _BOUNDS.get(element.tag, ((), _MOST))
        size = _size(element, *keys) if keys else copied
        if size > most:
            raise RobotError(
                f"'{path}': <{element.tag}> on line {element.sourceline} is too large.",
                got=f"{size:.3g} {' x '.join(keys) or 'copies'}",
                expected=f"{most:g} at most",
            )
    known[own] = len(root.xpath("//*")) + int(copied)
    return known[own]


def _named_files(root: Any, folders: set[Path]) -> Iterator[tuple[Any, Path]]:
    """Elements and the files that they name, of those that are there.

    Raises:
        RobotError: one is a pipe, a device or something else that is not read to its end.
    """
    below = {c.get(key, "") for c in root.iter("compiler") for key in _FOLDERS} | {""}
    for element in root.iter():
        for name in (value for key, value in element.attrib.items() if key.startswith("file")):
            files = [folder / inner / name for folder in folders for inner in below]
            for file in (file for file in files if file.exists() and not file.is_dir()):
                require_regular(file)
                yield element, file
                break


def _size(element: Any, *keys: str) -> float:
    """The product of the numbers in attributes; what is absent, or no number, is 1."""
    words = " ".join(element.get(key, "") for key in keys).split()
    return prod(float(word) for word in words if word.isdecimal())
