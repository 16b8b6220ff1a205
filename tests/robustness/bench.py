"""Run commands in this process on bad inputs, and see whether each ends as it should."""

import contextlib
import hashlib
import io
import os
import resource
import signal
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

from torchid.app.commands import run

SECONDS, BYTES = 30, 1 << 30
"""What one bad input may take of the processor's time, and how much memory beside the process's."""
WAITING = 10
"""Times as long that it may take of a busy machine's."""
MOST_SAID = 6000
"""Letters of a clear error."""


class TooLongError(BaseException):
    """A command did not end in time."""


@dataclass(frozen=True)
class Outcome:
    """How a command ended.

    Attributes:
        code: of its exit.
        out, err: what it printed.
        changed: files that are new, gone or different afterwards.
    """

    code: int
    out: str
    err: str
    changed: tuple[str, ...]

    @property
    def fault(self) -> str | None:
        """What is not as it should be after bad input; None where all is."""
        said = self.out + self.err
        ended = "".join(self.err.splitlines(keepends=True)[-1:])
        checks = {
            f"exit code {self.code}": self.code not in (1, 2),
            "a traceback": "Traceback" in said,
            f"changed: {', '.join(self.changed)}": bool(self.changed),
            "no message": not self.err.strip(),
            f"{len(said)} letters": len(said) > MOST_SAID,
            "control characters": any(not c.isprintable() and c != "\n" for c in said),
            "not one error": self.code == 1 and f"\n{said}".count("\nerror: ") != 1,
        }
        wrong = [text for text, bad in checks.items() if bad]
        return f"{'; '.join(wrong)}: {ended[:400]}" if wrong else None


@contextlib.contextmanager
def limited(seconds: int = SECONDS, more: int = BYTES) -> Iterator[None]:
    """A process that may take only so much longer, and so much more memory."""

    def stop(*_: object) -> None:
        raise TooLongError

    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before = [(which, signal.signal(which, stop)) for which in (signal.SIGPROF, signal.SIGALRM)]
    resource.setrlimit(resource.RLIMIT_AS, (used + more, hard))
    signal.setitimer(signal.ITIMER_PROF, seconds)
    signal.alarm(WAITING * seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.setitimer(signal.ITIMER_PROF, 0)
        for which, handler in before:
            signal.signal(which, handler)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def hashes(*folders: Path) -> dict[str, str]:
    """What files hold, by their names."""
    files = (file for folder in folders for file in folder.rglob("*") if file.is_file())
    return {str(file): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def outcome(arguments: Sequence[str], folders: Sequence[Path]) -> Outcome:
    """Run `torchid ARGUMENTS` in the first of the folders, and see what changes in all of them."""
    out, err = io.StringIO(), io.StringIO()
    before, here = hashes(*folders), Path.cwd()
    code = 0
    with (
        contextlib.chdir(folders[0]),
        mock.patch.object(sys, "argv", ["torchid", *arguments]),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        try:
            with limited():
                run()
        except SystemExit as stop:
            code = int(stop.code or 0)
        except TooLongError:
            code = 124
    assert Path.cwd() == here
    after = hashes(*folders)
    names = sorted(name for name in {*before, *after} if before.get(name) != after.get(name))
    return Outcome(code, out.getvalue(), err.getvalue(), tuple(map(os.path.basename, names)))
