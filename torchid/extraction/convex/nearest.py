"""The feasible set next to an infeasible one, at the least cost in torque.

Cutting off each link's negative eigenvalues changes the torque although other links could have
taken the change over: most combinations of parameters do not act on the torque at all. Here all
links move together. The cost is the torque itself,

    || R (x - x0) ||,      R the triangular factor of the regressor over many states,

so it is the root mean square of the change of the joints' torques [N m; N]. First the least cost
over all feasible sets is found; then, among the sets that cost little more, the one whose
parameters change least, each change in the size of its link's parameters. Both are semidefinite
programs (`torchid.extraction.convex.sets`).
"""

from dataclasses import dataclass, replace

import numpy as np
import torch

from torchid.effects.base import Motion
from torchid.errors import TorchidError
from torchid.extraction.convex.sets import Nearest, convex_sets, link_columns, sets_of
from torchid.feasibility.conditions import Conditions, physics_only
from torchid.feasibility.margins import feasibility
from torchid.feasibility.sets import ParameterSets
from torchid.identification.base_parameters import random_states, stacked_regressor
from torchid.robot.model import Robot
from torchid.typing import Bool, Float, Tensor

MARGIN = 1e-6
"""Smallest eigenvalue of the pseudo-inertias of a nearest set [kg m^2, kg]."""
SLACK_SHARE = 0.01
"""Share of the least cost that smaller changes of parameters may cost beside it."""
LARGEST_CHANGE = 100.0
"""Change of the parameters at most, in their links' sizes: without it the least cost in torque may
be approached by masses that grow without end."""


@dataclass(frozen=True, eq=False)
class NearestSets:
    """Feasible sets next to K given ones.

    Attributes:
        sets: (K) with the given ids; nan where there is none.
        feasible: (K,) whether `torchid.feasibility.margins` finds no violation.
        margin: (K,) smallest eigenvalue of the links' pseudo-inertias.
        torque_change: (K, n) root mean square over the states of each joint's change [N m; N].
        torque_change_relative: (K, n) the same over that of the joint's torque.
        least: (K,) lower bound of the change's root mean square over all joints and states, of any
            feasible set whose parameters change by at most FAR times their links' sizes.
        status: (K,) unchanged (it was feasible), solved, inexact, infeasible or failed.
    """

    sets: ParameterSets
    feasible: Bool[Tensor, " K"]
    margin: Float[Tensor, " K"]
    torque_change: Float[Tensor, "K n"]
    torque_change_relative: Float[Tensor, "K n"]
    least: Float[Tensor, " K"]
    status: tuple[str, ...]


def nearest_feasible(
    robot: Robot,
    sets: ParameterSets,
    conditions: Conditions | None = None,
    *,
    motion: Motion | None = None,
    margin: float = MARGIN,
    slack: float = SLACK_SHARE,
    seed: int = 0,
) -> NearestSets:
    """The feasible sets that change the torque of given ones least, and then their parameters.

    Args:
        robot: whose torque counts.
        sets: K sets; feasible ones come back unchanged.
        conditions: beside physics (positive masses, inertias of bodies, signs of coefficients).
        motion: states (M, n) over which the torque counts; `random_states` of the seed if None.
        margin: smallest eigenvalue that pseudo-inertias get [kg m^2, kg]; those of links that are
            consistent with less need not gain.
        slack: share of the least cost in torque that may be spent on smaller changes.
        seed: of the random states.

    Raises:
        TorchidError: a set that is not finite, or a margin or slack that is not positive.
    """
    if not margin > 0 or not slack > 0:
        raise TorchidError("margin and slack are positive numbers.", got=f"{margin}, {slack}")
    given = sets.vector.detach().cpu().double()
    bad = ~torch.isfinite(given).all(-1)
    if bool(bad.any()):
        broken = [i for i, b in zip(sets.ids, bad.tolist(), strict=True) if b]
        raise TorchidError("these sets are not all numbers.", got=", ".join(broken))
    asked = physics_only(robot.n_links) if conditions is None else conditions.to("cpu")
    states = random_states(robot, seed) if motion is None else motion.to("cpu")
    y = stacked_regressor(robot, sets.effects, states)
    # R (P, P) with ||R x|| the root mean square of the torque Y x.
    factor = (torch.linalg.qr(y, mode="r").R / y.shape[0] ** 0.5).numpy()
    question = _Question(robot, sets, asked, margin, slack, factor)
    nearest = [question.nearest(k) for k in range(len(sets))]
    x = torch.as_tensor(np.stack([f[0] for f in nearest]))
    after = sets_of(x.numpy(), robot.n_links, sets.effects, sets.ids)
    joints = (-1, robot.n, len(sets))
    change = (y @ (x - given).T).reshape(joints).square().mean(0).sqrt().T
    own = (y @ given.T).reshape(joints).square().mean(0).sqrt().T
    return NearestSets(
        sets=after,
        feasible=feasibility(after, asked).feasible,
        margin=_least_eigenvalue(after).amin(-1),
        torque_change=change,
        torque_change_relative=change / own,
        least=torch.tensor([f[1] for f in nearest], dtype=torch.float64),
        status=tuple(f[2] for f in nearest),
    )


def _least_eigenvalue(sets: ParameterSets) -> Float[Tensor, "K n"]:
    """(K, n) of the pseudo-inertias; nan where a set is."""
    pi = sets.parameters.pi
    finite = torch.isfinite(pi).all(-1).all(-1)
    values = type(sets.parameters)(torch.where(finite[:, None, None], pi, 0.0)).consistency_margin()
    return torch.where(finite.unsqueeze(-1), values, torch.nan)


@dataclass(frozen=True, eq=False)
class _Question:
    """What is the same for all sets."""

    robot: Robot
    sets: ParameterSets
    conditions: Conditions
    margin: float
    slack: float
    factor: np.ndarray

    def nearest(self, k: int) -> tuple[np.ndarray, float, str]:
        """x (P,), the least cost, and a status, for set k."""
        one = self.sets.part([k])
        x0 = one.vector[0].detach().cpu().double().numpy()
        if bool(feasibility(one, self.conditions).feasible[0]):
            return x0, 0.0, "unchanged"
        own = _least_eigenvalue(one)[0]
        margins = torch.where(own > 0, own.clamp(max=self.margin), self.margin).tolist()
        best = self._cheapest(x0, margins)
        return best.x, best.bound, best.solution.status

    def _cheapest(self, x0: np.ndarray, margins: list[float]) -> Nearest:
        """Least torque, then least change; the bound is that of the torque."""
        # 1e-9: share of the other conditions' sizes by which it keeps away from them
        body = convex_sets(
            self.robot, self.sets.effects, self.conditions, None, margin=margins
        ).tightened(1e-9)
        # The size of each parameter, from its link's mass and inertia.
        n, sizes = self.robot.n_links, np.ones_like(x0)
        columns = [link_columns(n, link) for link in range(n)]
        masses = _at_least(np.abs(x0[:n]))
        inertias = _at_least(np.array([np.abs(x0[c[[4, 7, 9]]]).mean() for c in columns]))
        for c, m, j in zip(columns, masses, inertias, strict=True):
            sizes[c] = [m, *([np.sqrt(m * j)] * 3), *([j] * 6)]
        if len(x0) > 10 * n:
            sizes[10 * n :] = _at_least(np.abs(x0[10 * n :]))
        weights = np.diag(1 / sizes)
        body = body.plus([body.ball(weights, -weights @ x0, LARGEST_CHANGE, "far")])
        body = replace(body, radius=(np.abs(x0) + LARGEST_CHANGE * sizes) / body.basis.diagonal())
        first = body.least_norm(self.factor, -self.factor @ x0)
        if not first.solution.usable:
            return first
        torque = float(np.linalg.norm(self.factor @ x0))
        # 1e-6: share of the set's own torque that counts as no cost
        radius = max((1 + self.slack) * first.value, 1e-6 * torque)
        near = body.plus([body.ball(self.factor, -self.factor @ x0, radius, "torque")])
        second = near.least_norm(weights, -weights @ x0)
        cost = float(np.linalg.norm(self.factor @ (second.x - x0)))
        if not second.solution.usable or cost > (1 + 1e-3) * radius:
            return first
        return Nearest(second.solution, second.x, second.value, first.bound)


def _at_least(sizes: np.ndarray) -> np.ndarray:
    """None smaller than a twentieth of the mean."""
    return np.maximum(sizes, 0.05 * sizes.mean() + 1e-12)
