"""Tables in MATLAB's .mat files: arrays, and the fields of structs, `struct.field`."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from torchid.errors import LogError
from torchid.log.hdf5 import hdf5_table
from torchid.log.table import Request, Table


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
