"""Room between a moving arm's links, and between them and what stands around it.

Distances are MuJoCo's, of the robot's own collision shapes (`torchid.robot.shapes`). A motion keeps
them at instants so dense that between two of them nothing comes nearer by more than `BETWEEN`:
where two shapes are nearest, their distance changes with the square of time.

A search follows the gradient of the distance: that of the two nearest points, held fixed in their
links.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import torch

from torchid.errors import RobotError, TorchidError
from torchid.excitation.distances import Distances
from torchid.excitation.fourier import FourierTrajectory, midpoints
from torchid.excitation.limits import position_limits
from torchid.excitation.restriction import Restriction
from torchid.excitation.settings import CLEARANCE
from torchid.excitation.trajectories import Sinusoid
from torchid.robot.model import Robot, link_poses
from torchid.robot.placement import pose
from torchid.robot.shapes import LinkShapes, joint_points, link_shapes
from torchid.robot.solids import assembled, capsule
from torchid.typing import Bool, Float, Int, Tensor

BETWEEN = 0.0005
"""What two shapes may come nearer between two instants that are looked at [m]."""

FAR_ROOM = 0.1
"""Room beyond what is needed from which on nothing is near [m]."""


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
        pairs: (P, 2) shapes that are checked against each other, half-spaces first, then the one on
            the earlier link.
        needed: (P,) distance that each pair keeps [m].
        room: (P,) distance beyond it from which a pair counts as far apart [m].
        distances: between the shapes.
        notes: pairs that are not checked, one sentence each.
        warnings: what is not checked because it is not known.
    """

    robot: Robot
    usage: float
    clearance: float
    names: tuple[str, ...]
    link: Int[Tensor, " G"]
    pairs: Int[Tensor, "P 2"]
    needed: Float[Tensor, " P"]
    room: Float[Tensor, " P"]
    distances: Distances
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    def penalty(self, trajectory: FourierTrajectory) -> Float[Tensor, "*batch"]:
        """What a search pays for coming too near; differentiable, 0 where all is clear."""
        search_samples = 100
        t = midpoints(trajectory.duration, search_samples)
        q = trajectory.at(t).q
        placed = self.placed(q.reshape(-1, self.robot.n))
        # 0.005 m: the search's instants are further apart
        wanted = self.needed + (self.room / 4).clamp(max=0.005)
        with torch.no_grad():
            near = self.distances.at_least(placed, self.pairs) < wanted
            row, pair = near.nonzero(as_tuple=True)
            now, points = self._between(placed, row, pair)
        ends = placed[row.unsqueeze(1), self.pairs[pair]]
        # Nearest points move with their links, and count along the way between them.
        local = torch.linalg.solve(ends.detach(), _homogeneous(points))
        first, second = (ends @ local)[..., :3, 0].unbind(1)
        gap = points[:, 1] - points[:, 0]
        way = gap / torch.where(now.abs() < 1e-9, torch.inf, now)[:, None]
        apart = now + ((second - first - gap) * way).sum(-1)
        short = (wanted[pair] - apart).clamp(min=0) / FAR_ROOM
        # Of each pair the instant counts at which it is nearest.
        worst = q.new_zeros(q[..., 0, 0].numel(), len(self.pairs))
        at = (row // search_samples) * len(self.pairs) + pair
        worst = worst.flatten().scatter_reduce(0, at, short, "amax").reshape(worst.shape)
        # 2.0: beside the logarithm of a condition number, for FAR too little
        return 2.0 * worst.sum(-1).reshape(q.shape[:-2])

    def fits(self, trajectory: FourierTrajectory | Sinusoid) -> Bool[Tensor, "*batch"]:
        """Whether each motion keeps the distances all along."""
        if isinstance(trajectory, FourierTrajectory) and trajectory.q0.ndim > 1:
            each = [self.fits(trajectory.select(k)) for k in range(len(trajectory.q0))]
            return torch.stack(each)
        with torch.no_grad():
            q = trajectory.at(_times(trajectory)).q
            # A few of the instants refuse most motions that come too near.
            # 16: every so many of them are looked at first
            few_and_all = (self.apart(x, BETWEEN) - self.needed for x in (q[::16], q))
            return torch.tensor(all(bool((spare >= BETWEEN).all()) for spare in few_and_all))

    def strain(self, q: Float[Tensor, "K n"]) -> Float[Tensor, " K"]:
        """0 with much room in postures, 1 where a pair is as near as it may be."""
        return (1 - (self.apart(q) - self.needed) / self.room).clamp(min=0).amax(-1)

    def impossible(self, q: Float[Tensor, " n"]) -> RobotError:
        """Which pair is too near in posture q."""
        apart = self.apart(q.unsqueeze(0))[0]
        worst = int((apart - self.needed).argmin())
        first, second = (self.names[k] for k in self.pairs[worst].tolist())
        distance = 1000 * float(apart[worst])
        return RobotError(
            f"robot '{self.robot.name}': no motion found keeps {second} clear of {first}.",
            got=f"{distance:.0f} mm in the posture that leaves most room"
            + (", where they overlap" if distance < 0 else ""),
            expected=f"{1000 * float(self.needed[worst]):.0f} mm at least",
            hint="check `floor=...` and `workspace=...`, which are in the base frame; "
            "`clearance=...` asks for less room, `usage=...` for a larger range of the joints",
        )

    def nearest(self, trajectories: Sequence[FourierTrajectory | Sinusoid]) -> Nearest:
        """Where motions spare least room, at the instants that `fits` knows."""
        best = Nearest(math.inf, math.inf, "", "", 0.0)
        for trajectory in trajectories:
            t = _times(trajectory)
            apart = self.apart(trajectory.at(t).q.detach().reshape(-1, self.robot.n))
            row, pair = divmod(int((apart - self.needed).argmin()), len(self.pairs))
            spare = float(apart[row, pair] - self.needed[pair])
            if spare < min(best.spare, FAR_ROOM):
                first, second = (self.names[k] for k in self.pairs[pair].tolist())
                time = float(t[row % len(t)])
                best = Nearest(float(apart[row, pair]), spare, first, second, time)
        return best

    def placed(self, q: Float[Tensor, "K n"]) -> Float[Tensor, "K G 4 4"]:
        """Poses of all shapes in postures."""
        moving = link_poses(self.robot, q)
        still = torch.eye(4).to(moving).expand(len(q), 1, 4, 4)
        return self.distances.placed(torch.cat([still, moving], 1)[:, self.link])

    def apart(self, q: Float[Tensor, "K n"], room: float = FAR_ROOM) -> Float[Tensor, "K P"]:
        """Distances in postures; where they are beyond what is needed and `room`, only at least so
        [m]."""
        placed = self.placed(q)
        out = self.distances.at_least(placed, self.pairs)
        row, pair = (out < self.needed + room).nonzero(as_tuple=True)
        out[row, pair] = self._between(placed, row, pair)[0]
        return out

    def _between(self, placed: Tensor, row: Tensor, pair: Tensor) -> tuple[Tensor, Tensor]:
        """Distances (R,) of one pair in one of the postures (K, G, 4, 4) each, and nearest points
        (R, 2, 3); what is far is only at least so, without points."""
        shapes = self.pairs[pair]
        farthest = float(self.needed.max()) + FAR_ROOM
        return self.distances.between(shapes, placed[row.unsqueeze(1), shapes], farthest)


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
    shapes = link_shapes(robot) or assembled([None] * robot.n_links, ())
    planes, plane_names = _planes(floor, workspace)
    planes = torch.cat([planes, shapes.planes])
    plane_names += ["the model's plane"] * len(shapes.planes)
    drawn = [(0, solid) for solid in shapes.base or ()]
    drawn += [(k, solid) for k, own in enumerate(shapes.solids, start=1) for solid in own]
    # Of a link that is not known, or in part, the origins of its joints keep off half-spaces.
    origins = [
        (k, capsule(pose(None, point), 0.0, 0.0))
        for k, (known, ends) in enumerate(zip(shapes.known, joint_points(robot), strict=True), 1)
        for point in ends
        if not known
    ]
    link, solids = zip(*drawn, *origins, strict=True)
    # Links without shapes, as between the joints of one body, leave their neighbours adjacent.
    shaped = {0, *link[: len(drawn)]}
    carriers = {
        k: max({j + 1 for j in robot.ancestors(k - 1)[:-1]} & shaped, default=0)
        for k in shaped
        if k
    }
    pairs = [
        (a, b)
        for a, b in product(range(len(drawn)), repeat=2)
        if link[a] < link[b] and carriers[link[b]] != link[a]
    ]
    walls = range(len(link), len(link) + len(planes))
    pairs += [(wall, b) for wall in walls for b, moving in enumerate(link) if moving]
    none = torch.zeros(len(pairs), dtype=torch.float64)
    made = Clearance(
        robot, usage, clearance,
        names=(*(("base", *robot.link_names)[k] for k in link), *plane_names),
        link=torch.tensor([*link, *[0] * len(planes)]),
        pairs=torch.tensor(pairs, dtype=torch.long).reshape(-1, 2),
        needed=none + clearance, room=none + FAR_ROOM,
        distances=Distances(solids, planes), warnings=_not_known(robot, shapes),
    )  # fmt: skip
    return _sensible(made, len(link)) if pairs else made


def _not_known(robot: Robot, shapes: LinkShapes) -> tuple[str, ...]:
    """What is not checked because its shape is not known, one sentence each."""
    warnings = []
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
    return tuple(warnings)


def _planes(
    floor: float | None, workspace: Sequence[float] | None
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
    return torch.tensor(rows, dtype=torch.float64).reshape(-1, 4), names


def _sensible(made: Clearance, solids: int) -> Clearance:
    """Without pairs that no motion can keep apart, as far as the shapes themselves say so; what
    comes after the solids is half-spaces."""
    lower, upper = position_limits(made.robot)[0].unbind(-1)
    generator = torch.Generator().manual_seed(0)
    # 512: of which pairs are asked whether they are ever clear
    drawn = torch.rand((512, made.robot.n), generator=generator, dtype=torch.float64)
    zero = torch.zeros_like(lower).clamp(lower, upper)
    apart = made.apart(torch.cat([zero.unsqueeze(0), lower + drawn * (upper - lower)]))
    largest, smallest = apart.amax(0), apart.amin(0)
    wall = made.pairs[:, 0] >= solids
    # A link that turns on the floor is as near to it whatever the motion. Of what is far, it is
    # only known that it is far.
    # Distance below which nothing is told apart [m]
    resolution = 0.001
    still = (largest - smallest < resolution) & (largest < made.needed + FAR_ROOM - resolution)
    overlap = ~wall & ((apart[0] < 0) | (largest < resolution))
    close = ~wall & ~overlap & ~still & (largest < made.needed + resolution)

    def named(which: Tensor) -> str:
        both = ([made.names[k] for k in pair] for pair in made.pairs[which].tolist())
        return ", ".join(dict.fromkeys(f"{a} and {b}" for a, b in both))

    notes = []
    if not bool(wall.all()):
        also = f", nor those that overlap in the zero posture: {named(overlap)}"
        also = also if bool(overlap.any()) else ""
        notes.append(f"links next to each other are not checked against each other{also}.")
    near, least = still & ~overlap & (largest < made.needed), f"{1000 * made.clearance:g} mm"
    if bool(near.any()):
        notes.append(f"not checked, for no motion moves them apart: {named(near)}.")
    if bool(close.any()):
        notes.append(f"hardly ever {least} apart, so only kept from touching: {named(close)}.")
    needed, kept = torch.where(close, 0.0, made.needed), ~(still | overlap)
    return replace(
        made,
        pairs=made.pairs[kept],
        needed=needed[kept],
        room=(largest - needed).clamp(resolution, FAR_ROOM)[kept],
        notes=tuple(notes),
    )


def _times(trajectory: FourierTrajectory | Sinusoid) -> Float[Tensor, " T"]:
    """Instants from 0 to the duration."""
    # 200: instants a period of the fastest harmonic
    # 500: instants at least
    count = math.ceil(max(500, 200 * trajectory.duration * trajectory.fastest))
    return torch.linspace(0, trajectory.duration, count + 1, dtype=torch.float64)


def _homogeneous(points: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 4 1"]:
    return torch.nn.functional.pad(points, (0, 1), value=1.0).unsqueeze(-1)
