"""A set of cases on disk: what lies in its folder, and the sealed keys beside it.

    DIR/cases.json         {schema, seed, cases: [ID...], keys_sha256, version}
    DIR/<ID>/robot.urdf    the nominal model: all that the diagnosis is told of the arm
    DIR/<ID>/log.parquet   what was measured
    DIR/<ID>/answer.json   what the diagnosis said
    DIR.keys.json          {schema, seed, cases: [KEY...]}: what was planted

The SHA-256 of the key file's bytes is in cases.json from the beginning, so that whoever has both
can check that no key was changed after the answers were known.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from torchid.errors import TorchidError
from torchid.json_data import read_json, write_json

SCHEMA = "torchid.withheld/1"
KEYS_SCHEMA = "torchid.withheld.keys/1"

CASES, ROBOT, LOG, ANSWER = "cases.json", "robot.urdf", "log.parquet", "answer.json"


@dataclass(frozen=True)
class CaseSet:
    """A set of cases.

    Attributes:
        folder: where it is.
        seed: that it was drawn from.
        ids: of the cases, in order of their numbers.
        keys_sha256: of the key file's bytes, in hexadecimal.
        version: of torchid that wrote it.
    """

    folder: Path
    seed: int
    ids: tuple[str, ...]
    keys_sha256: str
    version: str

    def robot(self, case: str) -> Path:
        """The nominal model of a case."""
        return self.folder / case / ROBOT

    def log(self, case: str) -> Path:
        """The log of a case."""
        return self.folder / case / LOG

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


def write_cases(found: CaseSet) -> None:
    """Write cases.json of a set."""
    data = {"schema": SCHEMA, **asdict(found), "cases": list(found.ids)}
    del data["folder"], data["ids"]
    write_json(data, found.folder / CASES)


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
        found = CaseSet(
            folder,
            int(data["seed"]),
            tuple(str(case) for case in data["cases"]),
            str(data["keys_sha256"]),
            str(data["version"]),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise TorchidError(f"'{path}' is incomplete or damaged.", got=str(error)) from error
    if not found.ids:
        raise TorchidError(f"'{path}' lists no case.")
    for case in found.ids:
        for file in (found.robot(case), found.log(case)):
            if not file.is_file():
                raise TorchidError(f"the set '{folder}' is incomplete: there is no '{file}'.")
    return found


def read_keys(found: CaseSet, path: Path) -> list[dict[str, Any]]:
    """The keys of a set, in order of its cases.

    Raises:
        TorchidError: the file is not the one whose SHA-256 the set holds.
    """
    data = read_json(path, "a file of keys")
    digest = sha256(path.read_bytes())
    if digest != found.keys_sha256:
        raise TorchidError(
            f"'{path}' is not the key file that was sealed with '{found.folder}'.",
            got=f"SHA-256 {digest}",
            expected=found.keys_sha256,
            hint="keys of another set, or changed after they were sealed",
        )
    _check_schema(data, KEYS_SCHEMA, path)
    by_id = {str(key["id"]): dict(key) for key in data["cases"]}
    if set(by_id) != set(found.ids):
        raise TorchidError(f"'{path}' has keys of other cases than '{found.folder}' lists.")
    return [by_id[case] for case in found.ids]


def read_answers(found: CaseSet) -> dict[str, dict[str, Any]]:
    """The answers that are there, by case."""
    paths = {case: found.answer(case) for case in found.ids}
    return {case: read_json(p, "an answer") for case, p in paths.items() if p.is_file()}


def _check_schema(data: Mapping[str, Any], schema: str, path: Path) -> None:
    if data.get("schema") != schema:
        raise TorchidError(f"'{path}' has another schema.", got=data.get("schema"), expected=schema)
