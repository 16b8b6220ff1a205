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
    columns: dict[str, Shape | None] = {}

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and 1 <= len(item.shape) <= 2:
            shape = tuple(item.shape[:: -1 if matlab else 1])
            fields = item.dtype.names
            names = [f"{name}/{field}" for field in fields] if fields else [name]
            columns.update(dict.fromkeys(names, shape))

    with h5py.File(path, "r") as file:
        file.visititems(visit)
    if not columns:
        raise LogError(f"'{path}' has no dataset of one or two dimensions.", expected="columns")

    def read(wanted: Sequence[str]) -> dict[str, np.ndarray]:
        out = {}
        with h5py.File(path, "r") as file:
            for name in wanted:
                found, field = file.get(name), ""
                if not isinstance(found, h5py.Dataset):
                    dataset, _, field = name.rpartition("/")
                    found = file[dataset]
                require_held(path, name, int(found.nbytes), int(found.id.get_storage_size()))
                array = np.asarray(found[field] if field else found[()])
                if array.dtype.kind in "SO":
                    array = array.astype(str).astype(object)
                out[name] = array.T if matlab else array
        return out

    return Table(path, kind, columns, read, arrays=True)
