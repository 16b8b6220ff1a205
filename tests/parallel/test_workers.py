"""The same answers here, in processes and on a cluster, whatever happens to a worker."""

import os
import sys
from concurrent.futures import BrokenExecutor, ThreadPoolExecutor

import pytest

from tests.parallel import jobs
from torchid.errors import MissingExtraError, TorchidError
from torchid.parallel.workers import Failure, RefusedError, Serial, attempted, each

WORKERS = {"one": 1, "two": 2, "serial": Serial(), "threads": ThreadPoolExecutor(3)}


@pytest.mark.parametrize("workers", WORKERS.values(), ids=WORKERS)
def test_results_are_in_the_order_of_the_jobs(workers) -> None:
    said = []
    assert each(jobs.root, [1.0, 4.0, 9.0], workers, "roots", lambda *a: said.append(a)) == [
        1,
        2,
        3,
    ]
    assert said == [("roots", k, 3) for k in range(4)]


def test_a_task_that_raises_is_tried_again_and_stops_no_other() -> None:
    found = attempted(jobs.root, [4.0, -1.0, 9.0], retries=1)
    assert found == [2.0, Failure("ValueError: no root of -1.0", 2), 3.0]


def test_only_the_job_that_kills_its_process_is_blamed() -> None:
    found = attempted(jobs.killed, [1.0, 2.0, 3.0, 4.0, 5.0], 2, retries=1)
    assert found[:2] + found[3:] == [1.0, 2.0, 4.0, 5.0]
    assert isinstance(found[2], Failure)
    assert "killed or out of memory" in found[2].reason


def test_a_worker_that_is_killed_loses_nothing(tmp_path) -> None:
    todo = [(str(tmp_path), k) for k in range(5)]
    assert attempted(jobs.killed_once, todo, 2) == [0, 1, 2, 3, 4]


def test_an_executor_that_has_ended_gives_failures_and_not_for_ever() -> None:
    class Ended(Serial):
        def submit(self, fn, /, *args, **kwargs):
            raise BrokenExecutor("ended")

    found = attempted(jobs.root, [1.0, 4.0], Ended(), retries=1)
    assert [type(one) for one in found] == [Failure, Failure]


def test_what_is_refused_ends_the_run() -> None:
    with pytest.raises(RefusedError, match="another torchid"):
        attempted(jobs.refuse, [1.0, 2.0])


def test_no_worker_is_no_choice() -> None:
    with pytest.raises(TorchidError, match="at least one worker"):
        each(jobs.root, [1.0, 2.0], 0)


def test_a_scheduler_that_is_not_there(monkeypatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("torchid.parallel.workers.PATIENCE", 0.2)
    with pytest.raises(TorchidError, match="no dask scheduler answers"):
        each(jobs.root, [1.0, 2.0], "tcp://127.0.0.1:9")


def test_without_dask_the_error_says_how_to_install_it(monkeypatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    with pytest.raises(MissingExtraError, match=r"torchid\[cluster\]"):
        each(jobs.root, [1.0, 2.0], "tcp://127.0.0.1:9")


def test_a_process_works_where_this_one_does_with_one_thread(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert each(jobs.state, [1, 2], 2) == [(str(tmp_path), "1")] * 2


@pytest.mark.skipif(sys.platform != "linux", reason="/proc")
def test_results_keep_no_files_open() -> None:
    before = len(os.listdir("/proc/self/fd"))
    found = each(jobs.tensors, [300, 300], 2)
    assert [float(x[-1]) for one in found for x in one] == [*map(float, range(300))] * 2
    assert len(os.listdir("/proc/self/fd")) < before + 100


@pytest.mark.slow
def test_a_cluster_gives_the_same() -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        found = attempted(jobs.root, [1.0, -1.0, 9.0], cluster.scheduler_address, retries=1)
    assert found == [1.0, Failure("ValueError: no root of -1.0", 2), 3.0]
