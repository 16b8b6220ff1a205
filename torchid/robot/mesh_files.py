"""Corners of mesh files: STL (binary or ASCII) and OBJ. Other formats are not read."""

import re
from pathlib import Path

import numpy as np

from torchid.errors import RobotError

MESH_SUFFIXES = (".stl", ".obj")
"""Suffixes of the mesh files that are read."""

_STL_HEADER = 84
_STL_FACE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_STL_VERTEX = re.compile(rb"^\s*vertex\s+(\S+)\s+(\S+)\s+(\S+)", re.MULTILINE | re.IGNORECASE)
_OBJ_VERTEX = re.compile(rb"^\s*v\s+(\S+)\s+(\S+)\s+(\S+)", re.MULTILINE)


def find_mesh(reference: str, beside: Path) -> Path | None:
    """The file that a URDF's mesh reference means, or None where it is not there.

    `file://` is an absolute path, anything without a scheme is next to the URDF, and
    `package://NAME/REST` is looked for from the URDF's folder upwards: a folder NAME in or of the
    way up that has REST.

    Args:
        reference: the `filename` of a <mesh>.
        beside: the URDF.
    """
    if reference.startswith("package://"):
        name, _, rest = reference.removeprefix("package://").partition("/")
        folders = list(beside.resolve().parents)
        places = [folder / name / rest for folder in folders]
        places += [folder / rest for folder in folders if folder.name == name]
        # A URDF copied out of its package often keeps the package's folders beside it.
        places.append(folders[0] / rest)
    elif reference.startswith("file://"):
        places = [Path(reference.removeprefix("file://"))]
    elif "://" in reference:
        return None
    else:
        places = [beside.parent / reference]
    return next((place for place in places if place.is_file()), None)


def mesh_vertices(path: Path) -> np.ndarray:
    """Corners (V, 3) of a mesh file, in its own units.

    Raises:
        RobotError: a suffix that is not known, a file that cannot be read, is no such mesh, has no
            corner, or has one that is not finite.
    """
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise RobotError(f"mesh '{path}' is not read.", available=MESH_SUFFIXES)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise RobotError(f"mesh '{path}' cannot be read: {error.strerror or error}.") from error
    try:
        vertices = _stl(data) if suffix == ".stl" else _words(_OBJ_VERTEX.findall(data))
    except ValueError as error:
        raise RobotError(f"mesh '{path}' is not {suffix[1:].upper()}: {error}.") from error
    if not len(vertices) or not np.isfinite(vertices).all():
        said = "has a corner that is not finite" if len(vertices) else "has no corner"
        raise RobotError(f"mesh '{path}' {said}.")
    return vertices


def _stl(data: bytes) -> np.ndarray:
    # Binary files may begin with "solid" too; their length says what they are.
    if len(data) >= _STL_HEADER:
        count = int.from_bytes(data[_STL_HEADER - 4 : _STL_HEADER], "little")
        if len(data) == _STL_HEADER + count * _STL_FACE.itemsize:
            faces = np.frombuffer(data, _STL_FACE, count, _STL_HEADER)
            return faces["corners"].reshape(-1, 3).astype(np.float64)
    if not data.lstrip().lower().startswith(b"solid"):
        raise ValueError("neither binary of that length nor ASCII")
    return _words(_STL_VERTEX.findall(data))


def _words(found: list[tuple[bytes, bytes, bytes]]) -> np.ndarray:
    return np.array([[float(word) for word in row] for row in found]).reshape(-1, 3)
