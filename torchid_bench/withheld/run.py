"""Ask of every case of a set what a user asks: `torchid.diagnose`, the doctor first. Nothing here
knows where keys are, or reads one."""

import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from torchid import __version__
from torchid.errors import TorchidError
from torchid.gap.settings import GapSettings
from torchid.json_data import plain, read_json, write_json
from torchid.parallel.store import code as sources
from torchid.parallel.workers import Progress, each
from torchid_bench.withheld.case_set import CaseSet

ERROR, REFUSED, LATE = "error", "refused", "out_of_time"
UNANSWERED = (ERROR, REFUSED, LATE)
"""Statuses of a case without a diagnosis: it failed, where the command's exit code is 70; its log
or file is refused with a reason; it took more CPU seconds than it may."""

LIMIT = 240.0
"""CPU seconds in which a case is to be answered."""

NOT_THE_DIAGNOSIS = (
    "app", "report", "withheld", "fleet", "extraction", "wrenches", "parallel",
)  # fmt: skip
"""Rooms of torchid that a diagnosis does not depend on."""


@dataclass(frozen=True)
class Job:
    """One case to diagnose.

    Attributes:
        case: its name.
        robot, logs, answer: files.
        settings: of the diagnosis.
        earlier: file of an earlier log of the arm; None without one.
        limit: CPU seconds in which it is to be answered.
    """

    case: str
    robot: Path
    logs: tuple[Path, ...]
    answer: Path
    settings: GapSettings
    earlier: Path | None = None
    limit: float = LIMIT


class OutOfTime(BaseException):
    """A case took more CPU seconds than it may; no `except Exception` on the way keeps it."""


def job_of(cases: CaseSet, case: str, answer: Path, settings: GapSettings | None = None) -> Job:
    """A job for a case, its answer in any file; the default if None."""
    settings = settings or GapSettings()
    return Job(case, cases.robot(case), cases.logs(case), answer, settings, cases.earlier(case))


def jobs_of(cases: CaseSet, settings: GapSettings) -> list[Job]:
    """A job a case."""
    return [job_of(cases, case, cases.answer(case), settings) for case in cases.ids]


def run(
    todo: Sequence[Job],
    *,
    jobs: int = 1,
    again: bool = False,
    progress: Progress | None = None,
) -> dict[str, dict[str, Any]]:
    """Answers of all jobs, those that are there already as they are.

    A case without a diagnosis gets an answer that says why: `error` and `out_of_time`, which are
    tried again the next time, or `refused`.

    Args:
        todo: from `jobs_of`.
        jobs: processes, of one thread each.
        again: whether answers of another torchid, or with other settings, are replaced.
        progress: called with (stage, done, total).

    Raises:
        TorchidError: answers of another torchid, or with other settings, are there.
    """
    # Answers that need not be found again.
    answers: dict[str, dict[str, Any]] = {}
    other: dict[str, str] = {}
    for one in todo:
        if not one.answer.is_file():
            continue
        old = read_json(one.answer, "an answer")
        # Why it is not one of this diagnosis.
        if old.get("version") != __version__:
            other[one.case] = f"they are of torchid {old.get('version')}, and this is {__version__}"
        elif old.get("code") != source_digest():
            other[one.case] = "the diagnosis has changed since"
        elif old.get("settings") != plain(asdict(one.settings)):
            other[one.case] = "they were found with other settings"
        elif old.get("status") not in (ERROR, LATE):
            answers[one.case] = old
    if other and not again:
        case, reason = next(iter(other.items()))
        raise TorchidError(
            f"{len(other)} of the answers there are not this diagnosis': {reason}.",
            got=f"{case}, {len(other) - 1} others" if len(other) > 1 else case,
            hint="`again=True` replaces them",
        )
    left = [job for job in todo if job.case not in answers]
    kept = len(answers)

    def say(stage: str, done: int, _: int) -> None:
        if progress is not None:
            progress(stage, kept + done, len(todo))

    new = each(diagnose_case, left, jobs, "diagnosing", say)
    answers |= {job.case: answer for job, answer in zip(left, new, strict=True)}
    return {job.case: answers[job.case] for job in todo}


def diagnose_case(job: Job) -> dict[str, Any]:
    """Diagnose one case and write its answer."""
    return written_answer(job, lambda: _answer(job))


def written_answer(job: Job, answer: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """What a method answers to a job, and what it was obtained with, written to the job's file.

    Args:
        job: which.
        answer: the method; its error becomes an answer that names nothing, for one case must not
            stop the others.
    """
    import torch

    torch.set_num_threads(1)
    begin = time.process_time()
    nothing: dict[str, Any] = {"which": []}
    try:
        with limited(job.limit):
            answered = answer()
    except OutOfTime:
        answered = {"status": LATE, **nothing, "error": f"more than {job.limit:g} CPU s"}
    except TorchidError as error:
        answered = {"status": REFUSED, **nothing, "error": str(error)}
    except Exception as error:
        answered = {"status": ERROR, **nothing, "error": f"{type(error).__name__}: {error}"}
    answered |= {
        "case": job.case,
        "settings": plain(asdict(job.settings)),
        "version": __version__,
        "code": source_digest(),
        "seconds": round(time.process_time() - begin, 2),
    }
    write_json(answered, job.answer)
    return answered


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """A block that may use so many CPU seconds of this process, whose main thread it is in.

    Raises:
        OutOfTime: it uses more.
    """

    def late(*_: object) -> None:
        raise OutOfTime

    before = signal.signal(signal.SIGPROF, late)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def _answer(job: Job) -> dict[str, Any]:
    from torchid import diagnose
    from torchid.gap.diagnosis import TorqueDiagnosis

    diagnosis = diagnose(job.robot, job.logs, before=job.earlier, settings=job.settings)
    if not isinstance(diagnosis, TorqueDiagnosis):
        return diagnosis.plain()
    corrected = {
        "effects": [dict(effect) for effect in diagnosis.corrected.effects],
        "pi": diagnosis.corrected.require_parameters("an answer").pi,
    }
    return {**diagnosis.plain(), "corrected": plain(corrected)}


def source_digest() -> str:
    """SHA-256, in hexadecimal, of the sources that a diagnosis depends on."""
    return sources(NOT_THE_DIAGNOSIS)
