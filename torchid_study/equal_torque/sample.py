"""Families of parameter sets with exactly equal torque, on both sides of feasibility.

With G the grouping of the base parameters, every x = x_ref + N z, with N a basis of G's null space,
has the same base parameters as x_ref and so the same torque in every motion. In the coordinates
x = (m, m c, J) the conditions of section 2.3 are convex:

    positive mass (2.22)        m > 0
    a body's inertia (2.26)     pseudo-inertia [[S, m c], [m c', m]] > 0, S = tr(J)/2 E - J
    box of the CoM (2.27)       m c_min <= m c <= m c_max
    total mass (2.31)           linear

(Wensing, Kim and Slotine 2018 for the pseudo-inertia). Sets that violate one kind of condition only
are found by sampling a convex region in which that kind is relaxed and all others are kept. Each
chain has its own region: which links are relaxed, and by how much, so that the violations are
spread from slight to gross. Chains are sampled by hit-and-run (Smith 1984; Lovasz and Vempala
2006), many at once, in coordinates that make each region round: the Hessian of the logarithmic
barrier at its analytic centre (Boyd and Vandenberghe 2004, sections 8.5 and 11.4).

A link with a negative mass needs care: its conditions hold for -m, -m c in place of m, m c, and of
those on the inertia the convex S > 0 is asked, which is sufficient for S - m c c' > 0.

What no condition limits is limited by `outer`: masses, relaxed CoM boxes and |J|. The coefficients
of effects stay as they are, also where the torque could share them with a link (rotor inertia).
"""

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from torchid.errors import TorchidError
from torchid.feasibility.bounds import Bounds
from torchid.feasibility.conditions import Conditions
from torchid.feasibility.margins import feasibility
from torchid.feasibility.margins import kinds as kinds_of
from torchid.feasibility.sets import ParameterSets, joined
from torchid.identification.base_parameters import BaseParameters
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.typing import Float, Int, Tensor
from torchid_study.equal_torque.hit_and_run import (
    Region,
    analytic_centre,
    hit_and_run,
    interior_point,
)


@dataclass(frozen=True, eq=False)
class Limits:
    """What each of K regions allows: with s = sign, s m in `mass`, c in `com`, and so on.

    Attributes:
        sign: (K, n) 1, or -1 for a link with a negative mass.
        mass: (K, n, 2) of sign * m [kg].
        com: (K, n, 3, 2) [m].
        second: (K, n) smallest second moments about the CoM [kg m^2].
        total: (K, 2) of the sum of the masses [kg].
        firm: (K,) smallest degrees of masses and of second moments.
    """

    sign: Tensor
    mass: Tensor
    com: Tensor
    second: Tensor
    total: Tensor
    firm: Tensor


@dataclass(frozen=True, eq=False)
class EqualTorqueSpace:
    """A reference, the directions that keep its torque, and the conditions' scales.

    Attributes:
        reference: one set.
        x: (P,) its rigid-body parameters in the paper's stacking.
        directions: (P, D) orthonormal.
        conditions, outer: as given.
        inertia: (n, 6) limits of |J|.
        scale: (n,) mean second moment of each link of the reference [kg m^2].
    """

    reference: ParameterSets
    x: Tensor
    directions: Tensor
    conditions: Conditions
    outer: Bounds
    inertia: Tensor
    scale: Tensor

    @property
    def n(self) -> int:
        """Number of links."""
        return self.scale.shape[0]

    @property
    def heaviest(self) -> Tensor:
        """Upper limits (n,) of the masses."""
        return self.outer.mass[:, 1]

    @property
    def mass_scale(self) -> Tensor:
        """Mean mass of the reference's links [kg]."""
        return self.x[: self.n].abs().mean()

    @property
    def widest(self) -> Tensor:
        """(n, 3, 2) the smallest box around the conditions' and the outer one."""
        box, outer = self.conditions.com_box, self.outer.com
        known = torch.isfinite(box)
        low = torch.where(known[..., 0], torch.minimum(box[..., 0], outer[..., 0]), outer[..., 0])
        high = torch.where(known[..., 1], torch.maximum(box[..., 1], outer[..., 1]), outer[..., 1])
        return torch.stack([low, high], -1)

    def limits(self, k: int) -> Limits:
        """What a feasible set must meet, k times."""
        box = self.conditions.com_box
        com = torch.where(torch.isfinite(box), box, self.outer.com)
        mass = torch.stack([self.outer.mass[:, 0].clamp(min=0.0), self.heaviest], -1)
        zeros = torch.zeros_like(self.scale)
        total = self.conditions.total_mass
        full = Limits(zeros + 1, mass, com, zeros, total, self.x.new_zeros(()))
        return Limits(*(v.expand(k, *v.shape).clone() for v in vars(full).values()))

    def region(self, limits: Limits) -> Region:
        """The regions of the limits, in coordinates z of x = reference + directions z."""
        a, f = self._linear(self.directions.T.unsqueeze(1), limits)
        b, c = self._linear(self.x.unsqueeze(0), limits)
        row, block = self._constants(limits)
        a, f = (x.permute(1, 2, 0).contiguous() for x in (a, f))
        return Region(a, b + row, f, c + block)

    def _linear(self, x: Tensor, limits: Limits) -> tuple[Tensor, Tensor]:
        """Homogeneous parts (..., K, R) and (..., K, 16 L) for x (..., 1 or K, P)."""
        pi = InertialParameters.from_paper_order(x)
        sign = limits.sign.unsqueeze(-1)
        m, h = pi.mass.unsqueeze(-1) * sign, pi.first_moment * sign
        j = pi.inertia_about_link_frame.flatten(-2).expand(*h.shape[:-2], -1)
        total = pi.mass.sum(-1, keepdim=True).expand(*h.shape[:-2], 1)
        total = total * torch.isfinite(limits.total)
        m1 = m.squeeze(-1)
        rows = [
            torch.cat([m1 - limits.firm.unsqueeze(-1) * m1.mean(-1, keepdim=True), -m1], -1),
            (h - m * limits.com[..., 0]).flatten(-2),
            (m * limits.com[..., 1] - h).flatten(-2),
            torch.cat([j, -j], -1),
            total * total.new_tensor([1.0, -1.0]),
        ]
        # A negative link: S and -m on the diagonal, without the first moments.
        keep = torch.ones(*limits.sign.shape, 4, 4, dtype=x.dtype)
        keep[..., 3, 3] = limits.sign
        keep[..., :3, 3] = keep[..., 3, :3] = (limits.sign.unsqueeze(-1) + 1) / 2
        # S - firm tr(S)/3 E: positive definite only where the smallest second moment about the CoM
        # is at least that share of their mean, which is at most tr(S)/3.
        pseudo = pi.pseudo_inertia
        mean = pseudo[..., :3, :3].diagonal(dim1=-2, dim2=-1).mean(-1, keepdim=True)
        less = limits.firm[:, None, None] * mean
        pseudo = pseudo - torch.diag_embed(torch.cat([less, less, less, 0 * less], -1))
        return torch.cat(rows, -1), (pseudo * keep).flatten(-3)

    def _constants(self, limits: Limits) -> tuple[Tensor, Tensor]:
        """Constant parts (K, R) and (K, 16 L)."""
        k = limits.sign.shape[0]
        j = self.inertia.flatten().expand(k, -1)
        total = torch.where(
            torch.isfinite(limits.total), limits.total * limits.total.new_tensor([-1.0, 1.0]), 1.0
        )
        boxes = torch.zeros(k, 6 * self.n, dtype=self.x.dtype)
        rows = torch.cat([-limits.mass[..., 0], limits.mass[..., 1], boxes, j, j, total], -1)
        shift = torch.zeros(k, self.n, 4, dtype=self.x.dtype)
        shift[..., :3] = -limits.second.unsqueeze(-1)
        return rows, torch.diag_embed(shift).flatten(1)

    def sets(self, z: Float[Tensor, "K D"], ids: Sequence[str]) -> ParameterSets:
        """The sets at coordinates z."""
        x = self.x + z @ self.directions.T
        return ParameterSets(
            tuple(ids),
            InertialParameters.from_paper_order(x),
            self.reference.effects,
            self.reference.coefficients.expand(len(z), -1).clone(),
        )


def equal_torque_space(
    reference: ParameterSets, base: BaseParameters, conditions: Conditions, outer: Bounds
) -> EqualTorqueSpace:
    """The space of a reference (K = 1), whose effects are those of the base parameters."""
    rigid = base.n_rigid_parameters
    own = reference.parameters
    scale = own.inertia_about_com[0].abs()[:, [0, 3, 5]].sum(-1) / 6
    return EqualTorqueSpace(
        reference,
        own.to_paper_order()[0],
        # Effects' coefficients stay: only changes of the rigid body's own parameters.
        kernel(base.grouping[:, :rigid]),
        conditions,
        outer,
        outer.inertia.abs().amax(-1),
        scale,
    )


def kernel(matrix: Tensor) -> Tensor:
    """Orthonormal basis of {x : matrix x = 0}, as columns."""
    _, singular, right = torch.linalg.svd(matrix)
    rank = int((singular > 1e-9 * singular[0]).sum())
    return right[rank:].T.contiguous()


SLIGHTEST = 0.02
"""Relaxation of the first chain of a kind; the last has 1, those between a geometric sequence."""


def relaxed_limits(
    walk: EqualTorqueSpace, relaxed: frozenset[str], chains: int, generator: np.random.Generator
) -> Limits | None:
    """Limits of the chains of a kind, from slightly to grossly relaxed; None if the conditions
    leave the kind nothing to violate."""
    limits = walk.limits(chains)
    if not relaxed:
        # Feasible with a degree of at least: nothing in half of the chains, then growing from chain
        # to chain. Chains that ask for more than there is have an empty region.
        level = torch.linspace(-1.0, 1.0, chains, dtype=walk.x.dtype)
        # 0.5: degree that the most firmly feasible chain asks for, if there are such sets
        firm = _between(level.new_tensor(SLIGHTEST), level.new_tensor(0.5), level).flatten()
        firm = torch.where(level > 0, firm, 0.0)
        by = firm.unsqueeze(-1)
        low, high = limits.com.unbind(-1)
        side = by.unsqueeze(-1) * (high - low) / 2
        half = (limits.total[:, 1:] - limits.total[:, :1]) / 2
        inner = torch.where(torch.isfinite(half), by * half, 0.0)
        return replace(
            limits,
            firm=firm,
            com=torch.stack([low + side, high - side], -1),
            total=limits.total + torch.cat([inner, -inner], -1),
        )
    # What leaves a kind nothing to violate.
    wider = torch.isfinite(walk.conditions.com_box) & (walk.widest != walk.conditions.com_box)
    possible = {
        "com": bool(wider.any()),
        "total_mass": bool(torch.isfinite(walk.conditions.total_mass).any()),
    }
    if not all(possible.get(kind, True) for kind in relaxed):
        return None
    for kind in sorted(relaxed):
        level = torch.linspace(0.0, 1.0, chains, dtype=walk.x.dtype)
        if len(relaxed) > 1:
            level = level[torch.from_numpy(generator.permutation(chains))]
        # Random links (chains, n), any number of them from 1 to n, all numbers equally often.
        order = generator.permuted(np.tile(np.arange(walk.n), (chains, 1)), axis=1)
        count = generator.permutation(np.arange(chains) % walk.n) + 1
        links = torch.from_numpy(order < count[:, None])
        limits = _relaxed(kind, walk, limits, level, links, generator)
    return limits


def _between(slight: Tensor, gross: Tensor, level: Tensor) -> Tensor:
    """Geometrically from slight (n,) at level 0 to gross (n,) at 1, for each level: (K, n)."""
    power = level.reshape(-1, *[1] * slight.ndim)
    return gross * (slight / gross) ** (1 - power)


def _relaxed(
    kind: str,
    walk: EqualTorqueSpace,
    limits: Limits,
    level: Tensor,
    links: Tensor,
    generator: np.random.Generator,
) -> Limits:
    """The limits (K regions) without those of one kind, for levels (K,) and links (K, n)."""
    k, n = links.shape
    chain = torch.arange(k)
    share = _between(level.new_tensor(SLIGHTEST), level.new_tensor(1.0), level).reshape(-1, 1)
    if kind == "inertia":
        # Second moments from slightly below zero to where only |J| limits them.
        gross = torch.maximum(3 * walk.inertia.amax(-1), walk.scale)
        depth = _between(SLIGHTEST * walk.scale, gross, level)
        return replace(limits, second=torch.where(links, -depth, 0.0))
    if kind == "com":
        # Boxes on the way from the conditions' to the outer ones, and one coordinate of each chain
        # beyond one of its faces: otherwise few draws would violate anything.
        reach = (walk.widest - limits.com[0]).abs()
        faces = (reach.flatten() > 0).nonzero().flatten()
        face = faces[torch.from_numpy(generator.permutation(np.arange(k) % len(faces)))]
        link, side = face // 6, face % 2
        links = links | torch.nn.functional.one_hot(link, n).bool()
        com = limits.com + (share * links).reshape(k, n, 1, 1) * (walk.widest - limits.com)
        beyond = com.flatten(1)
        beyond[chain, face + 1 - 2 * side] = limits.com[0].flatten()[face]
        return replace(limits, com=beyond.reshape_as(com))
    if kind == "mass":
        # Negative masses: of one link in every other chain, of several in the rest.
        one = torch.nn.functional.one_hot(chain // 2 % n, n).bool()
        negative = torch.where((chain % 2 == 0).unsqueeze(-1), one, links)
        deepest = _between(SLIGHTEST * walk.mass_scale.expand(n), walk.heaviest, level)
        low = torch.where(negative, 0.0, limits.mass[..., 0])
        high = torch.where(negative, deepest, limits.mass[..., 1])
        sign = torch.where(negative, -1.0, 1.0).to(low)
        return replace(limits, sign=sign, mass=torch.stack([low, high], -1))
    # Above the interval, and below it in every other chain.
    low, high = limits.total.unbind(-1)
    part = share.flatten()
    above = torch.stack([high, high + part * (walk.heaviest.sum() - high).clamp(min=0.0)], -1)
    below = torch.stack([low * (1 - part), low], -1)
    down = ((chain % 2 == 1) & (low > 0)) | ~torch.isfinite(high)
    return replace(limits, total=torch.where(down.unsqueeze(-1), below, above))


FEASIBLE = "feasible"
RELAXABLE = ("inertia", "com", "mass", "total_mass")
"""Kinds of conditions a family can violate; several are joined by +, e.g. inertia+com."""
KINDS = (FEASIBLE, "inertia", "com", "mass", "total_mass", "inertia+com")
DRAWS = 4
"""Draws for every set asked for; those kept are spread over the degrees."""


@dataclass(frozen=True, eq=False)
class EqualTorqueSets:
    """K sets with the torque of a reference, each violating the kinds of conditions asked for.

    Attributes:
        sets: ids such as inertia_0001.
        kind: (K,) the kind asked for, e.g. feasible, com, inertia+com.
        cluster: (K,) the chain a set was drawn from; statistics resample whole chains.
        reference: the feasible set they have the torque of, K = 1.
        warnings: sentences for the user, e.g. a kind that cannot be reached.
    """

    sets: ParameterSets
    kind: tuple[str, ...]
    cluster: Int[Tensor, " K"]
    reference: ParameterSets
    warnings: tuple[str, ...]


def equal_torque_sets(
    robot: Robot,
    base: BaseParameters,
    reference: ParameterSets,
    conditions: Conditions,
    outer: Bounds,
    *,
    kinds: Sequence[str] = KINDS,
    per_kind: int = 200,
    seed: int = 0,
    chains: int = 40,
) -> EqualTorqueSets:
    """Sets with the torque of a feasible reference, for each kind of violation asked for.

    Args:
        robot: the arm.
        base: its base parameters with the reference's effects.
        reference: one feasible set.
        conditions: what is kept, and what is violated by choice.
        outer: limits of the masses, of |J|, and of the CoMs where their boxes are relaxed.
        kinds: feasible, or names of `RELAXABLE`, several joined by +.
        per_kind: sets of each kind.
        seed: of all draws; the same arguments give the same sets.
        chains: independent chains for each kind.

    Returns:
        The sets, kind by kind in the order asked for. `feasibility` finds exactly the kinds asked
        for violated in each. A kind has fewer sets than asked for, or none, if no more were found;
        `warnings` says so.

    Raises:
        TorchidError: the reference is not feasible, a kind is unknown, sizes do not match.
    """
    _require(robot, base, reference, conditions, kinds)
    if per_kind < 1 or chains < 1:
        raise TorchidError(
            "per_kind and chains must be positive.", got=f"{per_kind} and {chains}", expected=">= 1"
        )
    walk = equal_torque_space(reference, base, conditions, outer)
    parts: list[ParameterSets] = []
    names: list[str] = []
    clusters: list[Tensor] = []
    warnings: list[str] = []
    for order, kind in enumerate(kinds):
        relaxed = frozenset(kind.split("+")) - {FEASIBLE}
        generator = np.random.default_rng([seed, zlib.crc32(kind.encode())])
        pool, chain = _draw(walk, relaxed, chains, per_kind, generator)
        rows = _chosen(pool, relaxed, conditions, per_kind, generator)
        label = kind.replace("+", "_")
        ids = tuple(f"{label}_{k:04d}" for k in range(1, len(rows) + 1))
        parts.append(replace(pool.part(rows), ids=ids))
        names += [kind] * len(rows)
        clusters.append(chain[rows] + order * chains)
        if len(rows) < per_kind:
            warnings.append(f"kind {kind}: {len(rows)} of {per_kind} sets found")
    return EqualTorqueSets(
        joined(parts) if parts else reference.part([]),
        tuple(names),
        torch.cat(clusters) if clusters else torch.zeros(0, dtype=torch.long),
        reference,
        tuple(warnings),
    )


def _require(
    robot: Robot,
    base: BaseParameters,
    reference: ParameterSets,
    conditions: Conditions,
    kinds: Sequence[str],
) -> None:
    """Raise unless the kinds are known, and the reference is one feasible set of the robot."""
    for kind in kinds:
        if kind != FEASIBLE and not set(kind.split("+")) <= set(RELAXABLE):
            raise TorchidError(
                "no such kind of violation.",
                got=kind,
                available=[FEASIBLE, *RELAXABLE],
                hint="several kinds are joined by +, e.g. inertia+com",
            )
    expected = robot.n_links, len(base.parameter_names)
    got = reference.parameters.mass.shape[-1], reference.vector.shape[-1]
    if len(reference) != 1 or got != expected:
        raise TorchidError(
            "the reference must be one set of this robot, with the effects of the base parameters.",
            got=f"{len(reference)} sets of {got[0]} links and {got[1]} parameters",
            expected=f"1 set of {expected[0]} links and {expected[1]} parameters",
        )
    checked = feasibility(reference, conditions)
    if not bool(checked.feasible[0]):
        raise TorchidError(
            "the reference of a family with equal torque must be feasible.",
            got=f"set '{reference.ids[0]}' violates {', '.join(checked.reasons(0))}",
            hint="coefficients of effects stay as they are: correct their signs first",
        )


def _draw(
    walk: EqualTorqueSpace,
    relaxed: frozenset[str],
    chains: int,
    per_kind: int,
    generator: np.random.Generator,
) -> tuple[ParameterSets, Tensor]:
    """Draws of all chains of a kind, and (K,) the chain of each; none if the kind is empty."""
    limits = relaxed_limits(walk, relaxed, chains, generator)
    rows = torch.zeros(0, dtype=torch.long)
    if limits is not None:
        region = walk.region(limits)
        start, inside = interior_point(region)
        rows = inside.nonzero().flatten()
    if not len(rows):
        return walk.reference.part([]), rows
    region, start = region.part(rows), start[rows]
    # 40: Newton steps at most
    centre, axes = analytic_centre(region, start, 40)
    draws = math.ceil(DRAWS * per_kind / len(rows))
    # 2: hit-and-run steps between two draws, for every dimension of the null space. The
    # autocorrelation time of a parameter is about 9 steps a dimension on the LWR (median; 25 for
    # the slowest).
    thin = 2 * start.shape[1]
    seeds = generator.integers(2**62, size=chains)[rows.numpy()]
    y = hit_and_run(region.at(centre, axes), seeds.tolist(), draws, thin)
    z = centre.unsqueeze(1) + y @ axes.mT
    chain = rows.unsqueeze(1).expand(-1, draws).flatten()
    return walk.sets(z.flatten(0, 1), [""] * len(chain)), chain


def _chosen(
    pool: ParameterSets,
    relaxed: frozenset[str],
    conditions: Conditions,
    per_kind: int,
    generator: np.random.Generator,
) -> list[int]:
    """Draws that violate exactly the kinds asked for, evenly over their degrees.

    Degrees are binned, by their logarithm where they are violations; draws are taken from the bins
    in turn, at random in each.
    """
    checked = feasibility(pool, conditions)
    fitting = [k for k in range(len(pool)) if kinds_of(checked.reasons(k)) == relaxed]
    if len(fitting) <= per_kind:
        return fitting
    degree = checked.degree[fitting].numpy()
    key = np.log(np.maximum(-degree, 1e-12)) if relaxed else degree
    low, high = np.quantile(key, [0.01, 1.0])
    bins = 10
    number = np.floor((key - low) / max(high - low, 1e-300) * bins).clip(0, bins - 1)
    order = generator.permutation(len(fitting))
    turn = np.empty(len(fitting))
    for own in range(bins):
        members = order[number[order] == own]
        turn[members] = np.arange(len(members))
    best = np.lexsort((number, turn))[:per_kind]
    return sorted(fitting[k] for k in best)
