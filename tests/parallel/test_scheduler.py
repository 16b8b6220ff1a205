"""A dask scheduler that ends while work is under way: nothing that is stored is lost, and where it
comes back, the run goes on."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.parallel import jobs
from torchid.errors import TorchidError
from torchid.parallel.workers import attempted

pytest.importorskip("distributed")
pytestmark = pytest.mark.slow


class Cluster:
    """A scheduler with a worker, each a process, as people start them."""

    def __init__(self) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self.port}"
        self.running: list[subprocess.Popen[bytes]] = []

    def start(self) -> None:
        self._run("scheduler", "--host", "127.0.0.1", "--port", str(self.port))
        self.start_worker()

    def start_worker(self) -> None:
        self._run("worker", self.address, "--nthreads", "1", "--no-nanny")

    def _run(self, *command: str) -> None:
        self.running.append(
            subprocess.Popen(
                [sys.executable, "-m", "dask", *command, "--no-dashboard"],
                env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": os.getcwd()},
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
        )

    def kill(self) -> None:
        for process in self.running:
            with contextlib.suppress(ProcessLookupError):
                process.send_signal(signal.SIGKILL)
            process.wait()
        self.running.clear()


@pytest.fixture
def cluster(monkeypatch: pytest.MonkeyPatch) -> Iterator[Cluster]:
    monkeypatch.setattr("torchid.parallel.workers.PATIENCE", 120)
    found = Cluster()
    found.start()
    yield found
    found.kill()


@pytest.mark.nightly
def test_a_scheduler_that_comes_back_goes_on(cluster: Cluster, tmp_path: Path) -> None:
    killed: list[int] = []

    def kill_once(stage: str, done: int, total: int) -> None:
        if done == 2 and not killed:
            killed.append(done)
            cluster.kill()
            cluster.start()

    todo = [(str(tmp_path), k) for k in range(6)]
    assert attempted(jobs.counted, todo, cluster.address, progress=kill_once) == list(range(6))
    assert killed
    # What was under way was done again, and nothing else.
    times = [len((tmp_path / str(k)).read_text()) for k in range(6)]
    assert sum(times) <= 6 + 2


def test_a_scheduler_that_is_gone_ends_the_run_with_a_sentence(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def kill(stage: str, done: int, total: int) -> None:
        if done == 2:
            cluster.kill()
            monkeypatch.setattr("torchid.parallel.workers.PATIENCE", 2)

    todo = [(str(tmp_path), k) for k in range(6)]
    with pytest.raises(TorchidError, match="no dask scheduler answers"):
        attempted(jobs.counted, todo, cluster.address, progress=kill)
