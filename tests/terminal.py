"""A pseudo-terminal that a program writes to."""

import fcntl
import os
import pty
import struct
import subprocess
import termios
from collections.abc import Callable

Started = Callable[[int], "subprocess.Popen[bytes]"]
"""Starts a program with the terminal's descriptor as one of its streams."""


def on_a_terminal(start: Started, columns: int | None = None) -> tuple[str, str]:
    """What a program writes to the terminal until it ends well, and what to a pipe that is its
    standard output, if that is one.

    Args:
        start: as `Started`.
        columns: width of the terminal; its default if None.
    """
    main, other = pty.openpty()
    if columns is not None:
        fcntl.ioctl(other, termios.TIOCSWINSZ, struct.pack("HHHH", 50, columns, 0, 0))
    with start(other) as process:
        os.close(other)
        shown = b""
        while True:
            try:
                part = os.read(main, 4096)
            except OSError:  # the other end is closed
                break
            if not part:
                break
            shown += part
        out = b"" if process.stdout is None else process.stdout.read()
    os.close(main)
    assert process.returncode == 0, shown.decode()
    return shown.decode(), out.decode()
