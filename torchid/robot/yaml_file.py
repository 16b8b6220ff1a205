"""Robots in yaml: kinematics, and whatever else is known (format in docs/robots.md).

The structs declare which keys there are and what they hold; what concerns several of them, or the
number of joints, is checked below.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal

import msgspec
import torch
from msgspec import UNSET, UnsetType
from torch import Tensor

from torchid.errors import RobotError
from torchid.files import UNCONFIRMED
from torchid.robot.inertia import InertialParameters, parallel_axis
from torchid.robot.knowledge import from_mapping as knowledge_of
from torchid.robot.model import STANDARD_GRAVITY, Basis, JointType, Limits, Mimic, Robot, Tip
from torchid.robot.origin import read_origin
from torchid.robot.placement import dh_classical, dh_modified, pose, rotation_z
from torchid.robot.yaml_values import number, numbers, text_and_content
from torchid.typing import Float

CONVENTIONS = ("classical", "modified")

_Some = msgspec.Meta(min_length=1)


class _Keys(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A mapping without other keys. Numbers are `Any`: `numbers` reads them, and says more."""


class _Joint(_Keys, frozen=True, kw_only=True):
    type: Literal["R", "P"] = "R"
    name: str | None = None
    link: str | None = None


class _DhJoint(_Joint, frozen=True, kw_only=True):
    a: Any = 0
    d: Any = 0
    alpha: Any = UNSET
    alpha_deg: Any = UNSET
    theta: Any = UNSET
    theta_deg: Any = UNSET


class _Dh(_Keys, frozen=True, kw_only=True):
    convention: Literal["classical", "modified"]
    joints: Annotated[tuple[_DhJoint, ...], _Some]


class _Pose(_Keys, frozen=True, kw_only=True):
    xyz: Any = (0.0, 0.0, 0.0)
    rotation: Any = UNSET


class _Follow(_Keys, frozen=True, kw_only=True):
    joint: str
    ratio: Any = 1.0
    offset: Any = 0.0


class _PlacedJoint(_Joint, frozen=True, kw_only=True):
    parent: str | UnsetType | None = UNSET  # None is the base
    before: _Pose = _Pose()
    after: _Pose = _Pose()
    mimic: _Follow | UnsetType = UNSET


class _PlacedTip(_Keys, frozen=True, kw_only=True):
    link: str
    name: str | None = None
    pose: _Pose = _Pose()


class _Placements(_Keys, frozen=True, kw_only=True):
    joints: Annotated[tuple[_PlacedJoint, ...], _Some]
    tips: tuple[_PlacedTip, ...] | None = None


class _Limits(_Keys, frozen=True, kw_only=True):
    position: Any = None
    velocity: Any = None
    acceleration: Any = None
    torque: Any = None


class _Parameters(_Keys, frozen=True, kw_only=True):
    mass: Any
    com: Any = None
    first_moment: Any = None
    inertia_about_com: Any = None
    inertia_about_link_frame: Any = None


class _File(_Keys, frozen=True, kw_only=True):
    name: str
    dh: _Dh | None = None
    placements: _Placements | None = None
    gravity: Any = STANDARD_GRAVITY
    limits: _Limits | None = None
    parameters: _Parameters | None = None
    compensated: Any = None
    effects: Any = None
    drive_gain: Any = None
    bounds: dict[str, Any] | None = None
    basis: Basis = Robot.basis
    tool: Any = tuple(map(tuple, torch.eye(4).tolist()))
    floating: bool = False
    knowledge: Any = None
    file: Any = None
    servo: Any = None  # of `torchid.position`, as is the next
    servos: Any = None


def read_yaml(path: Path) -> Robot:
    """Read a robot from torchid's yaml.

    Raises:
        RobotError: not yaml, an unknown key, a wrong count, or a value that is not a number.
    """
    text, content = text_and_content(path)
    robot = from_mapping(content, str(path))
    first = text.partition("\n")[0].removeprefix("# warning: ")
    return replace(robot, warnings=(first,)) if first.startswith(UNCONFIRMED) else robot


def from_mapping(data: Any, source: str) -> Robot:
    """A Robot from the parsed content of a robot yaml; `source` names it in errors."""
    try:
        file = msgspec.convert(data, _File)
    except msgspec.ValidationError as error:
        raise RobotError(
            f"'{source}' is not a robot description.",
            got=str(error),
            expected="keys and values as in docs/robots.md",
        ) from error
    if file.dh is not None and file.placements is None:
        kinematics = _of_dh(file.dh, source)
    elif file.placements is not None and file.dh is None:
        kinematics = _of_placements(file.placements, source)
    else:
        what = "both 'dh' and 'placements' are given" if file.dh else "'dh' is missing"
        raise RobotError(f"{source}: {what}.", got=list(data), expected="dh, or placements")
    n, links = len(kinematics["joint_types"]), len(kinematics["before"])
    limits = {} if file.limits is None else msgspec.structs.asdict(file.limits)
    gain, knowledge, light = file.drive_gain, file.knowledge, file.compensated
    return Robot(
        name=file.name,
        **kinematics,
        gravity=numbers(file.gravity, (3,), f"{source}: gravity"),
        floating=file.floating,
        tool=numbers(file.tool, (4, 4), f"{source}: tool"),
        limits=Limits(
            **{
                key: _interval(bounds, n, f"{source}: limits.{key}")
                for key, bounds in limits.items()
                if bounds is not None
            }
        ),
        parameters=_parameters(file.parameters, links, source),
        compensated=None if light is None else numbers(light, (links, 4), f"{source}: compensated"),
        effects=read_effects(file.effects or (), n, source),
        drive_gain=None if gain is None else numbers(gain, (n,), f"{source}: drive_gain"),
        bounds=MappingProxyType(file.bounds or {}),
        basis=file.basis,
        source=source,
        file=read_origin(file.file, source) if file.file else {},
        knowledge=None if knowledge is None else knowledge_of(knowledge, links, source),
    )


def _of_dh(table: _Dh, source: str) -> dict[str, Any]:
    """Names, types and poses of the joints of a DH table, under the names of a Robot's fields."""
    poses = []
    for i, row in enumerate(table.joints, start=1):
        where = f"{source}: joint {i}"
        a, d = number(row.a, f"{where}: a"), number(row.d, f"{where}: d")
        alpha, theta = _angle(row, "alpha", where), _angle(row, "theta", where)
        poses.append(dh_step(table.convention, a, alpha, d, theta))
    return _named(table.joints, poses)


def _of_placements(table: _Placements, source: str) -> dict[str, Any]:
    """Kinematics of joints that are placed one by one, with what carries each, what follows
    another, and the tips."""
    rows = [(i, row, f"{source}: joint {i + 1}") for i, row in enumerate(table.joints)]
    poses = [
        (_pose(row.before, f"{where}: before"), _pose(row.after, f"{where}: after"))
        for _, row, where in rows
    ]
    fields = _named(table.joints, poses)
    links, parents, mimics, tips = fields["link_names"], [], [], []
    for i, row, where in rows:
        parent = i - 1 if row.parent is UNSET else -1
        if isinstance(row.parent, str):
            parent = _place(row.parent, links[:i], where, "link before it to carry it")
        parents.append(parent)
        if isinstance(row.mimic, _Follow):
            what = f"{where}: mimic"
            followed = _place(row.mimic.joint, fields["joint_names"], what, "joint to follow")
            ratio = number(row.mimic.ratio, f"{what}: ratio")
            offset = number(row.mimic.offset, f"{what}: offset")
            name = row.name or f"joint_{i + 1}"
            mimics.append(Mimic(i, name, JointType(row.type), followed, ratio, offset))
    for k, tip in enumerate(table.tips or (), start=1):
        where = f"{source}: tip {k}"
        link = _place(tip.link, links, where, "link")
        tips.append(Tip(tip.name or links[link], link, _pose(tip.pose, f"{where}: pose")))
    return {**fields, "parents": tuple(parents), "mimics": tuple(mimics), "tips": tuple(tips)}


def _named(
    rows: Sequence[_DhJoint | _PlacedJoint], poses: Sequence[tuple[Tensor, Tensor]]
) -> dict[str, Any]:
    """Names and types of the joints that follow no other, and names and poses of all links."""
    each = list(enumerate(rows, start=1))
    moving = [(i, row) for i, row in each if getattr(row, "mimic", UNSET) is UNSET]
    return {
        "joint_names": tuple(row.name or f"joint_{i}" for i, row in moving),
        "link_names": tuple(row.link or f"link_{i}" for i, row in each),
        "joint_types": tuple(JointType(row.type) for _, row in moving),
        "before": torch.stack([before for before, _ in poses]),
        "after": torch.stack([after for _, after in poses]),
    }


def _place(name: str, names: Sequence[str], where: str, what: str) -> int:
    """Where a name stands among those that are known.

    Raises:
        RobotError: it is none of them.
    """
    if name not in names:
        raise RobotError(f"{where}: there is no such {what}.", got=name, available=list(names))
    return names.index(name)


def dh_step(
    convention: str, a: float, alpha: float, d: float, theta: float
) -> tuple[Float[Tensor, "4 4"], Float[Tensor, "4 4"]]:
    """Poses before and after a joint's motion, from its row of a DH table.

    Args:
        convention: `classical` or `modified`.
        a, d: [m].
        alpha, theta: [rad].
    """
    if convention == "classical":
        return pose(), dh_classical(a, alpha, d, theta)
    # Rz(theta) and Tz(d) commute with the joint's own motion about or along z.
    return dh_modified(a, alpha) @ pose(rotation_z(theta), (0, 0, d)), pose()


def _angle(row: _DhJoint, key: str, where: str) -> float:
    radians, degrees = getattr(row, key), getattr(row, f"{key}_deg")
    if degrees is UNSET:
        return number(0 if radians is UNSET else radians, f"{where}: {key}")
    if radians is not UNSET:
        raise RobotError(f"{where}: both {key} and {key}_deg are given.", expected="one of them")
    return math.radians(number(degrees, f"{where}: {key}_deg"))


def _pose(data: _Pose, where: str) -> Tensor:
    """(4, 4), entry by entry as written: what was written is read back."""
    out = torch.eye(4, dtype=torch.float64)
    out[:3, 3] = numbers(data.xyz, (3,), f"{where}.xyz")
    if data.rotation is not UNSET:
        rotation = numbers(data.rotation, (3, 3), f"{where}.rotation")
        error = (rotation @ rotation.T - torch.eye(3, dtype=torch.float64)).abs().max()
        # 1e-6: how far a rotation that was typed with a few digits may be from one
        if error > 1e-6 or torch.linalg.det(rotation) < 0:
            raise RobotError(
                f"{where}.rotation: not a rotation.",
                got=data.rotation,
                expected="three orthonormal rows, right-handed",
            )
        out[:3, :3] = rotation
    return out


def _interval(data: Any, n: int, where: str) -> Tensor:
    """Symmetric bounds, or [lo, hi] a joint, as (n, 2)."""
    # A joint that turns for ever has infinite limits.
    if isinstance(data, Sequence) and data and isinstance(data[0], Sequence):
        bounds = numbers(data, (n, 2), where, finite=False)
    else:
        upper = numbers(data, (n,), where, finite=False)
        bounds = torch.stack([-upper, upper], -1)
    if (bounds[:, 0] >= bounds[:, 1]).any():
        raise RobotError(f"{where}: a lower limit is not below its upper limit.", got=data)
    return bounds


def _parameters(data: _Parameters | None, n: int, source: str) -> InertialParameters | None:
    if data is None:
        return None
    where = f"{source}: parameters"
    pairs = [("com", "first_moment"), ("inertia_about_com", "inertia_about_link_frame")]
    given = [[key for key in pair if getattr(data, key) is not None] for pair in pairs]
    if [len(keys) for keys in given] != [1, 1]:
        raise RobotError(
            f"{where}: needs mass, com (or first_moment) and exactly one kind of inertia.",
            got=[key for keys in given for key in keys],
            expected=["mass", *(" | ".join(pair) for pair in pairs)],
        )
    (moment,), (inertia,) = given
    mass = numbers(data.mass, (n,), f"{where}.mass")
    first = numbers(getattr(data, moment), (n, 3), f"{where}.{moment}")
    tensor = numbers(getattr(data, inertia), (n, 6), f"{where}.{inertia}")
    m = mass.unsqueeze(-1)
    moved = m * first if moment == "com" else first
    if inertia == "inertia_about_com":
        own = InertialParameters(torch.cat([m, moved, tensor], -1))
        tensor = tensor + parallel_axis(mass, first if moment == "com" else own.com)
    return InertialParameters(torch.cat([m, moved, tensor], -1))


def read_effects(data: Any, n: int, source: str) -> tuple[Mapping[str, Any], ...]:
    """Records of effects on existing joints, from the parsed yaml; `source` names it in errors."""
    if not isinstance(data, Sequence) or isinstance(data, str):
        raise RobotError(f"{source}: effects must be a list of records.", got=data)
    for record in data:
        if not isinstance(record, Mapping) or "effect" not in record:
            raise RobotError(
                f"{source}: an effect needs the key 'effect'.",
                got=record,
                expected="{effect: viscous_friction, joint: 1, Fv: 0.07}",
            )
        joint = record.get("joint")
        whole = isinstance(joint, int) and not isinstance(joint, bool)
        if joint is not None and not (whole and 1 <= joint <= n):
            raise RobotError(
                f"{source}: effect '{record['effect']}' is on a joint that does not exist.",
                got=joint,
                available=list(range(1, n + 1)),
            )
    return tuple(MappingProxyType(dict(record)) for record in data)
