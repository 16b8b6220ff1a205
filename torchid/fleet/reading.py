"""Logs longer than memory: a parquet file with our column names comes in parts."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa

from torchid.fleet.factors import STRETCH, in_stretches
from torchid.log.columns import is_wanted, log_from_columns
from torchid.log.formats import from_arrow, open_parquet
from torchid.log.model import Log
from torchid.log.readers import guarded, open_log
from torchid.log.table import Request

PART = 600_000
"""Rows read at a time: ten minutes at 1 kHz, 200 MB with positions, velocities and torques of
seven joints while they are made a log."""


def stretches(path: Path, request: Request) -> Iterator[Log]:
    """A log in stretches of about ten minutes; no more than one of them is in memory where the
    file is a parquet file in our columns.

    Raises:
        LogError: as `open_log`.
    """
    if path.suffix.lower() != ".parquet" or request.columns is not None or path.is_dir():
        yield from in_stretches(open_log(path, request)[1])
        return
    with guarded(path), open_parquet(path) as file:
        rows, names = file.metadata.num_rows, list(file.schema_arrow.names)
        if rows <= 2 * PART or "t" not in names:
            yield from in_stretches(open_log(path, request)[1])
            return
        wanted = [name for name in names if is_wanted(name)]
        # Parts are equally long, so that none is a rest too short to be fitted.
        length = -(-rows // round(rows / PART))
        for k, batch in enumerate(file.iter_batches(length, columns=wanted)):
            part = pa.Table.from_batches([batch])
            columns = {name: from_arrow(part[name], name, path) for name in wanted}
            log = log_from_columns(columns, path)
            named = log.replace(names=tuple(f"{name} part {k + 1}" for name in log.names))
            del batch, part, columns, log
            yield from in_stretches(named, 2 * STRETCH)


def first_minute(log: Log) -> Log:
    """The beginning of its first trajectory, for what shows in any of it."""
    part = log.trajectories()[0]
    end = int(np.searchsorted(part.t.numpy(), float(part.t[0]) + 60.0))
    return part.select(slice(0, max(2, end)))
