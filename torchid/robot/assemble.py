"""From a tree of links and joints to a Robot: fixed joints folded, inertias merged."""

import math
from collections.abc import Sequence
from pathlib import Path
from types import MappingProxyType

import torch
from torch import Tensor

from torchid.robot.inertia import PARAMETERS_PER_LINK, InertialParameters, move
from torchid.robot.model import JointType, Limits, Robot
from torchid.robot.placement import align_z, pose, rotation_z
from torchid.robot.tree import Chain, Group, Interval, Tree, TreeJoint, choose_chain
from torchid.typing import Float

# Below this share of the largest eigenvalue a negative one is rounding, as for a point mass.
_ROUNDING = 1e-12
_EFFECTS = (
    ("viscous_friction", "Fv", "damping"),
    ("coulomb_friction", "Fc", "friction"),
    ("rotor_inertia", "Ia", "armature"),
)


def assemble(
    tree: Tree,
    *,
    tip: str | None,
    name: str,
    gravity: Sequence[float],
    path: Path,
    warnings: Sequence[str] = (),
) -> Robot:
    """The Robot of a tree's chain; link frames are those of the file's links.

    Args:
        tree: links and joints.
        tip: the last link, or None where there is only one chain.
        name: of the robot.
        gravity: (3,) in the root link's frame [m/s^2].
        path: file it was read from.
        warnings: what the reader noticed so far.

    Raises:
        RobotError: not a tree, or no unambiguous serial chain (see `choose_chain`).
    """
    chain = choose_chain(tree, tip)
    steps = [_step(group, joint) for group, joint in zip(chain.groups, chain.joints, strict=False)]
    parameters, noticed = merged_parameters(tree, chain)
    linear = tuple(
        MappingProxyType({"effect": effect, "joint": i, symbol: getattr(joint, field)})
        for effect, symbol, field in _EFFECTS
        for i, joint in enumerate(chain.joints, start=1)
        if getattr(joint, field)
    )
    springs = (
        MappingProxyType({"effect": "joint_spring", "joint": i, "k": k, "c0": -k * joint.rest})
        for i, joint in enumerate(chain.joints, start=1)
        if (k := joint.stiffness)
    )
    return Robot(
        name=name,
        joint_names=tuple(joint.name for joint in chain.joints),
        link_names=tuple(group.link for group in chain.groups[1:]),
        joint_types=tuple(JointType(joint.motion) for joint in chain.joints if joint.motion),
        before=torch.stack([before for before, _ in steps]),
        after=torch.stack([after for _, after in steps]),
        gravity=torch.tensor(list(gravity), dtype=torch.float64),
        tool=chain.groups[-1].poses[chain.tip],
        limits=Limits(
            position=_intervals([joint.position for joint in chain.joints]),
            velocity=_intervals([joint.velocity for joint in chain.joints]),
            torque=_intervals([joint.torque for joint in chain.joints]),
        ),
        parameters=parameters,
        effects=(*linear, *springs),
        warnings=(*warnings, *chain.warnings, *noticed),
        source=str(path),
    )


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


def merged_parameters(
    tree: Tree, chain: Chain
) -> tuple[InertialParameters | None, tuple[str, ...]]:
    """Parameters (n, 10) of each moving group in its first link's frame, and warnings.

    None, with a warning, where no link of the chain has any.
    """
    rows = [_merged(tree, group) for group in chain.groups[1:]]
    if all(row is None for row in rows):
        return None, ("no link of the chain has inertial parameters",)
    warnings = []
    zeros = torch.zeros(PARAMETERS_PER_LINK, dtype=torch.float64)
    for group, row in zip(chain.groups[1:], rows, strict=True):
        if row is None:
            warnings.append(f"link '{group.link}' has no inertial parameters: zeros are used")
    parameters = InertialParameters(torch.stack([zeros if row is None else row for row in rows]))
    eigenvalues = torch.linalg.eigvalsh(parameters.pseudo_inertia)
    for group, values in zip(chain.groups[1:], eigenvalues, strict=True):
        if values[0] < -_ROUNDING * values.abs().max():
            warnings.append(
                f"link '{group.link}' is not physically consistent: no body has its mass, centre "
                f"of mass and inertia (smallest eigenvalue of its pseudo-inertia {values[0]:.3g})"
            )
    return parameters, tuple(warnings)


def _merged(tree: Tree, group: Group) -> Float[Tensor, "10"] | None:
    """Sum of a group's inertial parameters in its first link's frame; None where it has none."""
    moved = [
        move(pi, link_pose)
        for name, link_pose in group.poses.items()
        if (pi := tree.links[name]) is not None
    ]
    return torch.stack(moved).sum(0) if moved else None


def _intervals(rows: Sequence[Interval | None]) -> Tensor | None:
    """(n, 2), infinite where one joint has no limit; None where no joint has a finite one."""
    free = (-math.inf, math.inf)
    if all(row is None or row == free for row in rows):
        return None
    return torch.tensor([free if row is None else row for row in rows], dtype=torch.float64)
