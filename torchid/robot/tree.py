"""A robot file as a tree of links and joints, and the part of it that is chosen.

URDF and MJCF both become this tree. Links joined by fixed joints move as one body: a `rigid
group`, each link with its pose in the group's first link. A part is a tree of groups and of the
movable joints between them: all that the base carries, or the chain from the base to a tip.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

from torch import Tensor

from torchid.errors import RobotError
from torchid.robot.model import JointType, Robot
from torchid.robot.placement import align_z, pose, rotation_z
from torchid.typing import Float

Interval = tuple[float, float]
Base = Literal["fixed", "moving"]


@dataclass(frozen=True)
class Following:
    """How a joint mimics another: its position is ratio times that one's plus offset [rad or m]."""

    joint: str
    ratio: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Choice:
    """What a user asks for of a file.

    Attributes:
        tip: last link of a chain; None for all that the root carries.
        root: link that is the base; None for the file's own.
        lock: joints that are held, and where [rad or m].
        base: whether the base is held (`fixed`) or moves and is measured (`moving`).
    """

    tip: str | None = None
    root: str | None = None
    lock: Mapping[str, float] = field(default_factory=dict)
    base: Base = "fixed"

    @property
    def options(self) -> dict[str, Any]:
        """As keywords of `load_robot`."""
        return {"tip": self.tip, "root": self.root, "lock": self.lock, "base": self.base}

    def __bool__(self) -> bool:
        """Whether anything is chosen."""
        return bool(self.tip or self.root or self.lock or self.base != "fixed")


@dataclass(frozen=True)
class TreeJoint:
    """A joint: T(q) = origin * motion about or along axis by (q - zero) * child_pose.

    Attributes:
        name, parent, child: of the joint and of the links it connects.
        motion: R or P; None for a fixed joint.
        origin: (4, 4) pose of the joint frame in the parent link frame.
        axis: (3,) unit vector in the joint frame.
        zero: position at which the joint's motion is the identity [rad or m].
        child_pose: (4, 4) pose of the child link frame in the moved joint frame.
        position, velocity, torque: lower and upper limits, None where not given.
        damping: [N m s/rad or N s/m].
        quadratic, cubic: of the damper's torque, with |dq| dq and dq^3.
        friction: Coulomb friction [N m or N].
        armature: inertia reflected from the rotor [kg m^2 or kg].
        stiffness: of a spring between parent and child [N m/rad or N/m].
        rest: position at which that spring is at rest [rad or m].
        refused: why this joint cannot be part of a robot, or None.
        floating: whether its child may move in every direction, as the base of a walking robot.
        mimic: the joint that it follows, or None.
    """

    name: str
    parent: str
    child: str
    motion: JointType | None = None
    origin: Float[Tensor, "4 4"] = field(default_factory=pose)
    axis: Float[Tensor, "3"] = field(default_factory=lambda: pose()[0, :3])
    zero: float = 0.0
    child_pose: Float[Tensor, "4 4"] = field(default_factory=pose)
    position: Interval | None = None
    velocity: Interval | None = None
    torque: Interval | None = None
    damping: float = 0.0
    quadratic: float = 0.0
    cubic: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0
    refused: str | None = None
    floating: bool = False
    mimic: Following | None = None

    def held(self, position: float) -> "TreeJoint":
        """The joint fixed at a position [rad or m]."""
        return replace(
            self,
            motion=None,
            origin=self.origin @ self.moved(position),
            refused=None,
            floating=False,
            mimic=None,
        )

    def moved(self, position: float) -> Float[Tensor, "4 4"]:
        """The joint's motion alone, at a position [rad or m]."""
        turn, away = pose(align_z(self.axis)), position - self.zero
        if self.motion is JointType.REVOLUTE:
            return turn @ pose(rotation_z(away)) @ turn.T
        return turn @ pose(None, (0.0, 0.0, away)) @ turn.T

    @property
    def movable(self) -> bool:
        """Whether the child link can move in the parent."""
        return self.motion is not None or self.refused is not None


@dataclass(frozen=True)
class Group:
    """Links that move as one body: (4, 4) pose of each in the first one's frame."""

    poses: Mapping[str, Tensor]

    @property
    def link(self) -> str:
        """The link whose frame the group's poses are in."""
        return next(iter(self.poses))


@dataclass(frozen=True)
class Part:
    """Groups and the movable joints between them: groups[i] is moved by joints[i - 1].

    Attributes:
        groups: L + 1, the base first, each behind the one that carries it.
        joints: L.
        tips: ends of the branches: a link and the index of its group, the last group's last.
        pose: (4, 4) of the base's frame in the file's root frame.
        warnings: what the choice leaves out, one sentence each.
    """

    groups: tuple[Group, ...]
    joints: tuple[TreeJoint, ...]
    tips: tuple[tuple[str, int], ...]
    pose: Float[Tensor, "4 4"]
    warnings: tuple[str, ...]

    @cached_property
    def carriers(self) -> tuple[int, ...]:
        """For each joint the index of the group that carries it."""
        place = {name: k for k, group in enumerate(self.groups) for name in group.poses}
        return tuple(place[joint.parent] for joint in self.joints)


@dataclass(frozen=True)
class Tree:
    """Links with their inertial parameters (10,) in the link frame, or None, and joints.

    Attributes:
        links: by name, in file order.
        joints: in file order.
        source: names the file in errors.
        compensated: by link, the share of its weight that servos do not feel [1].
    """

    links: Mapping[str, Tensor | None]
    joints: tuple[TreeJoint, ...]
    source: str
    compensated: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def below(self) -> Mapping[str, list[TreeJoint]]:
        """Joints that leave each link."""
        out: dict[str, list[TreeJoint]] = {name: [] for name in self.links}
        for joint in self.joints:
            out[joint.parent].append(joint)
        return out

    @cached_property
    def above(self) -> Mapping[str, TreeJoint]:
        """The joint that carries each link but the root."""
        return {joint.child: joint for joint in self.joints}

    def root(self) -> str:
        """The link no joint carries.

        Raises:
            RobotError: there is no such link, or several.
        """
        roots = [name for name in self.links if name not in self.above]
        if len(roots) != 1:
            raise RobotError(
                f"{self.source}: a robot has one root, a link that no joint carries.",
                got=", ".join(roots) or "none: links form a cycle",
            )
        return roots[0]

    def descendants(self, link: str) -> list[str]:
        """A link and all that hang from it, whatever the joints."""
        out, waiting = [], [link]
        while waiting:
            out.append(waiting.pop())
            waiting.extend(joint.child for joint in self.below[out[-1]])
        return out

    def group(self, link: str) -> Group:
        """The link and what hangs rigidly from it."""
        poses = {link: pose()}
        waiting = [link]
        while waiting:
            parent = waiting.pop()
            for joint in self.below[parent]:
                if not joint.movable:
                    poses[joint.child] = poses[parent] @ joint.origin @ joint.child_pose
                    waiting.append(joint.child)
        return Group(poses)

    def joints_to(self, link: str) -> list[TreeJoint]:
        """Movable joints between the root and a link."""
        out = []
        while link in self.above:
            joint = self.above[link]
            if joint.movable:
                out.append(joint)
            link = joint.parent
        return out[::-1]

    def with_joints(self, others: Iterable[TreeJoint]) -> "Tree":
        """The tree with other joints in the places of those of their names."""
        changed = {joint.name: joint for joint in others}
        joints = tuple(changed.get(joint.name, joint) for joint in self.joints)
        return replace(self, joints=joints)

    def leaving(self, group: Group) -> list[TreeJoint]:
        """Movable joints from a group to others, in file order."""
        return [joint for joint in self.joints if joint.movable and joint.parent in group.poses]

    def ends(self, group: Group) -> list[str]:
        """Links of a group from which nothing hangs rigidly."""
        return [name for name in group.poses if all(joint.movable for joint in self.below[name])]


def choose(tree: Tree, choice: Choice) -> Part:
    """All that the root carries, or the chain to a tip.

    A base that floats is held where the file puts it; where it is to move, it is the base link. A
    mimic of a joint that is held is held, too.

    Raises:
        RobotError: no joint can move, an unknown link or joint, a joint that is not revolute or
            prismatic, or one that mimics a joint which is not part of it.
    """
    own_root = tree.root()
    if not any(joint.movable for joint in tree.joints):
        raise RobotError(f"{tree.source}: no joint can move, so there is nothing to identify.")
    floating = [j.child for j in tree.joints if j.floating and not tree.joints_to(j.parent)]
    tree, noticed = with_joints_held(tree, choice.lock)
    root, placed = own_root, pose()
    if choice.base == "moving" and choice.root is None and floating:
        root = floating[0]
    above: list[str] = []
    if choice.root is not None:
        root = _known_link(tree, choice.root, "root")
        placed, above = _at_rest(tree, root)
    part = _whole(tree, root) if choice.tip is None else _chain_to(tree, root, choice.tip)
    for joint in part.joints:
        if joint.refused is not None:
            raise RobotError(f"{tree.source}: {joint.refused}")
    part = replace(part, joints=tuple(_followed(tree, part, joint) for joint in part.joints))
    at_rest = [
        f"'{root}' is the base; joints {', '.join(map(repr, above))} between it and '{own_root}' "
        "are held at 0 (`lock=...` holds them elsewhere)"
    ] * bool(above)
    return replace(
        part,
        pose=placed,
        warnings=(*noticed, *at_rest, *part.warnings),
    )


def choice_of(robot: Robot) -> Choice:
    """What a robot was chosen by from its file."""
    return Choice(robot.tip, robot.root, robot.locked, "moving" if robot.floating else "fixed")


def with_joints_held(tree: Tree, lock: Mapping[str, float]) -> tuple[Tree, list[str]]:
    """The tree with joints held where a user says and a base that floats fixed, and what there is
    to say on it; links that are held together are one group then."""
    tree, alone = _without_lost(tree)
    tree, floating = _on_a_fixed_base(_locked(tree, lock))
    return tree, [*alone, *floating]


def _known_link(tree: Tree, name: str, what: str) -> str:
    if name not in tree.links:
        raise RobotError(
            f"{tree.source}: there is no link to be the {what}.",
            got=name,
            available=list(tree.links),
        )
    return name


def _without_lost(tree: Tree) -> tuple[Tree, list[str]]:
    """The tree with a coordinate for each joint that follows one which the file lacks, and a
    sentence on them."""
    known = {joint.name for joint in tree.joints}
    lost = [joint for joint in tree.joints if joint.mimic and joint.mimic.joint not in known]
    if not lost:
        return tree, []
    listed = ", ".join(f"'{j.name}' ('{j.mimic.joint}')" for j in lost if j.mimic)
    return tree.with_joints(replace(joint, mimic=None) for joint in lost), [
        f"these joints mimic others that the file lacks, so they move by themselves: {listed}"
    ]


def _locked(tree: Tree, lock: Mapping[str, float]) -> Tree:
    """The tree with joints held where the user says, and those that follow one that is held."""
    known = {joint.name: joint for joint in tree.joints}
    for name, position in lock.items():
        if name not in known or known[name].motion is None:
            raise RobotError(
                f"{tree.source}: there is no joint to lock that turns or slides.",
                got=name,
                available=[joint.name for joint in tree.joints if joint.motion is not None],
            )
        if not abs(position) < float("inf"):
            raise RobotError(f"{tree.source}: joint '{name}' cannot be locked there.", got=position)
    # Where each joint is held: as the user says, at 0 if it is fixed in the file, or as what it
    # follows.
    still = {name: 0.0 for name, joint in known.items() if not joint.movable} | dict(lock)
    followers = [(joint.name, joint.mimic) for joint in tree.joints if joint.mimic]
    for _ in followers:  # one that follows a follower takes another round
        for name, way in followers:
            if name not in still and (way.joint in still or not way.ratio):
                still[name] = way.ratio * still.get(way.joint, 0.0) + way.offset
    return tree.with_joints(
        joint.held(still[name]) for name, joint in known.items() if joint.movable and name in still
    )


def _on_a_fixed_base(tree: Tree) -> tuple[Tree, list[str]]:
    """The tree with joints fixed that let the base float, and a sentence on them."""
    # Of a joint that floats beyond another joint nothing is known.
    free = [j for j in tree.joints if j.floating and not tree.joints_to(j.parent)]
    if not free:
        return tree, []
    listed = ", ".join(f"'{joint.child}' (joint '{joint.name}')" for joint in free)
    said = f"{listed} can float: it is taken as fixed where the file puts it, as part of the base"
    return tree.with_joints(joint.held(0.0) for joint in free), [said]


def _at_rest(tree: Tree, link: str) -> tuple[Tensor, list[str]]:
    """Pose (4, 4) of a link in the root with all joints at 0, and which of them can move."""
    placed, moving = pose(), []
    while link in tree.above:
        joint = tree.above[link]
        if joint.refused is not None:
            raise RobotError(f"{tree.source}: {joint.refused}")
        motion = pose() if joint.motion is None else joint.moved(0.0)
        placed = joint.origin @ motion @ joint.child_pose @ placed
        moving += [joint.name] if joint.movable else []
        link = joint.parent
    return placed, moving[::-1]


def _followed(tree: Tree, part: Part, joint: TreeJoint) -> TreeJoint:
    """The joint with what it follows at last, if that follows another one itself."""
    seen = {joint.name}
    known = {other.name: other for other in tree.joints}
    while joint.mimic is not None and joint.mimic.joint in known:
        onward = known[joint.mimic.joint].mimic
        if onward is None or joint.mimic.joint in seen:
            break
        seen.add(joint.mimic.joint)
        ratio, offset = joint.mimic.ratio, joint.mimic.offset
        way = Following(onward.joint, ratio * onward.ratio, ratio * onward.offset + offset)
        joint = replace(joint, mimic=way)
    independent = [other.name for other in part.joints if other.mimic is None]
    if joint.mimic is not None and joint.mimic.joint not in independent:
        raise RobotError(
            f"{tree.source}: joint '{joint.name}' mimics joint '{joint.mimic.joint}', which is not "
            "one of the joints that move here.",
            available=independent,
            hint=f"lock '{joint.name}' (`lock=...`), or choose a part with both",
        )
    return joint


def _whole(tree: Tree, root: str) -> Part:
    """All that a link carries; joints in the order of the file, each behind those that carry it."""
    groups, place = [tree.group(root)], {}
    for name in groups[0].poses:
        place[name] = 0
    reached = set(tree.descendants(root))
    waiting = [joint for joint in tree.joints if joint.movable and joint.parent in reached]
    joints: list[TreeJoint] = []
    while waiting:
        joint = next(joint for joint in waiting if joint.parent in place)
        waiting.remove(joint)
        joints.append(joint)
        groups.append(tree.group(joint.child))
        for name in groups[-1].poses:
            place[name] = len(groups) - 1
    if not joints:
        raise RobotError(f"{tree.source}: no joint can move that '{root}' carries.")
    carrying = {place[joint.parent] for joint in joints}
    leaves = [k for k in range(1, len(groups)) if k not in carrying]
    tips, warnings = [], []
    for k in leaves:
        ends = tree.ends(groups[k])
        tips.append((ends[0] if len(ends) == 1 else groups[k].link, k))
        if len(ends) > 1 and len(leaves) == 1:
            link = groups[k].link
            warnings.append(
                f"several links are fixed to the last moving link '{link}' ({', '.join(ends)}): "
                f"the tool is '{link}' itself; choose another with `tip=...`"
            )
    return Part(tuple(groups), tuple(joints), tuple(tips), pose(), tuple(warnings))


def _chain_to(tree: Tree, root: str, tip: str) -> Part:
    _known_link(tree, tip, "tip")
    below = tree.descendants(root)
    if tip not in below:
        raise RobotError(
            f"{tree.source}: the root '{root}' does not carry the tip.", got=tip, available=below
        )
    before = len(tree.joints_to(root))
    joints = tree.joints_to(tip)[before:]
    if not joints:
        raise RobotError(
            f"{tree.source}: no joint can move between the root '{root}' and the tip '{tip}'."
        )
    groups = [tree.group(root), *(tree.group(joint.child) for joint in joints)]
    return Part(
        tuple(groups),
        tuple(joints),
        ((tip, len(joints)),),
        pose(),
        tuple(_left_out(tree, groups, joints, tip)),
    )


def _left_out(
    tree: Tree, groups: Sequence[Group], joints: Sequence[TreeJoint], tip: str
) -> list[str]:
    """A warning for each branch that a chain carries and leaves out."""
    chosen = {joint.name for joint in joints}
    warnings = []
    for group in groups[1:]:
        for joint in tree.leaving(group):
            if joint.name in chosen:
                continue
            links = tree.descendants(joint.child)
            mass = sum(float(pi[0]) for name in links if (pi := tree.links[name]) is not None)
            warnings.append(
                f"joint '{joint.name}' is not on the chain to '{tip}': the masses of links "
                f"{', '.join(repr(name) for name in links)} ({mass:g} kg) are not included"
            )
    return warnings
