"""The true arm as data, and as a MuJoCo model."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from torchid.errors import MissingExtraError
from torchid_bench.withheld.plant.arms import Arm, spaced
from torchid_bench.withheld.plant.bodies import Array, Inertial, combined


def mujoco() -> Any:
    """The module.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        import mujoco as module
    except ImportError as error:
        raise MissingExtraError("mujoco", "mjcf", "Simulating withheld cases") from error
    return module


GRAVITY = (0.0, 0.0, -9.81)

_HARD = 'solreflimit="0.004 1" solimplimit="0.99 0.9999 0.001 0.5 2"'
"""An end that gives way by less than a milliradian."""

_TOUCH = 1e-3
"""Radius of what touches the floor [m]."""

_WEIGHTLESS = '<inertial pos="0 0 0" mass="1e-9" diaginertia="1e-12 1e-12 1e-12"/>'


@dataclass(frozen=True)
class Link:
    """A link: pose of its joint in the link that carries it (position [m], rotation), axis, body,
    and which link that is, from 0, -1 the base."""

    position: Array
    rotation: Rotation
    axis: Array
    body: Inertial
    parent: int


@dataclass(frozen=True)
class Spring:
    """A spring between two links: stiffness [N m/rad], at rest at an angle [rad]."""

    joint: int
    stiffness: float
    rest: float


@dataclass(frozen=True)
class Coupling:
    """A motor that turns with w = dq_j + ratio dq_i and has friction of its own.

    Attributes:
        joint, source: j and i, from 0.
        ratio: turns with i per turn with j.
        damping: [N m s/rad].
        friction: [N m].
    """

    joint: int
    source: int
    ratio: float
    damping: float
    friction: float


@dataclass(frozen=True)
class Drive:
    """A motor with a mass of its own before a gear that gives way.

    Attributes:
        joint: from 0.
        rotor: its inertia [kg m^2], which the link's joint has less, so that a stiff gear gives
            the nominal arm.
        stiffness: of the gear [N m/rad].
        damping: of the gear [N m s/rad].
        play: angle between its flanks [rad].
    """

    joint: int
    rotor: float
    stiffness: float
    damping: float
    play: float = 0.0


@dataclass(frozen=True)
class BaseMount:
    """A base on a damped rotational spring about two horizontal axes.

    Attributes:
        stiffness: [N m/rad].
        damping: [N m s/rad].
        inertia: of the base [kg m^2].
    """

    stiffness: float
    damping: float
    inertia: float


@dataclass(frozen=True)
class Plant:
    """The true arm.

    Attributes:
        links: from the base.
        tool: (3,) tool point in the last link [m].
        gravity: (3,) [m/s^2].
        damping, friction, armature: (n,) [N m s/rad; N m; kg m^2] of the motors.
        payload: a body on the last link, in its frame.
        springs, couplings, drives: see there.
        mount: of the base; None where it is rigid.
        fluid: density [kg/m^3] of what the arm moves in.
        stops: ends (low, high) [rad] of joints (from 0) that have any.
        floor: height of a plane that the tool point touches [m]; None where there is none.
    """

    links: tuple[Link, ...]
    tool: Array
    damping: Array
    friction: Array
    armature: Array
    gravity: Array = field(default_factory=lambda: np.array(GRAVITY))
    payload: Inertial | None = None
    springs: tuple[Spring, ...] = ()
    couplings: tuple[Coupling, ...] = ()
    drives: tuple[Drive, ...] = ()
    mount: BaseMount | None = None
    fluid: float = 0.0
    stops: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    floor: float | None = None

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.links)


def plant_of(arm: Arm, damping: Array, friction: Array) -> Plant:
    """The arm as described."""
    links = tuple(
        Link(np.array(j.xyz), Rotation.from_euler("xyz", j.rpy), np.array(j.axis), j.inertial(), p)
        for j, p in zip(arm.joints, arm.parents, strict=True)
    )
    rotors = np.array([j.rotor for j in arm.joints])
    return Plant(links, np.array(arm.tool), damping, friction, rotors)


def compiled(plant: Plant, kp: Array, kd: Array, step: float) -> tuple[Any, Array]:
    """The plant with its position controllers, u = command - kp q - kd dq, as a MuJoCo model.

    Args:
        plant: the arm.
        kp, kd: (n,) gains [N m/rad; N m s/rad].
        step: [s].

    Returns:
        The model, and the degrees of freedom (n,) of the motors; any others are deflections.
    """
    carried = dict.fromkeys(range(-1, plant.n), "")
    for k in reversed(range(plant.n)):
        above = plant.links[k].parent
        carried[above] = _body(plant, k, carried[k]) + carried[above]
    # The shortest time constant MuJoCo allows: friction then slides at once.
    friction = f'solreffriction="{2 * step!r} 1" solimpfriction="0.99 0.99 0.001 0.5 2"'
    actuators = "".join(
        f'<general joint="motor{k}" gainprm="1" biastype="affine" '
        f'biasprm="0 {-float(kp[k])!r} {-float(kd[k])!r}"/>'
        for k in range(plant.n)
    )
    model = mujoco().MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian" autolimits="false"/>'
        f'<option timestep="{step!r}" integrator="implicitfast" gravity="{spaced(plant.gravity)}" '
        f'density="{plant.fluid!r}"/>'
        f"<default><joint {friction}/><tendon {friction}/></default>"
        f"<worldbody>{_mounted(plant, carried[-1])}</worldbody>"
        f"<tendon>{_tendons(plant)}</tendon><actuator>{actuators}</actuator></mujoco>"
    )
    motors = np.array([int(model.joint(f"motor{k}").dofadr[0]) for k in range(plant.n)])
    for drive in plant.drives:
        # What the rotor has the link has not: XML takes no negative number.
        model.tendon_armature[model.tendon(f"link{drive.joint}").id] = -drive.rotor
    return model, motors


def _mounted(plant: Plant, inner: str) -> str:
    if plant.floor is not None:
        inner += f'<geom type="plane" size="3 3 .1" pos="0 0 {plant.floor - _TOUCH!r}" condim="1"/>'
    if plant.mount is None:
        return inner
    m = plant.mount
    hinges = "".join(
        f'<joint name="mount_{name}" axis="{axis}" stiffness="{m.stiffness!r}" '
        f'damping="{m.damping!r}"/>'
        for name, axis in (("x", "1 0 0"), ("y", "0 1 0"))
    )
    i = m.inertia
    return (
        f'<body name="mount">{hinges}<inertial pos="0 0 0" mass="10" diaginertia="{i} {i} {i}"/>'
        f"{inner}</body>"
    )


def _body(plant: Plant, k: int, inner: str) -> str:
    link = plant.links[k]
    drive = next((d for d in plant.drives if d.joint == k), None)
    x, y, z, w = link.rotation.as_quat()
    pose = f'pos="{spaced(link.position)}" quat="{spaced(np.array([w, x, y, z]))}"'
    axis = f'axis="{spaced(link.axis)}"'
    friction = (
        f'damping="{float(plant.damping[k])!r}" frictionloss="{float(plant.friction[k])!r}" '
        f'armature="{float(plant.armature[k]) + (drive.rotor if drive else 0.0)!r}"'
    )
    body = link.body
    last = k == plant.n - 1
    if last and plant.payload is not None:
        body = combined([body, plant.payload])
    if last:
        # Forces at the tool act on a body of its own, whose weight is nothing.
        touches = "" if plant.floor is None else f'<geom size="{_TOUCH!r}" condim="1" mass="0"/>'
        inner += f'<body name="tool" pos="{spaced(plant.tool)}">{_WEIGHTLESS}{touches}</body>'
    ends = plant.stops.get(k)
    stop = "" if ends is None else f' limited="true" range="{spaced(ends)}" {_HARD}'
    motor = f'<joint name="motor{k}" {axis} {friction}{stop}/>'
    entries = spaced(body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
    content = (
        f'<inertial pos="{spaced(body.com)}" mass="{float(body.mass)!r}" '
        f'fullinertia="{entries}"/>{inner}'
    )
    if not drive:
        return f'<body name="link{k}" {pose}>{motor}{content}</body>'
    # The link's own joint is the gear's deflection: in this order MuJoCo's implicit damping of the
    # gear is exact, for links that follow one another share entries of the mass matrix.
    return (
        f'<body name="rotor{k}" {pose}>{motor}{_WEIGHTLESS}<body name="link{k}">'
        f'<joint name="gear{k}" {axis} damping="{drive.damping!r}"/>{content}</body></body>'
    )


def _tendons(plant: Plant) -> str:
    driven = {d.joint for d in plant.drives}

    def link(k: int) -> str:
        """The link's angle: the motor's, and the gear's deflection where there is one."""
        motor = f'<joint joint="motor{k}" coef="1"/>'
        return motor + (f'<joint joint="gear{k}" coef="1"/>' if k in driven else "")

    parts = [
        f'<fixed stiffness="{s.stiffness!r}" springlength="{s.rest!r}">{link(s.joint)}</fixed>'
        for s in plant.springs
    ]
    parts += [
        f'<fixed damping="{c.damping!r}" frictionloss="{c.friction!r}">'
        f'<joint joint="motor{c.joint}" coef="1"/>'
        f'<joint joint="motor{c.source}" coef="{c.ratio!r}"/></fixed>'
        for c in plant.couplings
    ]
    for d in plant.drives:
        half = d.play / 2
        parts.append(f'<fixed name="link{d.joint}">{link(d.joint)}</fixed>')
        parts.append(
            f'<fixed stiffness="{d.stiffness!r}" springlength="{-half!r} {half!r}">'
            f'<joint joint="gear{d.joint}" coef="1"/></fixed>'
        )
    return "".join(parts)
