"""The robot as a pytorch-kinematics chain, and the Jacobian of the tool from it.

The chain is built from our float64 matrices: pytorch-kinematics' own readers parse numbers in
float32. Every joint turns about z between two constant poses, as in torchid.robot.model.
"""

from functools import lru_cache

import pytorch_kinematics as pk
import torch
from torch import Tensor

from torchid.errors import RobotError
from torchid.robot.model import JointType, Limits, Robot, Tip, free_name
from torchid.typing import Float, Joints

_TOGETHER = 2000
"""Configurations at a time [1]: the poses of an arm of seven joints then stay in the cache."""


def to_chain(
    robot: Robot, dtype: torch.dtype = torch.float64, tip: str | None = None
) -> "pk.SerialChain":
    """The chain to the tool as a SerialChain of the given dtype, on the device of its data.

    Each joint has two frames: `<joint>/moved`, which moves, and one named as the link, which is
    the link frame. The root is `base` and the end is `tool`. A name that is already taken has
    underscores appended. Joint parameters are named as the robot's joints. Forward kinematics of
    the end is `torchid.robot.model.tool_pose`. Of a tree these are the joints that move the tip, in
    order; one that mimics another is a joint like the others.

    Args:
        robot: the robot.
        dtype: of the chain.
        tip: which of several tips.

    Raises:
        RobotError: several tips and none chosen, or none of that name.
    """
    end = robot.end(tip)
    # Frame names must differ, whereas a URDF link may be called `base` or `tool`.
    taken = set(robot.link_names)
    root = last = _fixed(free_name("base", taken), None, dtype)
    for i in robot.ancestors(end.link):
        moved = free_name(f"{robot.drives[i].joint}/moved", taken)
        last = _append(last, _moving(robot, i, moved, robot.before[i], dtype))
        last = _append(last, _fixed(robot.link_names[i], robot.after[i], dtype))
    tool = _append(last, _fixed(free_name("tool", taken), end.pose, dtype))
    return _serial(root, tool, robot, dtype)


def tool_jacobian(
    robot: Robot, q: Joints, tip: str | Tip | None = None
) -> Float[Tensor, "*batch 6 n"]:
    """Geometric Jacobian of the tool, or of another point of the arm, in axes of the base frame.

    Args:
        robot: the robot.
        q: (..., n) joint positions [rad or m]; its dtype and device are the result's.
        tip: which of several tips, by its name; or any point, as `point_of_link` gives it.

    Returns:
        (..., 6, n). Rows 0-2: velocity of the tool's origin per unit joint velocity [m/rad or 1];
        rows 3-5: angular velocity of the tool [1 or rad/m, 0 for a prismatic joint]. Linear
        first, so that J' (force, moment at the tool's origin) is the joint torque. Columns of
        joints that do not move the tip are zero.

    Raises:
        RobotError: several tips and none chosen, or none of that name.
    """
    end = tip if isinstance(tip, Tip) else robot.end(tip)
    chain = _folded_chain(robot, end, q.dtype, q.device)
    if robot.is_serial and end.link == robot.n_links - 1:
        parts = [chain.jacobian(some) for some in q.reshape(-1, robot.n).split(_TOGETHER)]
        return torch.cat(parts).reshape(*q.shape[:-1], 6, robot.n)
    line = list(robot.ancestors(end.link))
    on_line = robot.on_links(q.reshape(-1, robot.n))[:, line]
    own = torch.cat([chain.jacobian(some) for some in on_line.split(_TOGETHER)])
    out = own.new_zeros(len(own), 6, robot.n)
    for k, link in enumerate(line):
        drive = robot.drives[link]
        out[:, :, drive.coordinate] += own[:, :, k] * drive.ratio
    return out.reshape(*q.shape[:-1], 6, robot.n)


@lru_cache(maxsize=64)
def point_of_link(robot: Robot, link: str, along: float) -> Tip:
    """A point between a link's own joint and the next one.

    Args:
        robot: the robot.
        link: by its name.
        along: 0 at its own joint, 1 at the next one; of several that at the farthest, of none the
            tip.

    Raises:
        RobotError: no such link.
    """
    if link not in robot.link_names:
        raise RobotError(
            f"robot '{robot.name}' has no such link.",
            got=link,
            expected="the name of one",
            available=list(robot.link_names),
        )
    i = robot.link_names.index(link)
    # Origins in the link's frame: of its own joint, of those that it carries, and of tips.
    after = robot.after[i]
    near = -after[:3, :3].T @ after[:3, 3]
    carried = [robot.before[k][:3, 3] for k, p in enumerate(robot.parents) if p == i]
    ends = carried or [tip.pose[:3, 3] for tip in robot.ends if tip.link == i] or [near]
    far = max(ends, key=lambda x: float((x - near).norm()))
    pose = torch.eye(4, dtype=after.dtype, device=after.device)
    pose[:3, 3] = near + along * (far - near)
    return Tip(link, i, pose)


@lru_cache(maxsize=64)
def _folded_chain(
    robot: Robot, end: Tip, dtype: torch.dtype, device: torch.device
) -> "pk.SerialChain":
    """The chain without its link frames: half the frames, and twice as fast."""
    root = last = _fixed("base", None, dtype)
    line = robot.ancestors(end.link)
    for i in line:
        above = robot.parents[i]
        placed = robot.before[i] if above < 0 else robot.after[above] @ robot.before[i]
        last = _append(last, _moving(robot, i, f"moved {i}", placed, dtype))
    tool = _append(last, _fixed("tool", robot.after[end.link] @ end.pose, dtype))
    return _serial(root, tool, robot, dtype).to(device=device)


def _append(last: "pk.Frame", frame: "pk.Frame") -> "pk.Frame":
    last.add_child(frame)
    return frame


def _serial(root: "pk.Frame", tool: "pk.Frame", robot: Robot, dtype: torch.dtype) -> pk.SerialChain:
    device = robot.before.device
    tree = pk.Chain(root, dtype=dtype, device=device)
    return pk.SerialChain(tree, tool.name, dtype=dtype, device=device)


def _offset(matrix: Tensor, dtype: torch.dtype) -> "pk.Transform3d":
    return pk.Transform3d(matrix=matrix.to(dtype).contiguous())


def _fixed(name: str, placed: Tensor | None, dtype: torch.dtype) -> "pk.Frame":
    offset = None if placed is None else _offset(placed, dtype)
    joint = pk.Joint(name=f"{name}/fixed", offset=offset, joint_type="fixed", dtype=dtype)
    return pk.Frame(name, link=pk.Link(name), joint=joint)


def _moving(robot: Robot, i: int, name: str, placed: Tensor, dtype: torch.dtype) -> "pk.Frame":
    drive = robot.drives[i]
    revolute = drive.joint_type is JointType.REVOLUTE
    # Limits are those of coordinates.
    limits = Limits() if drive in robot.mimics else robot.limits
    own = drive.coordinate
    joint = pk.Joint(
        name=drive.joint,
        offset=_offset(placed, dtype),
        joint_type="revolute" if revolute else "prismatic",
        axis=torch.tensor([0.0, 0.0, 1.0], dtype=dtype, device=robot.before.device),
        dtype=dtype,
        device=robot.before.device,
        limits=_pair(limits.position, own),
        velocity_limits=_pair(limits.velocity, own),
        effort_limits=_pair(limits.torque, own),
    )
    return pk.Frame(name, link=pk.Link(name), joint=joint)


def _pair(limit: Tensor | None, i: int) -> tuple[float, float] | None:
    return None if limit is None else (float(limit[i, 0]), float(limit[i, 1]))
