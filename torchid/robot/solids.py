"""Placed solids: their boxes with sides along the axes, and their volumes."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch

from torchid.errors import RobotError
from torchid.typing import Float, Tensor

MESH_SUFFIXES = (".stl", ".obj")
"""Suffixes of the mesh files that are read."""

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
    stl_header = 84
    if len(data) >= stl_header:
        count = int.from_bytes(data[stl_header - 4 : stl_header], "little")
        if len(data) == stl_header + count * _STL_FACE.itemsize:
            faces = np.frombuffer(data, _STL_FACE, count, stl_header)
            return faces["corners"].reshape(-1, 3).astype(np.float64)
    if not data.lstrip().lower().startswith(b"solid"):
        raise ValueError("neither binary of that length nor ASCII")
    return _words(_STL_VERTEX.findall(data))


def _words(lines: list[tuple[bytes, bytes, bytes]]) -> np.ndarray:
    return np.array([[float(word) for word in row] for row in lines]).reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class Solid:
    """A convex solid in a link's frame.

    Attributes:
        kind: what it is.
        pose: (4, 4) of its own frame in the link's.
        size: (3,) [m]: half sides of a box, semi-axes of an ellipsoid; radius, half length and 0
            of a cylinder or capsule, along z; zeros of a hull.
        box: (3, 2) lower and upper corner of the smallest box along the link's axes that holds it
            [m].
        volume: [m^3].
        corners: (V, 3) of a hull, in its own frame [m]; None of others.
    """

    kind: Literal["box", "ellipsoid", "cylinder", "capsule", "hull"]
    pose: Float[Tensor, "4 4"]
    size: Float[Tensor, "3"]
    box: Float[Tensor, "3 2"]
    volume: float
    corners: Float[Tensor, "V 3"] | None = None


@dataclass(frozen=True, eq=False)
class LinkShapes:
    """Shapes of a robot's n moving links.

    Attributes:
        boxes: (n, 3, 2) lower and upper corner [m] in the link frames; nan where unknown.
        volumes: (n,) at most the volume of the links' shapes [m^3] (a mesh counts as its convex
            hull, shapes that overlap count twice); nan where unknown.
        kinds: (n,) elements they come from: `collision`, `visual`, both, or None where unknown.
        warnings: what could not be read.
        solids: (n,) the shapes that were read, in the link frames, of links too whose box is
            unknown for a part of it.
        base: those of what does not move, in the base frame; None where a part could not be read.
        planes: (F, 4) unit normal and offset [m], in the base frame, of half-spaces n'x < offset
            that are solid: planes that an MJCF fixes to the world.
        left_out: names of links off the chain, whose shapes are in none of these.
    """

    boxes: Float[Tensor, "n 3 2"]
    volumes: Float[Tensor, " n"]
    kinds: tuple[str | None, ...]
    warnings: tuple[str, ...] = ()
    solids: tuple[tuple[Solid, ...], ...] = ()
    base: tuple[Solid, ...] | None = ()
    planes: Float[Tensor, "F 4"] = field(default_factory=lambda: torch.zeros(0, 4).double())
    left_out: tuple[str, ...] = ()

    @property
    def known(self) -> tuple[bool, ...]:
        """(n,) whether the link's box is known."""
        return tuple(kind is not None for kind in self.kinds)


def box(pose: Float[Tensor, "4 4"], half: Float[Tensor, "3"]) -> Solid:
    """A box with half sides `half` about its centre."""
    return _around("box", pose, half, pose[:3, :3].abs() @ half, 8 * float(half.prod()))


def ellipsoid(pose: Float[Tensor, "4 4"], semi_axes: Float[Tensor, "3"]) -> Solid:
    """An ellipsoid about its centre."""
    extent = (pose[:3, :3] * semi_axes).norm(dim=-1)
    volume = 4 / 3 * math.pi * float(semi_axes.prod())
    return _around("ellipsoid", pose, semi_axes, extent, volume)


def cylinder(pose: Float[Tensor, "4 4"], radius: float, length: float) -> Solid:
    """A cylinder about its centre, along z."""
    # A disc with axes u and v reaches r (u_k^2 + v_k^2)^1/2 in direction k.
    across = pose[:3, :2].norm(dim=-1)
    extent = pose[:3, 2].abs() * (length / 2) + across * radius
    size = pose.new_tensor([radius, length / 2, 0.0])
    return _around("cylinder", pose, size, extent, math.pi * radius**2 * length)


def capsule(pose: Float[Tensor, "4 4"], radius: float, length: float) -> Solid:
    """A cylinder of this length along z with a half ball on each end; a ball of length 0."""
    extent = pose[:3, 2].abs() * (length / 2) + radius
    size = pose.new_tensor([radius, length / 2, 0.0])
    return _around("capsule", pose, size, extent, math.pi * radius**2 * (length + 4 / 3 * radius))


def points(pose: Float[Tensor, "4 4"], vertices: Float[Tensor, "V 3"]) -> Solid:
    """The convex hull of points."""
    placed = vertices @ pose[:3, :3].T + pose[:3, 3]
    around = torch.stack([placed.amin(0), placed.amax(0)], -1)
    return Solid("hull", pose, pose.new_zeros(3), around, _hull_volume(vertices), vertices)


def assembled(
    parts: Sequence[tuple[list[Solid], str] | None], warnings: tuple[str, ...], **more: Any
) -> LinkShapes:
    """LinkShapes from each link's solids and their kind, None where they are unknown; `more` are
    its other attributes."""
    nowhere = torch.full((3, 2), torch.nan, dtype=torch.float64), math.nan
    merged = [nowhere if part is None else _together(part[0]) for part in parts]
    return LinkShapes(
        torch.stack([around for around, _ in merged]),
        torch.tensor([volume for _, volume in merged], dtype=torch.float64),
        tuple(None if part is None else part[1] for part in parts),
        warnings,
        **more,
    )


def _together(solids: Sequence[Solid]) -> tuple[Tensor, float]:
    """The box (3, 2) of all solids; the sum of their volumes, at most the box's."""
    boxes = torch.stack([solid.box for solid in solids])
    union = torch.stack([boxes[..., 0].amin(0), boxes[..., 1].amax(0)], -1)
    whole = float((union[:, 1] - union[:, 0]).prod())
    return union, min(whole, sum(solid.volume for solid in solids))


def _around(
    kind: Literal["box", "ellipsoid", "cylinder", "capsule"],
    pose: Tensor,
    size: Tensor,
    extent: Tensor,
    volume: float,
) -> Solid:
    centre = pose[:3, 3]
    return Solid(kind, pose, size, torch.stack([centre - extent, centre + extent], -1), volume)


def _hull_volume(vertices: Tensor) -> float:
    """Volume of the convex hull; 0 for points in a plane."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return float(ConvexHull(vertices.numpy()).volume)
    except (QhullError, ValueError):
        return 0.0
