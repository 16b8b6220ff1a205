"""What was computed, by the SHA-256 of all that it depends on: the same question is never answered
twice, and half an answer is never seen.

Answers are kept by joblib's Memory, pickled: whoever may write into a store can have the workers
that read it run any code.
"""

import hashlib
import json
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, cached_property, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

import fsspec
from joblib.memory import (
    CacheWarning,
    FileSystemStoreBackend,
    MemorizedFunc,
    Memory,
    register_store_backend,
)

from torchid.errors import LogError, TorchidError
from torchid.files import file_hash
from torchid.json_data import plain

Answer = TypeVar("Answer")


@dataclass(frozen=True)
class Store:
    """A folder, or a URL that fsspec knows, of answers."""

    place: str

    @cached_property
    def _kept(self) -> MemorizedFunc:
        backend = "fsspec" if is_url(self.place) else "local"
        try:
            memory = Memory(self.place, backend=backend, verbose=0)
            return memory.cache(_answer, ignore=["compute"])
        except (OSError, ValueError, ImportError) as error:  # no such protocol, or its package
            said = getattr(error, "strerror", None) or error
            raise TorchidError(f"the folder '{self.place}' cannot be made: {said}.") from error

    def __contains__(self, key: str) -> bool:
        return self._kept.check_call_in_cache(key, None)

    def answer(self, key: str, compute: Callable[[], Answer]) -> Answer:
        """The answer to a question; computed, and kept, where there is none or a damaged one.

        Raises:
            TorchidError: it cannot be written: a full disk, a folder that takes no file.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("error", CacheWarning)
            try:
                return self._kept(key, compute)
            except CacheWarning as warning:
                reason = str(warning).rpartition("Exception: ")[2]
                raise TorchidError(f"'{self.place}' cannot be written: {reason}") from warning

    def kept(self, key: str) -> Any:
        """The answer to a question that was asked before.

        Raises:
            TorchidError: it is not there.
        """

        def missing() -> None:
            raise TorchidError(
                f"the store '{self.place}' does not have {key[:12]}, which it had.",
                hint="do all workers see the same folder?",
            )

        return self.answer(key, missing)


def _answer(key: str, compute: Callable[[], Answer]) -> Answer:
    """The answer that the store keeps by a key."""
    return compute()


class _Remote(FileSystemStoreBackend):
    """Answers behind a URL."""

    def configure(
        self, location: str, verbose: int = 0, backend_options: Mapping[str, Any] | None = None
    ) -> None:
        """Begin at a URL, with joblib's options."""
        # Another worker's answers are there as well, whatever was listed before.
        files, self.location = fsspec.url_to_fs(location, use_listings_cache=False)
        self.verbose, self.mmap_mode = verbose, None
        self.compress = (backend_options or {})["compress"]
        self._open_item, self._item_exists = files.open, files.exists
        self._move_item = files.mv
        self.create_location = partial(files.makedirs, exist_ok=True)
        self.clear_location = partial(files.rm, recursive=True)


register_store_backend("fsspec", _Remote)


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
    with TemporaryDirectory() as folder:
        copy = Path(folder) / place.rstrip("/").rpartition("/")[2]
        try:
            files, path = fsspec.url_to_fs(place)
            files.get_file(path, str(copy))
        except (OSError, ImportError, ValueError) as error:
            raise LogError(f"'{place}' cannot be read.", got=str(error).split("\n")[0]) from error
        yield copy


def content_hash(path: Path) -> str:
    """SHA-256, in hexadecimal, of a file, or of the names and contents of all files in a folder.

    Raises:
        LogError: it cannot be read.
    """
    found: dict[str, str] = {}
    try:
        for file in path.rglob("*") if path.is_dir() else [path]:
            if not file.is_dir():
                found[file.relative_to(path).as_posix()] = file_hash(file)
    except OSError as error:
        raise LogError(f"'{path}' cannot be read: {error.strerror or error}.") from error
    return key_of(found) if path.is_dir() else found["."]


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
