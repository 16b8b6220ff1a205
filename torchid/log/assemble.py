"""A Log from a table: columns that have our names, and those that a mapping gives other sources."""

import re
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

import torchid
from torchid.errors import LogError
from torchid.log.columns import (
    PREFIXES,
    first_names,
    is_wanted,
    joint_columns,
    log_from_columns,
)
from torchid.log.guess import commanded_columns, proposed_mapping, torques_among
from torchid.log.mapping import KEYS, SENSORLESS, ColumnMapping, Source, read_mapping
from torchid.log.motor_off import enabling_columns, while_on
from torchid.log.sources import (
    Piece,
    labels_of,
    resolve,
    samples_first,
    signal_of,
    time_of,
)
from torchid.log.table import AbsentColumnError, Table, natural

OTHER_NAMES = " has no torque by our names"
"""What is said of a table that has torque, or current, by another name beside our own q."""
_ARRAYS = {prefix: prefix for prefix in (*PREFIXES.values(), "ext")} | {"current": "i"}


def log_from_table(
    table: Table, mapping: ColumnMapping | None = None, joints: Sequence[str] = ()
) -> "torchid.Log":
    """The Log of a table.

    Args:
        table: of any format.
        mapping: for columns that do not have our names; it goes before those that do. Without one,
            names that leave one way to read them are read so.
        joints: names of the robot's, by which a mapping is proposed; empty where it is not known.

    Raises:
        LogError: a column is missing (the message proposes a mapping where it can guess one),
            or is not what `log_from_columns` expects.
    """
    free, mapping = mapping is None, mapping or ColumnMapping({})
    commands, notes = _commands(table, mapping), table.warnings
    try:
        values = _wildcards(table, mapping)
        if values is not None:
            logs = []
            for value in values:
                log, stem = _read(table, mapping.at(value)), table.path.stem
                names = [name.replace(stem, f"{stem}[{value}]", 1) for name in log.names]
                logs.append(log.replace(names=tuple(names)))
            log = torchid.Log.concatenate(logs)
        elif commands is None:
            log = _read(table, mapping)
        else:
            try:
                sources = {**mapping.sources, **read_mapping(commands).sources}
                log = _read(table, ColumnMapping(sources, mapping.text))
                notes = (*notes, f"'{table.path}': {commands}, by the name")
            except LogError:  # of other joints, or no numbers: no reason to refuse the rest
                log = _read(table, mapping)
    except LogError as error:
        if error.available is None:
            raise
        guessed = proposed_mapping(table, joints) if free else None
        if guessed is None or guessed[1]:
            raise _with_help(error, table, joints) from None
        # The names leave one way to read it.
        try:
            log = log_from_table(table, read_mapping(guessed[0]), joints)
        except LogError:
            raise _with_help(error, table, joints) from None
        notes = (*notes, f"'{table.path}' is read by the names of its columns: {guessed[0]}")
    if free and log.tau is None and log.current is None and (own := _torque(table)):
        notes = (*notes, f"'{table.path}'{OTHER_NAMES}: perhaps `columns=\"{own}\"`")
    if free and log.tau is not None and (others := torques_among(unused_columns(table))):
        notes = (*notes, f"'{table.path}' has other torques, left aside: {', '.join(others)}")
    warnings = tuple(dict.fromkeys((*log.warnings, *notes)))
    return log.replace(source=str(table.path), warnings=warnings, servos=table.servos)


def require_columns(table: Table, mapping: ColumnMapping | None = None) -> None:
    """Refuse a table without t, q and what a mapping names, before anything of it is read.

    Raises:
        LogError: it has not, and no mapping can be proposed, for which the robot's joints count.
    """
    mapping = mapping or ColumnMapping({})
    try:
        sources, _, own = _plan(table, _first_of(table, mapping))
        if not (sources or table.arrays or _sensorless(mapping)):
            joint_columns(own, table.path)
    except LogError as error:
        if proposed_mapping(table) is None:
            raise (_with_help(error, table, ()) if error.available is not None else error) from None


def _commands(table: Table, mapping: ColumnMapping) -> str | None:
    """Columns of commanded positions that are taken for u by their names: beside our own q, where
    no torque is, and nothing else says what u is."""
    own = {re.sub(r"\d+$", "", name) for name in table.columns}
    if "q" not in own or own & {"u", "tau"} or mapping.sources.keys() & {"q", "u", "tau"}:
        return None
    return commanded_columns(table)


def _torque(table: Table) -> str | None:
    """A text for --columns that names torque, or current, which has another name than ours beside
    our own q; None where there is none."""
    guessed = proposed_mapping(table) if {"t", "q1"} <= table.columns.keys() else None
    if guessed is None or not read_mapping(guessed[0]).sources.keys() & {"tau", "i"}:
        return None
    return guessed[0]


def _read(table: Table, mapping: ColumnMapping) -> "torchid.Log":
    sources, pieces, own = _plan(table, mapping)
    needed = _needed(pieces, own)
    twice = [name for name in needed if name in table.repeated]
    if twice:
        raise LogError(f"'{table.path}' has two columns {twice[0]}.", got=", ".join(twice))
    if table.one_by_one and not (sources or _sensorless(mapping)):
        return log_from_columns(_Columns(table, own), table.path)
    arrays = table.read(needed)
    columns: dict[str, np.ndarray] = {}
    if "t" in sources and sources["t"].rate is None:
        columns["t"] = time_of(sources["t"], pieces["t"], arrays, table)
    elif "t" in own:
        columns |= _own_columns(table, {"t": arrays["t"]}, -1)
    lengths = [max(array.shape) for array in arrays.values() if array.ndim]
    samples = len(columns["t"]) if "t" in columns else max(lengths, default=0)
    if "t" in sources and sources["t"].rate is not None:
        columns["t"] = np.arange(samples) / sources["t"].rate
    if "traj" in sources:
        columns["traj"] = labels_of(pieces["traj"], arrays, table)
    rest = {name: arrays[name] for name in own if name != "t"}
    columns |= _own_columns(table, rest, samples)
    for key in [key for key in sources if key not in ("t", "traj")]:
        values = signal_of(key, sources[key], pieces[key], arrays, samples, table)
        if key in KEYS:
            columns |= {f"{key}{k + 1}": values[:, k] for k in range(values.shape[1])}
        else:  # of one joint
            columns[key] = values[:, 0]
    columns = _with_sensorless(columns, sources, mapping)
    switches = list(table.read(enabling_columns(table)).values())
    left, notes = while_on(columns, switches, f"'{table.path}'")
    log = log_from_columns(left, table.path)
    return log.replace(warnings=(*log.warnings, *notes)) if notes else log


def _with_sensorless(
    columns: dict[str, np.ndarray], sources: Mapping[str, Source], mapping: ColumnMapping
) -> dict[str, np.ndarray]:
    """Columns with zeros for the torque of joints that have no sensor; where a mapping lists the
    others alone, they are in their order."""
    none = _sensorless(mapping)
    for prefix in dict.fromkeys(key.rstrip("0123456789") for key in none):
        joints = sum(re.fullmatch(r"q\d+", name) is not None for name in columns)
        names = [f"{prefix}{k + 1}" for k in range(joints)]
        listed = [name for name in names if name in columns]
        measured = [name for name in names if name not in none]
        if prefix in sources and len(listed) == len(measured):
            values = [columns.pop(name) for name in listed]
            columns |= dict(zip(measured, values, strict=True))
        if measured and all(name in columns for name in measured):
            columns |= {name: np.zeros(len(columns["q1"])) for name in names if name in none}
    return columns


def _sensorless(mapping: ColumnMapping) -> list[str]:
    """Torques and currents of single joints that a mapping says have no sensor."""
    return [key for key in mapping.sources if SENSORLESS.fullmatch(key)]


class _Columns(Mapping[str, np.ndarray]):
    """Columns with our names, each read when it is asked for, so that no more than one is in memory
    beside the log that is made of them."""

    def __init__(self, table: Table, names: Sequence[str]):
        self._table, self._names = table, names

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self._names:
            raise KeyError(name)
        return _own_columns(self._table, self._table.read([name]), -1)[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


def unused_columns(table: Table, mapping: ColumnMapping | None = None) -> list[str]:
    """The columns that `log_from_table` leaves where they are."""
    own = table.columns.keys()
    if mapping is None and not ("t" in own and {"q", "q1"} & own):
        guessed = proposed_mapping(table)  # by which it was read
        mapping = read_mapping(guessed[0]) if guessed and not guessed[1] else None
    mapping = mapping or ColumnMapping({})
    values = _wildcards(table, mapping)
    parts = [mapping] if values is None else [mapping.at(value) for value in values]
    taken = {name for part in parts for name in _needed(*_plan(table, part)[1:])}
    return [name for name in table.columns if name not in taken]


def _plan(
    table: Table, mapping: ColumnMapping
) -> tuple[dict[str, Source], dict[str, tuple[Piece, ...]], list[str]]:
    """The sources of a mapping, what they name, and the columns that have our names and that the
    mapping does not replace."""
    sources = {key: source for key, source in mapping.sources.items() if source is not None}
    pieces = {key: resolve(key, source, table) for key, source in sources.items()}
    arrays = _ARRAYS if table.arrays else {}
    own = [
        name
        for name in table.columns
        if (is_wanted(name) or name in arrays)
        and _ARRAYS.get(name, re.sub(r"\d+$", "", name)) not in mapping.sources
        and name not in mapping.sources
    ]
    return sources, pieces, own


def _needed(pieces: Mapping[str, tuple[Piece, ...]], own: list[str]) -> list[str]:
    named = [name for group in pieces.values() for piece in group for name in piece.names]
    return list(dict.fromkeys([*own, *named]))


def _own_columns(
    table: Table, arrays: Mapping[str, np.ndarray], samples: int
) -> dict[str, np.ndarray]:
    """Columns t, q1, q2, ... of arrays that have our names: (T,) is one, (T, n) are n."""
    columns: dict[str, np.ndarray] = {}
    for name, array in arrays.items():
        signal, label = _ARRAYS.get(name), f"'{table.path}': array {name}"
        column = array.ndim == 1 or (array.ndim == 2 and 1 in array.shape)
        if signal is None and not column:
            raise LogError(
                f"{label} has the wrong number of dimensions.",
                got=f"shape {array.shape}",
                expected="(samples,)",
            )
        whole = samples_first(array if signal else array.ravel(), samples, label)
        for k in range(whole.shape[1]):
            own = name if signal is None else f"{signal}{k + 1}"
            if own in columns:
                raise LogError(f"'{table.path}' gives {own} twice, as an array and alone.")
            columns[own] = whole[:, k]
    return columns


def _first_of(table: Table, mapping: ColumnMapping) -> ColumnMapping:
    """The mapping with the first of what its `*` may stand for."""
    values = _wildcards(table, mapping)
    return mapping if values is None else mapping.at(values[0])


def _wildcards(table: Table, mapping: ColumnMapping) -> list[str] | None:
    """What `*` in the mapping may stand for, in order; None where there is no `*`."""
    texts = [
        re.sub(r"\[[^\]]*,.*\]$", "", column)
        for source in mapping.sources.values()
        if source is not None
        for column in source.columns
        if "*" in column and column not in table.columns
    ]
    if not texts:
        return None
    filled: list[set[str]] = []
    for text in texts:
        start, *ends = re.split(r"\*", re.sub(r"\{[^}]*\}", "\0", text))
        pattern = "(.+?)".join(
            re.escape(part).replace("\0", r"\d+") for part in (start, ends[0])
        ) + "".join(r"\1" + re.escape(part).replace("\0", r"\d+") for part in ends[1:])
        filled.append({m[1] for name in table.columns if (m := re.fullmatch(pattern, name))})
    values = set.intersection(*filled)
    if not values:
        absent = next((t for t, f in zip(texts, filled, strict=True) if not f), " and ".join(texts))
        raise AbsentColumnError(
            f"'{table.path}' has no columns {absent}, which the mapping names.",
            available=table.described,
        )
    return sorted(values, key=natural)


def _with_help(error: LogError, table: Table, joints: Sequence[str]) -> LogError:
    """The error with all columns, and a mapping that would do where one can be guessed."""
    guessed = proposed_mapping(table, joints)
    hints = []
    if guessed is not None:
        text, remark = guessed
        hints.append(f'perhaps `columns="{text}"`' + (f" ({remark})" if remark else ""))
    elif isinstance(error, AbsentColumnError) and {"t", "q1"} <= table.columns.keys():
        hints.append(f"this log needs no mapping; {one_for_all('columns')}")
    elif not isinstance(error, AbsentColumnError) and not error.hint:
        hints.append(
            'say which are which: `columns="t=NAME s,q=NAME_{j} deg,tau=[NAME, ..]"`; without time '
            "stamps t=HZ Hz"
        )
    return with_hint(error, *hints, available=first_names(table.described, 60))


def with_hint(error: LogError, *hints: str, available: Sequence[object] | None = None) -> LogError:
    """The error with more hints, each once, and with another list of what is available."""
    known = error.hint or ""
    said = [known] if known else []
    said += [hint for hint in hints if hint not in known]
    return type(error)(
        error.problem,
        got=error.got,
        expected=error.expected,
        available=error.available if available is None else available,
        hint="; ".join(said) or None,
    )


def one_for_all(argument: str) -> str:
    """The way out where an argument that all logs share does not fit one of them."""
    return (
        f"`{argument}=...` holds for every log: convert those of another kind first, "
        f"torchid log show LOG --{argument} .. --save run.parquet"
    )
