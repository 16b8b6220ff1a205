"""A base that moves and is measured, as six coordinates before those of the joints.

A robot that hangs from a rope, flies or jumps carries its base along. Where the base is, is
measured: by motion capture, or by the robot's own estimate. Its pose is six coordinates,

    base_x, base_y, base_z             of the base link's origin, in axes of the world [m]
    base_yaw, base_pitch, base_roll    R = Rz(yaw) Ry(pitch) Rx(roll), from base axes to the world's

each of which moves a frame, and the last of them the base's body. So inverse dynamics, regressor
and mass matrix are those of a tree, the base's own ten parameters are in them, and the torques of
the six coordinates are what holds the base from outside. Where nothing holds it they are 0: six
more equations. They see every mass as a whole, which the joints of a robot in a stand do not.

At a pitch of +-pi/2 yaw and roll are one coordinate: `torchid.log.base_motion`, which makes them of
a measured pose, refuses a base that comes near.
(Featherstone 2008, Rigid Body Dynamics Algorithms, section 4.1.)
"""

from dataclasses import replace

import torch

from torchid.errors import RobotError
from torchid.robot.inertia import PARAMETERS_PER_LINK, InertialParameters
from torchid.robot.model import FREE, LIMITS, BaseLink, JointType, Limits, Robot
from torchid.robot.placement import align_z, pose

COORDINATES = ("base_x", "base_y", "base_z", "base_yaw", "base_pitch", "base_roll")
"""Names of the coordinates, in order."""

_AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def on_moving_base(robot: Robot) -> Robot:
    """The robot with its base carried along by six coordinates of its own, first of all.

    Args:
        robot: of a file that says which link its base is.

    Returns:
        n + 6 coordinates and L + 6 links: five frames without a body, the base, and the others.

    Raises:
        RobotError: nothing is known of the base.
    """
    if robot.floating:
        return robot
    if robot.base is None:
        raise RobotError(
            f"robot '{robot.name}' says nothing of the link that is its base, so that cannot move.",
            expected="a URDF or an MJCF",
        )
    turns = [pose(align_z(torch.tensor(axis, dtype=torch.float64))) for axis in _AXES]
    turns += turns[::-1]  # yaw about z, pitch about y, roll about x
    none = robot.before.new_tensor([-torch.inf, torch.inf]).expand(FREE, 2)
    limits = {
        name: None if (own := getattr(robot.limits, name)) is None else torch.cat([none, own])
        for name in LIMITS
    }
    return replace(
        robot,
        joint_names=(*COORDINATES, *robot.joint_names),
        link_names=(*COORDINATES[:-1], robot.base.name, *robot.link_names),
        joint_types=(*[JointType.PRISMATIC] * 3, *[JointType.REVOLUTE] * 3, *robot.joint_types),
        before=torch.cat([torch.stack(turns).to(robot.before), robot.before]),
        after=torch.cat([torch.stack([t.T for t in turns]).to(robot.after), robot.after]),
        gravity=robot.base.gravity,
        limits=Limits(**limits),
        parameters=_with_base(robot.parameters, robot.base),
        compensated=None,
        effects=tuple(
            {k: v + FREE if k in ("joint", "source_joint") else v for k, v in record.items()}
            for record in robot.effects
        ),
        drive_gain=None
        if robot.drive_gain is None
        else torch.cat([robot.drive_gain.new_ones(FREE), robot.drive_gain]),
        parents=(*range(-1, FREE - 1), *(parent + FREE for parent in robot.parents)),
        mimics=tuple(
            replace(m, link=m.link + FREE, coordinate=m.coordinate + FREE) for m in robot.mimics
        ),
        tips=tuple(replace(tip, link=tip.link + FREE) for tip in robot.tips),
        warnings=tuple(w for w in robot.warnings if "can float: it is taken as fixed" not in w),
        knowledge=None,
        floating=True,
    )


def _with_base(known: InertialParameters | None, base: BaseLink) -> InertialParameters | None:
    """Parameters (L + 6, 10): zeros for the frames, the base's own, and the links'."""
    if known is None:
        return None
    frames = known.pi.new_zeros(FREE - 1, PARAMETERS_PER_LINK)
    own = frames[0] if base.parameters is None else base.parameters.to(known.pi)
    return InertialParameters(torch.cat([frames, own.unsqueeze(0), known.pi]))
