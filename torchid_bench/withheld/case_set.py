"""A set of cases on disk: what lies in its folder, and the sealed keys beside it; how it is made.

    DIR/cases.json         {schema, seed, mix, cases: [ID...], keys_sha256, version}
    DIR/<ID>/robot.urdf    the nominal model: all that the diagnosis is told of the arm
    DIR/<ID>/log.parquet   what was measured; log-2.parquet, .. where there are more files
    DIR/<ID>/earlier.parquet   an earlier log of the arm, where there is one
    DIR/<ID>/robot.urdf.effects.yaml   rotors, where the maker's data tell them
    DIR/<ID>/answer.json   what the diagnosis said
    DIR.keys.json          {schema, seed, cases: [KEY...]}: what was planted

The SHA-256 of the key file's bytes is in cases.json from the beginning, so that whoever has both
can check that no key was changed after the answers were known.
"""

import hashlib
import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from torchid import __version__
from torchid.errors import TorchidError
from torchid.files import atomic_write
from torchid.json_data import picked, read_json, write_json
from torchid.parallel.workers import Progress, each
from torchid.robot.sidecar import sidecar_path, sidecar_yaml
from torchid_bench.withheld.plant.arms import ROBOTS

SCHEMA = "torchid.withheld/1"
KEYS_SCHEMA = "torchid.withheld.keys/1"

KEPT = ".keys"
"""Of a set that is being made: keys of its cases so far."""

MOST_BACKGROUND = 3.0
"""Beyond which it would hide every cause of standard size."""

_MIXES = {"torque": ("mixed", "release"), "position": ("mixed",)}
"""Of sets of arms, by what their logs have."""

CASES, ROBOT, LOG, ANSWER = "cases.json", "robot.urdf", "log.parquet", "answer.json"
EARLIER = "earlier.parquet"


@dataclass(frozen=True)
class CaseSet:
    """A set of cases.

    Attributes:
        folder: where it is.
        seed: that it was drawn from.
        ids: of the cases, in order of their numbers.
        keys_sha256: of the key file's bytes, in hexadecimal.
        version: of torchid that wrote it.
        mix: of its kinds of cases, `mixed` or `release`.
        kind: what its logs have: `torque`, or `position`, commands alone.
        robots: that its arms are drawn from: `arms`, `tree`, or one robot that branches.
        background: of its arms, of a cause of standard size; None of arms that are as described.
    """

    folder: Path
    seed: int
    ids: tuple[str, ...]
    keys_sha256: str
    version: str
    mix: str = "mixed"
    kind: str = "torque"
    robots: str = "arms"
    background: float | None = None

    def robot(self, case: str) -> Path:
        """The nominal model of a case."""
        return self.folder / case / ROBOT

    def logs(self, case: str) -> tuple[Path, ...]:
        """The log of a case, and its further files in order."""
        folder = self.folder / case
        return (folder / LOG, *sorted(folder.glob(f"{Path(LOG).stem}-*.parquet")))

    def earlier(self, case: str) -> Path | None:
        """The earlier log of a case, if it has one."""
        path = self.folder / case / EARLIER
        return path if path.is_file() else None

    def answer(self, case: str) -> Path:
        """The answer to a case, which may not be there yet."""
        return self.folder / case / ANSWER


def case_id(number: int) -> str:
    """The name of a case, which says nothing about it; `number` from 0."""
    return f"case-{number + 1:04d}"


def keys_beside(folder: Path) -> Path:
    """Where the keys of a set lie unless said otherwise."""
    return folder.parent / f"{folder.name}.keys.json"


def sha256(content: bytes) -> str:
    """In hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def read_cases(folder: Path) -> CaseSet:
    """A set of cases, its folders checked.

    Raises:
        TorchidError: no set of cases, or files of it are missing.
    """
    path = folder / CASES
    if not folder.is_dir():
        raise TorchidError(f"there is no folder '{folder}'.", hint="torchid withheld make")
    data = read_json(path, "a list of withheld cases")
    _check_schema(data, SCHEMA, path)
    try:
        cases = CaseSet(
            folder,
            int(data["seed"]),
            tuple(str(case) for case in data["cases"]),
            str(data["keys_sha256"]),
            str(data["version"]),
            str(data.get("mix", "mixed")),
            str(data.get("kind", "torque")),
            str(data.get("robots", "arms")),
            data.get("background"),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise TorchidError(f"'{path}' is incomplete or damaged.", got=str(error)) from error
    if not cases.ids:
        raise TorchidError(f"'{path}' lists no case.")
    for case in cases.ids:
        # Answers are written beside the logs: never outside of the set.
        if case == ".." or Path(case).name != case:
            raise TorchidError(f"'{path}' names a case that is no folder in the set.", got=case)
        for file in (cases.robot(case), *cases.logs(case)):
            if not file.is_file():
                raise TorchidError(f"the set '{folder}' is incomplete: there is no '{file}'.")
    return cases


def read_keys(cases: CaseSet, path: Path) -> list[dict[str, Any]]:
    """The keys of a set, in order of its cases.

    Raises:
        TorchidError: the file is not the one whose SHA-256 the set holds.
    """
    data = read_json(path, "a file of keys")
    digest = sha256(path.read_bytes())
    if digest != cases.keys_sha256:
        raise TorchidError(
            f"'{path}' is not the key file that was sealed with '{cases.folder}'.",
            got=f"SHA-256 {digest}",
            expected=cases.keys_sha256,
            hint="keys of another set, or changed after they were sealed",
        )
    _check_schema(data, KEYS_SCHEMA, path)
    by_id = {str(key["id"]): dict(key) for key in data["cases"]}
    if set(by_id) != set(cases.ids):
        raise TorchidError(f"'{path}' has keys of other cases than '{cases.folder}' lists.")
    return [by_id[case] for case in cases.ids]


def read_answers(cases: CaseSet) -> dict[str, dict[str, Any]]:
    """The answers that are there, by case."""
    paths = {case: cases.answer(case) for case in cases.ids}
    return {case: read_json(p, "an answer") for case, p in paths.items() if p.is_file()}


def _check_schema(data: Mapping[str, Any], schema: str, path: Path) -> None:
    if data.get("schema") != schema:
        raise TorchidError(f"'{path}' has another schema.", got=data.get("schema"), expected=schema)


def make(
    folder: Path,
    count: int,
    seed: int,
    *,
    kind: str = "torque",
    mix: str = "mixed",
    robots: str = "arms",
    background: float | None = None,
    keys: Path | None = None,
    jobs: int = 1,
    progress: Progress | None = None,
) -> CaseSet:
    """Write the first `count` cases of a seed, and their keys apart.

    A case depends on seed, kind, mix, robots, background and number alone, so a smaller set is the
    beginning of a larger one. A set appears in its place when it is complete, or not at all; one
    that was interrupted goes on where it stopped.

    Args:
        folder: of the set; it must not exist yet, or be empty.
        count: cases.
        seed: of everything random.
        kind: `torque`: logs of torques; `position`: of commands and positions alone, of twenty
            cases of arms five without an effect, nine with one, two with two, four outside the
            library.
        mix: of logs of torques. `mixed`: all kinds of cases, for development; `release`: of
            nineteen cases four without an effect, eight with one, three with two or three, four
            outside the library.
        background: instead of a mix, of arms as they are without faults on motions as people record
            them: what a fit of all usual laws, or of plain servos, leaves of it, of a cause of
            standard size [1]. Of 24 cases 4 have no effect, 12 one, 4 two, 4 one outside the
            library; half of those with torques have an earlier log.
        robots: `arms`; or `tree`: a quadruped, two arms with grippers and the upper body of a
            humanoid, or one of them by name. Of twenty cases of these five have no effect, and
            fifteen one.
        keys: file of the keys, outside the folder; `FOLDER.keys.json` if None.
        jobs: processes.
        progress: called with (stage, done, total).

    Raises:
        TorchidError: the folder or the key file is there already, or the keys would lie inside.
        MissingExtraError: the simulator is not installed.
    """
    for what, asked, known in (
        ("kind of logs", kind, _MIXES),
        (f"mix of {kind} cases", mix, _MIXES.get(kind, ())),
        ("robots", robots, ROBOTS),
    ):
        if asked not in known:
            raise TorchidError(f"unknown {what}.", got=asked, available=list(known))
    if robots != "arms" and mix != "mixed":
        raise TorchidError("robots that branch have one mix.", got=mix, expected="mixed")
    if background is not None:
        if (mix, robots) != ("mixed", "arms"):
            raise TorchidError("a background is of arms, in one mix.", got=f"{mix}, {robots}")
        if not 0 <= background <= MOST_BACKGROUND:
            expected = f"0 to {MOST_BACKGROUND:g}"
            raise TorchidError("no such background.", got=background, expected=expected)
    if count < 1:
        raise TorchidError("a set has at least one case.", got=count)
    keys = keys_beside(folder) if keys is None else keys
    _require_new(folder, keys)
    # It takes the place of `folder` when all are there; until then it keeps what is made.
    given: dict[str, Any] = {"mix": mix if kind == "torque" else kind}
    if robots != "arms":
        given = {"mix": "tree" if kind == "torque" else "tree_position", "robots": robots}
    if background is not None:
        own = "background" if kind == "torque" else "position_background"
        given = {"mix": own, "background": background}
    words = (f".{folder.name}", str(seed), *map(str, given.values()))
    place = folder.resolve().parent / "-".join(words)
    (place / KEPT).mkdir(parents=True, exist_ok=True)
    write = partial(write_drawn, place, seed, given)
    written = each(write, range(count), jobs, "simulating cases", progress)
    sealed = sha256(write_json({"schema": KEYS_SCHEMA, "seed": seed, "cases": written}, keys))
    ids = tuple(map(case_id, range(count)))
    made = CaseSet(folder, seed, ids, sealed, __version__, mix, kind, robots, background)
    data = {"schema": SCHEMA, **picked(made, "seed kind mix keys_sha256 version cases=ids")}
    if robots != "arms":
        data["robots"] = robots
    if background is not None:
        data["background"] = background
    write_json(data, place / CASES)
    # What a longer run had begun is no part of this one.
    shutil.rmtree(place / KEPT)
    for left in {path.name for path in place.iterdir()} - {CASES, *ids}:
        shutil.rmtree(place / left)
    if folder.exists():
        folder.rmdir()
    os.replace(place, folder)
    return made


def _require_new(folder: Path, keys: Path) -> None:
    """Raise TorchidError, before any work is done, where a set or its keys cannot be written."""
    other = "another `out=...`"
    if (folder / CASES).exists():
        raise TorchidError(f"'{folder}' holds a set of cases already.", hint=other)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise TorchidError(f"'{folder}' is not an empty folder.", hint=other)
    if keys.exists():
        raise TorchidError(
            f"'{keys}' exists, and keys are never overwritten.", hint="another `keys=...`"
        )
    if folder.resolve() in keys.resolve().parents:
        raise TorchidError(
            "the keys must not lie in the folder of the cases.", got=keys, hint="another `keys=...`"
        )
    for above in (folder.resolve().parent, keys.resolve().parent):
        if not above.is_dir():
            raise TorchidError(f"there is no folder '{above}'.", hint=f"mkdir -p '{above}'")


def write_drawn(folder: Path, seed: int, given: Mapping[str, Any], number: int) -> dict[str, Any]:
    """Draw one case of a seed, and write it; returns its key, which is kept until all are made."""
    kept = folder / KEPT / f"{case_id(number)}.json"
    if not kept.exists():
        write_json(write_case(folder / case_id(number), seed, number, **given), kept)
    return read_json(kept, "a key")


def write_case(place: Path, seed: int, number: int, **given: Any) -> dict[str, Any]:
    """Simulate one case and write what the diagnosis may see.

    Args:
        place: its folder, with the case's name.
        seed, number: that it is drawn from.
        given: what is not drawn, see `draw_case`.

    Returns:
        Its key.
    """
    from torchid_bench.withheld.plant.case import draw_case, simulate_case

    case = simulate_case(draw_case(seed, number, **given))
    write_shown(case.urdf, case.columns, place, case.rotors)
    for k, columns in enumerate(case.more, 2):
        write_columns(columns, place / f"{Path(LOG).stem}-{k}.parquet")
    if case.earlier is not None:
        write_columns(case.earlier, place / EARLIER)
    return {"id": place.name} | case.key | {"id": place.name}


def write_shown(
    urdf: str, columns: Mapping[str, np.ndarray], place: Path, rotors: Sequence[float] = ()
) -> None:
    """Write what the diagnosis sees of a case: model and log, and what is known of rotors (n,)
    [kg m^2]."""
    place.mkdir(exist_ok=True)
    if any(rotors):
        known = [
            {"effect": "rotor_inertia", "joint": k, "Ia": float(x)} for k, x in enumerate(rotors, 1)
        ]
        names = [f"joint{k}" for k in range(1, len(rotors) + 1)]
        path = place / ROBOT
        with atomic_write(sidecar_path(path), "w") as text:
            text.write(sidecar_yaml(path.name, names, known, None))
    with atomic_write(place / ROBOT, "w") as text:
        text.write(urdf)
    write_columns(columns, place / LOG)


def write_columns(columns: Mapping[str, np.ndarray], path: Path) -> None:
    """Write a log."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    with atomic_write(path, "wb") as file:
        table = pa.table({name: np.ascontiguousarray(x) for name, x in columns.items()})
        pq.write_table(table, file)
