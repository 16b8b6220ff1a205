"""Writing files so that a reader never sees half of one, and so that no input is lost."""

import hashlib
import os
import secrets
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from difflib import get_close_matches
from pathlib import Path
from typing import IO, Any

from torchid.errors import TorchidError

UNCONFIRMED = "not confirmed:"
"""How the first line of a file begins whose model no data confirm."""
_MODES = ("w", "wb")
_INPUTS: ContextVar[list[Path] | None] = ContextVar("inputs", default=None)
Staged = dict[Path, Path | None]
"""Where files will be that are written whole, and their temporary names; None for a file of an
earlier set, which goes when these come."""
_STAGED: ContextVar[Staged | None] = ContextVar("staged", default=None)


@contextmanager
def inputs_kept(paths: Iterable[Path]) -> Iterator[None]:
    """While it lasts, `require_no_input` and `atomic_write` refuse to write over these files, or
    over a file in one of these folders."""
    token = _INPUTS.set(list(paths))
    try:
        yield
    finally:
        _INPUTS.reset(token)


def add_input(path: Path) -> None:
    """One more file for `inputs_kept`, if it lasts: what a command reads may name others."""
    kept = _INPUTS.get()
    if kept is not None:
        kept.append(path)


def require_no_input(path: str | Path, what: str = "") -> None:
    """Refuse to write a file over an input.

    Links are resolved, and files are told by their inodes, so that no other name hides one.

    Args:
        path: to be written.
        what: would be written there, for the error: `--json`.

    Raises:
        TorchidError: it is an input.
    """
    target = Path(os.path.realpath(path))
    if not os.path.lexists(target) or _is_device(target):
        return
    for given in filter(os.path.exists, _INPUTS.get() or ()):
        inside = given.is_dir() and Path(os.path.realpath(given)) in target.parents
        if inside or os.path.samefile(given, target):
            raise TorchidError(
                f"{what or 'a result'} would overwrite the input '{given}'.",
                got=path,
                expected="the name of another file",
            )


def require_writable(path: Path, what: str) -> None:
    """Refuse a result that cannot be written, before any work is done for it; `-` and devices
    always can.

    Args:
        path: to be written.
        what: would be written there, for the error: `--json`.

    Raises:
        TorchidError: it is an input or a folder, or its folder does not exist or takes no file.
    """
    try:
        if str(path) == "-" or _is_device(path):
            return
        if path.is_dir():
            raise TorchidError(f"{what} needs a file, and '{path}' is a folder.")
        if not path.parent.is_dir():
            raise TorchidError(f"{what}: the folder of '{path}' does not exist.")
        require_no_input(path, what)
        probe(path.parent)
    except (OSError, ValueError) as error:  # a name that is too long, or holds a zero byte
        raise TorchidError(f"{what}: '{path}' is no name of a file.", got=error) from error


def require_name(name: str) -> None:
    """Raise TorchidError unless this names a file, without folder or suffix."""
    if not name or Path(name).name != name or name.startswith("."):
        raise TorchidError("the name is that of a file, without folder.", got=name)


def rows_file(model: Path) -> Path:
    """Beside a model's file, the log that it was made from."""
    return model.with_suffix(".rows.npz")


def file_hash(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal.

    Raises:
        OSError: it cannot be read.
    """
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def similar_files(path: Path, suffixes: Iterable[str] = ()) -> list[str]:
    """Files beside one that is not there and may be meant: of these suffixes, if there are any,
    and with a name or stem like its own, the nearest first."""
    folder, word = path.parent, path.name.lower()
    try:
        names = [p.name for p in folder.iterdir() if not suffixes or p.suffix.lower() in suffixes]
    except OSError:
        return []
    known = {key: name for name in names for key in (Path(name).stem.lower(), name.lower())}
    near = [known[key] for key in get_close_matches(word, list(known), n=4, cutoff=0.7)]
    return [f"./{n}" if folder == Path() else str(folder / n) for n in dict.fromkeys(near)]


def require_folder(folder: Path) -> None:
    """Refuse a folder of results that is not there and cannot be made, or takes no file; it is not
    made yet.

    Raises:
        TorchidError: it cannot, or is a file.
    """
    there = next(path for path in (folder, *folder.parents, Path()) if os.path.lexists(path))
    if not there.is_dir():
        raise TorchidError(
            f"the output folder '{folder}' cannot be made: '{there}' is a file.",
            expected="a folder, or a new name",
        )
    probe(there)


def make_folder(folder: Path) -> list[Path]:
    """A folder that results can be written to.

    Returns:
        The folders that were made for it, the deepest first.

    Raises:
        TorchidError: it cannot be made, or takes no file.
    """
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TorchidError(
            f"the output folder '{folder}' cannot be made: {error.strerror or error}."
        ) from error
    probe(folder)
    return missing


def remove_empty(folders: Iterable[Path]) -> None:
    """Remove what is empty of these folders and below them."""
    for folder in folders:
        for inside, _, _ in os.walk(folder, topdown=False):
            with suppress(OSError):
                os.rmdir(inside)


def probe(folder: Path) -> None:
    """A file really written and removed: permission bits say nothing to root or of a full disk. Its
    name is no other process's.

    Raises:
        TorchidError: it cannot be.
    """
    file = _temporary(folder)
    try:
        file.touch()
        file.unlink()
    except OSError as error:
        raise TorchidError(
            f"the folder '{folder}' cannot be written: {error.strerror or error}."
        ) from error


@contextmanager
def staged(files: Staged | None) -> Iterator[None]:
    """While it lasts, `place` adds files to these, and `put_in_place` gives all of them their
    names; with None each file has its own at once, as without this."""
    token = _STAGED.set(files)
    try:
        yield
    finally:
        _STAGED.reset(token)


def place(files: Staged) -> None:
    """Give files that belong together their names, at the end of `staged` where that lasts.

    Raises:
        TorchidError: as `put_in_place`.
    """
    around = _STAGED.get()
    if around is None:
        put_in_place(files)
    else:
        discard({target: around.pop(target, None) for target in files})
        around.update(files)


def put_in_place(files: Staged) -> None:
    """Rename files that belong together, in their order, but JSON last.

    A JSON that stands in the place of one of them is removed before: whoever finds one has the
    whole set, even where this is stopped half-way.

    Raises:
        TorchidError: a file cannot be renamed.
    """
    in_order = sorted(files.items(), key=lambda pair: pair[0].suffix == ".json")
    try:
        for target, temporary in in_order:
            if temporary is None or (len(files) > 1 and target.suffix == ".json"):
                target.unlink(missing_ok=True)
        for target, temporary in in_order:
            if temporary is not None:
                os.replace(temporary, target)
    except OSError as error:
        discard(files)
        raise TorchidError(
            f"'{error.filename2 or error.filename}' cannot be written: {error.strerror}."
        ) from error


def discard(files: Staged) -> None:
    """Remove files that are not in their place."""
    for temporary in filter(None, files.values()):
        with suppress(OSError):
            temporary.unlink()


@contextmanager
def atomic_write(path: str | Path, mode: str = "w") -> Iterator[IO[Any]]:
    """Open a file for writing that takes the place of `path` only when all went well.

    The content goes to a temporary file in the same folder, which is renamed at the end. If
    anything is raised inside the `with`, nothing is left behind and an existing file stays as it
    was. A link is followed; a device such as /dev/stdout is written to directly.

    Args:
        path: the file to write.
        mode: "w" (text, UTF-8) or "wb".

    Raises:
        TorchidError: the folder does not exist, the file cannot be written, or it is an input
            (`inputs_kept`).
    """
    if mode not in _MODES:
        raise ValueError(f"mode must be one of {_MODES}, got {mode!r}")
    path = Path(path)
    require_no_input(path)
    try:
        if _is_device(path):
            with _open(path, mode) as file:
                yield file
            return
        target = Path(os.path.realpath(path))
        _check_target(path, target)
        temporary = _temporary(target.parent)
        try:
            with _open(temporary, mode.replace("w", "x")) as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            if target.exists():
                os.chmod(temporary, target.stat().st_mode & 0o7777)
            place({target: temporary})
        except BaseException:
            with suppress(OSError):
                temporary.unlink()
            raise
    except BrokenPipeError:
        raise  # the reader of a pipe has left: nothing is wrong with the file
    except OSError as error:
        # An error that names another file comes from the caller's own block, not from writing.
        if error.filename is not None and not _concerns(error, path):
            raise
        raise TorchidError(f"'{path}' cannot be written: {error.strerror or error}") from error


def write_text(path: str | Path, text: str) -> None:
    """Write a text atomically.

    Raises:
        TorchidError: as `atomic_write`.
    """
    with atomic_write(path) as file:
        file.write(text)


def _temporary(folder: Path) -> Path:
    return folder / f".torchid-{secrets.token_hex(6)}.tmp"


def _open(path: Path, mode: str) -> IO[Any]:
    if "b" in mode:
        return open(path, mode)
    # The same bytes on every system: no translation of line ends.
    return open(path, mode, encoding="utf-8", newline="")


def _is_device(path: Path) -> bool:
    """Pipes and devices cannot be replaced, and /dev/null must not be."""
    if path.is_absolute() and path.parts[1:2] == ("dev",):
        return path.exists()
    return path.exists() and not path.is_file() and not path.is_dir()


def _check_target(path: Path, target: Path) -> None:
    if target.is_dir():
        raise TorchidError(f"'{path}' cannot be written: it is a folder.", expected="a file name")
    if not target.parent.is_dir():
        raise TorchidError(
            f"'{path}' cannot be written: there is no folder '{path.parent}'.",
            hint=f"mkdir -p '{path.parent}'",
        )
    if target.exists() and not os.access(target, os.W_OK):
        raise TorchidError(f"'{path}' cannot be written: it is read-only.")


def _concerns(error: OSError, path: Path) -> bool:
    folder = os.path.realpath(path.parent)
    return os.path.dirname(os.path.realpath(os.fspath(error.filename))) == folder
