"""The torque error of sets, against the dynamics themselves."""

import pytest
import torch

from tests.extraction.setups import problem_of
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.extraction.problem import (
    extraction_problem,
    torque_error,
    two_step,
    with_coefficient_bounds,
)
from torchid.feasibility.bounds import read_bounds
from torchid.feasibility.sets import nominal_set
from torchid.identification.base_parameters import base_parameters, random_states
from torchid.identification.values import nominal_base
from torchid.robot.library import load_robot


@pytest.mark.parametrize("name", ["3r", "kuka_lwr4"])
def test_as_the_dynamics_say(name):
    problem = problem_of(name)
    generator = torch.Generator().manual_seed(3)
    u = torch.rand(4, problem.size, generator=generator, dtype=torch.float64)
    sets = problem.sets(problem.physical(u), ["a", "b", "c", "d"])
    states = random_states(problem.robot).state
    true = inverse_dynamics(problem.robot, *states)
    for k in range(4):
        own = inverse_dynamics(
            problem.robot, *states, sets.part([k]).to_robot(problem.robot, 0).parameters
        )
        expected = (own - true).square().mean(0).sqrt() / true.square().mean(0).sqrt()
        torch.testing.assert_close(torque_error(problem, sets)[k], expected, rtol=1e-9, atol=1e-12)


def test_the_nominal_set_has_none_and_unread_parameters_do_not_count():
    robot = load_robot("3r_friction")
    found = nominal_base(robot)
    problem = problem_of("3r_friction")
    assert float(torque_error(problem, nominal_set(robot)).max()) < 1e-13
    known = torch.ones(len(found.base), dtype=torch.bool)
    known[0] = False
    values = found.values.clone()
    values[0] = 0.0
    target = two_step(found.base, found.effects, values, known)
    blind = extraction_problem(robot, target, problem.bounds, problem.conditions)
    assert float(torque_error(blind, nominal_set(robot)).max()) < 1e-13


def test_a_coefficient_in_a_sum_may_be_the_whole_sum():
    """The torque tells rotor inertia 1 and the link's own apart in no motion of joint 1."""
    from torchid.effects.registry import on_every_joint

    robot = load_robot("3r")
    effects = on_every_joint(["rotor_inertia"], 3)
    base = base_parameters(robot, effects)
    assert "Ia1" in base.absorbed_effects()
    values = torch.ones(len(base), dtype=torch.float64)
    bounds, added = with_coefficient_bounds(read_bounds(robot, "normal"), base, effects, values)
    assert added == ("Ia",)
    assert bounds.coefficients["Ia"][0].tolist() == pytest.approx([0.0, 2.0])
    given, none = with_coefficient_bounds(bounds, base, effects, 5 * values)
    assert none == ()
    assert torch.equal(given.coefficients["Ia"], bounds.coefficients["Ia"])
