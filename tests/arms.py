"""Arms and states for the tests, all made from a seed."""

from functools import lru_cache

import torch
from torch import Tensor

from tests.marks import some
from torchid.robot.inertia import InertialParameters, six
from torchid.robot.library import load_robot
from torchid.robot.model import JointType, Limits, Robot
from torchid.robot.placement import align_z, pose, roll_pitch_yaw

ISSUE_ARMS = ("3r", "kuka_lwr4", "panda", "ur10e")
ARMS = ("3r", "panda", "mixed", "kuka_lwr4", "ur10e")
QUICK_ARMS = some(ARMS, slow=0, quick=3)
"""Three kinds of arms, one with sliding joints; the others are like the first two, and nightly."""


@lru_cache
def arm(name: str) -> Robot:
    """A built-in robot, or `mixed`: revolute and prismatic joints about oblique axes, oblique
    gravity. Random consistent parameters where a robot has none."""
    robot = mixed_arm() if name == "mixed" else load_robot(name)
    if robot.parameters is None:
        robot = robot.with_parameters(consistent_parameters(robot.n, seed=1))
    return robot


def mixed_arm(kinds: str = "RPRRPR", seed: int = 3) -> Robot:
    """A chain with one R or P joint a letter, random poses, axes and gravity."""
    g = torch.Generator().manual_seed(seed)

    def uniform(*shape: int) -> Tensor:
        return 2 * torch.rand(shape, generator=g, dtype=torch.float64) - 1

    n = len(kinds)
    before, after = [], []
    for _ in kinds:
        # As a URDF joint: the axis's alignment on both sides, and an offset of the link's frame.
        turn = align_z(uniform(3))
        origin = pose(roll_pitch_yaw((2 * uniform(3)).tolist()), 0.4 * uniform(3))
        before.append(origin @ pose(turn))
        after.append(pose(turn.T) @ pose(roll_pitch_yaw(uniform(3).tolist()), 0.2 * uniform(3)))
    return Robot(
        name=f"mixed_{kinds}_{seed}",
        joint_names=tuple(f"joint_{i}" for i in range(n)),
        link_names=tuple(f"link_{i}" for i in range(n)),
        joint_types=tuple(JointType(k) for k in kinds),
        before=torch.stack(before),
        after=torch.stack(after),
        gravity=9.81 * uniform(3),
        tool=pose(),
        limits=Limits(),
        parameters=consistent_parameters(n, seed + 1),
    )


def consistent_parameters(n: int, seed: int, batch: tuple[int, ...] = ()) -> InertialParameters:
    """Parameters (*batch, n, 10) that some body has: its second moments are those of a cloud of
    points of positive mass."""
    g = torch.Generator().manual_seed(seed)
    points = torch.randn(*batch, n, 12, 3, generator=g, dtype=torch.float64) * 0.1
    points = points + 0.1 * torch.randn(*batch, n, 1, 3, generator=g, dtype=torch.float64)
    masses = 0.05 + 0.5 * torch.rand(*batch, n, 12, generator=g, dtype=torch.float64)
    mass = masses.sum(-1)
    com = (masses.unsqueeze(-1) * points).sum(-2) / mass.unsqueeze(-1)
    second = torch.einsum("...k,...ka,...kb->...ab", masses, points, points)
    trace = second.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    inertia = trace * torch.eye(3, dtype=torch.float64) - second
    return InertialParameters.from_link_frame(mass, com, six(inertia))


def states(robot: Robot, *batch: int, seed: int = 7) -> tuple[Tensor, Tensor, Tensor]:
    """Random q in +-pi, dq in +-3, ddq in +-8 (*batch, n)."""
    g = torch.Generator().manual_seed(seed)
    shape = (*batch, robot.n)
    q, dq, ddq = (
        scale * (2 * torch.rand(shape, generator=g, dtype=torch.float64) - 1)
        for scale in (torch.pi, 3.0, 8.0)
    )
    return q, dq, ddq


def relative(a: Tensor, b: Tensor) -> float:
    """Largest difference, relative to the largest entry of b."""
    return float((a - b).abs().max() / b.abs().max())


def single_axis(
    kind: str = "R", inertia: float = 1.2e-3, mass: float = 0.5, *, known: bool = True
) -> Robot:
    """One joint along the vertical that turns or slides without limits: a motor, or a table on
    its side, which gravity does not load."""
    one = torch.eye(4, dtype=torch.float64)
    pi = torch.tensor([[mass, 0, 0, 0, inertia, 0, 0, inertia, 0, inertia]], dtype=torch.float64)
    gravity = (0.0, 0.0, -9.81) if kind == "R" else (0.0, -9.81, 0.0)
    return Robot(
        name="axis",
        joint_names=("hub",),
        link_names=("rotor",),
        joint_types=(JointType(kind),),
        before=one[None],
        after=one[None],
        gravity=torch.tensor(gravity, dtype=torch.float64),
        tool=one,
        limits=Limits(),
        parameters=InertialParameters(pi) if known else None,
    )
