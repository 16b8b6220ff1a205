"""Diagnose every case of a set. Nothing here knows where keys are, or reads one."""

import time
from collections.abc import Callable, Mapping, Sequence
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

ERROR = "error"
"""Status of a case whose diagnosis failed."""

NOT_THE_DIAGNOSIS = (
    "app", "report", "withheld", "fleet", "extraction", "wrenches", "parallel",
)  # fmt: skip
"""Rooms of torchid that a diagnosis does not depend on."""


@dataclass(frozen=True)
class Job:
    """One case to diagnose.

    Attributes:
        case: its name.
        robot, log, answer: files.
        settings: of the diagnosis.
    """

    case: str
    robot: Path
    log: Path
    answer: Path
    settings: GapSettings


def job_of(cases: CaseSet, case: str, answer: Path, settings: GapSettings | None = None) -> Job:
    """A job for a case, its answer in any file; the default if None."""
    return Job(case, cases.robot(case), cases.log(case), answer, settings or GapSettings())


def jobs_of(cases: CaseSet, settings: GapSettings) -> list[Job]:
    """A job a case."""
    return [job_of(cases, case, cases.answer(case), settings) for case in cases.ids]


def run(
    todo: Sequence[Job],
    *,
    method: Callable[[Job], dict[str, Any]] | None = None,
    jobs: int = 1,
    again: bool = False,
    progress: Progress | None = None,
) -> dict[str, dict[str, Any]]:
    """Answers of all jobs, those that are there already as they are.

    A case whose diagnosis fails gets an answer with the status `error`, which is tried again the
    next time.

    Args:
        todo: from `jobs_of`.
        method: what answers a job and writes its file; `diagnose_case` if None.
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
        elif old.get("status") != ERROR:
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

    new = each(method or diagnose_case, left, jobs, "diagnosing", say)
    answers |= {job.case: answer for job, answer in zip(left, new, strict=True)}
    return {job.case: answers[job.case] for job in todo}


def diagnose_case(job: Job) -> dict[str, Any]:
    """Diagnose one case and write its answer."""
    return written_answer(job, lambda: _answer(job), {"which": []})


def written_answer(
    job: Job, answer: Callable[[], dict[str, Any]], failed: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """What a method answers to a job, and what it was obtained with, written to the job's file.

    Args:
        job: which.
        answer: the method; its error becomes an answer, for one case must not stop the others.
        failed: what such an answer holds besides.
    """
    import torch

    torch.set_num_threads(1)
    begin = time.perf_counter()
    try:
        answered = answer()
    except Exception as error:
        answered = {"status": ERROR, **(failed or {}), "error": f"{type(error).__name__}: {error}"}
    answered |= {
        "case": job.case,
        "settings": plain(asdict(job.settings)),
        "version": __version__,
        "code": source_digest(),
        "seconds": round(time.perf_counter() - begin, 2),
    }
    write_json(answered, job.answer)
    return answered


def _answer(job: Job) -> dict[str, Any]:
    from torchid import load_robot, read_log
    from torchid.gap.torque import diagnose_torque
    from torchid.position.diagnose import diagnose_positions

    robot, log = load_robot(job.robot), read_log(job.log)
    if log.tau is None and log.u is not None:
        return diagnose_positions(robot, log).plain()
    diagnosis = diagnose_torque(robot, log, settings=job.settings)
    corrected = {
        "effects": [dict(effect) for effect in diagnosis.corrected.effects],
        "pi": diagnosis.corrected.require_parameters("an answer").pi,
    }
    return {**diagnosis.plain(), "corrected": plain(corrected)}


def source_digest() -> str:
    """SHA-256, in hexadecimal, of the sources that a diagnosis depends on."""
    return sources(NOT_THE_DIAGNOSIS)
