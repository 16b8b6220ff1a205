"""A program of its own that reads HDF5 and .mat files, for `torchid.log.apart`.

Each line of standard input is a request as JSON, `{"do": .., "path": ..}` and more; the answer is a
line of JSON and, as npy, the arrays that its `arrays` name. It imports nothing of torchid.
"""

import json
import os
import signal
import sys
import warnings
from collections.abc import Iterator, Mapping
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy

LISTED, SIZED, READ, MATLAB = "hdf5 list", "hdf5 sizes", "hdf5 read", "mat"
"""What can be asked for: the columns of an HDF5 file; the bytes that datasets claim and hold;
arrays; all arrays of a .mat file up to v7.2."""


def hdf5_list(path: str) -> dict[str, list[int]]:
    """Shapes of all datasets of one or two dimensions, and of the fields of compound ones."""
    import h5py

    columns: dict[str, list[int]] = {}

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and 1 <= len(item.shape) <= 2:
            fields = item.dtype.names
            for field in fields or ("",):
                columns[f"{name}/{field}" if fields else name] = list(item.shape)

    with h5py.File(path, "r") as file:
        file.visititems(visit)
    return columns


def _dataset(file: Any, name: str) -> tuple[Any, str]:
    """A dataset, and the field of it that is meant."""
    import h5py

    found, field = file.get(name), ""
    if not isinstance(found, h5py.Dataset):
        dataset, _, field = name.rpartition("/")
        found = file[dataset]
    return found, field


def hdf5_sizes(path: str, names: list[str]) -> dict[str, tuple[int, int]]:
    """Bytes that each dataset claims to have, and that the file keeps for it."""
    import h5py

    with h5py.File(path, "r") as file:
        found = {name: _dataset(file, name)[0] for name in names}
        return {name: (int(d.nbytes), int(d.id.get_storage_size())) for name, d in found.items()}


def hdf5_read(path: str, names: list[str]) -> Iterator[np.ndarray]:
    """Arrays, one at a time; what is no number as text."""
    import h5py

    with h5py.File(path, "r") as file:
        for name in names:
            found, field = _dataset(file, name)
            array = np.asarray(found[field] if field else found[()])
            yield array.astype(str) if array.dtype.kind in "SO" else array


def mat_arrays(path: str) -> tuple[dict[str, np.ndarray], list[str]]:
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

    content = loadmat(path, simplify_cells=True)
    visit("", {k: v for k, v in content.items() if not k.startswith("__")})
    return arrays, others


class _Piped:
    """A pipe by its `write` alone: NumPy would look for its place in what it takes for a file."""

    def __init__(self, pipe: IO[bytes]) -> None:
        self.write = pipe.write


def answer(request: dict[str, Any], out: IO[bytes]) -> None:
    """Answer one request; what a library raises is an answer, too."""
    path, names = request["path"], request.get("names", [])
    said: dict[str, Any] = {}
    arrays: Iterator[np.ndarray] = iter(())
    try:
        if request["do"] == LISTED:
            said["columns"] = hdf5_list(path)
        elif request["do"] == SIZED:
            said["sizes"] = hdf5_sizes(path, names)
        elif request["do"] == READ:
            # The first array before the line is written: most errors come with it.
            arrays = hdf5_read(path, names)
            first = [next(arrays)] if names else []
            said["arrays"], arrays = names, (a for part in (first, arrays) for a in part)
        else:
            found, said["others"] = mat_arrays(path)
            said["arrays"], arrays = list(found), iter(found.values())
    except Exception as error:
        said, arrays = {"error": f"{type(error).__name__}: {error}"[:200]}, iter(())
    out.write(json.dumps(said).encode() + b"\n")
    for array in arrays:
        npy.write_array(_Piped(out), array, allow_pickle=False)
    out.flush()


def main() -> None:
    """Serve until standard input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    warnings.simplefilter("ignore")
    # What a library prints must not stand among the answers.
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    for line in sys.stdin.buffer:
        answer(json.loads(line), out)


if __name__ == "__main__":
    main()
