"""A program of its own, `matlab_arrays.py FILE.mat`: arrays of numbers of a .mat file up to v7.2 to
standard output as npz, names of what is none to standard error."""

import io
import sys
import warnings
from collections.abc import Iterator, Mapping
from typing import Any
from zipfile import ZipFile

import numpy as np
from numpy.lib import format as npy
from scipy.io import loadmat


def _arrays(prefix: str, values: Mapping[str, Any]) -> Iterator[tuple[str, np.ndarray]]:
    """Arrays of numbers by name; structs within structs have dots."""
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _arrays(f"{prefix}{name}.", value)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "iufb" and 1 <= value.ndim <= 2:
            yield f"{prefix}{name}", value
        else:
            sys.stderr.write(f"{prefix}{name}\n")


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    try:
        content = loadmat(sys.argv[1], simplify_cells=True)
        named = {k: v for k, v in content.items() if not k.startswith("__")}
        whole = io.BytesIO()
        with ZipFile(whole, "w") as archive:
            for name, array in _arrays("", named):
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    npy.write_array(member, array, allow_pickle=False)
    except Exception as error:
        sys.exit(f"{type(error).__name__}: {error}")
    sys.stdout.buffer.write(whole.getbuffer())
