"""Links and joints of a robot file, URDF or MJCF, as MuJoCo's parser (MjSpec) has them.

A URDF counts as it is written and is never compiled: impossible inertias are read too, and absent
meshes matter to nobody. Of an MJCF the numbers are those of the compiled model: defaults, angles in
degrees and inertias of geoms are the compiler's work.
"""

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np
import torch
from torch import Tensor

from torchid.errors import LARGEST, RobotError
from torchid.robot.inertia import InertialParameters, move
from torchid.robot.model import JointType, free_name
from torchid.robot.placement import pose, quaternion
from torchid.robot.tree import Following, Interval, Tree, TreeJoint

FAILURES = (ValueError, RuntimeError, mujoco.FatalError)
"""What MuJoCo raises of a file that it cannot read."""

SET_POINT = "torchid_set_point_"
"""Before a joint's name: body and joint that are its servo's set point, and no part of the arm."""
SERVO, INSIDE = "torchid_servo_", "_damping"
"""Before a joint's name: actuators of its servo where it has a set point; and behind it: that of
the damping that a limit of force holds, too."""
_SHORTEST_AXIS = 1e-12
_MOTIONS = {
    mujoco.mjtJoint.mjJNT_HINGE: JointType.REVOLUTE,
    mujoco.mjtJoint.mjJNT_SLIDE: JointType.PRISMATIC,
}


def listening() -> list[str]:
    """A list into which MuJoCo's warnings go from now on; else it writes a file into the working
    directory."""
    said: list[str] = []
    mujoco.set_mju_user_warning(said.append)
    return said


def name_parts(spec: Any) -> None:
    """Give bodies and joints that have no name one, distinct from the others."""
    for word, parts in (("body", spec.bodies), ("joint", spec.joints)):
        taken = {part.name for part in parts}
        for part in parts:
            if not part.name:
                part.name = free_name(f"{word}_{part.id}", taken)


def spec_tree(
    spec: Any,
    source: str,
    mimics: Mapping[str, Following] = MappingProxyType({}),
    model: Any = None,
    tip: str | None = None,
) -> Tree:
    """Links with their parameters (10,) or None, and joints, in MuJoCo's order.

    A body with several joints is a chain of massless links, named `body/joint`, that ends in it.

    Args:
        spec: of MuJoCo, in which all parts have names.
        source: names the file in errors.
        mimics: by joint, which other one it follows.
        model: compiled from the spec; its numbers count then.
        tip: where it names a site, that is a massless link fixed to its body.

    Raises:
        RobotError: a number that is not finite, an axis without direction, limits that cross.
    """
    reader = _Reader(source, mimics, model)
    links: dict[str, Tensor | None] = {spec.worldbody.name: None}
    joints: list[TreeJoint] = []
    for body in sorted(spec.bodies[1:], key=lambda body: body.id):
        if body.name.startswith(SET_POINT):
            continue
        links[body.name] = reader.inertial(body)
        steps = reader.steps(body)
        joints.extend(steps)
        for step in steps[:-1]:
            links[step.child] = torch.zeros(10, dtype=torch.float64)
    site = None if tip is None or tip in links else spec.site(tip)
    if tip is not None and site is not None:
        links[tip] = None
        placed = reader.placed(model.site(site.id), f"site '{tip}'")
        joints.append(TreeJoint(f"{tip} (fixed)", site.parent.name, tip, origin=placed))
    return Tree(links, tuple(joints), source)


class _Reader:
    """The numbers of bodies and joints: those of the compiled model where there is one."""

    def __init__(self, source: str, mimics: Mapping[str, Following], model: Any):
        self.source, self.mimics, self.model = source, mimics, model

    def finite(self, values: Any, where: str) -> list[float]:
        """Numbers, or a RobotError."""
        numbers = np.ravel(values).astype(float)
        if not (abs(numbers) < LARGEST).all():
            raise RobotError(f"{self.source}: {where}: not all numbers are finite.")
        return [float(v) for v in numbers]

    def placed(self, part: Any, where: str) -> Tensor:
        """(4, 4) pose of a body or site in the frame that it is given in."""
        turn = quaternion(self.finite(part.quat, where))
        return pose(turn, self.finite(part.pos, where))

    def inertial(self, body: Any) -> Tensor | None:
        """(10,) parameters in the body frame; None for a link of a URDF without <inertial>, or for
        a body of a compiled model without mass."""
        own = body if self.model is None else self.model.body(body.id)
        if not (own.mass if own is not body else body.explicitinertial):
            return None
        full = getattr(own, "fullinertia", np.array([np.nan]))
        # nan: the moments are about principal axes, or all zero.
        xx, yy, zz, xy, xz, yz = (*own.inertia, 0, 0, 0) if np.isnan(full[0]) else full
        where = f"link '{body.name}'"
        mass, *six = self.finite([*np.ravel(own.mass), xx, xy, xz, yy, yz, zz], where)
        # In the axes of the inertial frame and about its origin, the centre of mass.
        tensor = torch.tensor(six, dtype=torch.float64)
        about = InertialParameters.from_com(tensor.new_tensor(mass), tensor.new_zeros(3), tensor)
        turn = quaternion(self.finite(own.iquat, where))
        return move(about.pi, pose(turn, self.finite(own.ipos, where)))

    def steps(self, body: Any) -> list[TreeJoint]:
        """The joints from a body's parent to the body; one fixed joint where it has none."""
        own = body if self.model is None else self.model.body(body.id)
        above, placed = body.parent.name, self.placed(own, f"link '{body.name}'")
        if not body.joints:
            return [TreeJoint(f"{body.name} (fixed)", above, body.name, origin=placed)]
        out: list[TreeJoint] = []
        for joint in body.joints:
            last = joint is body.joints[-1]
            below = body.name if last else f"{body.name}/{joint.name}"
            out.append(self.movable(joint, above, below, placed))
            # The next joint of the body starts where this one has taken the body frame.
            above, placed = below, pose()
        return out

    def movable(self, joint: Any, above: str, below: str, placed: Tensor) -> TreeJoint:
        """A joint of a body, whose frame stands at `placed` in that of `above`."""
        name, where = joint.name, f"joint '{joint.name}'"
        if joint.type not in _MOTIONS:
            free = joint.type == mujoco.mjtJoint.mjJNT_FREE
            refused = (
                f"joint '{name}' is a {'free' if free else 'ball'} joint; only hinge and slide "
                "joints are known"
            )
            return TreeJoint(name, above, below, origin=placed, refused=refused, floating=free)
        own = joint if self.model is None else self.model.joint(joint.id)

        def value(key: str) -> float:
            return self.finite(getattr(own, key), where)[0]

        axis = torch.tensor(self.finite(own.axis, where), dtype=torch.float64)
        if float(axis.norm()) < _SHORTEST_AXIS:
            raise RobotError(f"{self.source}: {where}: the axis has no direction.")
        anchor = torch.tensor(self.finite(own.pos, where), dtype=torch.float64)
        whole = joint.damping if own is joint else [*own.damping, *np.ravel(own.dampingpoly)]
        damping, quadratic, cubic = self.finite(whole, where)
        return TreeJoint(
            name,
            above,
            below,
            _MOTIONS[joint.type],
            placed @ pose(None, anchor),
            axis / axis.norm(),
            zero=value("ref" if self.model is None else "qpos0"),
            child_pose=pose(None, -anchor),
            position=self._range(joint),
            torque=self._torque(joint),
            damping=damping,
            quadratic=quadratic,
            cubic=cubic,
            friction=value("frictionloss"),
            armature=value("armature"),
            stiffness=value("stiffness"),
            rest=value("springref" if self.model is None else "qpos_spring"),
            mimic=self.mimics.get(name),
        )

    def _range(self, joint: Any) -> Interval | None:
        if self.model is not None:
            limited = self.model.jnt_limited[joint.id]
            return _interval(self.model.jnt_range[joint.id]) if limited else None
        low, high = map(float, joint.range)
        if low == high == 0.0:
            return None
        if not low < high:
            raise RobotError(
                f"{self.source}: joint '{joint.name}': the lower limit is not below the upper.",
                got=[low, high],
            )
        return low, high

    def _torque(self, joint: Any) -> Interval | None:
        """The joint's own range, or that of the only actuator on it; None where neither is
        known."""
        model, k = self.model, joint.id
        if model is None:
            return _interval(joint.actfrcrange) if any(joint.actfrcrange) else None
        if model.jnt_actfrclimited[k]:
            return _interval(model.jnt_actfrcrange[k])
        on_joint = [
            a
            for a in range(model.nu)
            if int(model.actuator_trntype[a]) == int(mujoco.mjtTrn.mjTRN_JOINT)
            and int(model.actuator_trnid[a, 0]) == k
        ]
        if len(on_joint) != 1 or not model.actuator_forcelimited[on_joint[0]]:
            return None
        return _interval(
            model.actuator_forcerange[on_joint[0]] * model.actuator_gear[on_joint[0], 0]
        )


def _interval(values: Iterable[float]) -> Interval:
    low, high = sorted(float(v) for v in values)
    return low, high
