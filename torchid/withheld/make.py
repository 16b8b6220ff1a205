"""Write a set of cases, and seal its keys before anything is diagnosed."""

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from torchid import __version__
from torchid.errors import TorchidError
from torchid.files import atomic_write
from torchid.withheld.case_set import (
    CASES,
    KEYS_SCHEMA,
    LOG,
    ROBOT,
    CaseSet,
    case_id,
    keys_beside,
    sha256,
    write_cases,
    write_json,
)
from torchid.withheld.parallel import each

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class _CaseJob:
    """One case to write: `seed` and `number` say everything about it."""

    seed: int
    number: int
    folder: Path


def make(
    folder: Path,
    count: int,
    seed: int,
    *,
    keys: Path | None = None,
    jobs: int = 1,
    progress: Progress | None = None,
) -> CaseSet:
    """Write the first `count` cases of a seed, and their keys apart.

    A case depends on the seed and its number alone, so a smaller set is the beginning of a larger
    one. A set appears in its place when it is complete, or not at all.

    Args:
        folder: of the set; it must not exist yet, or be empty.
        count: cases.
        seed: of everything random.
        keys: file of the keys, outside the folder; `FOLDER.keys.json` if None.
        jobs: processes.
        progress: called with (stage, done, total).

    Raises:
        TorchidError: the folder or the key file is there already, or the keys would lie inside.
        MissingExtraError: the simulator is not installed.
    """
    if count < 1:
        raise TorchidError("a set has at least one case.", got=count)
    keys = keys_beside(folder) if keys is None else keys
    # Before any work is done.
    if (folder / CASES).exists():
        raise TorchidError(f"'{folder}' holds a set of cases already.", hint="another --out")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise TorchidError(f"'{folder}' is not an empty folder.", hint="another --out")
    if keys.exists():
        raise TorchidError(
            f"'{keys}' exists, and keys are never overwritten.", hint="another --keys"
        )
    if folder.resolve() in keys.resolve().parents:
        raise TorchidError(
            "the keys must not lie in the folder of the cases.", got=keys, hint="another --keys"
        )
    for above in (folder.resolve().parent, keys.resolve().parent):
        if not above.is_dir():
            raise TorchidError(f"there is no folder '{above}'.", hint=f"mkdir -p '{above}'")
    say = progress or (lambda stage, done, total: None)
    with _unfinished(folder) as place:
        todo = [_CaseJob(seed, k, place) for k in range(count)]
        found: dict[int, dict[str, Any]] = {}
        say("simulating cases", 0, count)
        for job, key in each(write_case, todo, jobs):
            found[job.number] = key
            say("simulating cases", len(found), count)
        record = {"schema": KEYS_SCHEMA, "seed": seed, "cases": [found[k] for k in range(count)]}
        sealed = sha256(write_json(record, keys))
        ids = tuple(case_id(k) for k in range(count))
        done = CaseSet(place, seed, ids, sealed, __version__)
        write_cases(done)
    return replace(done, folder=folder)


def write_case(job: _CaseJob) -> dict[str, Any]:
    """Simulate one case and write what the diagnosis may see; returns its key."""
    from torchid.withheld.plant.case import draw_case, simulate_case

    case = simulate_case(draw_case(job.seed, job.number))
    name = case_id(job.number)
    write_shown(case.urdf, case.columns, job.folder / name)
    return {"id": name} | case.key | {"id": name}


def write_shown(urdf: str, columns: Mapping[str, np.ndarray], place: Path) -> None:
    """Write what the diagnosis sees of a case: model and log."""
    place.mkdir(exist_ok=True)
    with atomic_write(place / ROBOT, "w") as text:
        text.write(urdf)
    with atomic_write(place / LOG, "wb") as file:
        import pyarrow as pa
        import pyarrow.parquet as pq

        table = pa.table({name: np.ascontiguousarray(x) for name, x in columns.items()})
        pq.write_table(table, file)


@contextmanager
def _unfinished(folder: Path) -> Iterator[Path]:
    """A folder that takes the place of `folder` only when all went well."""
    parent = folder.resolve().parent
    place = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=parent))
    place.chmod(0o755)
    try:
        yield place
        if folder.exists():
            folder.rmdir()
        os.replace(place, folder)
    except BaseException:
        shutil.rmtree(place, ignore_errors=True)
        raise
