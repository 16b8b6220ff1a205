"""Writing files so that a reader never sees half of one."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from torchid.errors import TorchidError

_MODES = ("w", "wb")


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
        TorchidError: the folder does not exist, or the file cannot be written.
    """
    if mode not in _MODES:
        raise ValueError(f"mode must be one of {_MODES}, got {mode!r}")
    path = Path(path)
    try:
        if _is_device(path):
            with _open(path, mode) as file:
                yield file
            return
        target = Path(os.path.realpath(path))
        _check_target(path, target)
        temporary = target.parent / f".torchid-{secrets.token_hex(6)}.tmp"
        try:
            with _open(temporary, mode.replace("w", "x")) as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            if target.exists():
                os.chmod(temporary, target.stat().st_mode & 0o7777)
            os.replace(temporary, target)
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
