"""Distances between convex shapes, by MuJoCo's convex collision detection."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import torch

from torchid.robot.placement import pose
from torchid.robot.solids import Solid
from torchid.typing import Float, Int, Tensor


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
    def _compiled(self) -> "tuple[Any, Any, Tensor, Tensor]":
        """MuJoCo's model and data, the pose (G, 4, 4) of every shape in its link, and the radius
        (G,) of the ball around it; 0 of a half-space."""
        import mujoco

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
        in_link = np.tile(np.eye(4), (model.ngeom, 1, 1))
        in_link[:, :3, :3] = data.geom_xmat.reshape(-1, 3, 3)
        in_link[:, :3, 3] = data.geom_xpos
        return model, data, torch.from_numpy(in_link), torch.from_numpy(model.geom_rbound.copy())

    def placed(self, links: Float[Tensor, "*batch G 4 4"]) -> Float[Tensor, "*batch G 4 4"]:
        """Poses of all shapes, by those of the links that they belong to."""
        return links @ self._compiled[2]

    def at_least(
        self, placed: Float[Tensor, "K G 4 4"], pairs: Int[Tensor, "P 2"]
    ) -> Float[Tensor, "K P"]:
        """What pairs are apart at least [m], by the balls around solids. A half-space comes first
        in its pair."""
        first, second = pairs.unbind(-1)
        radius = self._compiled[3]
        apart = placed[:, second, :3, 3] - placed[:, first, :3, 3]
        height = (apart * placed[:, first, :3, 2]).sum(-1)
        out = torch.where(first < len(self._solids), apart.norm(dim=-1), height)
        return out - radius[first] - radius[second]

    def between(
        self, pairs: Int[Tensor, "R 2"], placed: Float[Tensor, "R 2 4 4"], farthest: float
    ) -> tuple[Float[Tensor, " R"], Float[Tensor, "R 2 3"]]:
        """Distances (R,) [m], negative where shapes overlap, and the nearest points (R, 2, 3) of
        both.

        Args:
            pairs: of shapes.
            placed: their poses.
            farthest: distance from which on only that it is as far is told, and no points [m].
        """
        from mujoco import mj_geomDistance

        model, data, *_ = self._compiled
        turns = placed[..., :3, :3].reshape(len(pairs), 2, 9).numpy()
        places = np.ascontiguousarray(placed[..., :3, 3].numpy())
        out, points = np.empty(len(pairs)), np.zeros((len(pairs), 6))
        positions, matrices = data.geom_xpos, data.geom_xmat
        for k, (one, other) in enumerate(pairs.tolist()):
            positions[one], positions[other] = places[k]
            matrices[one], matrices[other] = turns[k]
            out[k] = mj_geomDistance(model, data, one, other, farthest, points[k])
        return torch.from_numpy(out), torch.from_numpy(points).reshape(-1, 2, 3)


def _add(mujoco: Any, spec: Any, solid: Solid) -> None:
    """The solid as a geom in the frame of its link."""
    at, kind = solid.pose, str(solid.kind)
    if kind == "capsule" and float(solid.size[1]) == 0:
        kind = "sphere"
    # [m], of sizes that MuJoCo takes
    smallest = 1e-6
    more: dict[str, Any] = {"size": solid.size.clamp(min=smallest).tolist()}
    if solid.corners is not None and solid.volume > 0:
        kind, name = "mesh", f"mesh_{len(spec.meshes)}"
        spec.add_mesh(name=name, uservert=solid.corners.flatten().tolist())
        more = {"meshname": name}
    elif solid.corners is not None:
        # A flat mesh has no hull: it is the thin box of its corners.
        low, high = solid.corners.amin(0), solid.corners.amax(0)
        at, kind = at @ pose(None, (low + high) / 2), "box"
        more = {"size": ((high - low) / 2).clamp(min=smallest).tolist()}
    spec.worldbody.add_geom(
        type=getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}"),
        pos=at[:3, 3].tolist(),
        xyaxes=[*at[:3, 0].tolist(), *at[:3, 1].tolist()],
        **more,
    )
