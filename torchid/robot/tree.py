"""A robot file as a tree of links and joints, and the serial chain chosen in it.

URDF and MJCF both become this tree. Links joined by fixed joints move as one body: a `rigid
group`, each link with its pose in the group's first link. The chain alternates groups and movable
joints, from the root's group (the base) to the group that holds the tip.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

from torch import Tensor

from torchid.errors import RobotError
from torchid.robot.model import JointType
from torchid.robot.placement import pose
from torchid.typing import Float

Interval = tuple[float, float]


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
        friction: Coulomb friction [N m or N].
        armature: inertia reflected from the rotor [kg m^2 or kg].
        stiffness: of a spring between parent and child [N m/rad or N/m].
        rest: position at which that spring is at rest [rad or m].
        refused: why this joint cannot be part of a chain, or None.
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
    friction: float = 0.0
    armature: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0
    refused: str | None = None

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
class Chain:
    """Groups and the movable joints between them: groups[i] is moved by joints[i - 1].

    Attributes:
        groups: n + 1, the base first.
        joints: n.
        tip: link whose pose in the last group is the tool.
        warnings: what the choice leaves out, one sentence each.
    """

    groups: tuple[Group, ...]
    joints: tuple[TreeJoint, ...]
    tip: str
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class Tree:
    """Links with their inertial parameters (10,) in the link frame, or None, and joints.

    Attributes:
        links: by name, in file order.
        joints: in file order.
        source: names the file in errors.
    """

    links: Mapping[str, Tensor | None]
    joints: tuple[TreeJoint, ...]
    source: str

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
            RobotError: a joint between unknown links, a link with two parents, no or several
                roots, or a cycle.
        """
        carried: dict[str, str] = {}
        for joint in self.joints:
            for end in (joint.parent, joint.child):
                if end not in self.links:
                    raise RobotError(
                        f"{self.source}: joint '{joint.name}' names a link that does not exist.",
                        got=end,
                        available=list(self.links),
                    )
            if joint.child in carried:
                raise RobotError(
                    f"{self.source}: link '{joint.child}' is the child of two joints, so this is "
                    "not a tree.",
                    got=f"joints '{carried[joint.child]}' and '{joint.name}'",
                )
            carried[joint.child] = joint.name
        roots = [name for name in self.links if name not in carried]
        if len(roots) > 1:
            raise RobotError(
                f"{self.source}: links that no joint connects; a robot has one root.", got=roots
            )
        reached = set(self.descendants(roots[0])) if roots else set()
        lost = [name for name in self.links if name not in reached]
        if lost:
            raise RobotError(f"{self.source}: links that form a cycle.", got=lost)
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

    def leaving(self, group: Group) -> list[TreeJoint]:
        """Movable joints from a group to others, in file order."""
        return [joint for joint in self.joints if joint.movable and joint.parent in group.poses]

    def ends(self, group: Group) -> list[str]:
        """Links of a group from which nothing hangs rigidly."""
        return [name for name in group.poses if all(joint.movable for joint in self.below[name])]


def choose_chain(tree: Tree, tip: str | None) -> Chain:
    """The chain from the root to the tip, or the only one there is.

    Raises:
        RobotError: no movable joint, several chains and no tip, an unknown tip, or a joint that
            is not an independent revolute or prismatic one.
    """
    root = tree.root()
    if not any(joint.movable for joint in tree.joints):
        raise RobotError(f"{tree.source}: no joint can move, so there is nothing to identify.")
    tip, warnings = _only_tip(tree, root) if tip is None else (tip, ())
    chain = _chain_to(tree, root, tip)
    for joint in chain.joints:
        if joint.refused is not None:
            raise RobotError(f"{tree.source}: {joint.refused}")
    return replace(chain, warnings=(*warnings, *chain.warnings))


def _only_tip(tree: Tree, root: str) -> tuple[str, tuple[str, ...]]:
    """The end of the only chain there is, and what its choice leaves open."""
    group, has_chain = tree.group(root), False
    while leaving := tree.leaving(group):
        if len(leaving) > 1:
            raise _branching(tree, leaving, has_chain)
        group, has_chain = tree.group(leaving[0].child), True
    ends = tree.ends(group)
    if len(ends) == 1:
        return ends[0], ()
    return group.link, (
        f"several links are fixed to the last moving link '{group.link}' ({', '.join(ends)}): "
        f"the tool is '{group.link}' itself; choose another with `tip=...`",
    )


def _branching(tree: Tree, leaving: list[TreeJoint], has_chain: bool) -> RobotError:
    """Ends of chains, and links before which they branch again, each with its number of joints."""
    before = leaving[0].parent
    tips: list[str] = []
    waiting = [joint.child for joint in reversed(leaving)]
    while waiting:
        group = tree.group(waiting.pop())
        onward = [joint.child for joint in reversed(tree.leaving(group))]
        waiting.extend(onward)
        if len(onward) == 1:
            continue
        ends = [] if onward else tree.ends(group)
        tip = ends[0] if len(ends) == 1 else group.link
        joints = len(tree.joints_to(tip))
        tips.append(f"{tip} ({joints} joint{'s' * (joints > 1)})")
    return RobotError(
        f"{tree.source}: the robot branches into several moving chains at '{before}' "
        f"(joints {', '.join(repr(joint.name) for joint in leaving)}).",
        expected="the last link of one chain, as tip",
        available=tips,
        hint=f"tip '{before}' ends the chain before the branching" if has_chain else None,
    )


def _chain_to(tree: Tree, root: str, tip: str) -> Chain:
    if tip not in tree.links:
        raise RobotError(
            f"{tree.source}: there is no link to be the tip.", got=tip, available=list(tree.links)
        )
    joints = tree.joints_to(tip)
    if not joints:
        raise RobotError(
            f"{tree.source}: no joint can move between the root '{root}' and the tip '{tip}'."
        )
    groups = [tree.group(root), *(tree.group(joint.child) for joint in joints)]
    # A warning for each branch that the chain carries and leaves out.
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
    return Chain(tuple(groups), tuple(joints), tip, tuple(warnings))
