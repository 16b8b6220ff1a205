"""Tables in HDF5 files: every dataset of one or two dimensions, by its path."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from torchid.errors import LogError, MissingExtraError
from torchid.log.formats import require_held
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
    with h5py.File(path, "r") as file:
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
        with h5py.File(path, "r") as file:
            arrays = {name: _dataset(h5py, path, file, name) for name in wanted}
        return {name: array.T if matlab else array for name, array in arrays.items()}

    return Table(path, kind, columns, read, arrays=True)


def _dataset(h5py: Any, path: Path, file: Any, name: str) -> np.ndarray:
    found, field = file.get(name), ""
    if not isinstance(found, h5py.Dataset):
        dataset, _, field = name.rpartition("/")
        found = file[dataset]
    require_held(path, name, found.nbytes, found.id.get_storage_size())
    array = np.asarray(found[field] if field else found[()])
    return array.astype(str).astype(object) if array.dtype.kind in "SO" else array
