"""Where a result comes from: versions, command, files, settings, time."""

import hashlib
import platform
import shlex
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import torch

import torchid
from torchid.errors import TorchidError

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
