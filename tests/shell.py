"""A bash in which `torchid` is this one, and no command waits for torch to be imported.

One process imports everything and waits at a socket for as long as its parent lives. For each
command it forks: the child takes the caller's streams, folder, environment and arguments, and runs
the program from its entry point.
"""

import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.documents import ROOT

_CALLER = """#!{python} -SE
import json, os, socket, sys
caller = socket.socket(socket.AF_UNIX)
caller.connect({address!r})
request = json.dumps([sys.argv[1:], os.getcwd(), dict(os.environ)]).encode()
socket.send_fds(caller, [request], [0, 1, 2])
caller.shutdown(socket.SHUT_WR)
sys.exit(int(caller.recv(8) or 1))
"""


class Shell:
    """Bash in a folder."""

    def __init__(self, folder: Path, commands: Path) -> None:
        self.folder = folder
        path = f"{commands}{os.pathsep}{os.environ['PATH']}"
        self.environment = os.environ | {"PATH": path, "PYTHONPATH": str(ROOT)}

    def run(self, script: str) -> str:
        """What a script prints; it must succeed, all of it."""
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", script],
            cwd=self.folder, env=self.environment, capture_output=True, text=True, check=False,
            timeout=3600,
        )  # fmt: skip
        assert done.returncode == 0, f"{script}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
        return done.stdout


@contextmanager
def shell(folder: Path) -> Iterator[Shell]:
    """A shell in a folder, for as long as the process behind it lives."""
    commands = folder / "bin"
    commands.mkdir()
    address = str(commands / "socket")
    command = commands / "torchid"
    command.write_text(_CALLER.format(python=sys.executable, address=address))
    command.chmod(0o755)
    # It has none of this process's checks of types, and no threads that a fork would lose.
    server = subprocess.Popen(
        [sys.executable, "-m", "tests.shell", address],
        cwd=ROOT, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
    )  # fmt: skip
    try:
        assert server.stdout is not None
        assert server.stdout.readline() == b"ready\n"
        yield Shell(folder, commands)
    finally:
        server.terminate()
        server.wait()


def _serve(address: str) -> None:
    from torchid.app import set_environment

    set_environment(())
    import torchid
    import torchid.app.commands

    for name in torchid.__all__:
        getattr(torchid, name)
    with socket.socket(socket.AF_UNIX) as waiting:
        waiting.bind(address)
        waiting.listen()
        waiting.settimeout(1.0)
        parent = os.getppid()
        os.write(1, b"ready\n")
        while os.getppid() == parent:
            try:
                caller, _ = waiting.accept()
            except TimeoutError:
                continue
            caller.setblocking(True)
            if os.fork() == 0:
                waiting.close()
                _answer(caller)
            caller.close()


def _answer(caller: socket.socket) -> None:
    """In a child: be the command."""
    request, streams, _, _ = socket.recv_fds(caller, 1 << 16, 3)
    while part := caller.recv(1 << 16):
        request += part
    arguments, folder, environment = json.loads(request)
    for target, stream in enumerate(streams):
        os.dup2(stream, target)
    sys.stdin, sys.stdout = os.fdopen(0), os.fdopen(1, "w")
    sys.stderr = os.fdopen(2, "w", buffering=1)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = ["torchid", *arguments]
    code = 0
    try:
        from torchid.app import main

        main()
    except SystemExit as stop:
        code = stop.code if isinstance(stop.code, int) else int(stop.code is not None)
    except BaseException:
        sys.excepthook(*sys.exc_info())
        code = 1
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        caller.sendall(str(code).encode())
        os._exit(code)


if __name__ == "__main__":
    _serve(sys.argv[1])
