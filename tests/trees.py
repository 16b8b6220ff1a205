"""Robots with branches for the tests: one written out, random ones, and those of a package."""

import os
from importlib.util import find_spec
from pathlib import Path

import torch

from tests.arms import consistent_parameters, mixed_arm
from torchid.robot.model import JointType, Limits, Mimic, Robot, Tip
from torchid.robot.placement import pose

_BODY = (
    '<inertial><origin xyz="0.02 -0.01 {reach}" rpy="0.1 0.2 0.3"/><mass value="{mass}"/>'
    '<inertia ixx="0.02" ixy="0.001" ixz="-0.002" iyy="0.025" iyz="0.0015" izz="0.011"/></inertial>'
)


def _link(name: str, mass: float, reach: float = 0.1) -> str:
    return f'<link name="{name}">{_BODY.format(mass=mass, reach=reach)}</link>'


def _joint(name: str, ends: str, kind: str, xyz: str, axis: str, rest: str = "") -> str:
    parent, child = ends.split()
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="0.2 -0.1 0.3"/><axis xyz="{axis}"/>'
        f'<limit lower="-2" upper="2" velocity="3" effort="60"/>{rest}</joint>'
    )


TWO_ARMS = "\n".join(
    (
        '<robot name="two_arms">',
        "<!-- a torso with an arm of two joints and one of three, which ends in a gripper -->",
        '<link name="torso"/>',
        *(_link(name, mass) for name, mass in (("l1", 2.5), ("l2", 1.2), ("r1", 2.4))),
        *(_link(name, mass) for name, mass in (("r2", 1.4), ("r3", 0.6))),
        _link("thumb", 0.05, 0.02),
        _link("finger", 0.04, 0.02),
        '<link name="camera"/>',
        _joint("l_shoulder", "torso l1", "revolute", "0 0.2 0.4", "0 1 0"),
        _joint("r_shoulder", "torso r1", "revolute", "0 -0.2 0.4", "0 1 0"),
        _joint("l_elbow", "l1 l2", "revolute", "0 0 0.3", "1 0 0"),
        _joint(
            "r_elbow", "r1 r2", "revolute", "0 0 0.3", "1 0 0",
            '<dynamics damping="0.4" friction="0.2"/>',
        ),
        _joint("r_wrist", "r2 r3", "continuous", "0 0 0.25", "0 0 1"),
        _joint(
            "thumb_joint", "r3 thumb", "prismatic", "0.02 0 0.1", "1 0 0",
            '<dynamics damping="1.5"/>',
        ),
        _joint(
            "finger_joint", "r3 finger", "prismatic", "-0.02 0 0.1", "1 0 0",
            '<dynamics damping="0.5"/><mimic joint="thumb_joint" multiplier="-2" offset="0.01"/>',
        ),
        '<joint name="camera_mount" type="fixed"><parent link="l2"/><child link="camera"/>'
        '<origin xyz="0 0 0.2"/></joint>',
        "</robot>",
    )
)  # fmt: skip
"""Seven links that move, six coordinates: the joints of the two arms, and the gripper."""


def two_arms(folder: Path) -> Path:
    """The URDF of `TWO_ARMS` in a folder."""
    path = folder / "two_arms.urdf"
    path.write_text(TWO_ARMS)
    return path


def random_tree(parents: list[int], kinds: str, seed: int, follow: dict[int, int]) -> Robot:
    """A tree of these parents with random poses, axes, bodies and gravity.

    Args:
        parents: of each link, -1 the base.
        kinds: R or P, one a link.
        seed: of what is random.
        follow: links whose joints mimic those of other links.
    """
    chain = mixed_arm(kinds, seed)
    draw = torch.Generator().manual_seed(seed)
    own = [k for k in range(len(kinds)) if k not in follow]
    ratios = 2 * torch.rand(2, len(kinds), generator=draw, dtype=torch.float64) - 1.5
    mimics = tuple(
        Mimic(
            link,
            f"mimic_{link}",
            JointType(kinds[link]),
            own.index(other),
            float(ratios[0, link]),
            float(ratios[1, link]),
        )
        for link, other in follow.items()
    )
    leaves = [k for k in range(len(kinds)) if k not in parents]
    tips = tuple(Tip(f"tip_{k}", k, pose(None, (0.1, 0.0, 0.2))) for k in leaves)
    return Robot(
        name=f"tree_{seed}",
        joint_names=tuple(f"joint_{k}" for k in own),
        link_names=tuple(f"link_{k}" for k in range(len(kinds))),
        joint_types=tuple(JointType(kinds[k]) for k in own),
        before=chain.before,
        after=chain.after,
        gravity=chain.gravity,
        tool=tips[-1].pose,
        limits=Limits(),
        parameters=consistent_parameters(len(kinds), seed + 1),
        parents=tuple(parents),
        mimics=mimics,
        tips=tips if len(tips) > 1 else (),
    )


def package_urdfs() -> list[Path]:
    """The URDFs of the package example-robot-data, where it is installed."""
    found = find_spec("cmeel")
    if found is None or found.origin is None:
        return []
    share = Path(found.origin).parents[1] / "cmeel.prefix" / "share" / "example-robot-data"
    return sorted(
        Path(folder) / name
        for folder, _, names in os.walk(share / "robots")
        for name in names
        if name.endswith(".urdf")
    )
