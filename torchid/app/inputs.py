"""What a command reads and writes, checked before torch is loaded: a typing error costs half a
second.

An option's annotation says what its file is: `WRITTEN` a result, with its `Suffix` if it must have
one of some; `PLACE` a folder that is neither an input nor a result; `RECORDED` a log, `ROBOT` a
robot, `MODEL` a robot or a result. All other paths are inputs, too.
"""

import os
import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchid.errors import RobotError, TorchidError
from torchid.files import require_writable, rows_file, similar_files
from torchid.robot.config_files import names_robot, require_robot_file

if TYPE_CHECKING:
    from torchid.app.signature import Option

WRITTEN, PLACE = "a file that is written", "a folder to work in"
RECORDED, ROBOT, MODEL = "a log that is read", "a robot", "a robot or a result"
_RESULTS = ("RESULT", "RESULT...")
_SHOWN = 8
"""Of files that are in the way, those that an error names."""


@dataclass(frozen=True)
class Suffix:
    """Suffixes of a file that is written, which later readers go by."""

    names: tuple[str, ...]
    hint: str | None = None

    def require(self, option: str, path: Path) -> None:
        """Raise a TorchidError if a file would not be called what it will be."""
        if path.suffix.lower() not in self.names:
            raise TorchidError(
                f"{option} writes another kind of file.",
                got=str(path),
                expected=" or ".join(f"FILE{name}" for name in self.names),
                hint=self.hint,
            )


def _given(options: "Sequence[Option]", given: Mapping[str, Any]) -> "Iterator[tuple[Option, Any]]":
    """The options that are given, with each of their values."""
    for option in options:
        value = given[option.name]
        for one in value if isinstance(value, list | tuple) else [value]:
            if one is not None and one != "":
                yield option, one


def inputs_of(options: "Sequence[Option]", given: Mapping[str, Any]) -> list[Path]:
    """Files and folders that a command is told to read; what is given as text only where it is the
    name of a file. Of a folder of results the JSON files are read, and no page beside them."""
    files: list[Path] = []
    for option, one in _given(options, given):
        if WRITTEN in option.said or PLACE in option.said:
            continue
        if isinstance(one, Path) and "RESULT" in (option.info.metavar or "") and one.is_dir():
            files += one.rglob("*.json")
        elif isinstance(one, Path) or (isinstance(one, str) and os.path.isfile(one)):
            files.append(Path(one))
    return files


def require_apart(options: "Sequence[Option]", given: Mapping[str, Any]) -> None:
    """Raise a TorchidError where two results are to be written to one file, or a result to what is
    named as a folder."""
    named = [option for option in options if given[option.name] is not None]
    results = [option for option in named if WRITTEN in option.said]
    taken: dict[str, str] = {}
    for option in [*results, *(o for o in named if PLACE in o.said)]:
        path = os.path.realpath(given[option.name])
        # Two places may be one folder.
        other_of = taken.setdefault if option in results else taken.get
        if (other := other_of(path, option.shown)) != option.shown:
            raise TorchidError(
                f"{option.shown} and {other} name the same file.", got=given[option.name]
            )


def require_results(options: "Sequence[Option]", given: Mapping[str, Any]) -> None:
    """Raise a TorchidError where a result cannot be written, would take the place of an input, or
    has another suffix than its kind."""
    for option, path in _given(options, given):
        if WRITTEN in option.said:
            # The folder of --out is made where it is missing, also for what goes into it.
            if path.parent != given.get("out") or path.parent.exists():
                require_writable(path, option.shown)
            for suffix in option.said:
                if isinstance(suffix, Suffix):
                    suffix.require(option.shown, path)


def require_inputs(options: "Sequence[Option]", given: Mapping[str, Any]) -> None:
    """Raise a TorchidError where a robot, a log or another file is not there; it names those that
    may be meant."""
    named = list(_given(options, given))
    for option, one in named:
        if not isinstance(one, str | Path):
            continue
        path, said = Path(one), set(option.said)
        model = MODEL in said and path.suffix.lower() != ".json" and not path.exists()
        if ROBOT in said or model:
            _require_robot(str(one), [str(other) for _, other in named])
        elif RECORDED in said:
            from torchid.log.readers import require_log

            require_log(path)
        elif option.info.metavar in _RESULTS and MODEL not in said and path.is_file():
            from torchid.results.files import require_result

            require_result(path)
        elif (
            not path.exists()
            and (MODEL in said or option.takes_paths)
            and not said & {WRITTEN, PLACE}
        ):
            near = similar_files(path)
            raise TorchidError(
                f"'{one}' cannot be read: there is no such file.",
                hint=f"did you mean {near[0]}?" if near else None,
            )


def _require_robot(name: str, others: Sequence[str]) -> None:
    try:
        require_robot_file(name)
    except RobotError as error:
        robots = [other for other in others if names_robot(other)]
        if Path(name).exists() and robots and not names_robot(name):
            logs = [other for other in others if other not in robots and Path(other).exists()]
            line = shlex.join(["torchid", *sys.argv[1:2], robots[0], *logs])
            raise RobotError(f"'{name}' is no robot, which comes first.", hint=line) from None
        raise error from None


def require_free(given: Mapping[str, Any], results: Sequence[str]) -> None:
    """Raise a TorchidError where a folder holds the results of an earlier run, or a model is there
    already: nothing is written over unless `--overwrite` says so.

    Args:
        given: values of the options.
        results: names of files in the folder that --out names.
    """
    folder, model = given.get("out"), given.get("save_model")
    files = [] if model is None else [model, rows_file(model)]
    taken = [str(file) for file in files if file.exists()]
    if folder is not None:
        names = [name.format(**given) for name in results]
        if any((folder / name).exists() for name in names):
            inside = sorted(path.name for path in folder.iterdir() if path.is_file())
            taken += [str(folder / name) for name in inside]
    if taken:
        more = [f"and {len(taken) - _SHOWN} more"] if len(taken) > _SHOWN else []
        line = shlex.join(["torchid", *sys.argv[1:], "--overwrite"])
        raise TorchidError(
            "the results of an earlier run would be written over.",
            got=", ".join([*taken[:_SHOWN], *more]),
            hint=f"another name or folder, or: {line}",
        )
