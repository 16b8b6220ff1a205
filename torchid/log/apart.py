"""Files whose libraries may crash or not end on damaged ones are read by a process of their own.

One such process (`reading_program.py`) is started when the first file needs it, and serves all that
follow. Where it ends or is silent for too long, that file is damaged, and the next one has a new
process.
"""

import atexit
import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy

from torchid.errors import LogError

PATIENCE = 20.0
"""Time for a file's list of contents [s]; that of a hundred thousand datasets takes five."""

_PROGRAM = Path(__file__).with_name("reading_program.py")


class _Piped:
    """A pipe by its `read` alone: NumPy would look for its place in what it takes for a file."""

    def __init__(self, pipe: IO[bytes]) -> None:
        self.read = pipe.read


class _Reader:
    """The process, if there is one; it is asked one thing at a time."""

    def __init__(self) -> None:
        self.process: subprocess.Popen[bytes] | None = None
        self.lock = threading.Lock()

    def ask(self, line: bytes) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """An answer and its arrays, from a new process if there is none."""
        if self.process is None or self.process.poll() is not None:
            self.end()
            # A session of its own: Ctrl-C is for this process, which then ends the other.
            self.process = subprocess.Popen(
                [sys.executable, "-P", str(_PROGRAM)],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
                start_new_session=True,
            )  # fmt: skip
        asked, answered = self.process.stdin, self.process.stdout
        assert asked is not None
        assert answered is not None
        asked.write(line)
        asked.flush()
        said = json.loads(answered.readline())
        names = said.pop("arrays", ())
        piped = _Piped(answered)
        return said, {name: npy.read_array(piped, allow_pickle=False) for name in names}

    @contextmanager
    def ended_after(self, seconds: float | None) -> Iterator[threading.Event]:
        """End the process where the block takes longer; whether that was so."""
        late = threading.Event()

        def stop() -> None:
            late.set()
            if self.process is not None:
                self.process.kill()

        clock = threading.Timer(seconds or 0.0, stop)
        clock.daemon = True
        if seconds is not None:
            clock.start()
        try:
            yield late
        finally:
            clock.cancel()
            if seconds is not None:
                clock.join()
            if late.is_set():
                self.end()

    def end(self) -> None:
        """End the process; whatever it would still say is nobody's answer."""
        if self.process is None:
            return
        self.process.kill()
        self.process.wait()
        for stream in (self.process.stdin, self.process.stdout):
            if stream is not None:
                with suppress(OSError):  # what it was not told any more
                    stream.close()
        self.process = None

    def forget(self) -> None:
        """In a process that was forked: the reader is its parent's."""
        self.process, self.lock = None, threading.Lock()


_READER = _Reader()
atexit.register(_READER.end)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_READER.forget)


def read_apart(
    path: Path, kind: str, request: dict[str, Any], *, soon: bool = False
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Ask the process about a file.

    Args:
        path: of the file.
        kind: of the file, for people.
        request: JSON-ready: what to `do`, see `reading_program`.
        soon: whether the answer must be there in time; else it takes as long as it takes.

    Returns:
        What it says, and arrays by name.

    Raises:
        LogError: the library refuses the file, ends on it, or has no answer in time.
    """
    line = json.dumps({**request, "path": str(path)}).encode() + b"\n"
    with _READER.lock, _READER.ended_after(PATIENCE if soon else None) as late:
        try:
            said, arrays = _READER.ask(line)
        except (ValueError, OSError, EOFError):
            _READER.end()
            why = f"no answer within {PATIENCE:g} s" if late.is_set() else "its reader ends on it"
            said, arrays = {"error": why}, {}
        except BaseException:
            _READER.end()
            raise
    if "error" in said:
        raise LogError(
            f"'{path}' is not a {kind} file, though its name says so, or is damaged.",
            got=said["error"],
        )
    return said, arrays
