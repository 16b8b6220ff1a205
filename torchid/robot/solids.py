"""Boxes with sides along the axes, and volumes, of placed solids."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchid.typing import Float, Tensor


@dataclass(frozen=True, eq=False)
class Solid:
    """The smallest box with sides along the axes that holds a solid, and the solid's volume.

    Attributes:
        box: (3, 2) lower and upper corner [m].
        volume: [m^3].
    """

    box: Float[Tensor, "3 2"]
    volume: float


@dataclass(frozen=True, eq=False)
class LinkShapes:
    """Shapes of a robot's n moving links.

    Attributes:
        boxes: (n, 3, 2) lower and upper corner [m] in the link frames; nan where unknown.
        volumes: (n,) at most the volume of the links' shapes [m^3] (a mesh counts as its convex
            hull, shapes that overlap count twice); nan where unknown.
        kinds: (n,) elements they come from: `collision`, `visual`, both, or None where unknown.
        warnings: what could not be read.
    """

    boxes: Float[Tensor, "n 3 2"]
    volumes: Float[Tensor, " n"]
    kinds: tuple[str | None, ...]
    warnings: tuple[str, ...] = ()

    @property
    def known(self) -> tuple[bool, ...]:
        """(n,) whether the link's box is known."""
        return tuple(kind is not None for kind in self.kinds)


def box(pose: Float[Tensor, "4 4"], half: Float[Tensor, "3"]) -> Solid:
    """A box with half sides `half` about its centre."""
    return _around(pose, pose[:3, :3].abs() @ half, 8 * float(half.prod()))


def ellipsoid(pose: Float[Tensor, "4 4"], semi_axes: Float[Tensor, "3"]) -> Solid:
    """An ellipsoid about its centre."""
    extent = (pose[:3, :3] * semi_axes).norm(dim=-1)
    return _around(pose, extent, 4 / 3 * math.pi * float(semi_axes.prod()))


def cylinder(pose: Float[Tensor, "4 4"], radius: float, length: float) -> Solid:
    """A cylinder about its centre, along z."""
    # A disc with axes u and v reaches r (u_k^2 + v_k^2)^1/2 in direction k.
    across = pose[:3, :2].norm(dim=-1)
    extent = pose[:3, 2].abs() * (length / 2) + across * radius
    return _around(pose, extent, math.pi * radius**2 * length)


def capsule(pose: Float[Tensor, "4 4"], radius: float, length: float) -> Solid:
    """A cylinder of this length along z with a half ball on each end; a ball of length 0."""
    extent = pose[:3, 2].abs() * (length / 2) + radius
    return _around(pose, extent, math.pi * radius**2 * (length + 4 / 3 * radius))


def points(pose: Float[Tensor, "4 4"], vertices: Float[Tensor, "V 3"]) -> Solid:
    """The convex hull of points."""
    placed = vertices @ pose[:3, :3].T + pose[:3, 3]
    return Solid(torch.stack([placed.amin(0), placed.amax(0)], -1), _hull_volume(vertices))


def together(solids: Sequence[Solid]) -> Solid:
    """The box of all solids; the sum of their volumes, at most the box's."""
    boxes = torch.stack([solid.box for solid in solids])
    union = torch.stack([boxes[..., 0].amin(0), boxes[..., 1].amax(0)], -1)
    whole = float((union[:, 1] - union[:, 0]).prod())
    return Solid(union, min(whole, sum(solid.volume for solid in solids)))


def assembled(
    parts: Sequence[tuple[list[Solid], str] | None], warnings: tuple[str, ...]
) -> LinkShapes:
    """LinkShapes from each link's solids and their kind, None where they are unknown."""
    nowhere = Solid(torch.full((3, 2), torch.nan, dtype=torch.float64), math.nan)
    merged = [nowhere if part is None else together(part[0]) for part in parts]
    return LinkShapes(
        torch.stack([solid.box for solid in merged]),
        torch.tensor([solid.volume for solid in merged], dtype=torch.float64),
        tuple(None if part is None else part[1] for part in parts),
        warnings,
    )


def _around(pose: Tensor, extent: Tensor, volume: float) -> Solid:
    centre = pose[:3, 3]
    return Solid(torch.stack([centre - extent, centre + extent], -1), volume)


def _hull_volume(vertices: Tensor) -> float:
    """Volume of the convex hull; 0 for points in a plane."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return float(ConvexHull(vertices.numpy()).volume)
    except (QhullError, ValueError):
        return 0.0
