"""From a tree of links and joints to a Robot: fixed joints folded, inertias merged."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import torch
from torch import Tensor

from torchid.robot.inertia import PARAMETERS_PER_LINK, InertialParameters, move
from torchid.robot.model import BaseLink, JointType, Limits, Mimic, Robot, Tip
from torchid.robot.placement import align_z, pose, rotation_z
from torchid.robot.tree import Choice, Group, Interval, Part, Tree, TreeJoint, choose
from torchid.typing import Float

# Below this share of the largest eigenvalue a negative one is rounding, as for a point mass.
_ROUNDING = 1e-12
_EFFECTS: tuple[tuple[dict[str, Any], str, str, int], ...] = (
    ({"effect": "viscous_friction"}, "Fv", "damping", 2),
    ({"effect": "coulomb_friction"}, "Fc", "friction", 1),
    ({"effect": "rotor_inertia"}, "Ia", "armature", 2),
    ({"effect": "power_law_friction", "a": 2.0}, "F2", "quadratic", 3),
    ({"effect": "power_law_friction", "a": 3.0}, "F2", "cubic", 4),
)
"""Effects of the fields of a joint, and the power of its ratio with which a follower's count."""


def assemble(
    tree: Tree,
    choice: Choice,
    *,
    name: str,
    gravity: Sequence[float],
    path: Path,
    warnings: Sequence[str] = (),
) -> Robot:
    """The Robot of a tree, or of a part of it; link frames are those of the file's links.

    Joints that mimic others have no coordinate of their own: their damping, friction, armature and
    springs are part of the followed joint's, as virtual work has it.

    Args:
        tree: links and joints.
        choice: of the part.
        name: of the robot.
        gravity: (3,) in the root link's frame [m/s^2].
        path: file it was read from.
        warnings: what the reader noticed so far.

    Raises:
        RobotError: not a tree, or no such part (see `choose`).
    """
    part = choose(tree, choice)
    carriers = part.carriers
    steps = [_step(part.groups[k], joint) for k, joint in zip(carriers, part.joints, strict=True)]
    parameters, noticed = merged_parameters(tree, part)
    own = [joint for joint in part.joints if joint.mimic is None]
    place = {joint.name: k for k, joint in enumerate(own)}
    mimics = tuple(
        Mimic(
            link,
            joint.name,
            JointType(joint.motion),
            place[joint.mimic.joint],
            joint.mimic.ratio,
            joint.mimic.offset,
        )
        for link, joint in enumerate(part.joints)
        if joint.mimic is not None and joint.motion is not None
    )
    tips = tuple(Tip(end, k - 1, part.groups[k].poses[end]) for end, k in part.tips)
    down = torch.tensor(list(gravity), dtype=torch.float64)
    return Robot(
        name=name,
        joint_names=tuple(joint.name for joint in own),
        link_names=tuple(group.link for group in part.groups[1:]),
        joint_types=tuple(JointType(joint.motion) for joint in own if joint.motion),
        before=torch.stack([before for before, _ in steps]),
        after=torch.stack([after for _, after in steps]),
        gravity=down if choice.root is None else part.pose[:3, :3].T @ down,
        tool=tips[-1].pose,
        limits=Limits(
            position=_intervals([joint.position for joint in own]),
            velocity=_intervals([joint.velocity for joint in own]),
            torque=_intervals([joint.torque for joint in own]),
        ),
        parameters=parameters,
        compensated=_compensated(tree, part),
        effects=tuple(_effects(part, own)),
        warnings=(*warnings, *part.warnings, *noticed),
        source=str(path),
        tip=choice.tip,
        parents=tuple(k - 1 for k in carriers),
        mimics=mimics,
        tips=tips if len(tips) > 1 else (),
        root=choice.root,
        locked=MappingProxyType(dict(choice.lock)),
        spare=tuple(joint.name for joint in tree.joints if joint.name not in place),
        base=BaseLink(part.groups[0].link, _merged(tree, part.groups[0]), down),
    )


def _effects(part: Part, own: Sequence[TreeJoint]) -> Iterator[Mapping[str, Any]]:
    """Records of the joints' dynamics: those of joints that follow act on the joint that they
    follow, a torque times their ratio."""
    followers = [(joint, joint.mimic) for joint in part.joints if joint.mimic is not None]
    for effect, symbol, field, power in _EFFECTS:
        for i, joint in enumerate(own, start=1):
            value = getattr(joint, field)
            for other, way in followers:
                if way.joint == joint.name:
                    value += abs(way.ratio) ** power * getattr(other, field)
            if value:
                yield MappingProxyType({**effect, "joint": i, symbol: value})
    for i, joint in enumerate(own, start=1):
        k, c0 = joint.stiffness, -joint.stiffness * joint.rest
        for other, way in followers:
            if way.joint == joint.name:
                k += way.ratio**2 * other.stiffness
                c0 -= way.ratio * other.stiffness * (other.rest - way.offset)
        if k:
            yield MappingProxyType({"effect": "joint_spring", "joint": i, "k": k, "c0": c0})


def _step(group: Group, joint: TreeJoint) -> tuple[Tensor, Tensor]:
    """Poses before and after the joint's motion about z, so that z turns with the file's axis."""
    turn = align_z(joint.axis)
    before = group.poses[joint.parent] @ joint.origin @ pose(turn)
    if joint.zero:
        revolute = joint.motion is JointType.REVOLUTE
        before = before @ (
            pose(rotation_z(-joint.zero)) if revolute else pose(None, (0, 0, -joint.zero))
        )
    return before, pose(turn.T) @ joint.child_pose


def merged_parameters(tree: Tree, part: Part) -> tuple[InertialParameters | None, tuple[str, ...]]:
    """Parameters (L, 10) of each moving group in its first link's frame, and warnings.

    None, with a warning, where no link has any.
    """
    rows = [_merged(tree, group) for group in part.groups[1:]]
    if all(row is None for row in rows):
        return None, ("no link of the chain has inertial parameters",)
    warnings = []
    zeros = torch.zeros(PARAMETERS_PER_LINK, dtype=torch.float64)
    for group, row in zip(part.groups[1:], rows, strict=True):
        if row is None:
            warnings.append(f"link '{group.link}' has no inertial parameters: zeros are used")
    parameters = InertialParameters(torch.stack([zeros if row is None else row for row in rows]))
    eigenvalues = torch.linalg.eigvalsh(parameters.pseudo_inertia)
    for group, values in zip(part.groups[1:], eigenvalues, strict=True):
        if values[0] < -_ROUNDING * values.abs().max():
            warnings.append(
                f"link '{group.link}' is not physically consistent: no body has its mass, centre "
                f"of mass and inertia (smallest eigenvalue of its pseudo-inertia {values[0]:.3g})"
            )
    return parameters, tuple(warnings)


def _merged(
    tree: Tree, group: Group, shares: Mapping[str, float] | None = None
) -> Float[Tensor, "10"] | None:
    """Sum of a group's inertial parameters in its first link's frame, or of shares of them by link;
    None where it has none."""
    moved = [
        move(pi, link_pose) * (1.0 if shares is None else shares.get(name, 0.0))
        for name, link_pose in group.poses.items()
        if (pi := tree.links[name]) is not None
    ]
    return torch.stack(moved).sum(0) if moved else None


def _compensated(tree: Tree, part: Part) -> Float[Tensor, "L 4"] | None:
    """Masses and first moments of the moving groups whose weight servos do not feel."""
    if not tree.compensated:
        return None
    rows = [_merged(tree, group, tree.compensated) for group in part.groups[1:]]
    none = torch.zeros(PARAMETERS_PER_LINK, dtype=torch.float64)
    stacked = torch.stack([none if row is None else row for row in rows])[:, :4]
    return stacked if bool(stacked.any()) else None


def _intervals(rows: Sequence[Interval | None]) -> Tensor | None:
    """(n, 2), infinite where one joint has no limit; None where no joint has a finite one."""
    free = (-math.inf, math.inf)
    if all(row is None or row == free for row in rows):
        return None
    return torch.tensor([free if row is None else row for row in rows], dtype=torch.float64)
