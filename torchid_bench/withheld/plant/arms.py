"""Arms, and robots that branch, of our own making: joints, solids and limits, and the URDF of what
is known of them.

Of arms.yaml `3r` turns about the vertical and moves in a vertical plane; `6r` has the offsets of
light collaborative arms; `7r` has alternating axes and the size of a human arm. Those of trees.yaml
branch.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree
from lxml.builder import E

from torchid.errors import TorchidError
from torchid.yaml_data import parsed_yaml
from torchid_bench.withheld.plant.bodies import Array, Box, Cylinder, Inertial, combined

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
        """Mass, centre and inertia of the link."""
        return combined([solid.inertial() for solid in self.solids])


@dataclass(frozen=True)
class Arm:
    """An arm as its maker describes it.

    Attributes:
        name: 3r, 6r or 7r; of those that branch quadruped, two_arms or torso.
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

_UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_SOLIDS: dict[str, type[Solid]] = {"box": Box, "cylinder": Cylinder}


def _joint(
    axis: str, reach: float | tuple[float, float], solids: Sequence[dict[str, Any]], **known: Any
) -> Joint:
    """A joint as the files have it, which turns as far either way where one reach is given."""
    lower, upper = reach if isinstance(reach, tuple) else (-reach, reach)
    made = tuple(_SOLIDS[kind](*own) for solid in solids for kind, own in solid.items())
    known = {"rpy": (0.0, 0.0, 0.0)} | known
    return Joint(axis=_AXES[axis], lower=lower, upper=upper, solids=made, **known)


def _fixed(value: Any) -> Any:
    """Lists of numbers as tuples."""
    if isinstance(value, dict):
        return {key: _fixed(entry) for key, entry in value.items()}
    return tuple(map(_fixed, value)) if isinstance(value, list) else value


def _read(file: str) -> dict[str, Arm]:
    """The arms of a file beside this one."""
    parsed = _fixed(parsed_yaml(Path(__file__).with_name(file).read_text(encoding="utf-8")))
    return {
        name: Arm(name, tuple(_joint(**joint) for joint in own.pop("joints")), **own)
        for name, own in parsed.items()
    }


ARMS = _read("arms.yaml")
TREES = _read("trees.yaml")
"""Robots that branch, their base held in the air."""

ROBOTS = {"arms": tuple(ARMS), "tree": tuple(TREES)} | {name: (name,) for name in TREES}
"""What a set's robots are, by what is asked for: arms, robots that branch, or one of these."""


def arm_named(name: str) -> Arm:
    """One of the arms, or of the robots that branch.

    Raises:
        TorchidError: there is none of that name.
    """
    known = ARMS | TREES
    if name not in known:
        raise TorchidError(f"unknown withheld robot '{name}'.", available=list(known))
    return known[name]


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
