"""Equations of motion of a batch of arms in the axes of the base, all links of all arms at once.

The recursion of `recursion.py` handles one robot on many samples: its cost is the number of kernel
calls, some thousand, whatever the batch. A simulation steps a few states many times; here only the
poses are sequential, level by level of the tree, and everything else is a handful of products of
small matrices.

With everything in base axes about the base's origin, sums along the tree need no transformation;
`i <= l` below means that joint i is on the way from the base to link l.
Let T_l be the pose of link l (4x4), S_i the twist of a unit rate of joint i as a matrix [w]x, v
(its last row of zeros left out: 3x4), and P_l = T_l P0_l T_l' the pseudo-inertia

    P0 = [[tr(J)/2 1 - J, h], [h', m]].

A point r (homogeneous) of link l accelerates by A_l r, A_l = sum_{i<=l} (S_i ddq_i + dS_i/dt dq_i)
+ V_l V_l - g, where V_l = sum_{i<=l} S_i dq_i and dS_i/dt = V_i S_i - S_i V_i. By virtual work

    tau_i = sum_{l>=i} <S_i, A_l P_l>,     M_ij = <S_i, S_j sum_{l>=max(i,j)} P_l>

with <,> the sum of products of entries (Uicker 1965; Hollerbach 1980; the sums are the composite
bodies of Walker and Orin 1982). Joints that mimic others follow q_links = F q + offset: torques
and masses of the coordinates are F' tau and F' M F.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import torch
from torch import Tensor

from torchid.robot.inertia import InertialParameters, symmetric
from torchid.robot.model import JointType, Robot
from torchid.typing import BroadcastJoints, Float, JointMatrix, Joints

# vec([w]x) = w @ _CROSS, row by row.
_CROSS = ((0, 0, 0, 0, 0, -1, 0, 1, 0), (0, 0, 1, 0, 0, 0, -1, 0, 0), (0, -1, 0, 1, 0, 0, 0, 0, 0))


@dataclass(frozen=True, eq=False)
class Arms:
    """What does not move, of one arm for the whole batch or of one arm per element of it.

    Attributes:
        constant, cosine, sine, slide: (*arms, L, 4, 4); the pose of link i in the one that carries
            it is constant + cosine cos q + sine sin q + slide q.
        pose_of_axis: (*arms, L, 3, 2): in link axes, the unit vector along the joint's axis, and a
            point of it at q = 0, from the link frame's origin.
        revolute: (L,) 1 or 0.
        inertia: (*arms, L, 4, 4) pseudo-inertias about the link frames.
        gravity: (*arms, 3) in the base frame [m/s^2].
        above: (L, L) true where the link of the column is carried by that of the row.
        cross: (3, 9) takes w to the rows of [w]x.
        slides: whether any joint is prismatic.
        tree: which link carries which; None for a serial chain.
    """

    constant: Tensor
    cosine: Tensor
    sine: Tensor
    slide: Tensor
    pose_of_axis: Tensor
    revolute: Tensor
    inertia: Tensor
    gravity: Tensor
    above: Tensor
    cross: Tensor
    slides: bool
    tree: "Branches | None" = None

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return self.revolute.shape[0] if self.tree is None else self.tree.n

    def at(self, q: Float[Tensor, "*batch n"]) -> "Posture":
        """The arms at positions q (*batch, n); the batch ends with the axes of the arms."""
        if self.tree is not None:
            q = self.tree.on_links(q)
        poses = self._poses(q)
        axis = poses[..., :3, :3] @ self.pose_of_axis
        along, point = axis[..., 0], axis[..., 1] + poses[..., :3, 3]
        turn = (along @ self.cross).unflatten(-1, (3, 3))
        if self.slides:
            r = self.revolute.unsqueeze(-1)
            turn = turn * r.unsqueeze(-1)
            shift = along * (1 - r) - (turn @ point.unsqueeze(-1)).squeeze(-1)
        else:
            shift = -(turn @ point.unsqueeze(-1)).squeeze(-1)
        screws = torch.cat([turn, shift.unsqueeze(-1)], -1)
        return Posture(self, screws, poses @ self.inertia @ poses.transpose(-1, -2))

    def _poses(self, q: Tensor) -> Tensor:
        """T_l (*batch, L, 4, 4), in the base frame."""
        x = q[..., None, None]
        steps = torch.addcmul(
            torch.addcmul(self.constant, self.cosine, x.cos()), self.sine, x.sin()
        )
        if self.slides:
            steps = torch.addcmul(steps, self.slide, x)
        if self.tree is not None:
            return self.tree.chained(steps)
        chain = list(steps.unbind(-3))
        for i in range(1, len(chain)):
            chain[i] = chain[i - 1] @ chain[i]
        return torch.stack(chain, -3)


@dataclass(frozen=True, eq=False)
class Branches:
    """Sums over a tree in place of sums along a chain.

    Attributes:
        n: number of coordinates.
        levels: for each step away from the base the places, in the order of the levels, of the
            links that carry those of the level; None for the first.
        order: (L,) the place of each link in the order of the levels.
        carries: (L, L) 1 where link l (row) is carried by link i (column), itself included.
        follow: (L, n) F; None where no joint mimics another.
        offset: (L,) [rad or m].
    """

    n: int
    levels: tuple[tuple[tuple[int, ...], tuple[int, ...]], ...]
    order: Tensor
    carries: Tensor
    follow: Tensor | None
    offset: Tensor

    @classmethod
    def of(cls, robot: Robot, like: Tensor) -> "Branches":
        """Joints of a robot, with the dtype and on the device of a tensor."""
        count = robot.n_links
        place = {link: k for k, link in enumerate(sum(robot.levels, ()))}
        carries, follow = like.new_zeros(count, count), like.new_zeros(count, robot.n)
        for link, drive in enumerate(robot.drives):
            carries[link, list(robot.ancestors(link))] = 1.0
            follow[link, drive.coordinate] = drive.ratio
        levels = tuple(
            (links, tuple(robot.levels[k - 1].index(robot.parents[link]) for link in links))
            if k
            else (links, ())
            for k, links in enumerate(robot.levels)
        )
        return cls(
            n=robot.n,
            levels=levels,
            order=torch.tensor([place[link] for link in range(count)], device=like.device),
            carries=carries,
            follow=follow if robot.mimics else None,
            offset=like.new_tensor([drive.offset for drive in robot.drives]),
        )

    def on_links(self, q: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch L"]:
        """Positions of the joints that move the links."""
        return q if self.follow is None else q @ self.follow.T + self.offset

    def rates(self, dq: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch L"]:
        """Velocities or accelerations of the joints that move the links."""
        return dq if self.follow is None else dq @ self.follow.T

    def torque(self, tau: Float[Tensor, "*batch L"]) -> Float[Tensor, "*batch n"]:
        """Torques of the coordinates from those of the links' joints."""
        return tau if self.follow is None else tau @ self.follow

    def mass(self, m: Float[Tensor, "*batch L L"]) -> Float[Tensor, "*batch n n"]:
        """Mass matrix of the coordinates from that of the links' joints."""
        return m if self.follow is None else self.follow.T @ m @ self.follow

    def chained(self, steps: Float[Tensor, "*batch L 4 4"]) -> Float[Tensor, "*batch L 4 4"]:
        """Poses in the base frame from those in the links that carry, level by level."""
        done: list[Tensor] = []
        for links, above in self.levels:
            own = steps[..., list(links), :, :]
            done.append(done[-1][..., list(above), :, :] @ own if above else own)
        return torch.cat(done, -3)[..., self.order, :, :]

    def from_the_base(self, x: Float[Tensor, "*batch L a b"]) -> Float[Tensor, "*batch L a b"]:
        """Sums over the joints on the way to each link."""
        return (self.carries @ x.flatten(-2)).unflatten(-1, x.shape[-2:])

    def towards_the_base(self, x: Float[Tensor, "*batch L a b"]) -> Float[Tensor, "*batch L a b"]:
        """Sums over all that each link carries."""
        return (self.carries.T @ x.flatten(-2)).unflatten(-1, x.shape[-2:])


class Posture:
    """Arms at one position each: what M and the bias have in common."""

    def __init__(self, arms: Arms, screws: Tensor, inertia: Tensor):
        self._arms = arms
        self._screws = screws  # S_i (*batch, L, 3, 4)
        self._inertia = inertia  # P_l (*batch, L, 4, 4)
        self._flat = screws.flatten(-2)

    def mass_matrix(self) -> JointMatrix:
        """M(q) [kg m^2]."""
        tree, above = self._arms.tree, self._arms.above
        composite = self._towards_the_base(self._inertia)
        # <S_i, S_j sum_{l>=j} P_l> is M_ij for i <= j only.
        half = self._flat @ (self._screws @ composite).flatten(-2).transpose(-1, -2)
        whole = torch.where(above, half, half.transpose(-1, -2))
        # Two joints of which neither carries the other have no mass in common.
        return whole if tree is None else tree.mass(whole * (tree.carries + above))

    def torque(self, dq: BroadcastJoints, ddq: BroadcastJoints | None = None) -> Joints:
        """M ddq + S dq + g [N m; N]; the bias alone if ddq is None."""
        arms, s = self._arms, self._screws
        tree = arms.tree
        rate = (dq if tree is None else tree.rates(dq))[..., None, None]
        v = self._from_the_base(s * rate)
        turning = v[..., :3]
        # dS/dt dq, in which S dq's own part of V cancels.
        change = (turning @ s - s[..., :3] @ v) * rate
        if ddq is not None:
            ddq = ddq if tree is None else tree.rates(ddq)
            change = torch.addcmul(change, s, ddq[..., None, None])
        a = self._from_the_base(change) + turning @ v
        a[..., 3] -= arms.gravity.unsqueeze(-2)
        force = self._towards_the_base(a @ self._inertia)
        torque = (self._flat * force.flatten(-2)).sum(-1)
        return torque if tree is None else tree.torque(torque)

    def _from_the_base(self, x: Tensor) -> Tensor:
        """Sums over the joints i <= l (*batch, L, ., .), for every l."""
        tree = self._arms.tree
        return x.cumsum(-3) if tree is None else tree.from_the_base(x)

    def _towards_the_base(self, x: Tensor) -> Tensor:
        """Sums over the links l >= i (*batch, L, ., .), for every i."""
        tree = self._arms.tree
        return x.flip(-3).cumsum(-3).flip(-3) if tree is None else tree.towards_the_base(x)


def arms_of(
    robots: Sequence[Robot], like: Tensor, parameters: Sequence[InertialParameters] | None = None
) -> Arms:
    """A batch of arms, (B,) with one robot an element; () arms if there is one robot only.

    Args:
        robots: with the same tree and joint types.
        like: dtype and device of the result.
        parameters: (..., L, 10) each, in place of the robots' own.

    Raises:
        RobotError: a robot has no inertial parameters, and none are given.
    """
    if parameters is None:
        parameters = [r.require_parameters("the equations of motion") for r in robots]
    joined = torch.stack if len(robots) > 1 else _only
    frames = [_frames(robot) for robot in robots]
    constant, cosine, sine, slide, axis = (
        joined(list(parts)).to(like) for parts in zip(*frames, strict=True)
    )
    first = robots[0]
    revolute = torch.tensor([drive.joint_type is JointType.REVOLUTE for drive in first.drives])
    tree = None if first.is_serial else Branches.of(first, like)
    above = torch.ones(first.n_links, first.n_links, device=like.device).triu(1).bool()
    return Arms(
        constant=constant,
        cosine=cosine,
        sine=sine,
        slide=slide,
        pose_of_axis=axis,
        revolute=revolute.to(like),
        inertia=joined([pseudo_inertia(p.pi) for p in parameters]).to(like),
        gravity=joined([robot.gravity for robot in robots]).to(like),
        above=above if tree is None else above & tree.carries.T.bool(),
        cross=torch.tensor(_CROSS).to(like),
        slides=not bool(revolute.all()),
        tree=tree,
    )


def _only(tensors: list[Tensor]) -> Tensor:
    return tensors[0]


def pseudo_inertia(pi: Float[Tensor, "*batch 10"]) -> Float[Tensor, "*batch 4 4"]:
    """[[tr(J)/2 1 - J, h], [h', m]] of inertial parameters (Wensing et al. 2018)."""
    inertia = symmetric(pi[..., 4:])
    half_trace = inertia.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None] / 2
    second = half_trace * torch.eye(3, dtype=pi.dtype, device=pi.device) - inertia
    h = pi[..., 1:4, None]
    top = torch.cat([second, h], -1)
    bottom = torch.cat([h.transpose(-1, -2), pi[..., :1, None]], -1)
    return torch.cat([top, bottom], -2)


@lru_cache(maxsize=256)
def _frames(robot: Robot) -> tuple[Tensor, ...]:
    """constant, cosine, sine, slide and pose_of_axis of one robot."""
    before, after = robot.before.double().cpu(), robot.after.double().cpu()
    eye = torch.eye(4, dtype=torch.float64)
    kinds = [drive.joint_type for drive in robot.drives]
    revolute = torch.tensor([t is JointType.REVOLUTE for t in kinds])[:, None, None]
    turned, quarter, lift = (torch.zeros(4, 4, dtype=torch.float64) for _ in range(3))
    turned[0, 0] = turned[1, 1] = quarter[1, 0] = lift[2, 3] = 1.0
    quarter[0, 1] = -1.0
    none = torch.zeros_like(before)
    constant = torch.where(revolute, before @ (eye - turned) @ after, before @ after)
    cosine = torch.where(revolute, before @ turned @ after, none)
    sine = torch.where(revolute, before @ quarter @ after, none)
    slide = torch.where(revolute, none, before @ lift @ after)
    axis = after[:, 2, :3]
    point = -(after[:, :3, :3].transpose(1, 2) @ after[:, :3, 3:]).squeeze(-1)
    return constant, cosine, sine, slide, torch.stack([axis, point], -1)
