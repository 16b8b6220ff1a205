"""Distances between convex shapes, by MuJoCo's convex collision detection."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import torch

from torchid.robot.solids import Solid
from torchid.typing import Float, Int, Tensor

_SMALLEST = 1e-6  # [m], of sizes that MuJoCo takes


class Distances:
    """Signed distances between solids and half-spaces.

    Shapes are counted from 0, the solids first. Meshes count as their convex hulls.

    Args:
        solids: in their links' frames.
        planes: (F, 4) unit normal and offset of solid half-spaces n'x < offset [1, m].
    """

    def __init__(self, solids: Sequence[Solid], planes: Float[Tensor, "F 4"]):
        self._solids, self._planes = solids, planes

    @cached_property
    def _compiled(self) -> "tuple[Any, Any, Any, Tensor]":
        """MuJoCo, its model and data, and the pose (G, 4, 4) of every shape in its link."""
        import mujoco  # which takes .15 s

        spec = mujoco.MjSpec()
        for solid in self._solids:
            _add(mujoco, spec, solid)
        for plane in self._planes:
            spec.worldbody.add_geom(
                type=mujoco.mjtGeom.mjGEOM_PLANE,
                size=[1, 1, 1],
                pos=(plane[:3] * plane[3]).tolist(),
                zaxis=plane[:3].tolist(),
            )
        model = spec.compile()
        data = mujoco.MjData(model)
        # MuJoCo moves a mesh's frame to its centre: it alone knows where a shape lies in its link.
        mujoco.mj_kinematics(model, data)
        placed = np.tile(np.eye(4), (model.ngeom, 1, 1))
        placed[:, :3, :3] = data.geom_xmat.reshape(-1, 3, 3)
        placed[:, :3, 3] = data.geom_xpos
        return mujoco, model, data, torch.from_numpy(placed)

    def between(
        self,
        first: Int[Tensor, " R"],
        second: Int[Tensor, " R"],
        first_pose: Float[Tensor, "R 4 4"],
        second_pose: Float[Tensor, "R 4 4"],
        farthest: float,
    ) -> tuple[Float[Tensor, " R"], Float[Tensor, "R 2 3"]]:
        """Distances (R,) [m], negative where shapes overlap, and the nearest points (R, 2, 3) of
        both, in the frame that the links' poses are given in.

        Args:
            first, second: shapes.
            first_pose, second_pose: of the links that they belong to.
            farthest: distance from which on only that it is as far is told, and no points [m].

        """
        mujoco, model, data, placed = self._compiled
        shapes = torch.stack([first, second], 1)
        poses = torch.stack([first_pose, second_pose], 1) @ placed[shapes]
        turns = poses[..., :3, :3].reshape(len(first), 2, 9).numpy()
        places = np.ascontiguousarray(poses[..., :3, 3].numpy())
        out, points = np.empty(len(first)), np.zeros((len(first), 6))
        positions, matrices, find = data.geom_xpos, data.geom_xmat, mujoco.mj_geomDistance
        for k, (one, other) in enumerate(shapes.tolist()):
            positions[one], positions[other] = places[k]
            matrices[one], matrices[other] = turns[k]
            out[k] = find(model, data, one, other, farthest, points[k])
        return torch.from_numpy(out), torch.from_numpy(points).reshape(-1, 2, 3)


def _add(mujoco: Any, spec: Any, solid: Solid) -> None:
    """The solid as a geom in the frame of its link."""
    kinds = mujoco.mjtGeom
    pose, size = solid.pose, solid.size
    more: dict[str, Any]
    if solid.corners is not None and solid.volume > 0:
        from scipy.spatial import ConvexHull

        corners = solid.corners.numpy()
        name = f"mesh_{len(spec.meshes)}"
        spec.add_mesh(name=name, uservert=corners[ConvexHull(corners).vertices].ravel().tolist())
        kind, more = kinds.mjGEOM_MESH, {"meshname": name}
    elif solid.corners is not None:
        # A flat mesh has no hull: it is the thin box of its corners.
        low, high = solid.corners.amin(0), solid.corners.amax(0)
        centre = torch.eye(4, dtype=torch.float64)
        centre[:3, 3] = (low + high) / 2
        pose, kind = pose @ centre, kinds.mjGEOM_BOX
        more = {"size": ((high - low) / 2).clamp(min=_SMALLEST).tolist()}
    else:
        names = {"box": "BOX", "ellipsoid": "ELLIPSOID", "cylinder": "CYLINDER"}
        ball = "SPHERE" if float(size[1]) == 0 else "CAPSULE"
        kind = getattr(kinds, f"mjGEOM_{names.get(solid.kind, ball)}")
        more = {"size": size.clamp(min=_SMALLEST).tolist()}
    x, y = pose[:3, 0].tolist(), pose[:3, 1].tolist()
    spec.worldbody.add_geom(type=kind, pos=pose[:3, 3].tolist(), xyaxes=x + y, **more)
