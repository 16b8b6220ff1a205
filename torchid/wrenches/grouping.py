"""The parameters that the wrench at one joint feels, lumped to the fewest.

Seen from a joint, some parameters of the links beyond it act as if they were fixed to the link
before them (Gautier and Khalil 1990; Mayeda et al. 1990). In the frame that moves with a joint, z
along its axis:

- a revolute joint does not see a body that is symmetric about its axis turn: m, m c_z and an
  inertia diag(A, A, 0) with A = Jyy go over to the link before, and m cx, m cy, Jxx - Jyy, Jxy,
  Jxz, Jyz, Jzz stay;
- a prismatic joint does not turn its link: all of J goes over, and m and m c stay.

This holds for the whole wrench, not for the torque alone, so the wrench at joint i depends on the
ten lumped parameters of link i and on seven (or four) of each link beyond. For a 7R arm that is
27 % less arithmetic than the ten parameters of every link, and it changes no value.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import torch

from torchid.dynamics.recursion import ChainGeometry, chain_geometry
from torchid.robot.inertia import PARAMETERS_PER_LINK, move
from torchid.robot.model import JointType, Robot
from torchid.typing import Float, Pi, Tensor

FORCE_KINDS = 4
"""A link's first four parameters, m and m c, make forces; the six of J make couples alone."""


@dataclass(frozen=True)
class Kept:
    """Which lumped parameters of a link (0 to 9) stay with it, seen from the joints before it."""

    forces: tuple[int, ...]
    couples: tuple[int, ...]


_KEPT = {
    JointType.REVOLUTE: Kept((1, 2), (4, 5, 6, 8, 9)),
    JointType.PRISMATIC: Kept((0, 1, 2, 3), ()),
}


@dataclass(frozen=True)
class WrenchChain:
    """What is constant in a robot's wrenches, made once per robot.

    Attributes:
        geometry: of the chain whose link frames are the moved joint frames (z along the axis).
        kept: per link.
        descendants: per link all that it carries, itself first, in order of the links.
        link_axes: (L, 3, 3) takes a vector from axes of the moved joint frame to the link frame's.
        to_forces: per joint (10 D, Cf): from the parameters of the D links that it moves to those
            that make the force.
        to_moments: per joint (10 D, Cm): to those that make the moment: the Cf of the force
            first, then those of couples.
    """

    geometry: ChainGeometry
    kept: tuple[Kept, ...]
    descendants: tuple[tuple[int, ...], ...]
    link_axes: Float[Tensor, "L 3 3"]
    to_forces: tuple[Tensor, ...]
    to_moments: tuple[Tensor, ...]

    @property
    def n(self) -> int:
        """Number of links, and of the joints that carry them."""
        return len(self.kept)

    def children(self, link: int) -> list[int]:
        """Links that a link carries itself."""
        return [k for k, joint in enumerate(self.geometry.joints) if joint.parent == link]

    @property
    def columns(self) -> int:
        """Columns of all the blocks together."""
        return sum(m.shape[1] for m in (*self.to_forces, *self.to_moments))


@lru_cache(maxsize=64)
def wrench_chain(robot: Robot) -> WrenchChain:
    """The robot's chain in moved joint frames, and how its parameters are lumped."""
    after = robot.after.double().cpu()
    before = robot.before.double().cpu().clone()
    carried = [link for link, parent in enumerate(robot.parents) if parent >= 0]
    above = [robot.parents[link] for link in carried]
    before[carried] = after[above] @ before[carried]
    before = torch.where(before.abs() < 1e-15, torch.zeros_like(before), before)
    in_joint_frames = replace(robot, before=before, after=torch.eye(4).to(after).expand_as(after))
    links = robot.n_links
    unit = torch.eye(PARAMETERS_PER_LINK * links, dtype=torch.float64)
    lumped = _lumped(robot, before, unit.reshape(-1, links, PARAMETERS_PER_LINK))
    kinds = [drive.joint_type for drive in robot.drives]
    kept = tuple(_KEPT[kind] for kind in kinds)
    to_forces, to_moments = [], []
    for i in range(links):
        forces = [lumped[i][:, :FORCE_KINDS]]
        couples = [lumped[i][:, FORCE_KINDS:]]
        for link in _branch_by_branch(robot, i)[1:]:
            stays = lumped[link] - _handed_over(lumped[link], kinds[link])
            forces.append(stays[:, list(kept[link].forces)])
            couples.append(stays[:, list(kept[link].couples)])
        own = torch.tensor(robot.descendants(i)).unsqueeze(1) * PARAMETERS_PER_LINK
        felt = (own + torch.arange(PARAMETERS_PER_LINK)).flatten()
        to_forces.append(torch.cat(forces, 1)[felt])
        to_moments.append(torch.cat([*forces, *couples], 1)[felt])
    return WrenchChain(
        geometry=chain_geometry(in_joint_frames),
        kept=kept,
        descendants=tuple(robot.descendants(i) for i in range(links)),
        link_axes=after[:, :3, :3].transpose(-1, -2).contiguous(),
        to_forces=tuple(to_forces),
        to_moments=tuple(to_moments),
    )


def _branch_by_branch(robot: Robot, link: int) -> list[int]:
    """A link and all that it carries, each branch to its end before the next: the order in which
    blocks are put together."""
    out = [link]
    for child in [k for k, parent in enumerate(robot.parents) if parent == link]:
        out += _branch_by_branch(robot, child)
    return out


def lumped_parameters(
    chain: WrenchChain, pi: Float[Tensor, "K L 10"]
) -> list[tuple[Float[Tensor, "K Cf"], Float[Tensor, "K Cm"]]]:
    """Per joint the lumped parameters of K sets that make its force, and those of its moment."""
    felt = [pi[:, list(links)].flatten(1) for links in chain.descendants]
    return [
        (own @ to_force.to(pi), own @ to_moment.to(pi))
        for own, to_force, to_moment in zip(felt, chain.to_forces, chain.to_moments, strict=True)
    ]


def _lumped(
    robot: Robot, before: Float[Tensor, "L 4 4"], pi: Float[Tensor, "K L 10"]
) -> list[Float[Tensor, "K 10"]]:
    """Per link its parameters with those that the links beyond hand over, in the moved frame of
    its joint; `before` are the poses of these frames in the ones before."""
    after = robot.after.double().cpu()
    lumped: dict[int, Tensor] = {}
    for i in reversed(range(robot.n_links)):
        own = move(pi[:, i], after[i])
        for child in [k for k, parent in enumerate(robot.parents) if parent == i]:
            given = _handed_over(lumped[child], robot.drives[child].joint_type)
            own = own + move(given, before[child])
        lumped[i] = own
    return [lumped[i] for i in range(robot.n_links)]


def _handed_over(pi: Pi, kind: JointType) -> Pi:
    out = torch.zeros_like(pi)
    if kind is JointType.PRISMATIC:
        out[..., FORCE_KINDS:] = pi[..., FORCE_KINDS:]
    else:
        out[..., [0, 3]] = pi[..., [0, 3]]
        out[..., [4, 7]] = pi[..., [7, 7]]
    return out
