"""The extraction problem: which physical parameters, within bounds, give these base parameters?

The search variables p are those of tables A.5 and A.6: masses, centres of mass and *barycentric*
inertias of all links, then the coefficients of the effects. The loss is

    phi(p) = || W pi_R(p) - t ||^2,       pi_R(p) = G pi(p),

with W = 1 and t the identified coefficients for the two-step loss (2.28). For the one-step loss
(2.29), || Y pi(p) - tau ||^2, W and t are the triangular factor of [Y_R tau]: what the log says
about the coefficients, in a matrix as small as the two-step one; the part of the torque that no
parameters explain is left out of phi.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import torch

from torchid.effects.base import JointEffect
from torchid.errors import TorchidError
from torchid.feasibility.bounds import Bounds
from torchid.feasibility.conditions import Conditions
from torchid.feasibility.sets import ParameterSets
from torchid.identification.base_parameters import (
    BaseParameters,
    random_states,
    stacked_regressor,
    visible,
)
from torchid.robot.inertia import PARAMETERS_PER_LINK, InertialParameters, paper_order
from torchid.robot.model import Robot
from torchid.typing import Bool, Float, Tensor

LossName = Literal["two-step", "one-step"]


@dataclass(frozen=True, eq=False)
class Target:
    """Base parameters to reproduce, and how a deviation counts.

    Attributes:
        base: which combinations they are.
        effects: linear effects whose coefficients are among them.
        values: (B,) identified coefficients.
        weight, offset: (R, B), (R,) of the loss || weight pi_R - offset ||^2.
        loss: name of the loss.
        left: norm of the log's torque that no coefficients explain, in units of the loss; 0 for a
            loss without a log.
    """

    base: BaseParameters
    effects: tuple[JointEffect, ...]
    values: Float[Tensor, " B"]
    weight: Float[Tensor, "R B"]
    offset: Float[Tensor, " R"]
    loss: LossName
    left: float = 0.0

    @cached_property
    def matrix(self) -> Float[Tensor, "R P"]:
        """weight G: the loss is || matrix x - offset ||^2 of full parameter vectors x."""
        return self.weight @ self.base.grouping.to(self.weight)

    @cached_property
    def matrix_by_link(self) -> Float[Tensor, "R P"]:
        """The target's matrix with the rigid columns link by link, ten each; the effects'
        follow."""
        rigid = self.base.n_rigid_parameters
        columns = self.matrix.clone()
        columns[:, paper_order(rigid // PARAMETERS_PER_LINK)] = self.matrix[:, :rigid]
        return columns


def two_step(
    base: BaseParameters,
    effects: Sequence[JointEffect],
    values: Tensor,
    known: Bool[Tensor, " B"] | None = None,
) -> Target:
    """The two-step loss (2.28): squared distance to identified coefficients (B,).

    Args:
        base, effects: what the coefficients are.
        values: (B,) identified.
        known: (B,) those that count; all if None. A coefficient that the log did not determine
            asks for nothing.

    Raises:
        TorchidError: not one finite number a base parameter.
    """
    _check(base, values)
    weight = torch.eye(len(base), dtype=values.dtype, device=values.device)
    weight = weight if known is None else weight[known]
    return Target(base, tuple(effects), values, weight, weight @ values, "two-step")


def one_step(
    base: BaseParameters,
    effects: Sequence[JointEffect],
    values: Tensor,
    factor: Float[Tensor, "C C"],
) -> Target:
    """The one-step loss (2.29), with the rows weighted as in the fit.

    Args:
        base, effects, values: as for `two_step`.
        factor: (B + 1, B + 1) of the fit, `Identification.factor`.

    Raises:
        TorchidError: values or a factor that are not of these base parameters, or not finite.
    """
    _check(base, values)
    size = len(base) + 1
    if factor.shape != (size, size) or not bool(torch.isfinite(factor).all()):
        raise TorchidError(
            "the factor does not belong to these base parameters, or is not finite.",
            got=f"{tuple(factor.shape)}, {int((~torch.isfinite(factor)).sum())} not finite",
            expected=f"({size}, {size}) finite numbers",
        )
    weight, left = factor[:-1, :-1], abs(float(factor[-1, -1]))
    return Target(base, tuple(effects), values, weight, factor[:-1, -1], "one-step", left)


def _check(base: BaseParameters, values: Tensor) -> None:
    if values.shape != (len(base),) or not bool(torch.isfinite(values).all()):
        raise TorchidError(
            "the base parameters do not belong to this robot and these effects, or are not finite.",
            got=f"{tuple(values.shape)} values, {int((~torch.isfinite(values)).sum())} not finite",
            expected=f"({len(base)},) finite values",
        )


@dataclass(frozen=True, eq=False)
class Problem:
    """What to search for, and where.

    Attributes:
        robot: the arm.
        target: base parameters and loss.
        bounds: of the search variables.
        conditions: on centres of mass and total mass, which the penalty gamma counts.
        box: (D, 2) lower and upper bounds of p.
    """

    robot: Robot
    target: Target
    bounds: Bounds
    conditions: Conditions
    box: Float[Tensor, "D 2"]

    @property
    def n(self) -> int:
        """Number of links."""
        return self.robot.n

    @property
    def size(self) -> int:
        """Number D of search variables: 10 n and one for each coefficient of an effect."""
        return int(self.box.shape[0])

    @property
    def non_negative(self) -> Bool[Tensor, " E"]:
        """(E,) coefficients of the effects that physics forbids to be negative."""
        effects = self.target.effects
        return torch.tensor([c.non_negative for e in effects for c in e.coefficients]).bool()

    def physical(self, unit: Float[Tensor, "*batch D"]) -> Float[Tensor, "*batch D"]:
        """p from the unit box: LB + (UB - LB) u, never outside by rounding."""
        low, high = self.box.to(unit).unbind(-1)
        return torch.clamp(low + (high - low) * unit, low, high)

    def unit(self, p: Float[Tensor, "*batch D"]) -> Float[Tensor, "*batch D"]:
        """u in the unit box from p."""
        low, high = self.box.to(p).unbind(-1)
        return ((p - low) / (high - low)).clamp(0.0, 1.0)

    def split(self, p: Float[Tensor, "*batch D"]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Masses (..., n), centres of mass (..., n, 3), inertias (..., n, 6), coefficients."""
        n = self.n
        mass, com, inertia, rest = p.split([n, 3 * n, 6 * n, self.size - 10 * n], -1)
        return mass, com.unflatten(-1, (n, 3)), inertia.unflatten(-1, (n, 6)), rest

    def parameters(self, p: Float[Tensor, "*batch D"]) -> InertialParameters:
        """Inertial parameters (..., n, 10) of search vectors."""
        return InertialParameters.from_com(*self.split(p)[:3])

    def vector(self, p: Float[Tensor, "*batch D"]) -> Float[Tensor, "*batch P"]:
        """All parameters in the grouping's order: the paper's stacking, then coefficients."""
        return torch.cat([self.parameters(p).to_paper_order(), self.split(p)[3]], -1)

    def sets(self, p: Float[Tensor, "K D"], ids: Sequence[str]) -> ParameterSets:
        """Search vectors as parameter sets."""
        return ParameterSets(tuple(ids), self.parameters(p), self.target.effects, self.split(p)[3])

    def residual(self, p: Float[Tensor, "*batch D"]) -> Float[Tensor, "*batch R"]:
        """W pi_R(p) - t (..., R); phi is its squared norm."""
        return self.residual_of_vector(self.vector(p))

    def residual_of_vector(self, x: Float[Tensor, "*batch P"]) -> Float[Tensor, "*batch R"]:
        """The residual of full parameter vectors, in which it is linear."""
        return x @ self.target.matrix.to(x).T - self.target.offset.to(x)

    def phi(self, p: Float[Tensor, "*batch D"]) -> Float[Tensor, "*batch"]:
        """The loss (2.28) or (2.29)."""
        return self.residual(p).square().sum(-1)


def extraction_problem(
    robot: Robot, target: Target, bounds: Bounds, conditions: Conditions
) -> Problem:
    """Put a problem together.

    Raises:
        TorchidError: base parameters of another robot, or an effect without bounds.
    """
    expected = 10 * robot.n_links + sum(len(e.coefficients) for e in target.effects)
    if len(target.base.parameter_names) != expected:
        raise TorchidError(
            f"the base parameters do not belong to robot '{robot.name}'.",
            got=f"sums over {len(target.base.parameter_names)} parameters",
            expected=f"{expected}: 10 a link and the effects' coefficients",
        )
    return Problem(robot, target, bounds, conditions, bounds.box(target.effects))


def with_coefficient_bounds(
    bounds: Bounds,
    base: BaseParameters,
    effects: Sequence[JointEffect],
    values: Float[Tensor, " B"],
) -> tuple[Bounds, tuple[str, ...]]:
    """Bounds with an interval for every coefficient of the effects, and the names of those added.

    A coefficient without bounds gets twice its identified size, from zero where physics forbids a
    negative one; one that the log determines in a sum only, twice what it would be if it were the
    whole sum. None gets less than a tenth of the largest of its kind, or 1e-3.
    """
    # The size of each parameter if it alone made up one of the sums that it is part of.
    grouping = base.grouping.abs().to(values)
    share = torch.where(visible(grouping), values.abs().unsqueeze(-1) / grouping, 0.0)
    size = share.amax(0)[base.n_rigid_parameters :].tolist()
    kinds = [(c, effect.joint) for effect in effects for c in effect.coefficients]
    added = tuple(dict.fromkeys(c.name for c, _ in kinds if c.name not in bounds.coefficients))
    extra = {}
    for name in added:
        own = {
            j: (v, c.non_negative) for (c, j), v in zip(kinds, size, strict=True) if c.name == name
        }
        least = max(1e-3, 0.1 * max(v for v, _ in own.values()))
        rows = torch.zeros(bounds.mass.shape[0], 2, dtype=bounds.mass.dtype)
        rows[:, 1] = 2 * least
        for joint, (value, non_negative) in own.items():
            high = 2 * max(value, least)
            rows[joint] = rows.new_tensor([0.0 if non_negative else -high, high])
        extra[name] = rows
    return replace(bounds, coefficients={**bounds.coefficients, **extra}), added


FAR_TORQUE = 0.05
"""Largest such difference of a joint from which a set's torque is said to be another one."""


def torque_error(problem: Problem, sets: ParameterSets) -> Float[torch.Tensor, "K n"]:
    """Root mean square over random states of the difference between each set's torque and that of
    the asked-for base parameters, over the latter's own: (K, n), 0.01 is 1 %.

    Base parameters that the log did not determine, which the loss does not read, do not count.
    """
    base, values = problem.target.base, problem.target.values
    rows = stacked_regressor(problem.robot, problem.target.effects, random_states(problem.robot))
    rows = rows[:, list(base.independent)]
    read = problem.target.weight.abs().sum(0) > 0
    change = (base.project(sets.vector) - values) * read

    def rms(beta: torch.Tensor) -> torch.Tensor:
        return (beta @ rows.T).unflatten(-1, (-1, problem.n)).square().mean(-2).sqrt()

    return rms(change) / rms(values * read).clamp(min=1e-300)
