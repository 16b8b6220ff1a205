"""The command line: parse, call one function, print, save. No physics.

This module is imported before numpy and torch, and sets their thread counts: two BLAS or OpenMP
threads can be many times slower than one on a small or shared machine.
"""

import atexit
import ctypes
import gc
import os
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress

INTERRUPTED = 130
"""Exit code of a command that Ctrl-C ends, as shells have it."""
_KEPT = (("MALLOC_MMAP_THRESHOLD_", -3, 1 << 25), ("MALLOC_TRIM_THRESHOLD_", -1, 1 << 30))
"""Of the GNU C library: variable, parameter of mallopt (3), and bytes: the most that it takes of
the first, and what a process may keep at the end of its heap."""
_COLLECTED = 50_000
"""Objects made since the last look for cycles, before the next: at Python's 700 it takes a fifth of
the time in which modules load, and finds none of any size."""
_ONE_EACH = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def set_environment(arguments: Sequence[str]) -> None:
    """Set the variables that libraries read when they are loaded.

    Threads are `--threads N` of the arguments, one if absent; what the user has set stays, unless
    `--threads` is given.
    """
    asked = None
    for k, argument in enumerate(arguments):
        option, _, value = argument.partition("=")
        if option == "--threads":
            value = value if "=" in argument else "".join(arguments[k + 1 : k + 2])
            asked = value if value.isdigit() and int(value) > 0 else None
            break
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    # Arrow's own pool keeps what is freed, which for a large log is as much memory again.
    os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")
    # Arrays that are freed stay with the process: a third of the time of a stream went into fresh
    # pages. The C library reads the variables when a worker starts; here it is told.
    for name, number, most in _KEPT:
        os.environ.setdefault(name, str(most))
        with suppress(AttributeError, OSError, ValueError):
            ctypes.CDLL(None).mallopt(number, int(os.environ[name]))
    # Commands draw into files only, whatever windows the user's other programs draw in.
    os.environ["MPLBACKEND"] = "agg"
    for name in _ONE_EACH:
        if asked is not None:
            os.environ[name] = asked
        else:
            os.environ.setdefault(name, "1")


def exit_now(*_: object) -> None:
    """End the program, for Ctrl-C while modules load, which would turn it into errors of their own.
    Nothing has been begun."""
    with suppress(OSError):
        os.write(2, b"interrupted\n")
    os._exit(INTERRUPTED)


def allow_interrupts() -> None:
    """From now on Ctrl-C is a KeyboardInterrupt, so that what was begun ends in good order."""
    if signal.getsignal(signal.SIGINT) is exit_now:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def main() -> None:
    """Entry point of `torchid` and of cli.py."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, exit_now)
    set_environment(sys.argv[1:])
    gc.set_threshold(_COLLECTED)
    try:
        from torchid.app.commands import run
    except Exception as error:  # too little memory for a library, or one that is not whole
        from torchid.app.faults import report

        sys.exit(report(error, str))
    try:
        run()
    except SystemExit as end:
        if end.code == INTERRUPTED:
            # Python would free a long log array by array, for more than a second.
            atexit._run_exitfuncs()
            os._exit(INTERRUPTED)
        raise
