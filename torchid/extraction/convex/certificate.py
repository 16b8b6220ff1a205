"""What no search can beat: the least loss of any feasible set, and what stands in the way.

The loss is convex in (m, mc, J) and so are the conditions (`convex.sets`), hence its minimum over
all feasible sets is a semidefinite program with a dual: phi_min is a proven lower
bound. A search that claims less has violated a condition.
"""

import time
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from msgspec import field, structs

from torchid.extraction.convex.conic import Solution, minimise
from torchid.extraction.convex.sets import (
    AXES,
    ENTRIES,
    AskedSets,
    ConvexSets,
    Nearest,
    link_columns,
    sets_of,
)
from torchid.extraction.problem import Problem
from torchid.extraction.record import CertificateRecord
from torchid.feasibility.conditions import physics_only
from torchid.feasibility.margins import feasibility
from torchid.feasibility.sets import ParameterSets

NOTHING_SHARE = 1e-6
"""A least norm below this share of the offset's needs no explanation."""


def conflict_of(body: ConvexSets) -> tuple[str, ...]:
    """Conditions that no x meets together, none of which can be left out; () if some x does.

    The solver's proof of infeasibility (Farkas) names candidates; each that is not needed for the
    contradiction is then dropped.
    """
    nothing = np.zeros(body.basis.shape[1])
    solution = minimise(nothing, body.rows)
    if solution.usable:
        return ()
    kept = _active(body, solution)
    everything = set(body.names)
    for name in list(kept):
        rest = set(kept) - {name}
        if rest and minimise(nothing, body.without(everything - rest).rows).status == "infeasible":
            kept.remove(name)
    return tuple(kept)


def forcing_conditions(
    body: ConvexSets, matrix: np.ndarray, offset: np.ndarray, nearest: Nearest
) -> tuple[dict[str, float], tuple[str, ...]]:
    """What holds a least norm up.

    Args:
        body: the sets.
        matrix, offset: of the norm ||matrix x + offset||.
        nearest: its minimum over the sets.

    Returns:
        The squared minimum without each active condition (without any other it stays), and a small
        group of conditions, found greedily, without which it is nearly zero; () if there is none
        or the minimum is zero.
    """
    if nearest.bound <= NOTHING_SHARE * float(np.linalg.norm(offset)):
        return {}, ()
    first: dict[str, float] = {}
    # 1e-3: share of a least loss that counts as none
    goal, group, left = 1e-3 * nearest.value**2, list[str](), nearest
    while left.value**2 > goal:
        rest = body.without(group)
        trials = {
            name: rest.without([name]).least_norm(matrix, offset)
            for name in _active(rest, left.solution)
        }
        trials = {name: t for name, t in trials.items() if t.solution.usable}
        first = first or {name: t.bound**2 for name, t in trials.items()}
        if not trials:
            break
        best = min(trials, key=lambda name: trials[name].value)
        group.append(best)
        left = trials[best]
    if left.value**2 > goal:
        return first, ()
    for name in list(group):
        rest = body.without(set(group) - {name})
        if len(group) > 1 and rest.least_norm(matrix, offset).value ** 2 <= goal:
            group.remove(name)
    return first, tuple(group)


def _active(body: ConvexSets, solution: Solution) -> list[str]:
    """Conditions whose multipliers are not zero: without any other, the optimum stays."""
    sizes = [float(np.linalg.norm(z)) for z in solution.multipliers[: len(body.rows)]]
    # 1e-7: multipliers below this share of the largest are zero
    least = 1e-7 * max(sizes)
    # Not "s > least": a multiplier that is not a number counts.
    names = [r.name for r, s in zip(body.rows, sizes, strict=True) if not s <= least]
    return list(dict.fromkeys(names))


STRICT_EIGENVALUE = 1e-6
"""Smallest eigenvalue of the pseudo-inertias of a set called strictly feasible [kg m^2, kg]."""
INSIDE_SHARE = 1e-9
"""Share of the other conditions' sizes by which such a set keeps away from them."""
_SMALLER = (1.0, 1e-2)
"""Shares of STRICT that are tried in turn."""


class Certificate(CertificateRecord, frozen=True, eq=False, kw_only=True):
    """The least loss of any feasible set.

    Attributes:
        sets: one strictly feasible set that nearly reaches phi_min, with no violation by
            `torchid.feasibility.margins`; or None.
        strict: smallest eigenvalue of the pseudo-inertias it was asked for [kg m^2, kg].
        released: phi_min with one condition released, for each that is active at the optimum;
            releasing any other changes nothing.
        status: of the solver.
    """

    sets: ParameterSets | None = None
    strict: float = 0.0
    released: dict[str, float] = field(default_factory=dict)
    status: str


def certificate_where_possible(problem: Problem) -> tuple[Certificate, tuple[str, ...]]:
    """The certificate under all conditions; under bounds and physics alone where no set meets
    them all, with that `conflict`. A note says so, or that the solver failed.
    """
    proof = certificate(problem)
    if proof.feasible:
        return proof, ()
    bounds = f"the bounds '{problem.bounds.name}'"
    if not proof.conflict:
        return proof, (f"the solver failed within {bounds}: how small phi can be is not known",)
    note = (
        f"no set within {bounds} meets the conditions ({', '.join(proof.conflict)}): phi_min is "
        "that of the bounds alone"
    )
    alone = certificate(problem, with_conditions=False)
    return structs.replace(alone, conflict=alone.conflict or proof.conflict), (note,)


def certificate(
    problem: Problem,
    *,
    with_conditions: bool = True,
    com_bounds: bool = True,
    inertia_bounds: bool = True,
    margin: float = 0.0,
    explain: bool = True,
) -> Certificate:
    """The least loss that any feasible set of the problem can have.

    Args:
        problem: loss, bounds and conditions.
        with_conditions: whether the problem's conditions count beside physics and bounds.
        com_bounds, inertia_bounds: whether the bounds' boxes of the centres of mass and of the
            barycentric inertias count.
        margin: smallest eigenvalue of the pseudo-inertias that feasible sets have for phi_min
            [kg m^2, kg]; 0 is physical consistency.
        explain: whether to find `released` and `forcing`, some dozens of solutions more.
    """
    begun = time.perf_counter()
    question = _Question(problem, with_conditions, com_bounds, inertia_bounds, margin)
    conflict = question.crossed()
    matrix, offset = loss_matrix(problem)
    inner = None if conflict else question.strictly_inside(matrix, offset)
    if inner is None:
        conflict = conflict or conflict_of(question.body(margin + STRICT_EIGENVALUE))
        return Certificate(
            feasible=False,
            phi_min=np.inf if conflict else np.nan,
            conflict=conflict,
            with_conditions=with_conditions,
            status="infeasible" if conflict else "failed",
            seconds=time.perf_counter() - begun,
        )
    outer = question.body(margin)
    # Rows that only bound the inertias help some proofs and harm others; without them the bound
    # still holds within the radius.
    free = replace(outer.without(outer.reach_names), radius=outer.radius)
    best = max(
        (b.least_norm(matrix, offset) for b in (outer, free)), key=lambda nearest: nearest.bound
    )
    released, forcing = forcing_conditions(free, matrix, offset, best) if explain else ({}, ())
    phi_min = best.bound**2
    # 1e-3: share of phi_min by which releasing a condition must lower it to be listed
    lower = [(name, phi) for name, phi in released.items() if phi < phi_min * (1 - 1e-3)]
    return Certificate(
        feasible=True,
        phi_min=phi_min,
        phi_strict=inner.phi,
        sets=inner.sets,
        strict=inner.strict,
        released=released,
        phi_min_without=dict(sorted(lower, key=lambda item: item[1])),
        forcing=forcing,
        relaxed_active=inner.outside,
        with_conditions=with_conditions,
        exact=inner.phi <= NOTHING_SHARE**2 * float(offset @ offset),
        status=best.solution.status,
        seconds=time.perf_counter() - begun,
    )


class _Inner(NamedTuple):
    """A strictly feasible set, its loss and margin, and what it or the relaxation misses."""

    sets: ParameterSets
    phi: float
    strict: float
    outside: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Question(AskedSets):
    """Feasible sets with a margin (see `certificate`)."""

    margin: float = 0.0

    def crossed(self) -> tuple[str, ...]:
        """Centres of mass, and the total mass, for which no value is left."""
        apart = (self.box[..., 0] > self.box[..., 1]).nonzero()
        names = [f"com_{i + 1}{AXES[a]}" for i, a in zip(*(k.tolist() for k in apart), strict=True)]
        if not self.with_conditions:
            return tuple(names)
        low, high = self.problem.bounds.mass.sum(0).tolist()
        least, most = self.problem.conditions.total_mass.tolist()
        return (*names, "total_mass") if low > most or high < least else tuple(names)

    def strictly_inside(self, matrix: np.ndarray, offset: np.ndarray) -> "_Inner | None":
        """The best strictly feasible set; None if there is none.

        One that the relaxed bounds of inertias let out of the bounds is brought back inside, if
        it can be: each step is the best of sets that are within the bounds for certain, near the
        last one's centres of mass (the convex-concave procedure).
        """
        # Relative decrease of the loss for which another is made
        worth = 1e-6
        for strict in (self.margin + share * STRICT_EIGENVALUE for share in _SMALLER):
            relaxed = self._best(strict, None, matrix, offset)
            if relaxed is None:
                continue
            outside = self.outside(relaxed[0])
            if not outside:
                return _Inner(*relaxed, strict, ())
            sets, phi = relaxed[0], np.inf
            # 30: at most, towards the bounds of inertias, for a set that is outside them
            for _ in range(30):
                step = self._best(strict, sets.parameters.com[0].numpy(), matrix, offset)
                if step is None or step[1] >= (1 - worth) * phi:
                    break
                sets, phi = step
            if np.isinf(phi):
                return _Inner(*relaxed, strict, outside)
            reached = phi <= (1 + worth) * relaxed[1] + NOTHING_SHARE**2 * float(offset @ offset)
            return _Inner(sets, phi, strict, () if reached else outside)
        return None

    def _best(
        self, strict: float, inside: np.ndarray | None, matrix: np.ndarray, offset: np.ndarray
    ) -> tuple[ParameterSets, float] | None:
        """The set of least loss, and the loss; None if the solver or the margins say no."""
        nearest = self.body(strict, inside).tightened(INSIDE_SHARE).least_norm(matrix, offset)
        if not nearest.solution.usable:
            return None
        x, box = nearest.x.copy(), self.box
        for link in range(self.problem.n):
            # The solver's rounding, where the interval of a centre of mass is one point.
            mass, *moment = link_columns(self.problem.n, link)[:4]
            single = box[link, :, 0] == box[link, :, 1]
            x[moment] = np.where(single, x[mass] * box[link, :, 0], x[moment])
        # And beyond bounds and signs of coefficients, where the rounding is larger than the
        # distance kept in a short interval.
        low, high = self.problem.box[10 * self.problem.n :].cpu().numpy().T
        low = np.where(self.problem.non_negative.cpu().numpy(), np.maximum(low, 0.0), low)
        x[10 * self.problem.n :] = np.clip(x[10 * self.problem.n :], low, high)
        sets = sets_of(x[None], self.problem.n, self.problem.target.effects, ["certificate"])
        asked = self.conditions or physics_only(self.problem.n)
        phi = float(np.sum((matrix @ x + offset) ** 2))
        return (sets, phi) if bool(feasibility(sets, asked).feasible[0]) else None

    def outside(self, sets: ParameterSets) -> tuple[str, ...]:
        """Bounds of barycentric inertias that the first set does not meet."""
        if not self.inertia_bounds:
            return ()
        inertia = sets.parameters.inertia_about_com[0]
        low, high = self.problem.bounds.inertia.to(inertia).unbind(-1)
        slack = INSIDE_SHARE * (high - low)
        out = ((inertia < low - slack) | (inertia > high + slack)).nonzero().tolist()
        return tuple(f"bound_{link + 1}{ENTRIES[k]}" for link, k in out)


def loss_matrix(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """W G (R, P) and -t (R,): phi = ||W G x - t||^2."""
    target = problem.target
    return target.matrix.cpu().double().numpy(), -target.offset.cpu().double().numpy()
