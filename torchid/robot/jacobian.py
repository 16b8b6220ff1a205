"""The geometric Jacobian of the tool, or of any point of the arm."""

from functools import lru_cache

import torch

from torchid.errors import RobotError
from torchid.robot.model import JointType, Robot, Tip, link_poses
from torchid.typing import Float, Joints, Tensor


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
    # 2000: configurations at a time: the poses of an arm of seven joints then stay in the cache
    parts = [_jacobian(robot, end, some) for some in q.reshape(-1, robot.n).split(2000)]
    return torch.cat(parts).reshape(*q.shape[:-1], 6, robot.n)


def _jacobian(robot: Robot, end: Tip, q: Float[Tensor, "N n"]) -> Float[Tensor, "N 6 n"]:
    poses, out = link_poses(robot, q), q.new_zeros(len(q), 6, robot.n)
    point = poses[:, end.link] @ end.pose[:, 3].to(q)
    for link in robot.ancestors(end.link):
        # A joint moves about, or along, z of the pose that it has in the link that carries it.
        above, drive, placed = robot.parents[link], robot.drives[link], robot.before[link].to(q)
        placed = placed.expand_as(poses[:, 0]) if above < 0 else poses[:, above] @ placed
        axis, arm = placed[:, :3, 2], (point - placed[..., 3])[:, :3]
        turning = drive.joint_type is JointType.REVOLUTE
        both = (torch.linalg.cross(axis, arm), axis) if turning else (axis, 0 * axis)
        out[:, :, drive.coordinate] += drive.ratio * torch.cat(both, 1)
    return out


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
