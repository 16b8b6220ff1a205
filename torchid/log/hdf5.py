"""Tables in HDF5 files: every dataset of one or two dimensions, by its path."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from torchid.errors import LogError, MissingExtraError
from torchid.log.formats import damaged
from torchid.log.table import Request, Shape, Table


def hdf5_table(
    path: Path,
    request: Request,
    kind: str = "HDF5",
    purpose: str | None = None,
    *,
    matlab: bool = False,
) -> Table:
    """The table of an HDF5 file.

    A dataset in a group has the name `group/dataset`, a field of a compound one `dataset/field`.

    Args:
        path: of the file.
        request: how it is to be read.
        kind: of the file, for people.
        purpose: what h5py is needed for, where it is missing.
        matlab: whether arrays are transposed, rows being columns.

    Raises:
        MissingExtraError: h5py is not installed.
        LogError: no HDF5 file, or there is nothing to read in it.
    """
    try:
        import h5py
    except ImportError as error:
        raise MissingExtraError("h5py", "hdf5", purpose or f"reading '{path}'") from error
    with damaged(path, kind, OSError, RuntimeError, ValueError), h5py.File(path, "r") as file:
        columns: dict[str, Shape | None] = {}

        def visit(name: str, item: Any) -> None:
            if not isinstance(item, h5py.Dataset) or not 1 <= len(item.shape) <= 2:
                return
            shape = tuple(reversed(item.shape)) if matlab else item.shape
            fields = item.dtype.names
            for field in fields or ("",):
                columns[f"{name}/{field}" if fields else name] = shape

        file.visititems(visit)
    if not columns:
        raise LogError(f"'{path}' has no dataset of one or two dimensions.", expected="columns")

    def read(wanted: Sequence[str]) -> dict[str, np.ndarray]:
        # h5py raises many kinds of errors where a file is damaged.
        problems = (OSError, RuntimeError, ValueError, KeyError, TypeError)
        with damaged(path, kind, *problems), h5py.File(path, "r") as file:
            arrays = {name: _dataset(h5py, file, name) for name in wanted}
        return {name: array.T if matlab else array for name, array in arrays.items()}

    return Table(path, kind, columns, read, arrays=True)


def _dataset(h5py: Any, file: Any, name: str) -> np.ndarray:
    if name in file and isinstance(file[name], h5py.Dataset):
        array = np.asarray(file[name][()])
        return array.astype(str).astype(object) if array.dtype.kind in "SO" else array
    dataset, _, field = name.rpartition("/")
    return np.asarray(file[dataset][field])
