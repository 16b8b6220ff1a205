"""The robot as a pytorch-kinematics chain.

The chain is built from our float64 matrices: pytorch-kinematics' own readers parse numbers in
float32. Every joint turns about z between two constant poses, as in torchid.robot.model.
"""

import pytorch_kinematics as pk
import torch
from torch import Tensor

from torchid.robot.model import JointType, Limits, Robot, free_name


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
