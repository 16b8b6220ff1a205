"""What was computed, by the SHA-256 of all that it depends on: the same question is never answered
twice, and half an answer is never seen.

One file an answer, `ab/abcdef....npz`: arrays, and what is no array as JSON. It is written under
another name and renamed; where the place is a URL (s3://, gs://), the object appears when all of it
is there.
"""

import hashlib
import io
import json
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from torchid.errors import LogError, TorchidError
from torchid.files import atomic_write
from torchid.json_data import plain

WORDS = "json"
"""Name of the array that holds what is no array."""


@dataclass(frozen=True)
class Entry:
    """One answer.

    Attributes:
        words: JSON-ready data.
        arrays: by name.
    """

    words: dict[str, Any]
    arrays: dict[str, np.ndarray]


@dataclass(frozen=True)
class Store:
    """A folder, or a URL that fsspec knows, of answers."""

    place: str

    def path(self, key: str) -> str:
        """Where the answer of a key is."""
        return f"{self.place.rstrip('/')}/{key[:2]}/{key}.npz"

    def read(self, key: str) -> Entry | None:
        """The answer; None where there is none, or where its file is damaged."""
        try:
            if is_url(self.place):
                import fsspec

                with fsspec.open(self.path(key), "rb") as file:
                    content = file.read()
            else:
                content = Path(self.path(key)).read_bytes()
        except FileNotFoundError:
            return None
        try:
            with np.load(io.BytesIO(content), allow_pickle=False) as found:
                arrays = {name: found[name] for name in found.files}
            return Entry(json.loads(arrays.pop(WORDS).tobytes()), arrays)
        except (zipfile.BadZipFile, zlib.error, KeyError, ValueError, EOFError):
            return None

    def write(self, key: str, words: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
        """Keep an answer.

        Raises:
            TorchidError: it cannot be written: a full disk, a folder that takes no file.
        """
        text = json.dumps(plain(words), allow_nan=False).encode()
        stream = io.BytesIO()
        np.savez(stream, **{WORDS: np.frombuffer(text, np.uint8)}, **arrays)  # type: ignore[arg-type]
        self.put(self.path(key), stream)

    def put(self, place: str, stream: io.BytesIO) -> None:
        """Write a file of the store, whole or not at all.

        Raises:
            TorchidError: it cannot be written: a full disk, a folder that takes no file.
        """
        if is_url(self.place):
            import fsspec

            with fsspec.open(place, "wb", auto_mkdir=True) as file:
                file.write(stream.getbuffer())
            return
        path = Path(place)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise TorchidError(
                f"the folder '{path.parent}' cannot be made: {error.strerror or error}."
            ) from error
        with atomic_write(path, "wb") as file:
            file.write(stream.getbuffer())


def key_of(parts: Mapping[str, Any]) -> str:
    """SHA-256, in hexadecimal, of JSON-ready data; the order of its names does not matter."""
    text = json.dumps(plain(parts), sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def is_url(place: str) -> bool:
    """Whether it is a URL rather than a file's name."""
    return "://" in place


@contextmanager
def local_file(place: str) -> Iterator[Path]:
    """A file that can be opened: itself, or a copy of what a URL names while it lasts.

    Raises:
        LogError: what the URL names cannot be read.
    """
    if not is_url(place):
        yield Path(place)
        return
    import fsspec

    with TemporaryDirectory() as folder:
        copy = Path(folder) / place.rstrip("/").rpartition("/")[2]
        try:
            with fsspec.open(place, "rb") as source, open(copy, "wb") as target:
                while piece := source.read(1 << 22):
                    target.write(piece)
        except (OSError, ImportError, ValueError) as error:
            raise LogError(f"'{place}' cannot be read.", got=str(error).split("\n")[0]) from error
        yield copy


def content_hash(path: Path) -> str:
    """SHA-256, in hexadecimal, of a file, or of all files in a folder with their names.

    Raises:
        LogError: it cannot be read.
    """
    digest = hashlib.sha256()
    try:
        for file in _files(path):
            if file != path:
                digest.update(file.relative_to(path).as_posix().encode() + b"\0")
            with open(file, "rb") as stream:
                while piece := stream.read(1 << 20):
                    digest.update(piece)
    except OSError as error:
        raise LogError(f"'{path}' cannot be read: {error.strerror or error}.") from error
    return digest.hexdigest()


def stamp(path: Path) -> tuple[tuple[int, int, int], ...]:
    """Size, time of the last change and inode of a file, or of all files in a folder: another one
    after somebody wrote to it."""
    try:
        states = [file.stat() for file in _files(path)]
    except OSError as error:
        raise LogError(f"'{path}' cannot be read: {error.strerror or error}.") from error
    return tuple((s.st_size, s.st_mtime_ns, s.st_ino) for s in states)


def _files(path: Path) -> list[Path]:
    return sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]


@cache
def code(without: Sequence[str]) -> str:
    """SHA-256, in hexadecimal, of torchid's sources, but for those of some rooms that the answer
    does not depend on."""
    root = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        name = path.relative_to(root)
        if name.parts[0] not in without:
            digest.update(name.as_posix().encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()
