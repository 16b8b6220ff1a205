"""Room between a moving arm's links, and between them and what stands around it.

Distances are those of the robot's own collision shapes (`torchid.robot.shapes`), by `distances`. No
pair of links comes nearer to each other than its part of the joints' speeds allows: in the distance
of two shapes on links i < j, joint m between them counts with |dq_m| times what its axis can be
away from the farther end of one of the shapes (with |dq_m| alone where it slides). With that bound
L, a distance that is d and d' at the ends of an interval h is at least (d + d' - L h) / 2 within
it, so intervals are halved until each pair is proved clear at every instant, or found too near.

A search follows the gradient of the distance: that of the two nearest points, held fixed in their
links.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import torch

from torchid.errors import RobotError, TorchidError
from torchid.excitation.distances import Distances
from torchid.excitation.fourier import FourierTrajectory, midpoints
from torchid.excitation.limits import position_limits
from torchid.excitation.restriction import Restriction
from torchid.excitation.settings import CLEARANCE
from torchid.excitation.trajectories import Sinusoid
from torchid.robot.model import JointType, Robot, link_poses
from torchid.robot.placement import pose
from torchid.robot.shapes import LinkShapes, joint_points, link_shapes
from torchid.robot.solids import Solid, assembled, capsule
from torchid.typing import Bool, Float, Int, Tensor

RESOLUTION = 0.001
"""Distance below which nothing is proved or told apart [m]."""

FAR_ROOM = 0.1
"""Room beyond what is needed from which on nothing is near [m]."""

_PENALTY = 2.0  # beside the logarithm of a condition number, for FAR too little
_SEARCH_MARGIN = 0.005  # [m]: the search's instants are further apart
_SEARCH_SAMPLES = 100
_PER_PERIOD = 20  # instants a period of the fastest harmonic, before intervals are halved
_POSTURES = 512  # of which pairs are asked whether they are ever clear


class Nearest(NamedTuple):
    """Where motions spare least room: `distance` [m] between `first` and `second` after `time` [s],
    `spare` more than is needed. Infinite where nothing comes nearer than 0.1 m beyond that."""

    distance: float
    spare: float
    first: str
    second: str
    time: float


@dataclass(frozen=True, eq=False)
class Clearance(Restriction):
    """Distances that a motion keeps.

    Attributes:
        robot: that moves.
        usage: share of its limits that may be used.
        clearance: distance asked for [m].
        names: (G,) of what each shape belongs to: links, `base`, `floor`, `workspace`.
        link: (G,) number of the link that each shape is fixed to; 0 for what stands still.
        centre, radius: (G, 3), (G,) of a ball around each shape, in its link's frame [m]; a
            half-space has none (nan, 0).
        planes: (F, 4) unit normals and offsets of the half-spaces, the last F shapes.
        pairs: (P, 2) shapes that are checked against each other, the one on the earlier link
            first.
        needed: (P,) distance that each pair keeps [m].
        room: (P,) distance beyond it from which a pair counts as far apart [m].
        arms: (P, n) rate of a pair's distance at most, per speed of each joint [m or 1].
        distances: between the shapes.
        notes: pairs that are not checked, one sentence each.
        warnings: what is not checked because it is not known.
    """

    robot: Robot
    usage: float
    clearance: float
    names: tuple[str, ...]
    link: Int[Tensor, " G"]
    centre: Float[Tensor, "G 3"]
    radius: Float[Tensor, " G"]
    planes: Float[Tensor, "F 4"]
    pairs: Int[Tensor, "P 2"]
    needed: Float[Tensor, " P"]
    room: Float[Tensor, " P"]
    arms: Float[Tensor, "P n"]
    distances: Distances
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    def penalty(self, trajectory: FourierTrajectory) -> Float[Tensor, "*batch"]:
        """What a search pays for coming too near; differentiable, 0 where all is clear."""
        t = midpoints(trajectory.duration, _SEARCH_SAMPLES)
        q = trajectory.at(t).q
        poses = self._poses(q.reshape(-1, self.robot.n))
        wanted = self.needed + (self.room / 4).clamp(max=_SEARCH_MARGIN)
        with torch.no_grad():
            row, pair = (self._apart(poses) < wanted).nonzero(as_tuple=True)
            first, second = self.pairs[pair].unbind(-1)
            ends = poses[row, self.link[first]], poses[row, self.link[second]]
            farthest = float(wanted.max()) + RESOLUTION if len(wanted) else 0.0
            now, points = self.distances.between(first, second, *ends, farthest)
            # Nearest points in their links' frames, and the direction from the first to the second.
            local = [
                _moved(torch.linalg.inv(e), x) for e, x in zip(ends, points.unbind(1), strict=True)
            ]
            gap = points[:, 1] - points[:, 0]
            way = gap / torch.where(now.abs() < 1e-9, torch.inf, now).unsqueeze(-1)
        first_point = _moved(poses[row, self.link[first]], local[0])
        second_point = _moved(poses[row, self.link[second]], local[1])
        change = ((second_point - first_point - gap) * way).sum(-1)
        short = (wanted[pair] - now - change).clamp(min=0) / FAR_ROOM
        # Of each pair the instant counts at which it is nearest.
        worst = q.new_zeros(q[..., 0, 0].numel(), len(self.pairs))
        at = (row // _SEARCH_SAMPLES) * len(self.pairs) + pair
        worst = worst.flatten().scatter_reduce(0, at, short, "amax").reshape(worst.shape)
        return _PENALTY * worst.sum(-1).reshape(q.shape[:-2])

    def fits(self, trajectory: FourierTrajectory | Sinusoid) -> Bool[Tensor, "*batch"]:
        """Whether each motion is proved to keep the distances at every instant."""
        with torch.no_grad():
            if isinstance(trajectory, Sinusoid) or trajectory.q0.ndim == 1:
                return torch.tensor(self._proved(trajectory))
            every = [self._proved(trajectory.select(k)) for k in range(len(trajectory.q0))]
        return torch.tensor(every)

    def strain(self, q: Float[Tensor, "K n"]) -> Float[Tensor, " K"]:
        """0 with much room in postures, 1 where a pair is as near as it may be."""
        left = (self._exact(q, FAR_ROOM) - self.needed) / self.room
        return (1 - left).clamp(min=0).amax(-1)

    def impossible(self, q: Float[Tensor, " n"]) -> RobotError:
        """Which pair is too near in posture q."""
        found = self._exact(q.unsqueeze(0), FAR_ROOM)[0]
        worst = int((found - self.needed).argmin())
        first, second = (self.names[k] for k in self.pairs[worst].tolist())
        distance = 1000 * float(found[worst])
        return RobotError(
            f"robot '{self.robot.name}': no motion found keeps {second} clear of {first}.",
            got=f"{distance:.0f} mm in the posture that leaves most room"
            + (", where they overlap" if distance < 0 else ""),
            expected=f"{1000 * float(self.needed[worst]):.0f} mm at least",
            hint="check `floor=...` and `workspace=...`, which are in the base frame; "
            "`clearance=...` asks for less room, `usage=...` for a larger range of the joints",
        )

    def nearest(self, trajectories: Sequence[FourierTrajectory | Sinusoid]) -> Nearest:
        """Where motions spare least room, at instants as dense as samples of them."""
        best = Nearest(math.inf, math.inf, "", "", 0.0)
        for trajectory in trajectories:
            t = _times(trajectory, 10)
            q = trajectory.at(t).q.detach().reshape(-1, self.robot.n)
            found = self._exact(q, FAR_ROOM)
            row, pair = divmod(int((found - self.needed).argmin()), len(self.pairs))
            spare = float(found[row, pair] - self.needed[pair])
            if spare < min(best.spare, FAR_ROOM):
                first, second = (self.names[k] for k in self.pairs[pair].tolist())
                time = float(t[row % len(t)])
                best = Nearest(float(found[row, pair]), spare, first, second, time)
        return best

    def _poses(self, q: Float[Tensor, "K n"]) -> Float[Tensor, "K L 4 4"]:
        """Of the base and all links."""
        moving = link_poses(self.robot, q)
        return torch.cat([torch.eye(4).to(moving).expand(len(q), 1, 4, 4), moving], 1)

    def _apart(self, poses: Float[Tensor, "K L 4 4"]) -> Float[Tensor, "K P"]:
        """What pairs are apart at least, by the balls around them."""
        balls = _moved(poses[:, self.link], self.centre)
        first, second = self.pairs.unbind(-1)
        out = (balls[:, first] - balls[:, second]).norm(dim=-1)
        flat = len(self.link) - len(self.planes)
        plane = self.planes[(first - flat).clamp(min=0)] if len(self.planes) else None
        if plane is not None:
            height = (balls[:, second] * plane[:, :3]).sum(-1) - plane[:, 3]
            out = torch.where(first >= flat, height, out)
        return out - self.radius[first] - self.radius[second]

    def _exact(self, q: Float[Tensor, "K n"], room: float) -> Float[Tensor, "K P"]:
        """Distances in postures; those beyond what is needed and `room` are only at least so."""
        poses = self._poses(q)
        out = self._apart(poses)
        row, pair = (out < self.needed + room).nonzero(as_tuple=True)
        out[row, pair] = self._between(poses[row], pair, room)
        return out

    def _between(
        self, poses: Float[Tensor, "R L 4 4"], pair: Int[Tensor, " R"], room: float
    ) -> Float[Tensor, " R"]:
        """The distance of one pair a row."""
        first, second = self.pairs[pair].unbind(-1)
        rows = torch.arange(len(pair))
        ends = poses[rows, self.link[first]], poses[rows, self.link[second]]
        farthest = float(self.needed.max()) + room if len(self.needed) else room
        return self.distances.between(first, second, *ends, farthest)[0]

    def _proved(self, trajectory: FourierTrajectory | Sinusoid) -> bool:
        """Whether one motion keeps the distances at every instant."""
        extremes = trajectory.extremes()
        fastest, hardest = (x.abs().amax(-1) for x in (extremes.dq, extremes.ddq))

        def narrows(start: Tensor, end: Tensor) -> Tensor:
            """What pairs can lose and regain of their distance within intervals (I, P)."""
            ends = (trajectory.at(x).dq.abs() for x in (start, end))
            length = (end - start).unsqueeze(-1)
            speed = torch.maximum(*ends) + hardest * length / 2
            return torch.minimum(speed, fastest) @ self.arms.T * length

        def apart(t: Tensor, pair: Tensor) -> Tensor:
            return self._between(self._poses(trajectory.at(t).q), pair, farthest)

        t = _times(trajectory)
        start, end = t[:-1], t[1:]
        lost = narrows(start, end)
        farthest = float(lost.max()) if lost.numel() else 0.0
        # The balls around the shapes prove most intervals.
        balls = self._apart(self._poses(trajectory.at(t).q))
        left = (balls[:-1] + balls[1:] - lost) / 2 < self.needed
        interval, pair = left.nonzero(as_tuple=True)
        start, end, lost = start[interval], end[interval], lost[interval, pair]
        before, after = apart(start, pair), apart(end, pair)
        # The rest is halved.
        while len(pair):
            needed = self.needed[pair]
            if bool((torch.minimum(before, after) < needed).any()):
                return False
            left = (before + after - lost) / 2 < needed
            if bool((lost[left] < RESOLUTION).any()):
                return False
            start, end, pair = start[left], end[left], pair[left]
            before, after = before[left], after[left]
            middle = (start + end) / 2
            between = apart(middle, pair)
            start, end = torch.cat([start, middle]), torch.cat([middle, end])
            before, after = torch.cat([before, between]), torch.cat([between, after])
            pair = pair.repeat(2)
            lost = narrows(start, end).gather(1, pair.unsqueeze(-1)).squeeze(-1)
        return True


def motion_clearance(
    robot: Robot,
    *,
    clearance: float = CLEARANCE,
    floor: float | None = None,
    workspace: Sequence[float] | None = None,
    usage: float = 1.0,
) -> Clearance:
    """What motions of a robot have to keep clear of, as far as its shapes are known.

    Links are checked against each other and against what an MJCF fixes to the world, unless they
    are next to each other or overlap in the zero posture (brought within the limits), as is usual.
    Of a link without known shapes, the origins of its joints (and the tool) are checked against
    floor and workspace. Shapes nearer than the clearance in every posture must only not touch.

    Args:
        robot: from a URDF or MJCF, or without shapes.
        clearance: distance to keep [m].
        floor: height of a floor, z in the base frame [m].
        workspace: (6,) xmin, xmax, ymin, ymax, zmin, zmax that no moving link leaves, in the base
            frame [m].
        usage: share of the limits that may be used.

    Raises:
        TorchidError: a negative clearance, or a workspace that is no box.
        RobotError: the robot's file is no longer what it was read from, or its limits are
            incomplete.
    """
    if not 0 <= clearance < math.inf:
        raise TorchidError("a clearance is a distance.", got=clearance, expected="0 or more, in m")
    shapes = link_shapes(robot)
    solids, link, warnings = _solids(robot, shapes)
    planes, plane_names = _planes(floor, workspace, shapes)
    names = [("base", *robot.link_names)[k] for k in link] + plane_names
    count = len(solids)
    balls = [_ball(solid) for solid in solids] + [_NO_BALL] * len(planes)
    centre, radius = (torch.stack(part) for part in zip(*balls, strict=True))
    where = torch.tensor(link + [0] * len(planes))
    # Links without shapes, as between the joints of one body, leave their neighbours adjacent.
    drawn = [k for k, s in enumerate(solids) if s.corners is not None or bool(s.size.any())]
    shaped = sorted({0, *(link[k] for k in drawn)})
    adjacent = {(_carrier(robot, k, shaped), k) for k in shaped if k}
    pairs = [
        (a, b)
        for a in drawn
        for b in drawn
        if link[a] < link[b] and (link[a], link[b]) not in adjacent
    ]
    pairs += [(count + f, b) for f in range(len(planes)) for b in range(count) if link[b]]
    chosen = torch.tensor(pairs, dtype=torch.long).reshape(-1, 2)
    every = torch.ones(len(pairs), dtype=torch.float64)
    made = Clearance(
        robot, usage, clearance, tuple(names), where, centre, radius, planes, chosen,
        clearance * every, FAR_ROOM * every, _arms(robot, usage, where, centre, radius, chosen),
        Distances(solids, planes), warnings=tuple(warnings),
    )  # fmt: skip
    return _sensible(made) if pairs else made


def _carrier(robot: Robot, link: int, shaped: Sequence[int]) -> int:
    """The next link (from 1) with a shape on the way to the base, or the base, 0."""
    line = [k + 1 for k in robot.ancestors(link - 1)[:-1]]
    return max((k for k in line if k in shaped), default=0)


def _solids(robot: Robot, shapes: LinkShapes | None) -> tuple[list[Solid], list[int], list[str]]:
    """All shapes, the base's first, the numbers of their links, and what is not known of them.

    A link whose shapes are not all known also has its joints' origins as points.
    """
    warnings, points = [], joint_points(robot)
    if shapes is None:
        shapes = assembled([None] * robot.n_links, ())
    solids, link = list(shapes.base or ()), [0] * len(shapes.base or ())
    for k in range(robot.n_links):
        own = list(shapes.solids[k]) if shapes.solids else []
        if not shapes.known[k]:
            own += [capsule(pose(None, point), 0.0, 0.0) for point in points[k]]
        solids += own
        link += [k + 1] * len(own)
    # A link without mass is there to hold joints together; a DH table draws nothing at all.
    heavy = [True] * robot.n_links
    if robot.parameters is not None and any(shapes.known):
        heavy = (robot.parameters.mass > 0).tolist()
    every = zip(robot.link_names, shapes.known, heavy, strict=True)
    unknown = [name for name, known, weighs in every if weighs and not known]
    if unknown:
        who = f"links {', '.join(unknown)}" if any(shapes.known) else f"robot '{robot.name}'"
        why = f" ({shapes.warnings[0]})" if shapes.warnings else ""
        warnings.append(
            f"the shapes of {who} are not known{why}: only joints' origins and the tool are "
            "checked there, against floor and workspace."
        )
    if shapes.base is None:
        warnings.append("the shapes of what stands still could not all be read: it is not checked.")
    if shapes.left_out:
        out = ", ".join(shapes.left_out)
        warnings.append(f"links that are not on the chain are not checked: {out}.")
    return solids, link, warnings


def _planes(
    floor: float | None, workspace: Sequence[float] | None, shapes: LinkShapes | None
) -> tuple[Float[Tensor, "F 4"], list[str]]:
    """Half-spaces to keep out of, with unit normals away from them, and their names."""
    rows, names = [], []
    if floor is not None:
        rows.append([0.0, 0.0, 1.0, floor])
        names.append("the floor")
    if workspace is not None:
        sides = [(workspace[2 * k], workspace[2 * k + 1]) for k in range(len(workspace) // 2)]
        if len(workspace) != 6 or not all(low < high for low, high in sides):
            raise TorchidError(
                "a workspace is a box.",
                got=list(workspace),
                expected="xmin, xmax, ymin, ymax, zmin, zmax, each minimum below its maximum",
            )
        for k, (low, high) in enumerate(sides):
            axis = [float(k == j) for j in range(3)]
            rows += [[*axis, low], [*(-x for x in axis), -high]]
            names += [f"the workspace's {end} of {'xyz'[k]}" for end in ("minimum", "maximum")]
    given = torch.tensor(rows, dtype=torch.float64).reshape(-1, 4)
    if shapes is None:
        return given, names
    return torch.cat([given, shapes.planes]), names + ["the model's plane"] * len(shapes.planes)


_NO_BALL = torch.full((3,), math.nan, dtype=torch.float64), torch.tensor(0.0, dtype=torch.float64)


def _ball(solid: Solid) -> tuple[Float[Tensor, "3"], Float[Tensor, ""]]:
    """Centre and radius of a ball around a solid, in its link's frame."""
    size = solid.size
    if solid.corners is not None:
        centre = (solid.corners.amin(0) + solid.corners.amax(0)) / 2
        radius = (solid.corners - centre).norm(dim=-1).amax()
        return _moved(solid.pose, centre), radius
    sizes = {"box": size.norm(), "ellipsoid": size.amax(), "cylinder": size.norm()}
    return solid.pose[:3, 3], sizes.get(solid.kind, size.sum())


def _arms(
    robot: Robot,
    usage: float,
    link: Int[Tensor, " G"],
    centre: Float[Tensor, "G 3"],
    radius: Float[Tensor, " G"],
    pairs: Int[Tensor, "P 2"],
) -> Float[Tensor, "P n"]:
    """How fast the distance of pairs can change per speed of each joint [m or 1].

    The direction between two nearest points has no moment about the line through them, so a joint
    between the links acts alike on either point: the one nearer to its axis bounds what it can do.
    No configuration takes a point further from a joint than the chain between them is long.
    """
    drives = robot.drives
    slides = torch.tensor([drive.joint_type is JointType.PRISMATIC for drive in drives])
    reach = robot.on_links(position_limits(robot, usage)[0].T).abs().amax(0) * slides
    out = reach.new_zeros((len(pairs), robot.n))
    for p, (a, b) in enumerate(pairs.tolist()):
        i, j = int(link[a]) - 1, int(link[b]) - 1
        before, between = _between_links(robot, i, j)
        joints = [*before, *between]
        # Lengths along the way between the two, from each joint's origin to the next one's.
        steps = [_step(robot, reach, one, other) for one, other in pairwise(joints)]
        along = torch.cat([reach.new_zeros(1), torch.stack(steps).cumsum(0)]) if steps else None
        along = reach.new_zeros(1) if along is None else along
        last = _moved(robot.after[j], centre[b]).norm() + reach[j] + radius[b]
        behind = along[-1] - along + last
        if before:
            first = _moved(robot.after[i], centre[a]).norm() + reach[i] + radius[a]
        else:
            first = (centre[a] - robot.before[joints[0], :3, 3]).norm() + radius[a]
        # A half-space has no centre: only the shape before it counts.
        arms = torch.fmin(behind, first + along)
        arms = torch.where(slides[joints], torch.ones_like(arms), arms)
        for joint, arm in zip(joints, arms, strict=True):
            out[p, drives[joint].coordinate] += abs(drives[joint].ratio) * arm
    return out


def _between_links(robot: Robot, i: int, j: int) -> tuple[list[int], list[int]]:
    """Joints between two links (from 0, -1 the base) that move them against each other: those from
    the first to the link that carries both, and from there to the second."""
    up = robot.ancestors(i) if i >= 0 else ()
    down = robot.ancestors(j)
    return [k for k in up if k not in down][::-1], [k for k in down if k not in up]


def _step(robot: Robot, reach: Tensor, one: int, other: int) -> Tensor:
    """Largest distance between the origins of two joints of which one carries the other, or that
    one link carries both of."""
    for near, far in ((one, other), (other, one)):
        if robot.parents[far] == near:
            return (robot.after[near] @ robot.before[far])[:3, 3].norm() + reach[near]
    return (robot.before[one] - robot.before[other])[:3, 3].norm()


def _sensible(made: Clearance) -> Clearance:
    """Without pairs that no motion can keep apart, as far as the shapes themselves say so."""
    robot = made.robot
    bounds = position_limits(robot)[0]
    lower, upper = bounds.unbind(-1)
    generator = torch.Generator().manual_seed(0)
    drawn = torch.rand((_POSTURES, robot.n), generator=generator, dtype=torch.float64)
    zero = torch.zeros(robot.n, dtype=torch.float64).clamp(lower, upper)
    found = made._exact(torch.cat([zero.unsqueeze(0), lower + drawn * (upper - lower)]), FAR_ROOM)
    largest, smallest = found.amax(0), found.amin(0)
    wall = made.pairs[:, 0] >= len(made.link) - len(made.planes)
    # A link that turns on the floor is as near to it whatever the motion. Of what is far, it is
    # only known that it is far.
    still = (largest - smallest < RESOLUTION) & (largest < made.needed + FAR_ROOM - RESOLUTION)
    overlap = ~wall & ((found[0] < 0) | (largest < RESOLUTION))
    close = ~wall & ~overlap & ~still & (largest < made.needed + RESOLUTION)

    def named(which: Tensor) -> str:
        both = ([made.names[k] for k in pair] for pair in made.pairs[which].tolist())
        return ", ".join(dict.fromkeys(f"{a} and {b}" for a, b in both))

    notes = []
    if bool((~wall).any()):
        also = f", nor those that overlap in the zero posture: {named(overlap)}"
        notes.append(
            "links next to each other are not checked against each other"
            + (also if bool(overlap.any()) else "")
            + "."
        )
    near = still & ~overlap & (largest < made.needed)
    if bool(near.any()):
        notes.append(f"not checked, for no motion moves them apart: {named(near)}.")
    if bool(close.any()):
        least = f"{1000 * made.clearance:g} mm"
        notes.append(f"hardly ever {least} apart, so only kept from touching: {named(close)}.")
    needed = torch.where(close, 0.0, made.needed)
    kept = ~(still | overlap)
    return replace(
        made,
        pairs=made.pairs[kept],
        needed=needed[kept],
        room=(largest - needed).clamp(RESOLUTION, FAR_ROOM)[kept],
        arms=made.arms[kept],
        notes=tuple(notes),
    )


def _times(trajectory: FourierTrajectory | Sinusoid, finer: int = 1) -> Float[Tensor, " T"]:
    """Instants from 0 to the duration."""
    count = round(max(50.0, _PER_PERIOD * trajectory.duration * trajectory.fastest))
    return torch.linspace(0, trajectory.duration, finer * count + 1, dtype=torch.float64)


def _moved(poses: Float[Tensor, "*#batch 4 4"], x: Float[Tensor, "*#batch 3"]) -> Tensor:
    return (poses[..., :3, :3] @ x.unsqueeze(-1)).squeeze(-1) + poses[..., :3, 3]
