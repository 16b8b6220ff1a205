"""Tables in JSON lines: an object a line, of numbers, lists of numbers and objects of these.

What is within objects has dots in its name, `state.q`. Lists beside one of joint names, as in a
message of joint states, become a column for each joint, `elbow.position`; a stamp of sec and
nanosec is one of seconds.
"""

import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from torchid.errors import LogError
from torchid.log.table import Request, Table

_NAMES = ("name", "names", "joint_names", "joints")
_STAMPS = (("sec", "nanosec"), ("secs", "nsecs"))


def json_lines_table(path: Path, request: Request) -> Table:
    """The table of a file of JSON lines; a value that a line lacks is NaN.

    Lines that share no key with most of them, such as a header, are left out with a warning.

    Raises:
        LogError: a line that is no JSON object, lists of different lengths, or no numbers.
    """
    rows: dict[int, dict[str, Any]] = {}
    with open(path, encoding="utf-8-sig") as file:
        for number, line in enumerate(file, start=1):
            if line.strip():
                rows[number] = _row(path, number, line)
    usual = Counter(map(tuple, rows.values())).most_common(1)[0][0] if rows else ()
    apart = [number for number, row in rows.items() if not row.keys() & set(usual)]
    for number in apart:
        del rows[number]
    names = dict.fromkeys(name for row in rows.values() for name in row)
    arrays = {name: _array(path, name, rows) for name in names}
    if not any(array.dtype.kind in "if" for array in arrays.values()):
        raise LogError(f"'{path}' has no numbers.", got=", ".join(names) or "no lines")
    said = f"'{path}': line {', '.join(map(str, apart[:5]))} has other keys: left out"
    return Table.in_memory(path, "JSON lines", arrays, warnings=(said,) * bool(apart))


def _row(path: Path, number: int, line: str) -> dict[str, Any]:
    try:
        values, why = json.loads(line), "no JSON object"
    except ValueError as error:
        values, why = None, f"not JSON: {error}"
    if not isinstance(values, Mapping):
        raise LogError(
            f"'{path}', line {number}: {why}.",
            got=line.strip()[:60],
            expected='an object a line: {"t": 0.0, "q": [0.1, 0.2], "tau": [1.0, 2.0]}',
        )
    return dict(_flat("", values))


def _flat(prefix: str, values: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Names and numbers, or lists, of an object and of those within it."""
    lists = [values[key] for key in _NAMES if isinstance(values.get(key), list) and values[key]]
    joints = next((names for names in lists if all(isinstance(x, str) for x in names)), None)
    for key, value in values.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            stamp = next((pair for pair in _STAMPS if set(value) == set(pair)), None)
            if stamp is not None and all(isinstance(value[part], int) for part in stamp):
                yield name, value[stamp[0]] + 1e-9 * value[stamp[1]]
            else:
                yield from _flat(f"{name}.", value)
        elif joints is not None and isinstance(value, list):
            if len(value) == len(joints) and value is not joints:
                yield from ((f"{joint}.{key}", x) for joint, x in zip(joints, value, strict=True))
        elif not (isinstance(value, list) and not value):
            yield name, value


def _array(path: Path, name: str, rows: Mapping[int, Mapping[str, Any]]) -> np.ndarray:
    """(T,) or (T, k) of what lines have by a name; objects where it is no number."""
    given = {number: row[name] for number, row in rows.items() if row.get(name) is not None}
    width = next((len(x) for x in given.values() if isinstance(x, list)), None)
    for number, value in given.items():
        length = len(value) if isinstance(value, list) else None
        if length != width:
            raise LogError(
                f"'{path}', line {number}: {name} is not as long as in the lines before.",
                got="a number" if length is None else f"{length} values",
                expected="a number" if width is None else f"{width} values",
            )
    missing = math.nan if width is None else [math.nan] * width
    values = [given.get(number, missing) for number in rows]
    try:
        whole = width is None and all(type(value) is int for value in values)
        return np.array(values, dtype=np.int64 if whole else np.float64)
    except (TypeError, ValueError, OverflowError):
        objects = np.empty(len(values), dtype=object)
        objects[:] = values
        return objects
