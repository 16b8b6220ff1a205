"""What happens when a command does not end well: bad input, Ctrl-C, a fault of torchid itself, a
terminal that cannot show every sign."""

import codecs
import os
import platform
import shlex
import sys
import tempfile
import traceback
import unicodedata
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from torchid import __version__
from torchid.app import INTERRUPTED
from torchid.errors import TorchidError, visible

FAULT = 70
"""Exit code of a fault of torchid: EX_SOFTWARE of sysexits.h."""

_MEMORY = ("allocate memory", "not enough memory", "out of memory", "failed to map segment")
_NO_MEMORY = (
    "error: this work needs more memory than this process may use.\n"
    "  hint: fewer or shorter logs at a time; `ulimit -v` shows a limit that is set"
)
_PLAIN = {
    "\u00b1": "+-", "\u00b2": "^2", "\u00b3": "^3", "\u00b5": "u", "\u03bc": "u", "\u00b0": " deg",
    "\u00d7": "x", "\u00b7": ".", "\u2013": "-", "\u2014": "-", "\u2026": "...", "\u2192": "->",
    "\u2264": "<=", "\u2265": ">=", "\u2212": "-", "\u2018": "'", "\u2019": "'", "\u201c": '"',
    "\u201d": '"', "\u2588": "#", "\u2501": "-", "\u2500": "-",
}  # fmt: skip


def _plainly(error: UnicodeError) -> tuple[str, int]:
    """What an encoding cannot write, in ASCII."""
    assert isinstance(error, UnicodeEncodeError)
    text = ""
    for sign in error.object[error.start : error.end]:
        letters = unicodedata.normalize("NFKD", sign).encode("ascii", "ignore").decode()
        text += _PLAIN.get(sign) or letters or "?"
    return text, error.end


codecs.register_error("torchid.plain", _plainly)


def print_plainly() -> None:
    """Let standard output and error show in ASCII what their encoding cannot write."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="torchid.plain")


def out_of_memory(error: BaseException) -> bool:
    """Whether NumPy, torch or Python could not have the memory that they asked for."""
    return isinstance(error, MemoryError) or (
        isinstance(error, RuntimeError | ImportError | OSError)
        and any(words in str(error) for words in _MEMORY)
    )


def report(error: BaseException, words: Callable[[str], str]) -> int:
    """Say on standard error, in one line or a user's error's few, why a command ended.

    Args:
        error: that ended it.
        words: a message of the library as the command line has it.

    Returns:
        The exit code.
    """
    if isinstance(error, TorchidError):
        said, code = f"error: {words(str(error))}", 1
    elif isinstance(error, OSError) and error.errno is not None:  # a file system's, not torchid's
        what = f"'{error.filename}': " if error.filename is not None else ""
        said, code = visible(f"error: {what}{error.strerror}."), 1
    elif out_of_memory(error):
        said, code = _NO_MEMORY, 1
    elif isinstance(error, KeyboardInterrupt):
        said, code = "; ".join(["interrupted", *map(str, error.args)]), INTERRUPTED
    else:
        said, code = _fault(error), FAULT
    with suppress(OSError, AttributeError):  # no standard error either
        sys.stderr.write(f"{said}\n")
        sys.stderr.flush()
    return code


def _fault(error: BaseException) -> str:
    """One line about a fault of torchid, whose traceback goes to a file; with --debug the traceback
    itself."""
    trace = "".join(traceback.format_exception(error))
    if "--debug" in sys.argv:
        return trace.rstrip()
    kind = type(error).__name__
    what = " ".join(f"{kind}: {error}".split())[:200]
    command = shlex.join(["torchid", *sys.argv[1:]])
    about = f"torchid {__version__}, Python {platform.python_version()}, {platform.platform()}"
    try:
        number, name = tempfile.mkstemp(".txt", "torchid-fault-")
        with os.fdopen(number, "w", encoding="utf-8", errors="replace") as file:
            file.write(f"{command}\n{about}\nin {Path.cwd()}\n\n{trace}")
        where = f"the traceback is in {name}: please send that file with your report"
    except OSError:
        where = "please report it with what --debug shows"
    return visible(f"fault: torchid failed in `{command[:200]}` ({what}); {where}")


def flush() -> None:
    """Empty standard output where an error can be dealt with: at exit Python would complain."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except (OSError, ValueError):
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
