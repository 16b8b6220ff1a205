"""Tables in HDF5 files: every dataset of one or two dimensions, by its path."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
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
                data, field = file.get(name), ""
                if not isinstance(data, h5py.Dataset):
                    dataset, _, field = name.rpartition("/")
                    data = file[dataset]
                require_held(path, name, int(data.nbytes), int(data.id.get_storage_size()))
                array = np.asarray(data[field] if field else data[()])
                if array.dtype.kind in "SO":
                    array = array.astype(str).astype(object)
                out[name] = array.T if matlab else array
        return out

    return Table(path, kind, columns, read, arrays=True)


def matlab_table(path: Path, request: Request) -> Table:
    """The table of a .mat file, up to v7.2 by scipy, v7.3 by h5py.

    Raises:
        MissingExtraError: v7.3, and h5py is not installed.
        LogError: no .mat file, or there is no array of numbers in it.
    """
    with open(path, "rb") as file:
        start = file.read(19)
    if start.startswith((b"MATLAB 7.3", b"\x89HDF")):
        purpose = (
            f"reading '{path}' (MATLAB v7.3; `save -v7` writes a file that needs nothing more)"
        )
        table = hdf5_table(path, request, "MATLAB v7.3", purpose, matlab=True)
        dotted = {name.replace("/", "."): name for name in table.columns if name[0] != "#"}

        def read(wanted: Sequence[str]) -> dict[str, np.ndarray]:
            arrays = table.read([dotted[name] for name in wanted])
            return {name: arrays[dotted[name]] for name in wanted}

        return replace(table, columns={n: table.columns[k] for n, k in dotted.items()}, read=read)
    arrays, others = _arrays(path)
    if not arrays:
        raise LogError(
            f"'{path}' has no array of numbers.",
            got=", ".join(others) or "nothing",
            expected="arrays, or structs of arrays; save timeseries and tables as arrays",
        )
    return Table.in_memory(path, "MATLAB", arrays)


def _arrays(path: Path) -> tuple[dict[str, np.ndarray], list[str]]:
    """Arrays of numbers by name, structs within structs with dots; names of what is none."""
    from scipy.io import loadmat

    arrays: dict[str, np.ndarray] = {}
    others: list[str] = []

    def visit(prefix: str, values: Mapping[str, Any]) -> None:
        for name, value in values.items():
            if isinstance(value, Mapping):
                visit(f"{prefix}{name}.", value)
            elif (
                isinstance(value, np.ndarray)
                and value.dtype.kind in "iufb"
                and 1 <= value.ndim <= 2
            ):
                arrays[f"{prefix}{name}"] = value
            else:
                others.append(f"{prefix}{name}")

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        content = loadmat(path, simplify_cells=True)
    visit("", {name: value for name, value in content.items() if not name.startswith("__")})
    return arrays, others
