"""Signals in files of their own: `q=log_q.csv[:,1:7],tau=log_tau.csv[:,1:7]`.

A file that `--columns` names beside a log is an array of all its columns, at the log's times: both
have a column `t`, or their first column is their time, in one unit and of one clock.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from torchid.log.columns import numbers_of
from torchid.log.csv_file import at_one_time
from torchid.log.mapping import ColumnMapping
from torchid.log.table import Table

_FILE = re.compile(r"([^\[\]]+\.(?:csv|tsv|txt|dat))(?:\[.*\])?", re.IGNORECASE)


def with_side_files(
    table: Table, mapping: ColumnMapping, open_table: Callable[[Path], Table]
) -> Table:
    """The table with the files beside it that a mapping names, each an array (T, k) by its name.

    Args:
        table: of a text file; another one stays as it is.
        mapping: that may name files.
        open_table: opens a text file.

    Raises:
        LogError: a file without numbers, or of another time.
    """
    sources = [source for source in mapping.sources.values() if source is not None]
    files = [m[1] for source in sources for c in source.columns if (m := _FILE.fullmatch(c))]
    names = [n for n in dict.fromkeys(files) if (table.path.parent / n).is_file()]
    if not names or not table.kind.startswith("csv"):
        return table
    here = _time_of(table)
    signals = {"": (here, np.arange(len(here), dtype=np.float64))}
    for name in names:
        beside = open_table(table.path.parent / name)
        parts = beside.read(list(beside.columns)).items()
        arrays = [numbers_of(x, f"'{beside.path}': column {key}") for key, x in parts]
        whole = np.concatenate([x.reshape(len(x), -1) for x in arrays], 1).astype(np.float64)
        signals[name] = _time_of(beside), whole
    _, there = at_one_time(signals, f"'{table.path}'", "")
    rows = there[""].round().astype(np.int64)
    note = f"'{table.path}': joined by time with {', '.join(names)}"
    if lost := len(here) - len(rows):
        note = f"{note}; {lost} rows that not all of them have are left out"

    def read(wanted: Sequence[str]) -> dict[str, np.ndarray]:
        own = table.read([name for name in wanted if name not in names])
        return {n: there[n] if n in names else own[n][rows] for n in wanted}

    shapes = {**table.columns, **{name: there[name].shape for name in names}}
    return replace(table, columns=shapes, read=read, warnings=(*table.warnings, note))


def _time_of(table: Table) -> np.ndarray:
    """(T,) of the column t, else of the first column."""
    name = "t" if "t" in table.columns else next(iter(table.columns))
    array = numbers_of(table.read([name])[name], f"'{table.path}': its time")
    return array.reshape(len(array), -1)[:, 0].astype(np.float64)
