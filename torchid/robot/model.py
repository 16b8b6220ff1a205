"""What a robot is: frozen data, no masses in the kinematics.

Frames. Link i moves about the z axis of its joint frame. `before[i]` is the constant pose of joint
frame i in link frame i-1 (the base for i = 0); the joint turns (or slides) about z; `after[i]` is
the constant pose of link frame i in the moved joint frame. So

    T_i(q) = before_i * Rz(q_i) * after_i        (prismatic: Tz(q_i) in place of Rz)

Classical DH has before = 1, modified DH has after = 1, a URDF joint with axis a has a rotation
that takes z to a on both sides. Inertial parameters are expressed in the link frames.
"""

import copyreg
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

import torch
from torch import Tensor

from torchid.errors import RobotError, TorchidError
from torchid.robot.inertia import InertialParameters
from torchid.robot.knowledge import Knowledge
from torchid.tensors import as_tensor, joint_signals
from torchid.typing import Float, Numbers

if TYPE_CHECKING:
    import pytorch_kinematics

STANDARD_GRAVITY = (0.0, 0.0, -9.81)
Basis = Literal["report", "conditioned"]
"""Which base parameters stand for the others: the report's, or those of the best conditioning."""
LIMITS = ("position", "velocity", "acceleration", "torque")


def joint_list(joints: Sequence[int]) -> str:
    """Joints (from 0) for people: `joint 3`, `joints 1, 4`."""
    names = ", ".join(str(k + 1) for k in joints)
    return f"joint{'s' if len(joints) > 1 else ''} {names}"


def free_name(name: str, taken: set[str]) -> str:
    """A name that is not taken yet, and is from now on: with underscores appended if need be."""
    while name in taken:
        name += "_"
    taken.add(name)
    return name


class JointType(StrEnum):
    """Kinds of one-degree-of-freedom joints."""

    REVOLUTE = "R"
    PRISMATIC = "P"


@dataclass(frozen=True)
class Limits:
    """Joint limits, each (n, 2) lower and upper, or None where nothing is known.

    Attributes:
        position: [rad or m].
        velocity: [rad/s or m/s].
        acceleration: [rad/s^2 or m/s^2].
        torque: [N m or N].
    """

    position: Float[Tensor, "n 2"] | None = None
    velocity: Float[Tensor, "n 2"] | None = None
    acceleration: Float[Tensor, "n 2"] | None = None
    torque: Float[Tensor, "n 2"] | None = None

    def __post_init__(self) -> None:
        for name in LIMITS:
            _make_tensor(self, name, f"limits of {name}")

    def require(self, *names: str, robot: str, purpose: str) -> None:
        """Raise RobotError unless all the named limits are known and finite."""
        missing = [
            name
            for name in names
            if getattr(self, name) is None or not torch.isfinite(getattr(self, name)).all()
        ]
        if missing:
            raise RobotError(
                f"robot '{robot}' has no finite {' and '.join(missing)} limits, "
                f"which {purpose} needs.",
                expected="limits: {position: [...], velocity: [...], acceleration: [...]}",
                hint="add `limits` to the robot's yaml or <limit> to its URDF; acceleration: "
                "Robot.with_limits, --max-acceleration on the command line",
            )


def _make_tensor(thing: object, name: str, what: str) -> None:
    """Of a field that may be given as an array or lists; None stays."""
    if getattr(thing, name) is not None:
        object.__setattr__(thing, name, as_tensor(getattr(thing, name), what, RobotError))


def _read_only(values: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    return MappingProxyType(values)


# A robot goes to other processes, its read-only mappings with it.
copyreg.pickle(MappingProxyType, lambda mapping: (_read_only, (dict(mapping),)))


@dataclass(frozen=True, eq=False)
class Robot:
    """A serial manipulator with n one-degree-of-freedom joints. Compared by identity.

    Attributes:
        name: what to call it.
        joint_names, link_names: n each, from base to tip.
        joint_types: n of R or P.
        before: (n, 4, 4) pose of each joint frame in the previous link frame.
        after: (n, 4, 4) pose of each link frame in its moved joint frame.
        gravity: (3,) gravity acceleration in the base frame [m/s^2].
        tool: (4, 4) pose of the tool in the last link frame.
        limits: position, velocity, acceleration, torque.
        parameters: nominal inertial parameters (n, 10), or None.
        effects: nominal effects, as records {effect, joint, <parameter>: value}.
        drive_gain: (n,) [N m/A or N/A] torque per ampere, or None.
        bounds: groups of bounds for the extraction, as read from the robot's yaml.
        basis: of its base parameters, unless another is asked for.
        warnings: what the reader noticed, one sentence each.
        source: file or built-in name it came from.
        tip: that its chain was chosen by, of a URDF or MJCF.
        knowledge: how sure parameters and effects are; None where nobody says it: values like
            those of CAD, to some ten per cent.

    >>> import torchid
    >>> robot = torchid.load_robot("kuka_lwr4")
    >>> robot.n, robot.gravity.tolist()
    (7, [0.0, 0.0, -9.81])
    """

    name: str
    joint_names: tuple[str, ...]
    link_names: tuple[str, ...]
    joint_types: tuple[JointType, ...]
    before: Float[Tensor, "n 4 4"]
    after: Float[Tensor, "n 4 4"]
    gravity: Float[Tensor, "3"]
    tool: Float[Tensor, "4 4"]
    limits: Limits = field(default_factory=Limits)
    parameters: InertialParameters | None = None
    effects: tuple[Mapping[str, Any], ...] = ()
    drive_gain: Float[Tensor, "n"] | None = None
    bounds: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    basis: Basis = "conditioned"
    warnings: tuple[str, ...] = ()
    source: str = ""
    tip: str | None = None
    knowledge: Knowledge | None = None

    def __post_init__(self) -> None:
        for name in ("before", "after", "gravity", "tool", "drive_gain"):
            _make_tensor(self, name, f"robot '{self.name}': {name}")

    def __repr__(self) -> str:
        known = "without parameters" if self.parameters is None else "with parameters"
        joints = "1 joint" if self.n == 1 else f"{self.n} joints"
        return f"Robot('{self.name}', {joints}, {known}, {len(self.effects)} effects)"

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_types)

    @property
    def axes(self) -> Float[Tensor, "n 3"]:
        """Unit vectors along the joint axes, in the link frames."""
        return self.after[:, 2, :3].clone()

    def frames_apart(self, other: "Robot") -> Float[Tensor, "n"]:
        """Largest difference of entries of each link's two poses [1; m] in a robot of as many
        joints."""
        pairs = ((self.before, other.before), (self.after, other.after))
        return torch.stack([(a - b).abs().amax((1, 2)) for a, b in pairs]).amax(0)

    def require_parameters(self, purpose: str) -> InertialParameters:
        """The nominal inertial parameters, or a RobotError that says what needs them."""
        if self.parameters is None:
            raise RobotError(
                f"robot '{self.name}' has no inertial parameters, which {purpose} needs.",
                expected="`parameters` in the robot's yaml, or <inertial> in its URDF or MJCF",
                hint="`torchid identify` needs only the kinematics",
            )
        return self.parameters

    def with_parameters(self, parameters: InertialParameters | None) -> "Robot":
        """The same robot with other nominal inertial parameters, of which nobody says how sure
        they are."""
        return replace(self, parameters=parameters, knowledge=None)

    def with_limits(self, **limits: float | Numbers) -> "Robot":
        """The same robot with other limits of motion or torque.

        Args:
            limits: `position`, `velocity`, `acceleration` or `torque`: (n, 2) lower and upper
                [rad or m; per s; per s^2; N m or N], or, for the last three, (n,) or one number
                for all joints, which counts both ways.

        Raises:
            RobotError: not such numbers.
            TorchidError: another name.
        """
        changed = {}
        for name, given in limits.items():
            if name not in LIMITS:
                raise TorchidError("there is no such limit.", got=name, available=LIMITS)
            values = as_tensor(given, f"limits of {name}", RobotError)
            if values.ndim < 2 and name != "position":
                size = values.expand(self.n) if values.numel() == 1 else values
                values = torch.stack([-size, size], -1)
            if tuple(values.shape) != (self.n, 2) or not bool((values[:, 0] < values[:, 1]).all()):
                raise RobotError(
                    f"limits of {name} do not fit robot '{self.name}'.",
                    got=values.tolist(),
                    expected=f"({self.n}, 2) lower and upper"
                    + ("" if name == "position" else ", or positive numbers: one, or one a joint"),
                )
            changed[name] = values
        return replace(self, limits=replace(self.limits, **changed))

    def with_payload(
        self, mass: float, com: Numbers = (0.0, 0.0, 0.0), inertia: Numbers | None = None
    ) -> "Robot":
        """The same robot with a body that its last link carries, as part of its nominal parameters.

        Args:
            mass: [kg].
            com: (3,) centre of mass in the last link's frame [m].
            inertia: (6,) about the centre of mass, in that frame's axes: xx, xy, xz, yy, yz, zz
                [kg m^2]; none if None.

        Raises:
            RobotError: the robot has no parameters, or these are not those of a body.
        """
        own = self.require_parameters("a payload").pi
        given = [mass, com, [0.0] * 6 if inertia is None else inertia]
        parts = [as_tensor(part, "the payload", RobotError).to(own) for part in given]
        shapes = [tuple(part.shape) for part in parts]
        if shapes != [(), (3,), (6,)] or not all(bool(p.isfinite().all()) for p in parts):
            raise RobotError(
                "this is no payload.",
                got=f"mass {mass}, com {com}, inertia {inertia}",
                expected="mass [kg], com of three numbers [m], inertia of six [kg m^2]",
            )
        body = InertialParameters.from_com(parts[0][None], parts[1][None], parts[2][None])
        # A body of points has a pseudo-inertia that is singular: rounding is no fault.
        if not parts[0] > 0 or bool(body.consistency_margin()[0] < -1e-9 * parts[0]):
            raise RobotError("no body has this mass and inertia.", got=f"{mass} kg, {inertia}")
        carrying = InertialParameters(torch.cat([own[:-1], own[-1:] + body.pi]))
        return replace(self, parameters=carrying)

    def to_chain(self, dtype: torch.dtype = torch.float64) -> "pytorch_kinematics.SerialChain":
        """The robot as a pytorch-kinematics SerialChain (see torchid.robot.chain)."""
        from torchid.robot.chain import to_chain

        return to_chain(self, dtype)


def joint_transforms(robot: Robot, q: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n 4 4"]:
    """T_i(q): pose of each link frame in the previous one (..., n, 4, 4)."""
    before = robot.before.to(q)
    after = robot.after.to(q)
    revolute = torch.tensor([t is JointType.REVOLUTE for t in robot.joint_types], device=q.device)
    angle = torch.where(revolute, q, torch.zeros_like(q))
    slide = torch.where(revolute, torch.zeros_like(q), q)
    c, s = torch.cos(angle), torch.sin(angle)
    one, zero = torch.ones_like(q), torch.zeros_like(q)
    rows = (
        (c, -s, zero, zero),
        (s, c, zero, zero),
        (zero, zero, one, slide),
        (zero, zero, zero, one),
    )
    motion = torch.stack([torch.stack(row, -1) for row in rows], -2)
    return before @ motion @ after


def link_poses(robot: Robot, q: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n 4 4"]:
    """Poses of all link frames in the base frame (..., n, 4, 4), by chained 4x4 products."""
    steps = joint_transforms(robot, q).unbind(-3)
    poses = [steps[0]]
    for step in steps[1:]:
        poses.append(poses[-1] @ step)
    return torch.stack(poses, -3)


def tool_pose(robot: Robot, q: Numbers) -> Float[Tensor, "*batch 4 4"]:
    """Pose of the tool in the base frame.

    Args:
        robot: kinematics and tool.
        q: (..., n) [rad; m for prismatic joints]; arrays and lists too, in float64.

    Returns:
        (..., 4, 4) homogeneous transforms [1; m]: rotation, and position in the base frame.

    Raises:
        TorchidError: not numbers of all joints.

    >>> import torchid
    >>> pose = tool_pose(torchid.load_robot("3r"), [0.0, 0.0, 0.0])
    >>> pose.shape, pose[3].tolist()
    (torch.Size([4, 4]), [0.0, 0.0, 0.0, 1.0])
    """
    (q,) = joint_signals(robot.n, q=q)
    return link_poses(robot, q)[..., -1, :, :] @ robot.tool.to(q)
