"""From the sources of a mapping to columns t, q1, q2, ... in our units."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np

from torchid.errors import LogError
from torchid.log.columns import first_names, numbers_of, seconds
from torchid.log.mapping import Source
from torchid.log.table import AbsentColumnError, Table, natural

_NUMBERED = re.compile(r"\{(j0?|\d+\.\.\d+|\d+(?:\s*,\s*\d+)+)\}")
_INDEXED = re.compile(r"(.+?)\[([^,\[\]]+|\[[\d,\s]+\]),([^,\[\]]+|\[[\d,\s]+\])\]")

Index = slice | list[int]


@dataclass(frozen=True)
class Piece:
    """A column, an array, or some columns or rows of one; or a column and another one that is added
    to it `times` times."""

    name: str
    columns: Index | None = None
    rows: Index | None = None
    other: str | None = None
    times: float = 1.0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns that the piece is made of."""
        return (self.name,) if self.other is None else (self.name, self.other)

    def of(self, array: np.ndarray, label: str) -> np.ndarray:
        """The part of the array."""
        if self.columns is None and self.rows is None:
            return array
        if array.ndim != 2:
            raise LogError(f"{label} is no table to take columns of.", got=f"shape {array.shape}")
        index = self.columns if self.columns is not None else self.rows
        part = array if self.columns is not None else array.T
        if isinstance(index, list) and max(index) >= part.shape[1]:
            raise LogError(f"{label} has no column {max(index)}.", got=f"shape {array.shape}")
        column = part[:, index]
        if column.shape[1] == 0:
            raise LogError(f"{label}: no column is left.", got=f"shape {array.shape}")
        return column


def resolve(key: str, source: Source, table: Table) -> tuple[Piece, ...]:
    """What a source names in a table.

    Raises:
        LogError: it is not there; the message lists what is, the nearest names first.
    """
    if source.rate is not None:
        return ()
    if len(source.columns) == 1 and (pattern := _NUMBERED.search(source.columns[0])):
        return tuple(Piece(name) for name in _numbered(key, source.columns[0], pattern[1], table))
    return tuple(_piece(key, column, table) for column in source.columns)


def _piece(key: str, text: str, table: Table) -> Piece:
    if text in table.columns:
        return Piece(text)
    for m in re.finditer("[-+]", text):
        one, other = text[: m.start()].strip(), text[m.end() :].strip()
        if one in table.columns and other in table.columns:
            return Piece(one, other=other, times=-1.0 if m[0] == "-" else 1.0)
    match = _INDEXED.fullmatch(text)
    if match is None or match[1] not in table.columns:
        raise _absent(key, match[1] if match else text, table)
    rows, columns = _index(match[2]), _index(match[3])
    if rows is None or columns is None or (rows == slice(None)) == (columns == slice(None)):
        raise LogError(
            f"`columns=...`: {key} cannot be understood.",
            got=text,
            expected=f"columns {match[1]}[:,0:7] or {match[1]}[:,[2,0,1]], counted from 0; "
            f"{match[1]}[0:7,:] where they are rows",
        )
    name = match[1]
    return Piece(name, columns=columns) if rows == slice(None) else Piece(name, rows=rows)


def _index(text: str) -> Index | None:
    text = text.strip()
    if re.fullmatch(r"\d+", text):
        return [int(text)]
    if re.fullmatch(r"\[[\d,\s]+\]", text):
        return [int(part) for part in text.strip("[]").split(",") if part.strip()] or None
    if re.fullmatch(r"-?\d*:-?\d*(:-?[1-9]\d*)?", text):
        return slice(*(int(part) if part else None for part in text.split(":")))
    return None


def _numbered(key: str, text: str, numbers: str, table: Table) -> list[str]:
    """The columns of a pattern with {j}, {j0}, {2..7} or {3,1,2}."""
    parts = [re.escape(part) for part in _NUMBERED.sub("\0", text).split("\0")]
    # The same number wherever it stands; leading zeros do not matter.
    pattern = re.compile(r"0*(\d+)".join(parts[:2]) + "".join(r"0*\1" + p for p in parts[2:]))
    numbered = {int(m[1]): name for name in table.columns if (m := pattern.fullmatch(name))}
    counted = numbers in ("j", "j0")
    if ".." in numbers:
        first, last = (int(part) for part in numbers.split(".."))
        wanted = list(range(first, last + 1))
    elif counted:
        start = 1 if numbers == "j" else 0
        wanted = list(range(start, start + len(numbered)))
    else:
        wanted = [int(part) for part in numbers.split(",")]
        if len(set(wanted)) < len(wanted):
            raise LogError(f"`columns=...`: {key} names a column twice.", got=text)
    missing = [k for k in wanted if k not in numbered]
    if missing or not wanted:
        got = sorted(numbered.values(), key=natural)
        hint = None
        if 0 in numbered and numbers == "j":
            hint = f"{{j0}} counts from 0: {key}={text.replace('{j}', '{j0}')}"
        elif numbered and counted:
            ks = sorted(numbered)
            picked = ",".join(map(str, ks)) if ks[-1] - ks[0] >= len(ks) else f"{ks[0]}..{ks[-1]}"
            hint = f"numbers in braces pick some: {_NUMBERED.sub(f'{{{picked}}}', text)}"
        absent = [_NUMBERED.sub(str(k), text) for k in missing] if numbered else []
        raise _absent(key, text, table, got=", ".join(got[:20]) or None, hint=hint, missing=absent)
    return [numbered[k] for k in wanted]


def _absent(
    key: str,
    text: str,
    table: Table,
    got: str | None = None,
    hint: str | None = None,
    missing: Sequence[str] = (),
) -> AbsentColumnError:
    plain = {re.sub(r"\d+", "", name).lower(): name for name in table.columns}
    wanted = re.sub(r"\d+", "", _NUMBERED.sub("", text)).lower()
    near = [plain[name] for name in get_close_matches(wanted, list(plain), n=3, cutoff=0.5)]
    if near and hint is None:
        hint = f"nearest: {', '.join(near)}"
    what = f"no columns {text} in order" if _NUMBERED.search(text) else f"no column '{text}'"
    return AbsentColumnError(
        f"'{table.path}' has {what}, which the mapping of {key} names"
        + (f": {', '.join(first_names(missing, 5))} missing." if missing else "."),
        got=got,
        available=table.described,
        hint=hint,
    )


def time_of(
    source: Source, pieces: Sequence[Piece], arrays: Mapping[str, np.ndarray], table: Table
) -> np.ndarray:
    """(T,) seconds from a column of numbers, of time stamps or of their text."""
    raw, label = _one_column("t", pieces, arrays, table)
    if raw.dtype.kind == "O":
        try:
            raw = np.array(raw, dtype="datetime64[ns]")
        except ValueError:
            numbers_of(raw, label)
    if raw.dtype.kind in "mM":
        # From the first stamp on; durations as they are.
        since = raw - raw[:1] if raw.dtype.kind == "M" else raw
        return since / np.timedelta64(1, "ns") * 1e-9
    return seconds(numbers_of(raw, label), source.factors[0], source.offsets[0])


def labels_of(
    pieces: Sequence[Piece], arrays: Mapping[str, np.ndarray], table: Table
) -> np.ndarray:
    """(T,) whole numbers of trajectories; other labels are numbered as they come."""
    raw, _ = _one_column("traj", pieces, arrays, table)
    if raw.dtype.kind in "iuf":
        return raw
    known: dict[object, int] = {}
    return np.array([known.setdefault(value, len(known)) for value in raw.tolist()])


def signal_of(
    key: str, source: Source, pieces: Sequence[Piece], arrays: Mapping, samples: int, table: Table
) -> np.ndarray:
    """(T, n) of a joint signal in our units."""
    parts = []
    for piece in pieces:
        label = f"'{table.path}': column {piece.name}"
        part = samples_first(numbers_of(piece.of(arrays[piece.name], label), label), samples, label)
        if piece.other is not None:
            label = f"'{table.path}': column {piece.other}"
            added = samples_first(numbers_of(arrays[piece.other], label), samples, label)
            part = part + piece.times * added
        parts.append(part)
    if len({len(part) for part in parts}) > 1 or len(parts[0]) != samples:
        lengths = [f"{piece.name}: {len(part)}" for piece, part in zip(pieces, parts, strict=True)]
        raise LogError(
            f"'{table.path}': the columns of {key} have another length than t.",
            got=", ".join(lengths[:10]),
            expected=samples,
        )
    whole = np.concatenate(parts, 1).astype(np.float64)
    for values, word in ((source.factors, "factors"), (source.offsets, "offsets")):
        if len(values) not in (1, whole.shape[1]):
            raise LogError(
                f"the mapping of {key} has another number of {word} than columns.",
                got=len(values),
                expected=f"1 or {whole.shape[1]}",
            )
    if source.offsets != (0.0,):
        whole = whole + np.array(source.offsets)
    return whole if source.factors == (1.0,) else whole * np.array(source.factors)


def samples_first(array: np.ndarray, samples: int, label: str) -> np.ndarray:
    """(T, n), also where the file has it the other way round, or one column only."""
    if array.ndim == 1:
        return array[:, None]
    if array.ndim != 2:
        raise LogError(
            f"{label} has the wrong number of dimensions.",
            got=f"shape {array.shape}",
            expected="(samples,) or (samples, joints)",
        )
    return array.T if array.shape[0] != samples and array.shape[1] == samples else array


def _one_column(
    key: str, pieces: Sequence[Piece], arrays: Mapping[str, np.ndarray], table: Table
) -> tuple[np.ndarray, str]:
    """(T,) of a source that must be one column, and what to call it."""
    label = f"'{table.path}': column {pieces[0].name}"
    array = pieces[0].of(arrays[pieces[0].name], label)
    if len(pieces) > 1 or array.ndim not in (1, 2) or (array.ndim == 2 and 1 not in array.shape):
        raise LogError(
            f"'{table.path}': {key} is one column.",
            got=", ".join(f"{p.name} {arrays[p.name].shape}" for p in pieces[:5]),
        )
    return array.ravel(), label
