"""The same function of many jobs, in this process or in others that have one thread each."""

import multiprocessing
import multiprocessing.connection
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TypeVar

from torchid.errors import TorchidError

Job = TypeVar("Job")
Result = TypeVar("Result")

Progress = Callable[[str, int, int], None]

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def each(
    function: Callable[[Job], Result],
    jobs: Sequence[Job],
    processes: int,
    stage: str = "",
    progress: Progress | None = None,
) -> list[Result]:
    """The results, in the order of the jobs.

    Args:
        function: of a module, so that another process can find it.
        jobs: any number.
        processes: 1 stays in this one.
        stage: what is done, for the progress.
        progress: called with (stage, done, total).

    Raises:
        TorchidError: a process was ended from outside.
    """
    say = progress or (lambda stage, done, total: None)
    say(stage, 0, len(jobs))
    if processes == 1 or len(jobs) < 2:
        out = []
        for job in jobs:
            out.append(function(job))
            say(stage, len(out), len(jobs))
        return out
    context = multiprocessing.get_context("spawn")
    count = min(processes, len(jobs))
    with _one_thread_each(), ProcessPoolExecutor(count, context, end_with_parent) as pool:
        waiting = [pool.submit(function, job) for job in jobs]
        try:
            for done, future in enumerate(as_completed(waiting), 1):
                future.result()
                say(stage, done, len(jobs))
            return [future.result() for future in waiting]
        except BrokenProcessPool as error:
            raise TorchidError(
                "a process was ended from outside; memory may have run out.",
                hint="fewer `jobs=...`; what is done already stays",
            ) from error
        finally:
            for future in waiting:
                future.cancel()


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes started within have one thread; theirs are read when numpy and torch are loaded."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def end_with_parent() -> None:
    """A process whose parent is killed would wait for work for ever; Ctrl-C ends what it does,
    without a word, and a second later the process."""

    def stop(number: int, frame: object) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        ended = threading.Timer(1.0, os._exit, (130,))
        ended.daemon = True
        ended.start()
        raise SystemExit(130)

    signal.signal(signal.SIGINT, stop)
    parent = multiprocessing.parent_process()
    assert parent is not None
    sentinel = parent.sentinel

    def watch() -> None:
        multiprocessing.connection.wait([sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
