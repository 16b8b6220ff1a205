"""One door to every engine: what runs here, in processes or on a cluster is an Executor of
`concurrent.futures`, and functions of a module and their arguments are all that it is given.

    1                   this process
    4                   four processes of one thread each
    "tcp://host:8786"   the workers of a dask scheduler
    an Executor         of mpi4py, ipyparallel, loky, ...; whoever made it ends it
"""

import os
import pickle
import signal
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

from torchid.errors import MissingExtraError, TorchidError

Job = TypeVar("Job")
Result = TypeVar("Result")

Progress = Callable[[str, int, int], None]
"""Takes stage, done, total; a total of 0 where it is not known."""

Workers = int | str | Executor

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment of a process."""

RETRIES = 2
"""Times that a task is tried again."""

PATIENCE = 20
"""Time in which a dask scheduler must answer, and have a worker [s]."""


def stage(
    progress: Progress | None, name: str, before: int = 0, parts: int = 1
) -> Callable[[int, int], None] | None:
    """A callback (done, total) of one stage; of several parts that are as long, which are counted
    together, of the one that comes after so many."""
    if progress is None:
        return None
    return lambda done, total: progress(name, before * total + done, parts * total)


def of(progress: Progress | None, name: str) -> Progress | None:
    """A callback whose stages are those of one of several things, with its name before them."""
    if progress is None:
        return None
    return lambda stage, done, total: progress(f"{name}: {stage}", done, total)


class RefusedError(TorchidError):
    """What no other worker would do better: it ends the whole run, and is not tried again."""


@dataclass(frozen=True)
class Failure:
    """A task that was tried several times and gave nothing.

    Attributes:
        reason: the last error, or that the process ended, in one line.
        tries: how often.
    """

    reason: str
    tries: int


class Serial(Executor):
    """Runs what it is given, here and at once."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """A future that is done."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


@contextmanager
def opened(workers: Workers, least: int = 1) -> Iterator[tuple[Executor, int]]:
    """An executor, and how many tasks to give it at a time.

    Args:
        workers: see above.
        least: processes are started even for `workers` of 1 where this is 2.

    Raises:
        TorchidError: a scheduler that does not answer, or a number below 1.
        MissingExtraError: dask.distributed is not installed.
    """
    if isinstance(workers, Executor):
        yield workers, 1_000_000
    elif isinstance(workers, str):
        with _cluster(workers) as (pool, cores):
            yield pool, 2 * cores  # the next task waits at its worker, not at this end of the wire
    elif workers < 1:
        raise TorchidError("at least one worker is needed.", got=workers)
    elif workers == 1 and least == 1:
        yield Serial(), 1
    else:
        pool = _processes(workers)
        try:
            # No more tasks than processes: when one ends, those given are those it was busy with
            # or beside.
            yield pool, workers
        except BaseException:
            pool.shutdown(kill_workers=True)
            raise


def _processes(count: int) -> Any:
    """Processes that work in this folder, the same ones as before where they still wait. They
    inherit that Ctrl-C is held back, which is for this process to hear."""
    from joblib.externals.loky import get_reusable_executor

    posix = hasattr(signal, "pthread_sigmask")
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT]) if posix else set()
    try:
        pool = get_reusable_executor(
            count, initializer=os.chdir, initargs=(os.getcwd(),), env=ONE_THREAD
        )
        pool.submit(os.getpid)  # which starts them
    finally:
        if posix:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return pool


@contextmanager
def _cluster(address: str) -> Iterator[tuple[Executor, int]]:
    try:
        from distributed import Client
    except ModuleNotFoundError as error:
        raise MissingExtraError("distributed", "cluster", "A dask scheduler") from error
    try:
        client = Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise TorchidError(
            f"no dask scheduler answers at '{address}'.",
            got=str(error).splitlines()[0] if str(error) else type(error).__name__,
            expected="tcp://HOST:PORT of a running `dask scheduler`",
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE)  # they come back after their scheduler
        except TimeoutError as error:
            raise TorchidError(
                f"the scheduler at '{address}' has no workers.", hint=f"dask worker {address}"
            ) from error
        cores = sum(client.nthreads().values())
        with client.get_executor() as pool:
            yield pool, cores


def each(
    function: Callable[[Job], Result],
    jobs: Sequence[Job],
    workers: Workers = 1,
    stage: str = "",
    progress: Progress | None = None,
) -> list[Result]:
    """The results, in the order of the jobs; the first error ends it.

    Args:
        function: of a module, so that another process can find it.
        jobs: any number.
        workers: who does it.
        stage: what is done, for the progress.
        progress: called with (stage, done, total).

    Raises:
        TorchidError: a process was ended from outside.
    """
    say = progress or (lambda stage, done, total: None)
    say(stage, 0, len(jobs))
    results: dict[int, Result] = {}
    try:
        with opened(1 if len(jobs) < 2 else workers) as (pool, slots):
            for k, result, error in _finished(function, jobs, range(len(jobs)), pool, slots):
                if error is not None:
                    raise error
                results[k] = result
                say(stage, len(results), len(jobs))
    except BrokenExecutor as error:
        raise TorchidError(
            "a process was ended from outside; memory may have run out.",
            hint="fewer processes; what is done already stays",
        ) from error
    return [results[k] for k in range(len(jobs))]


def attempted(
    function: Callable[[Job], Result],
    jobs: Sequence[Job],
    workers: Workers = 1,
    stage: str = "",
    progress: Progress | None = None,
    retries: int = RETRIES,
) -> list[Result | Failure]:
    """The results in the order of the jobs, a failure in the place of one that cannot be had.

    A task that raises is tried again. Where a process ends (killed, out of memory), nobody knows
    which of the tasks that were under way ended it; each of them is then run in a process of its
    own, so that only the one that does it again is blamed.

    Args:
        function: idempotent: a task may run twice.
        jobs, workers, stage, progress: as for `each`.
        retries: times that a task is tried again.

    Raises:
        RefusedError: raised by a task.
    """
    say = progress or (lambda stage, done, total: None)
    say(stage, 0, len(jobs))
    results: dict[int, Result | Failure] = {}
    tries: Counter[int] = Counter()
    batches = deque[Sequence[int]]([range(len(jobs))])

    def done(k: int, result: Result | Failure) -> None:
        results[k] = result
        say(stage, len(results), len(jobs))

    def failed(k: int, reason: str) -> None:
        """One more try that gave nothing: the next one is alone, unless it was the last."""
        tries[k] += 1
        if tries[k] > retries:
            done(k, Failure(reason, tries[k]))
        else:
            batches.append([k])

    while batches:
        batch = batches.popleft()
        alone = len(batch) == 1
        crew: Workers = 1 if alone and isinstance(workers, int) else workers
        try:
            with opened(crew, 2 if alone and workers != 1 else 1) as (pool, slots):
                for k, result, error in _finished(function, jobs, batch, pool, slots):
                    if error is None:
                        done(k, result)
                    elif isinstance(error, RefusedError):
                        raise error
                    else:
                        failed(k, " ".join(f"{type(error).__name__}: {error}".split()))
        except _Broken as broken:
            if alone:
                failed(batch[0], "the process that worked on it ended, killed or out of memory")
                continue
            (suspects,) = broken.args
            rest = [k for k in batch if k not in {*results, *tries, *suspects}]
            batches += [*([k] for k in suspects), *([rest] if rest else [])]
    return [results[k] for k in range(len(jobs))]


class _Broken(BrokenExecutor):
    """An executor that ended, with the jobs that were under way."""


def _finished(
    function: Callable[[Job], Result],
    jobs: Sequence[Job],
    numbers: Sequence[int],
    pool: Executor,
    slots: int,
) -> Iterator[tuple[int, Any, BaseException | None]]:
    """Number, result and error of each job as it is done, no more than `slots` under way."""
    waiting, running = deque(numbers), dict[Future[Any], int]()
    here = isinstance(pool, Serial)  # nothing crosses a wire
    try:
        while waiting or running:
            while waiting and len(running) < slots:
                job = jobs[waiting[0]]
                task = (function, job) if here else (by_value, function, pickle.dumps(job))
                running[pool.submit(*task)] = waiting[0]
                waiting.popleft()
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            # A future is cancelled where the engine behind it has gone, as with its scheduler.
            broken = {f for f in done if f.cancelled() or isinstance(f.exception(), BrokenExecutor)}
            for future in sorted(done - broken, key=running.__getitem__):
                k, error = running.pop(future), future.exception()
                result: Any = None if error else future.result()
                yield k, result if here or error else pickle.loads(result), error
            if broken:
                raise BrokenExecutor
    except BrokenExecutor as error:  # giving a task to a pool that has just ended says so, too
        raise _Broken(list(running.values()) or [waiting[0]]) from error
    finally:
        for future in running:
            future.cancel()


def by_value(function: Callable[[Job], Result], job: bytes) -> bytes:
    """The pickled result of a pickled job.

    Left to itself, torch sends every tensor to another process as a file of shared memory that
    stays open as long as the tensor lives: a fleet of some hundred sessions is more than a process
    may have open.
    """
    return pickle.dumps(function(pickle.loads(job)))
