"""Three arms of our own making: joints, solids and limits, and the URDF of what is known of them.

`3r` turns about the vertical and moves in a vertical plane; `6r` has the offsets of light
collaborative arms; `7r` has alternating axes and the size of a human arm.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import numpy as np
from lxml import etree
from lxml.builder import E

from torchid.withheld.plant.bodies import Array, Box, Cylinder, Inertial, combined

Triple = tuple[float, float, float]
Solid = Box | Cylinder


@dataclass(frozen=True)
class Joint:
    """A revolute joint, and the link that it moves, whose frame is the joint's.

    Attributes:
        xyz, rpy: of the joint in the frame of the link before [m, rad], as in URDF.
        axis: unit vector in the joint frame.
        lower, upper: position limits [rad].
        velocity: limit [rad/s].
        effort: limit [N m].
        solids: what the link is made of.
        parent: the link (from 0) that carries it, -1 the base; the one before where None.
        rotor: inertia of the rotor seen through the gear, which the maker's data tell [kg m^2].
        free_speed: at which the motor has no torque left [rad/s]; None where it has it at any.
    """

    xyz: Triple
    rpy: Triple
    axis: Triple
    lower: float
    upper: float
    velocity: float
    effort: float
    solids: tuple[Solid, ...]
    parent: int | None = None
    rotor: float = 0.0
    free_speed: float | None = None

    def inertial(self) -> Inertial:
        """Of the link."""
        return combined([solid.inertial() for solid in self.solids])


@dataclass(frozen=True)
class Arm:
    """An arm as its maker describes it.

    Attributes:
        name: 3r, 6r or 7r; of `trees.py` quadruped, two_arms or torso.
        joints: from the base, branch by branch: each behind the one that carries it.
        tool: point of the last link where tools are, and of the last of every branch [m].
        bus: how late a command reaches the motors [s].
    """

    name: str
    joints: tuple[Joint, ...]
    tool: Triple
    bus: float = 0.0

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def parents(self) -> tuple[int, ...]:
        """The link (from 0) that carries each joint, -1 the base."""
        return tuple(k - 1 if j.parent is None else j.parent for k, j in enumerate(self.joints))

    def neighbours(self, joint: int) -> list[int]:
        """Joints (from 0) of the links next to a joint's own: the one before, and those behind."""
        behind = [k for k, parent in enumerate(self.parents) if parent == joint]
        return [k for k in (self.parents[joint], *behind) if k >= 0]

    def available(self, speed: Array) -> Array:
        """Torque (T, n) that the motors have at speeds (T, n): all of it up to `CORNER` of the free
        speed, and from there on less, to none at it [N m]."""
        effort = np.array([joint.effort for joint in self.joints])
        free = np.array([joint.free_speed or np.inf for joint in self.joints])
        with np.errstate(invalid="ignore"):
            left = (free - np.abs(speed)) / (free * (1 - CORNER))
        return effort * np.where(np.isfinite(free), np.clip(left, 0.0, 1.0), 1.0)


CORNER = 0.6
"""Share of its free speed up to which a motor has all of its torque: there the battery's voltage
ends, not the current."""

_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_LEVEL = (0.0, 0.0, 0.0)
_UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def _joint(xyz: Triple, rpy: Triple, axis: Triple, limits: Triple, *solids: Solid) -> Joint:
    """A joint that turns as far one way as the other: limits of position, velocity and effort."""
    reach, velocity, effort = limits
    return Joint(xyz, rpy, axis, -reach, reach, velocity, effort, solids)


def _tube(radius: float, length: float, density: float) -> Cylinder:
    """A tube from the joint along z."""
    return Cylinder(density, radius, length, (0.0, 0.0, length / 2))


def _hub(radius: float, length: float, axis: str, density: float, at: Triple) -> Cylinder:
    return Cylinder(density, radius, length, at, axis)


_3R = Arm(
    "3r",
    (
        _joint(
            (0.0, 0.0, 0.12), _LEVEL, _Z, (2.6, 3.0, 40.0),
            _tube(0.07, 0.16, 2400.0), _hub(0.06, 0.14, "y", 2700.0, (0.01, 0.03, 0.16)),
        ),
        _joint(
            (0.0, 0.0, 0.18), _LEVEL, _Y, (1.9, 2.6, 110.0),
            Box(1100.0, (0.09, 0.08, 0.36), (0.0, 0.01, 0.18)),
            _hub(0.05, 0.11, "y", 2600.0, (0.005, 0.0, 0.36)),
        ),
        _joint(
            (0.0, 0.02, 0.36), _LEVEL, _Y, (2.4, 3.2, 50.0),
            Box(1000.0, (0.06, 0.06, 0.30), (0.01, 0.0, 0.14)),
            Box(2200.0, (0.07, 0.10, 0.05), (0.0, -0.01, 0.30)),
        ),
    ),
    (0.0, 0.0, 0.34),
)  # fmt: skip

_6R = Arm(
    "6r",
    (
        _joint(
            (0.0, 0.0, 0.09), _LEVEL, _Z, (3.1, 3.0, 150.0),
            _hub(0.06, 0.12, "z", 2100.0, (0.0, -0.01, 0.0)),
            Box(1500.0, (0.1, 0.1, 0.09), (0.0, 0.03, 0.01)),
        ),
        _joint(
            (0.0, 0.135, 0.0), (0.0, pi / 2, 0.0), _Y, (1.7, 2.6, 150.0),
            Cylinder(1250.0, 0.055, 0.42, (0.0, 0.0, 0.21)),
            _hub(0.06, 0.13, "y", 2300.0, (0.0, 0.01, 0.0)),
            _hub(0.05, 0.11, "y", 2300.0, (0.0, -0.02, 0.42)),
        ),
        _joint(
            (0.0, -0.12, 0.425), _LEVEL, _Y, (2.5, 3.0, 110.0),
            Cylinder(1000.0, 0.04, 0.38, (0.005, 0.0, 0.19)),
            _hub(0.04, 0.09, "y", 2200.0, (0.0, 0.01, 0.38)),
        ),
        _joint(
            (0.0, 0.0, 0.392), (0.0, pi / 2, 0.0), _Y, (2.8, 3.3, 40.0),
            _hub(0.038, 0.11, "y", 2100.0, (0.0, 0.06, 0.01)),
            Box(1500.0, (0.06, 0.06, 0.06), (0.01, 0.09, 0.0)),
        ),
        _joint(
            (0.0, 0.093, 0.0), _LEVEL, _Z, (2.8, 3.6, 35.0),
            _hub(0.037, 0.10, "z", 2100.0, (0.005, 0.0, 0.05)),
            Box(1500.0, (0.05, 0.07, 0.06), (0.0, 0.015, 0.09)),
        ),
        _joint(
            (0.0, 0.0, 0.095), _LEVEL, _Y, (2.8, 3.6, 25.0),
            _hub(0.034, 0.05, "y", 2500.0, (0.0, 0.06, 0.0)),
            Box(1900.0, (0.05, 0.10, 0.09), (0.02, 0.12, 0.015)),
        ),
    ),
    (0.0, 0.16, 0.0),
)  # fmt: skip

_7R = Arm(
    "7r",
    (
        _joint(
            (0.0, 0.0, 0.11), _LEVEL, _Z, (2.8, 2.2, 160.0),
            _tube(0.06, 0.17, 1500.0), Box(1300.0, (0.1, 0.09, 0.09), (0.0, -0.03, 0.17)),
        ),
        _joint(
            (0.0, 0.0, 0.2), (-pi / 2, 0.0, 0.0), _Z, (1.9, 2.2, 180.0),
            _hub(0.06, 0.12, "z", 1500.0, (0.0, -0.01, 0.01)),
            _hub(0.06, 0.14, "y", 1500.0, (0.0, -0.11, 0.02)),
        ),
        _joint(
            (0.0, -0.2, 0.0), (pi / 2, 0.0, 0.0), _Z, (2.8, 2.3, 120.0),
            _tube(0.055, 0.16, 1550.0), Box(1300.0, (0.09, 0.08, 0.08), (0.0, 0.03, 0.17)),
        ),
        _joint(
            (0.0, 0.0, 0.2), (pi / 2, 0.0, 0.0), _Z, (2.0, 2.3, 120.0),
            _hub(0.055, 0.11, "z", 1550.0, (0.0, 0.01, 0.01)),
            _hub(0.055, 0.13, "y", 1550.0, (0.0, 0.10, 0.02)),
        ),
        _joint(
            (0.0, 0.2, 0.0), (-pi / 2, 0.0, 0.0), _Z, (2.8, 2.5, 60.0),
            _tube(0.045, 0.15, 1600.0), Box(1400.0, (0.08, 0.07, 0.07), (0.0, -0.02, 0.16)),
        ),
        _joint(
            (0.0, 0.0, 0.19), (-pi / 2, 0.0, 0.0), _Z, (2.0, 2.6, 60.0),
            _hub(0.045, 0.10, "z", 1700.0, (0.0, 0.01, 0.0)),
            Box(1500.0, (0.07, 0.06, 0.08), (0.005, -0.02, 0.02)),
        ),
        _joint(
            (0.0, -0.08, 0.0), (pi / 2, 0.0, 0.0), _Z, (2.8, 3.0, 40.0),
            _hub(0.04, 0.04, "z", 2300.0, (0.0, 0.0, 0.03)),
            Box(1900.0, (0.06, 0.10, 0.08), (0.025, 0.01, 0.09)),
        ),
    ),
    (0.0, 0.0, 0.14),
)  # fmt: skip

ARMS: dict[str, Arm] = {arm.name: arm for arm in (_3R, _6R, _7R)}


def urdf(arm: Arm, damping: Array, friction: Array) -> str:
    """URDF of the arm with what is known of its friction.

    Args:
        arm: the arm.
        damping, friction: (n,) viscous [N m s/rad] and Coulomb [N m] friction; zeros are left out.
    """
    robot = E.robot(E.link(name="base"), name="arm")
    branching = arm.parents != tuple(range(-1, arm.n - 1))
    for k, (joint, viscous, coulomb) in enumerate(zip(arm.joints, damping, friction, strict=True)):
        name, body = f"link{k + 1}", joint.inertial()
        parent = f"link{arm.parents[k] + 1}" if arm.parents[k] >= 0 else "base"
        moments = {f"i{'xyz'[a]}{'xyz'[b]}": spaced([body.inertia[a, b]]) for a, b in _UPPER}
        inertial = E.inertial(
            E.origin(xyz=spaced(body.com), rpy="0 0 0"),
            E.mass(value=spaced([body.mass])),
            E.inertia(moments),
        )
        limits = ("lower", "upper", "velocity", "effort")
        mount = E.joint(
            E.parent(link=parent),
            E.child(link=name),
            E.origin(xyz=spaced(joint.xyz), rpy=spaced(joint.rpy)),
            E.axis(xyz=spaced(joint.axis)),
            E.limit({limit: spaced([getattr(joint, limit)]) for limit in limits}),
            name=f"joint{k + 1}",
            type="revolute",
        )
        if viscous or coulomb:
            mount.append(E.dynamics(damping=spaced([viscous]), friction=spaced([coulomb])))
        robot.extend([E.link(inertial, name=name), mount])
    # A tool at the end of every branch: a hand, a foot.
    for k in [k for k in range(arm.n) if k not in arm.parents]:
        end = f"tip{k + 1}" if branching else "tool"
        mount = E.joint(
            E.parent(link=f"link{k + 1}"),
            E.child(link=end),
            E.origin(xyz=spaced(arm.tool), rpy="0 0 0"),
            name=f"{end}_mount",
            type="fixed",
        )
        robot.extend([E.link(name=end), mount])
    text: str = etree.tostring(robot, pretty_print=True, encoding="unicode")
    return f'<?xml version="1.0"?>\n{text}'


def spaced(values: Array | Sequence[float]) -> str:
    """Numbers separated by spaces, none of their digits lost."""
    return " ".join(repr(float(v)) for v in values)
