"""What a robot is: frozen data, no masses in the kinematics.

Frames. Link i moves about the z axis of its joint frame. `before[i]` is the constant pose of joint
frame i in the frame of the link that carries it (`parents[i]`, or the base); the joint turns (or
slides) about z; `after[i]` is the constant pose of link frame i in the moved joint frame. So

    T_i(q) = before_i * Rz(q_i) * after_i        (prismatic: Tz(q_i) in place of Rz)

Classical DH has before = 1, modified DH has after = 1, a URDF joint with axis a has a rotation
that takes z to a on both sides. Inertial parameters are expressed in the link frames.

The links form a tree. In a serial arm link i-1 carries link i, and each link has a coordinate of
its own. A joint that mimics another has none: its position is ratio * q + offset of that one's
coordinate, so a robot has as many coordinates n as independent joints, and L >= n links. What a
unit rate of coordinate j moves (`moved_by(j)`) is what torque j feels.
"""

import copyreg
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property
from html import escape
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

import torch
from torch import Tensor

from torchid.errors import RobotError, TorchidError
from torchid.notebooks import html_table
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
FREE = 6
"""Coordinates of a base that moves."""


def joint_list(joints: Sequence[int]) -> str:
    """Joints (from 0) for people: `joint 3`, `joints 1, 4`."""
    names = ", ".join(str(k + 1) for k in joints)
    return f"joint{'s' if len(joints) > 1 else ''} {names}"


def joint_unit(robot: "Robot", joint: int) -> str:
    """Unit of the torque of a joint (from 0)."""
    return "N" if robot.joint_types[joint] is JointType.PRISMATIC else "N m"


def torque_unit(robot: "Robot", both: str = "N m, N") -> str:
    """Unit of the torques of all joints together; `both` where the joints differ."""
    units = {joint_unit(robot, j) for j in range(robot.n)}
    return units.pop() if len(units) == 1 else both


def error_unit(robot: "Robot") -> str:
    """Unit of the joints' position errors, in thousandths: of angles, of ways, or of both."""
    return {"N m": "mrad", "N": "mm"}.get(torque_unit(robot), "mrad, mm")


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


_LIMITS_TO_GIVE = {
    "position": ("", 'lower=".." upper=".."'),
    "velocity": ("2.0", 'velocity="2.0"'),
    "acceleration": ("5.0", ""),
}
"""Examples: a value of the option, and the attributes of a URDF, which has no acceleration."""


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

    @property
    def effort(self) -> Float[Tensor, " n"] | None:
        """Largest torque (n,) either way [N m or N]; None where nothing is known."""
        return None if self.torque is None else self.torque.abs().amax(-1)

    def require(self, *names: str, robot: str, purpose: str) -> None:
        """Raise RobotError unless all the named limits are known and finite."""
        lacking, hints = {}, []
        for name in names:
            given = getattr(self, name)
            known = [] if given is None else torch.isfinite(given).all(-1).tolist()
            if known and all(known):
                continue
            joints = [str(j) for j, finite in enumerate(known, start=1) if not finite]
            whose = f"joint {', '.join(joints)}" if joints else "any joint"
            lacking[name] = f"no {name} limit of {whose}"
            value, line = _LIMITS_TO_GIVE[name]
            option = f"robot.with_limits({name}={value}), on the command line --max-{name} {value}"
            hints += [option] * bool(value) + [f"<limit {line}/> in the URDF"] * bool(line)
        if lacking:
            raise RobotError(
                f"robot '{robot}' has no finite {' and '.join(lacking)} limits, "
                f"which {purpose} needs.",
                got=f"{'; '.join(lacking.values())} (0 is taken for none)",
                hint="; or ".join(hints),
            )


@dataclass(frozen=True)
class Mimic:
    """A joint without a coordinate of its own: its position is ratio * q + offset.

    Attributes:
        link: that the joint moves, from 0.
        joint: its name.
        joint_type: R or P.
        coordinate: that it follows, from 0.
        ratio: [1; rad/m or m/rad where the two are of different kinds], not 0.
        offset: position where the coordinate is 0 [rad or m].
    """

    link: int
    joint: str
    joint_type: JointType
    coordinate: int
    ratio: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Tip:
    """An end of a branch: a hand, a foot.

    Attributes:
        name: of the link at the end.
        link: that carries it, from 0.
        pose: (4, 4) in that link's frame [1; m].
    """

    name: str
    link: int
    pose: Float[Tensor, "4 4"]


@dataclass(frozen=True)
class BaseLink:
    """What carries a robot: the link that a pose of the base is of, and its body.

    Attributes:
        name: of the link.
        parameters: (10,) in its own frame, or None where the file tells nothing of it.
        gravity: (3,) in the axes of the file's world [m/s^2].
    """

    name: str
    parameters: Float[Tensor, "10"] | None
    gravity: Float[Tensor, "3"]


def _make_tensor(thing: object, name: str, what: str) -> None:
    """Make a tensor of a field that may be given as an array or lists; None stays."""
    if getattr(thing, name) is not None:
        object.__setattr__(thing, name, as_tensor(getattr(thing, name), what, RobotError))


def _read_only(values: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    return MappingProxyType(values)


# A robot goes to other processes, its read-only mappings with it.
copyreg.pickle(MappingProxyType, lambda mapping: (_read_only, (dict(mapping),)))


@dataclass(frozen=True, eq=False)
class Robot:
    """A tree of L links moved by n coordinates: one-degree-of-freedom joints. Compared by identity.

    A serial manipulator is the tree whose links carry one another. L = n but for mimics.

    Attributes:
        name: what to call it.
        joint_names: n, of the coordinates, in the order of the links that they move.
        link_names: L, each behind the one that carries it.
        joint_types: n of R or P.
        before: (L, 4, 4) pose of each joint frame in the frame of the link that carries it.
        after: (L, 4, 4) pose of each link frame in its moved joint frame.
        gravity: (3,) gravity acceleration in the base frame [m/s^2].
        tool: (4, 4) pose of the tool in the last link's frame; of several tips, of the first.
        limits: position, velocity, acceleration, torque.
        parameters: nominal inertial parameters (L, 10), or None.
        compensated: (L, 4) masses [kg] and first moments [kg m] of the links whose weight servos do
            not feel, as something takes it out; None where they feel all of it. Torques of logs
            hold it.
        effects: nominal effects, as records {effect, joint, <parameter>: value}.
        drive_gain: (n,) [N m/A or N/A] torque per ampere, or None.
        bounds: groups of bounds for the extraction, as read from the robot's yaml.
        basis: of its base parameters, unless another is asked for.
        warnings: what the reader noticed, one sentence each.
        source: file or built-in name it came from.
        file: of a yaml: the URDF or MJCF that it was made from (`torchid.robot.origin`).
        tip, root: that its part was chosen by, of a URDF or MJCF.
        knowledge: how sure parameters and effects are; None where nobody says it: values like
            those of CAD, to some ten per cent.
        parents: L, the link that carries each link, -1 for the base; a serial chain if empty.
        mimics: joints without a coordinate of their own.
        tips: ends of the branches; empty where the tool on the last link is the only one.
        locked: joints that are held, and where [rad or m], of a URDF or MJCF.
        spare: joints of a URDF or MJCF without a coordinate here: held, following, of another part.
        base: the link that carries it, of a URDF or MJCF.
        floating: whether the base moves: the first six coordinates are then its pose (see
            `torchid.robot.floating`), which no motor drives.

    Raises:
        RobotError: the links form no tree in this order, or a mimic follows nothing.

    >>> import torchid
    >>> robot = torchid.load_robot("kuka_lwr4")
    >>> robot.n, robot.gravity.tolist()
    (7, [0.0, 0.0, -9.81])
    >>> robot.descendants(4), robot.ancestors(2)
    ((4, 5, 6), (0, 1, 2))
    """

    name: str
    joint_names: tuple[str, ...]
    link_names: tuple[str, ...]
    joint_types: tuple[JointType, ...]
    before: Float[Tensor, "L 4 4"]
    after: Float[Tensor, "L 4 4"]
    gravity: Float[Tensor, "3"]
    tool: Float[Tensor, "4 4"]
    limits: Limits = field(default_factory=Limits)
    parameters: InertialParameters | None = None
    compensated: Float[Tensor, "L 4"] | None = None
    effects: tuple[Mapping[str, Any], ...] = ()
    drive_gain: Float[Tensor, "n"] | None = None
    bounds: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    basis: Basis = "conditioned"
    warnings: tuple[str, ...] = ()
    source: str = ""
    file: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    tip: str | None = None
    knowledge: Knowledge | None = None
    parents: tuple[int, ...] = ()
    mimics: tuple[Mimic, ...] = ()
    tips: tuple[Tip, ...] = ()
    root: str | None = None
    locked: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    spare: tuple[str, ...] = ()
    base: BaseLink | None = None
    floating: bool = False

    def __post_init__(self) -> None:
        for name in ("before", "after", "gravity", "tool", "drive_gain", "compensated"):
            _make_tensor(self, name, f"robot '{self.name}': {name}")
        if not self.parents:
            object.__setattr__(self, "parents", tuple(range(-1, len(self.before) - 1)))
        self._require_tree()

    def _require_tree(self) -> None:
        """Raise RobotError unless links stand behind those that carry them, one coordinate each
        but for the mimics."""
        where, count = f"robot '{self.name}'", len(self.before)
        if len(self.parents) != count or any(not -1 <= p < i for i, p in enumerate(self.parents)):
            raise RobotError(
                f"{where}: the links are no tree in this order.",
                got=list(self.parents),
                expected=f"{count} links, each behind the one that carries it (-1: the base)",
            )
        followers = [mimic.link for mimic in self.mimics]
        followed = all(0 <= m.coordinate < self.n and m.ratio != 0 for m in self.mimics)
        if self.floating and (self.n < FREE or self.parents[:FREE] != tuple(range(-1, FREE - 1))):
            raise RobotError(
                f"{where}: a base that moves has six coordinates, before all others.",
                got=f"{self.n} coordinates, links carried by {list(self.parents)}",
            )
        distinct = len(set(followers)) == len(followers) and set(followers) <= set(range(count))
        if not (distinct and followed and self.n + len(followers) == count):
            raise RobotError(
                f"{where}: not every link has one joint that moves it.",
                got=f"{count} links, {self.n} coordinates, joints that mimic: "
                f"{[(m.joint, m.link, m.coordinate, m.ratio) for m in self.mimics]}",
                expected="a coordinate of its own, or a mimic of one with a ratio other than 0",
            )

    def __repr__(self) -> str:
        mass = "without parameters"
        if self.parameters is not None:
            mass = f"{float(self.parameters.mass.sum()):.4g} kg"
        joints = "1 joint" if self.n == 1 else f"{self.n} joints"
        source = f", from {Path(self.source).name}" if self.source else ""
        return f"Robot('{self.name}', {joints}, {mass}, {len(self.effects)} effects{source})"

    def _repr_html_(self) -> str:
        """In a notebook: a row a link that moves, with its joint and its mass."""
        masses = self.n_links * ["-"]
        if self.parameters is not None:
            masses = [f"{mass:.4g}" for mass in self.parameters.mass.tolist()]
        joints = [(drive.joint, drive.joint_type.value) for drive in self.drives]
        rows = [
            (*joint, link, mass)
            for joint, link, mass in zip(joints, self.link_names, masses, strict=True)
        ]
        head = ("joint", "type", "link", "mass [kg]")
        return f"<p>{escape(repr(self))}</p>{html_table(head, rows)}"

    @property
    def n(self) -> int:
        """Number of coordinates: of joints that move by themselves."""
        return len(self.joint_types)

    @property
    def free(self) -> tuple[int, ...]:
        """Coordinates (from 0) that no motor drives: the six of a base that moves, or none."""
        return tuple(range(FREE)) if self.floating else ()

    @property
    def driven(self) -> tuple[int, ...]:
        """Coordinates (from 0) that a motor drives."""
        return tuple(range(len(self.free), self.n))

    @property
    def driven_names(self) -> tuple[str, ...]:
        """Names of the joints that a motor drives: those that logs know."""
        return self.joint_names[len(self.free) :]

    @property
    def bodies(self) -> tuple[int, ...]:
        """Links (from 0) that are bodies: all but those between the coordinates of a base that
        moves, which are frames alone."""
        return tuple(range(FREE - 1 if self.floating else 0, self.n_links))

    def require_fixed_base(self, purpose: str) -> None:
        """Raise RobotError where the base moves and the purpose cannot have that."""
        if self.floating:
            raise RobotError(
                f"robot '{self.name}' has a base that moves, which {purpose} does not take.",
                got="base='moving'",
                expected="a base that is held: base='fixed', the default",
            )

    @property
    def n_links(self) -> int:
        """Number of links that move: n, and one for each mimic."""
        return len(self.parents)

    @cached_property
    def is_serial(self) -> bool:
        """Whether each link carries the next, and has a coordinate of its own."""
        return not self.mimics and self.parents == tuple(range(-1, self.n_links - 1))

    @cached_property
    def drives(self) -> tuple[Mimic, ...]:
        """How each link is moved, L: by its own coordinate, with ratio 1 and offset 0, or as a
        mimic."""
        mimics = {mimic.link: mimic for mimic in self.mimics}
        own = iter(zip(range(self.n), self.joint_names, self.joint_types, strict=True))
        drives = []
        for link in range(self.n_links):
            if link in mimics:
                drives.append(mimics[link])
                continue
            coordinate, name, kind = next(own)
            drives.append(Mimic(link, name, kind, coordinate))
        return tuple(drives)

    @cached_property
    def own_links(self) -> tuple[int, ...]:
        """The link (from 0) that each coordinate moves by its own joint, n."""
        follow = {mimic.link for mimic in self.mimics}
        return tuple(link for link in range(self.n_links) if link not in follow)

    @cached_property
    def _lines(self) -> tuple[tuple[int, ...], ...]:
        out: list[tuple[int, ...]] = []
        for link, parent in enumerate(self.parents):
            out.append((*(out[parent] if parent >= 0 else ()), link))
        return tuple(out)

    def ancestors(self, link: int) -> tuple[int, ...]:
        """Links (from 0) between the base and a link, and the link itself, last."""
        return self._lines[link]

    def descendants(self, link: int) -> tuple[int, ...]:
        """A link (from 0), first, and all that it carries, in order."""
        return self._carried[link]

    @cached_property
    def _carried(self) -> tuple[tuple[int, ...], ...]:
        out: list[list[int]] = [[] for _ in self.parents]
        for link, line in enumerate(self._lines):
            for above in line:
                out[above].append(link)
        return tuple(map(tuple, out))

    def neighbours(self, coordinate: int) -> tuple[int, ...]:
        """Coordinates (from 0) of the joints next to a coordinate's own: the one that carries it,
        and those on its link."""
        place = {link: k for k, link in enumerate(self.own_links)}
        link = self.own_links[coordinate]
        near = [self.parents[link], *(k for k, p in enumerate(self.parents) if p == link)]
        return tuple(place[k] for k in near if k in place)

    def moved_by(self, coordinate: int) -> tuple[int, ...]:
        """Links (from 0) that a coordinate (from 0) moves, in order."""
        return self._moved[coordinate]

    @cached_property
    def _moved(self) -> tuple[tuple[int, ...], ...]:
        out: list[set[int]] = [set() for _ in range(self.n)]
        for drive in self.drives:
            out[drive.coordinate].update(self.descendants(drive.link))
        return tuple(tuple(sorted(links)) for links in out)

    @cached_property
    def levels(self) -> tuple[tuple[int, ...], ...]:
        """Links as many steps away from the base as each other."""
        out: list[list[int]] = []
        for link, line in enumerate(self._lines):
            if len(line) > len(out):
                out.append([])
            out[len(line) - 1].append(link)
        return tuple(map(tuple, out))

    @cached_property
    def ends(self) -> tuple[Tip, ...]:
        """Ends of the branches: `tips`, or the tool on the last link."""
        return self.tips or (Tip(self.tip or self.link_names[-1], self.n_links - 1, self.tool),)

    def end(self, name: str | None = None) -> Tip:
        """An end by its name; the only one if None.

        Raises:
            RobotError: no such end, or several and no name.
        """
        tips = [tip for tip in self.ends if name in (None, tip.name)]
        if len(tips) == 1:
            return tips[0]
        raise RobotError(
            f"robot '{self.name}' has "
            + ("several tips, and one is needed." if name is None else "no such tip."),
            got=name,
            expected="the name of one, as `tip`",
            available=[tip.name for tip in self.ends],
        )

    def on_links(self, q: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch L"]:
        """Positions (..., L) of the joints that move the links [rad; m], from those of the
        coordinates (..., n)."""
        if not self.mimics:
            return q
        follow = [drive.coordinate for drive in self.drives]
        ratio, offset = (
            q.new_tensor([getattr(drive, name) for drive in self.drives])
            for name in ("ratio", "offset")
        )
        return q[..., follow] * ratio + offset

    @property
    def axes(self) -> Float[Tensor, "L 3"]:
        """Unit vectors along the joint axes, in the link frames."""
        return self.after[:, 2, :3].clone()

    def frames_apart(self, other: "Robot") -> Float[Tensor, " L"]:
        """Largest difference of entries of each link's two poses [1; m] in a robot of as many
        links."""
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
        """This robot with other nominal inertial parameters, of which nobody says how sure they
        are."""
        return replace(self, parameters=parameters, knowledge=None)

    def without_gravity(self) -> "Robot":
        """This robot for logs whose torques hold no gravity: a controller has taken it out."""
        return replace(self, gravity=torch.zeros_like(self.gravity))

    def with_limits(self, **limits: float | Numbers) -> "Robot":
        """This robot with other limits of motion or torque.

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
        self,
        mass: float,
        com: Numbers = (0.0, 0.0, 0.0),
        inertia: Numbers | None = None,
        *,
        tip: str | None = None,
    ) -> "Robot":
        """This robot with a body that its last link carries, as part of its nominal parameters.

        Args:
            mass: [kg].
            com: (3,) centre of mass in the last link's frame [m].
            inertia: (6,) about the centre of mass, in that frame's axes: xx, xy, xz, yy, yz, zz
                [kg m^2]; none if None.
            tip: of several, the one whose link carries it.

        Raises:
            RobotError: the robot has no parameters, or these are not those of a body; several tips
                and none chosen.
        """
        link = self.end(tip).link
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
        carrying = InertialParameters(
            torch.cat([own[:link], own[link : link + 1] + body.pi, own[link + 1 :]])
        )
        return replace(self, parameters=carrying)

    def to_chain(
        self, dtype: torch.dtype = torch.float64, tip: str | None = None
    ) -> "pytorch_kinematics.SerialChain":
        """The chain to the tool, or a tip, as pytorch-kinematics has it (see torchid.robot.chain).

        Raises:
            RobotError: several tips and none chosen, or none of that name.
        """
        from torchid.robot.chain import to_chain

        return to_chain(self, dtype, tip)


RobotLike = Robot | str | Path
"""A robot, or what `load_robot` finds one by: a built-in name or a file."""


def joint_transforms(robot: Robot, q: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch L 4 4"]:
    """T_i(q): pose of each link frame in that of the link that carries it (..., L, 4, 4)."""
    before = robot.before.to(q)
    after = robot.after.to(q)
    q = robot.on_links(q)
    kinds = [drive.joint_type for drive in robot.drives]
    revolute = torch.tensor([t is JointType.REVOLUTE for t in kinds], device=q.device)
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


def link_poses(robot: Robot, q: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch L 4 4"]:
    """Poses of all link frames in the base frame (..., L, 4, 4), by chained 4x4 products."""
    poses: list[Tensor] = []
    for step, parent in zip(joint_transforms(robot, q).unbind(-3), robot.parents, strict=True):
        poses.append(step if parent < 0 else poses[parent] @ step)
    return torch.stack(poses, -3)


def tool_pose(robot: RobotLike, q: Numbers, tip: str | None = None) -> Float[Tensor, "*batch 4 4"]:
    """Pose of the tool in the base frame.

    Args:
        robot: kinematics and tool; its name or file will do.
        q: (..., n) [rad; m for prismatic joints]; arrays and lists too, in float64.
        tip: which of several tips.

    Returns:
        (..., 4, 4) homogeneous transforms [1; m]: rotation, and position in the base frame.

    Raises:
        RobotError: several tips and none chosen, or none of that name.
        TorchidError: not numbers of all joints.

    >>> import torchid
    >>> pose = tool_pose(torchid.load_robot("3r"), [0.0, 0.0, 0.0])
    >>> pose.shape, pose[3].tolist()
    (torch.Size([4, 4]), [0.0, 0.0, 0.0, 1.0])
    """
    from torchid.robot.library import as_robot

    robot = as_robot(robot)
    (q,) = joint_signals(robot.n, q=q)
    end = robot.end(tip)
    return link_poses(robot, q)[..., end.link, :, :] @ end.pose.to(q)
