"""Tables in JSON lines: an object a line, of numbers, lists of numbers and objects of these; and in
JSON, a list of such objects.

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
_ROW = '{"t": 0.0, "q": [0.1, 0.2], "tau": [1.0, 2.0]}'
_RECORDS = f"a list of objects, or one in an object: [{_ROW}, ..]"
_STAMPS = (("sec", "nanosec"), ("secs", "nsecs"))


def json_lines_table(path: Path, request: Request) -> Table:
    """The table of a file of JSON lines; a value that a line lacks is NaN.

    Lines that share no key with most of them, such as a header, are left out with a warning, and so
    is a last line that is cut.

    Raises:
        LogError: a line that is no JSON object, lists of different lengths, or no numbers.
    """
    rows: dict[int, dict[str, Any]] = {}
    with open(path, encoding="utf-8-sig") as file:
        lines = {k: line for k, line in enumerate(file, start=1) if line.strip()}
    cut = ""
    for number, line in lines.items():
        try:
            rows[number] = dict(_flat("", _object(path, f", line {number}", json.loads(line))))
        except ValueError as error:
            if len(rows) < len(lines) - 1 or not rows:
                raise _no_row(path, f", line {number}", f"not JSON: {error}", line) from None
            cut = f"'{path}': line {number} ends too soon, and is left out"
    return _table(path, "JSON lines", "line", rows, (cut,) * bool(cut))


def json_table(path: Path, request: Request) -> Table:
    """The table of a JSON file: a list of objects, or the only such list in an object.

    Raises:
        LogError: no JSON, no such list, or as `json_lines_table`.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise LogError(f"'{path}' is not JSON.", got=str(error), expected=_RECORDS) from error
    inside = data.items() if isinstance(data, Mapping) else [("", data)]
    lists = {k: x for k, x in inside if isinstance(x, list) and x and isinstance(x[0], Mapping)}
    if len(lists) != 1:
        raise LogError(
            f"'{path}' has no table: {len(lists) or 'no'} lists of objects.",
            got=", ".join(lists) or type(data).__name__,
            expected=_RECORDS,
        )
    records = next(iter(lists.values()))
    rows = {
        k: dict(_flat("", _object(path, f", entry {k}", record)))
        for k, record in enumerate(records, start=1)
    }
    return _table(path, "JSON", "entry", rows)


def _table(
    path: Path, kind: str, word: str, rows: dict[int, dict[str, Any]], said: tuple[str, ...] = ()
) -> Table:
    usual = Counter(map(tuple, rows.values())).most_common(1)[0][0] if rows else ()
    apart = [number for number, row in rows.items() if not row.keys() & set(usual)]
    for number in apart:
        del rows[number]
    names = dict.fromkeys(name for row in rows.values() for name in row)
    arrays = {name: _array(path, name, rows) for name in names}
    if not any(array.dtype.kind in "if" for array in arrays.values()):
        raise LogError(f"'{path}' has no numbers.", got=", ".join(names) or "no lines")
    if apart:
        which = ", ".join(map(str, apart[:5]))
        said = (*said, f"'{path}': {word} {which} has other keys: left out")
    return Table.in_memory(path, kind, arrays, warnings=said)


def _object(path: Path, where: str, values: Any) -> Mapping[str, Any]:
    if not isinstance(values, Mapping):
        raise _no_row(path, where, "no JSON object", json.dumps(values))
    return values


def _no_row(path: Path, where: str, why: str, text: str) -> LogError:
    return LogError(
        f"'{path}'{where}: {why}.", got=text.strip()[:60], expected=f"an object a row: {_ROW}"
    )


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
