"""What a score is compared with: simple methods, and the diagnosis that is told.

Their answers lie beside the set, not in it, and are kept as long as the diagnosis does not change.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from torchid.withheld.baselines import baseline_case
from torchid.withheld.case_set import CaseSet
from torchid.withheld.oracle import told
from torchid.withheld.run import Job, Progress, default_settings, run


def beside(cases: CaseSet, what: str) -> Path:
    """The folder of what belongs to a set but must not lie in it; made if it is not there."""
    folder = cases.folder.parent / f"{cases.folder.name}.{what}"
    folder.mkdir(exist_ok=True)
    return folder


def baseline_answers(
    cases: CaseSet, wanted: Sequence[str], jobs: int, progress: Progress | None
) -> dict[str, dict[str, Any]]:
    """Records of `baselines.baseline_case`, by case."""
    folder = beside(cases, "baselines")
    todo = [_job(cases, case, folder) for case in wanted]
    return run(todo, method=baseline_case, jobs=jobs, again=True, progress=progress)


def oracle_answers(
    cases: CaseSet,
    keys: Sequence[dict[str, Any]],
    wanted: Sequence[str],
    jobs: int,
    progress: Progress | None,
) -> dict[str, dict[str, Any]]:
    """Answers of the diagnosis that is told, by case with one effect of the library."""
    folder = beside(cases, "oracle")
    todo = []
    for key in keys:
        settings = told(key, default_settings()) if key["kind"] == "single" else None
        if settings is not None and key["id"] in wanted:
            todo.append(_job(cases, key["id"], folder, settings))
    return run(todo, jobs=jobs, again=True, progress=progress)


def _job(cases: CaseSet, case: str, folder: Path, settings: Any = None) -> Job:
    settings = default_settings() if settings is None else settings
    return Job(case, cases.robot(case), cases.log(case), folder / f"{case}.json", settings)
