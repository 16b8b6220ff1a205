"""Tables in HDF5 files: every dataset of one or two dimensions, by its path."""

import importlib.util
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from torchid.errors import LogError, MissingExtraError
from torchid.log.apart import read_apart
from torchid.log.formats import require_held
from torchid.log.reading_program import LISTED, READ, SIZED
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
    # Its libraries are loaded by the process that reads the file, and by that alone.
    if importlib.util.find_spec("h5py") is None:
        raise MissingExtraError("h5py", "hdf5", purpose or f"reading '{path}'")
    said, _ = read_apart(path, kind, {"do": LISTED}, soon=True)
    order = -1 if matlab else 1
    columns: dict[str, Shape | None] = {
        name: tuple(shape[::order]) for name, shape in said["columns"].items()
    }
    if not columns:
        raise LogError(f"'{path}' has no dataset of one or two dimensions.", expected="columns")

    def read(wanted: Sequence[str]) -> dict[str, np.ndarray]:
        names = list(wanted)
        said, _ = read_apart(path, kind, {"do": SIZED, "names": names}, soon=True)
        for name, (claimed, held) in said["sizes"].items():
            require_held(path, name, claimed, held)
        _, arrays = read_apart(path, kind, {"do": READ, "names": names})
        texts = {name: a.astype(object) for name, a in arrays.items() if a.dtype.kind == "U"}
        return {name: a.T if matlab else a for name, a in (arrays | texts).items()}

    return Table(path, kind, columns, read, arrays=True)
