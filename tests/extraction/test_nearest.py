"""The nearest feasible set: feasible, cheap in torque, and never far without need."""

import pytest
import torch
from torch import Tensor

from tests.arms import arm, consistent_parameters, states
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Motion
from torchid.errors import TorchidError
from torchid.extraction.convex.nearest import LARGEST_CHANGE, nearest_feasible
from torchid.feasibility.conditions import conditions, physics_only
from torchid.feasibility.margins import feasibility
from torchid.feasibility.sets import ParameterSets, nominal_set
from torchid.identification.base_parameters import base_parameters
from torchid.robot.inertia import InertialParameters, six, symmetric
from torchid.robot.model import Robot


def rigid_sets(pi: Tensor) -> ParameterSets:
    return ParameterSets(
        tuple(str(k) for k in range(len(pi))),
        InertialParameters(pi),
        (),
        torch.zeros(len(pi), 0, dtype=torch.float64),
    )


def perturbed(robot: Robot, size: float, k: int, seed: int) -> ParameterSets:
    """Sets that are as a rule infeasible: each parameter off by a share of its own size."""
    assert robot.parameters is not None
    pi = robot.parameters.pi
    noise = torch.randn(
        k, *pi.shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64
    )
    return rigid_sets(pi + size * pi.abs() * noise)


def projected_per_link(parameters: InertialParameters, least: float) -> InertialParameters:
    """Each link's pseudo-inertia with its eigenvalues lifted: what is done without the torque."""
    values, vectors = torch.linalg.eigh(parameters.pseudo_inertia)
    p = vectors @ torch.diag_embed(values.clamp(min=least)) @ vectors.mT
    s = p[..., :3, :3]
    trace = s.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    j = six(trace * torch.eye(3, dtype=torch.float64) - s)
    return InertialParameters(torch.cat([p[..., 3, 3:], p[..., :3, 3], j], -1))


def torque_change(robot: Robot, a: InertialParameters, b: InertialParameters) -> Tensor:
    """(n,) root mean square over states, by recursive Newton-Euler."""
    q, dq, ddq = states(robot, 400, seed=3)
    tau = [inverse_dynamics(robot, q, dq, ddq, p) for p in (a, b)]
    return (tau[0] - tau[1]).square().mean(0).sqrt()


def test_the_reports_arm_becomes_feasible_at_less_cost_than_link_by_link() -> None:
    robot = arm("kuka_lwr4")
    given = nominal_set(robot)
    q, dq, ddq = states(robot, 400, seed=3)
    found = nearest_feasible(robot, given, motion=Motion(q, dq, ddq))
    assert found.status[0] in ("solved", "inexact")
    assert bool(found.feasible.all())
    assert feasibility(found.sets, physics_only(7)).reasons(0) == ()
    assert float(found.margin[0]) > 0.99e-6
    change = torque_change(robot, found.sets.parameters, given.parameters)
    torch.testing.assert_close(change, found.torque_change[0], rtol=1e-6, atol=1e-10)
    total = float(change.square().mean().sqrt())
    assert float(found.least[0]) <= total <= 1.0101 * float(found.least[0])
    other = projected_per_link(given.parameters, 1e-6)
    assert bool((other.consistency_margin() > 0).all())
    cost = torque_change(robot, other, given.parameters).square().mean().sqrt()
    assert total < 0.3 * float(cost)


@pytest.mark.parametrize("name", ["3r", "mixed", "panda"])
def test_feasible_sets_come_back(name: str) -> None:
    robot = arm(name)
    pi = consistent_parameters(robot.n, seed=2, batch=(3,)).pi
    found = nearest_feasible(robot, rigid_sets(pi))
    assert found.status == ("unchanged",) * 3
    assert torch.equal(found.sets.parameters.pi, pi)
    assert bool((found.torque_change == 0).all())
    assert bool(found.feasible.all())


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["mixed", "panda", "ur10e"])
def test_random_infeasible_sets(name: str) -> None:
    robot = arm(name)
    given = perturbed(robot, 0.8, 4, seed=0)
    assert not bool(feasibility(given, physics_only(robot.n)).feasible.any())
    motion = Motion(*states(robot, 400, seed=3))
    found = nearest_feasible(robot, given, motion=motion)
    assert bool(found.feasible.all())
    assert bool((found.margin > 0.9e-6).all())
    cost = found.torque_change.square().mean(-1).sqrt()
    assert bool((cost >= found.least).all())
    assert bool((cost <= 1.011 * found.least).all())
    projected = rigid_sets(projected_per_link(given.parameters, 1e-6).pi)
    for k in range(4):
        alone = nearest_feasible(robot, given.part([k]), motion=motion)
        assert torch.allclose(alone.sets.vector, found.sets.vector[k : k + 1], rtol=1e-9)
        a, b = projected.part([k]).parameters, given.part([k]).parameters
        assert float(cost[k]) < float(torque_change(robot, a, b).square().mean().sqrt())


def test_where_the_torque_can_be_kept_it_is() -> None:
    """Feasible sets moved along directions that no torque shows: there is a way back for free."""
    robot = arm("3r")
    g = base_parameters(robot).grouping
    null = torch.linalg.svd(g).Vh[len(g) :]
    x = nominal_set(robot).vector[0] + 0.5 * torch.randn(4, len(null), dtype=torch.float64) @ null
    given = rigid_sets(InertialParameters.from_paper_order(x).pi)
    assert not bool(feasibility(given, physics_only(3)).feasible.any())
    found = nearest_feasible(robot, given)
    assert bool(found.feasible.all())
    assert float(found.torque_change_relative.max()) < 1e-5


def test_the_second_stage_keeps_parameters_near() -> None:
    """With more torque to spend, parameters change less; never beyond what is allowed."""
    robot = arm("kuka_lwr4")
    given = nominal_set(robot)
    changes = []
    for slack in (0.001, 0.1, 1.0):
        found = nearest_feasible(robot, given, slack=slack)
        changes.append(float((found.sets.parameters.mass - given.parameters.mass).norm()))
        cost = float(found.torque_change.square().mean().sqrt())
        assert cost <= (1 + slack) * float(found.least[0]) * 1.001
    assert changes[0] > changes[1] > changes[2]
    assert changes[0] < LARGEST_CHANGE


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["kuka_lwr4_friction", "3r_friction"])
def test_conditions_and_signs_are_met(name: str) -> None:
    robot = arm(name)
    given = nominal_set(robot)
    vector = given.coefficients.clone()
    vector[0, :2] = -0.05
    given = ParameterSets(given.ids, given.parameters, given.effects, vector)
    asked = conditions(robot)
    found = nearest_feasible(robot, given, asked)
    assert found.sets.effects == given.effects
    assert bool(found.feasible.all())
    assert feasibility(found.sets, asked).reasons(0) == ()
    inertia = found.sets.parameters.inertia_about_com[0]
    assert float(found.sets.coefficients[0, :2].min()) >= 0
    assert bool((symmetric(inertia) == symmetric(inertia).mT).all())


def test_conditions_that_cannot_be_met_are_a_status() -> None:
    robot = arm("3r")
    asked = conditions(robot, total_mass=(1e-9, 2e-9))
    found = nearest_feasible(robot, perturbed(robot, 0.8, 2, seed=1), asked)
    assert found.status == ("infeasible",) * 2
    assert not bool(found.feasible.any())
    assert bool(torch.isnan(found.sets.vector).all())
    assert bool(torch.isnan(found.torque_change).all())


def test_bad_input() -> None:
    robot = arm("3r")
    given = nominal_set(robot)
    with pytest.raises(TorchidError, match="positive"):
        nearest_feasible(robot, given, margin=0.0)
    broken = rigid_sets(given.parameters.pi * torch.nan)
    with pytest.raises(TorchidError, match="not all numbers"):
        nearest_feasible(robot, broken)
