"""Boxes of the links' geoms in an MJCF, through MuJoCo's compiled model.

Geoms that can collide count; for a body without any, all of them do but those of a contact pair:
these are places that touch. Primitive geoms are exact, meshes are their corners, anything else is
the box that MuJoCo has of it.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import torch

from torchid.robot.mjcf import compiled, given_pose
from torchid.robot.model import Robot
from torchid.robot.placement import pose
from torchid.robot.solids import (
    LinkShapes,
    Solid,
    assembled,
    box,
    capsule,
    cylinder,
    ellipsoid,
    points,
)
from torchid.typing import Tensor


def mjcf_shapes(path: Path, robot: Robot) -> LinkShapes:
    """Shapes of the links of a robot read from an MJCF; a body without geoms has none.

    Planes and height fields have no end: a link with one has no known box, nor has one with a mesh
    that is absent, or one of whose bodies one has mass and no geom. The first links of a body with
    several joints are massless and have none either.

    Args:
        path: the MJCF.
        robot: what was read from it; its link names are those of bodies.

    Raises:
        RobotError: MuJoCo cannot compile the file any more.
    """
    compiled_model = compiled(path)
    model = compiled_model.model
    own = [_body_shapes(model, body, compiled_model.shapeless) for body in range(model.nbody)]
    parts: dict[str, tuple[list[Solid], str] | None] = {}
    read: dict[str, list[Solid]] = {}
    problems = []
    for body in range(1, model.nbody):
        if _is_still(model, body):
            continue
        name = mujoco.mj_id2name(model, int(mujoco.mjtObj.mjOBJ_BODY), body) or f"body_{body}"
        members = [b for b in range(body, model.nbody) if _moved_by(model, b) == body]
        shapes = [own[b] for b in members]
        solids = [s for part in shapes if part for s in part[0]]
        kinds = dict.fromkeys(part[1] for part in shapes if part and part[0])
        whole = all(part is not None for part in shapes) and not (
            solids and any(model.body_mass[b] and not model.body_geomnum[b] for b in members)
        )
        parts[name] = (solids, " and ".join(kinds)) if whole and solids else None
        read[name] = solids
        if not whole and name in robot.link_names:
            problems.append(f"'{name}'")
    warning = (
        f"shapes of {', '.join(problems)} are unknown: a geom has no end (plane, height field), a "
        "mesh is absent, or a body has mass and no geom."
    )
    base, planes = _world(model)
    if any(
        collides and not _moved_by(model, b) for b, collides in compiled_model.shapeless.items()
    ):
        base = None
    return assembled(
        [parts.get(name) for name in robot.link_names],
        (warning,) * bool(problems),
        solids=tuple(tuple(read.get(name, ())) for name in robot.link_names),
        base=base,
        planes=planes,
        left_out=tuple(name for name in read if name not in robot.link_names),
    )


def _world(model: Any) -> tuple[tuple[Solid, ...] | None, Tensor]:
    """Solids of what collides and is fixed to the world, None where one is a height field; and
    planes (F, 4), unit normal and offset."""
    kinds = mujoco.mjtGeom
    solids, planes, known = [], [], True
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        collides = model.geom_contype[geom] or model.geom_conaffinity[geom]
        if _moved_by(model, body) or not collides:
            continue
        placed, kind = _placed(model, body), int(model.geom_type[geom])
        if kind == kinds.mjGEOM_PLANE:
            at = placed @ given_pose(model, "geom", geom)
            planes.append(torch.cat([at[:3, 2], (at[:3, 2] @ at[:3, 3])[None]]))
        elif kind == kinds.mjGEOM_HFIELD:
            known = False
        else:
            solids.append(_solid(model, geom, placed))
    none = torch.zeros((0, 4), dtype=torch.float64)
    return tuple(solids) if known else None, torch.stack(planes) if planes else none


def _moved_by(model: Any, body: int) -> int:
    """The body with joints that a body is fixed to; 0 for those fixed to the world."""
    while body and _is_still(model, body):
        body = int(model.body_parentid[body])
    return body


def _is_still(model: Any, body: int) -> bool:
    """Whether a body is fixed to its parent; one that floats is held where the file puts it."""
    first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    return count == 0 or bool((model.jnt_type[first : first + count] == 0).all())  # mjJNT_FREE


def _placed(model: Any, body: int) -> Tensor:
    """Pose (4, 4) of a body in the frame of the body that moves it."""
    out = pose()
    while body and _is_still(model, body):
        out = given_pose(model, "body", body) @ out
        body = int(model.body_parentid[body])
    return out


def _body_shapes(
    model: Any, body: int, shapeless: Mapping[int, bool]
) -> tuple[list[Solid], str] | None:
    """Solids of a body's geoms in the frame of the body that moves it; None where one has no
    end, or is an absent mesh."""
    first = int(model.body_geomadr[body])
    geoms = range(first, first + int(model.body_geomnum[body]))
    colliding = [g for g in geoms if model.geom_contype[g] or model.geom_conaffinity[g]]
    kinds = mujoco.mjtGeom
    endless = {int(kinds.mjGEOM_PLANE), int(kinds.mjGEOM_HFIELD)}
    paired = {*model.pair_geom1.tolist(), *model.pair_geom2.tolist()}
    chosen = colliding or [g for g in geoms if g not in paired]
    absent = body in shapeless and (shapeless[body] or not colliding)
    if absent or any(int(model.geom_type[g]) in endless for g in chosen):
        return None
    placed = _placed(model, body)
    return [_solid(model, g, placed) for g in chosen], ("collision" if colliding else "visual")


def _solid(model: Any, geom: int, placed: Tensor) -> Solid:
    kinds = mujoco.mjtGeom
    at = placed @ given_pose(model, "geom", geom)
    size = torch.tensor(model.geom_size[geom].tolist(), dtype=torch.float64)
    radius, half = float(size[0]), float(size[1])
    kind = int(model.geom_type[geom])
    if kind == kinds.mjGEOM_BOX:
        return box(at, size)
    if kind == kinds.mjGEOM_ELLIPSOID:
        return ellipsoid(at, size)
    if kind == kinds.mjGEOM_CYLINDER:
        return cylinder(at, radius, 2 * half)
    if kind == kinds.mjGEOM_CAPSULE:
        return capsule(at, radius, 2 * half)
    if kind == kinds.mjGEOM_SPHERE:
        return capsule(at, radius, 0.0)
    if kind == kinds.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        corners = model.mesh_vert[first : first + count].tolist()
        return points(at, torch.tensor(corners, dtype=torch.float64))
    centre, extent = torch.tensor(model.geom_aabb[geom].tolist(), dtype=torch.float64).split(3)
    return box(at @ pose(None, centre), extent)
