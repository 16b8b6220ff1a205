"""Runs in the log-Cholesky parametrisation against the convex minimum."""

from dataclasses import replace
from functools import lru_cache

import pytest
import torch

from tests.arms import arm, consistent_parameters
from tests.marks import quick_first
from torchid.errors import TorchidError
from torchid.extraction.convex.certificate import certificate
from torchid.extraction.log_cholesky.extract import extract_log_cholesky
from torchid.extraction.log_cholesky.merit import along, link_p, link_x, theta_of
from torchid.extraction.penalty import gamma
from torchid.extraction.problem import Problem, extraction_problem, two_step
from torchid.feasibility.bounds import read_bounds
from torchid.feasibility.conditions import conditions
from torchid.feasibility.margins import feasibility
from torchid.feasibility.sets import nominal_set
from torchid.identification.base_parameters import base_parameters
from torchid.robot.inertia import second_moment


@lru_cache
def problem(name: str, group: str = "normal") -> Problem:
    robot = arm(name)
    sets = nominal_set(robot)
    base = base_parameters(robot, sets.effects)
    target = two_step(base, sets.effects, base.project(sets.vector[0]))
    return extraction_problem(robot, target, read_bounds(robot, group), conditions(robot))


def assert_inside(given: Problem, p: torch.Tensor) -> None:
    low, high = given.box.unbind(-1)
    assert bool(((p >= low) & (p <= high)).all())
    assert float(gamma(given, p).max()) == 0
    sets = given.sets(p, [str(k) for k in range(len(p))])
    found = feasibility(sets, given.conditions)
    assert bool(found.feasible.all()), [found.reasons(k) for k in range(len(p))]


def test_the_ten_numbers_are_the_link() -> None:
    parameters = consistent_parameters(5, seed=0, batch=(3,))
    theta = theta_of(parameters.mass, parameters.com, second_moment(parameters.inertia_about_com))
    p = torch.func.vmap(torch.func.vmap(link_p))(theta)
    torch.testing.assert_close(p[..., 0], parameters.mass)
    torch.testing.assert_close(p[..., 1:4], parameters.com)
    torch.testing.assert_close(p[..., 4:], parameters.inertia_about_com)
    torch.testing.assert_close(torch.func.vmap(torch.func.vmap(link_x))(p), parameters.pi)
    # The definition: P = U U'.
    a, d, s, t = theta[0, 0, 0], theta[0, 0, 1:4], theta[0, 0, 4:7], theta[0, 0, 7:]
    u = torch.eye(4, dtype=torch.float64)
    u[:3, :3] = torch.diag(d.exp())
    u[0, 1], u[0, 2], u[1, 2] = s
    u[:3, 3] = t
    u = a.exp() * u
    torch.testing.assert_close(u @ u.T, parameters.pseudo_inertia[0, 0])


def test_any_ten_numbers_are_a_body_and_no_body_has_none() -> None:
    theta = 2 * torch.randn(200, 3, 10, dtype=torch.float64)
    x = torch.func.vmap(torch.func.vmap(lambda t: link_x(link_p(t))))(theta)
    assert bool((x[..., 0] > 0).all())
    inertia = torch.func.vmap(torch.func.vmap(link_p))(theta)[..., 4:]
    eigenvalues = torch.linalg.eigvalsh(second_moment(inertia))
    assert bool((eigenvalues[..., 0] > -1e-12 * eigenvalues[..., 2]).all())
    flat = theta_of(
        torch.ones(1, 1, dtype=torch.float64),
        torch.zeros(1, 1, 3, dtype=torch.float64),
        -torch.eye(3, dtype=torch.float64).expand(1, 1, 3, 3),
    )
    assert bool(torch.isnan(flat).all())


def test_steps_are_straight_in_x() -> None:
    theta = 0.3 * torch.randn(4, 2, 10, dtype=torch.float64)
    turn = 0.1 * torch.randn(4, 2, 10, dtype=torch.float64)

    def x_of(t: torch.Tensor) -> torch.Tensor:
        return torch.func.vmap(torch.func.vmap(lambda one: link_x(link_p(one))))(t)

    ends = [
        x_of(along(theta, turn, torch.full((4,), h, dtype=torch.float64))) for h in (0.0, 0.1, 0.2)
    ]
    torch.testing.assert_close(ends[2] - ends[1], ends[1] - ends[0], atol=1e-12, rtol=1e-9)
    small = 1e-6
    rate = (x_of(theta + small * turn) - x_of(theta - small * turn)) / (2 * small)
    torch.testing.assert_close((ends[1] - ends[0]) / 0.1, rate, atol=1e-7, rtol=1e-6)


@pytest.mark.parametrize(
    ("name", "group"),
    quick_first([("3r", "normal"), ("3r", "tight"), ("3r", "loose")], 1, several=True),
)
def test_a_feasible_target_is_reproduced(name: str, group: str) -> None:
    given = problem(name, group)
    found = extract_log_cholesky(given, runs=5, seed=1)
    assert bool(found.converged.all())
    assert float(found.phi.max()) <= 1e-18
    assert_inside(given, found.p)


@pytest.mark.nightly
def test_sets_of_equal_torque_differ_with_their_starts() -> None:
    given = problem("3r")
    found = extract_log_cholesky(given, runs=4, seed=1, centring=0.01)
    assert bool(found.converged.all())
    assert float(found.phi.max()) <= 1e-18
    assert float(given.unit(found.p).std(0).mean()) > 0.02
    assert_inside(given, found.p)


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["kuka_lwr4", "kuka_lwr4_friction"])
def test_every_start_ends_at_the_least_loss(name: str) -> None:
    given = problem(name)
    found = extract_log_cholesky(given, runs=4, seed=0)
    least = certificate(given, explain=False).phi_min
    assert bool(found.converged.all())
    assert bool((found.phi >= least).all())
    assert float(found.phi.max()) <= 1.001 * least
    assert_inside(given, found.p)


@pytest.mark.nightly
def test_inertia_bounds_that_matter_are_kept() -> None:
    """Where the certificate's relaxation is not exact, runs end between its two figures or at the
    upper, whose set keeps away from flat links."""
    given = problem("kuka_lwr4", "tight_corrected")
    bound = certificate(given, explain=False, with_conditions=False)
    found = extract_log_cholesky(given, runs=3, seed=0, with_conditions=False)
    low, high = given.box.unbind(-1)
    assert bool(((found.p >= low) & (found.p <= high)).all())
    assert bool((found.phi >= bound.phi_min).all())
    assert float(found.phi.min()) <= 1.01 * bound.phi_strict


@pytest.mark.nightly
def test_shapes_and_total_mass_are_kept() -> None:
    given = problem("3r")
    asked = conditions(arm("3r"), shapes=True, total_mass=(5.0, 6.0))
    given = replace(given, conditions=asked)
    found = extract_log_cholesky(given, runs=4, seed=2)
    assert_inside(given, found.p)
    total = given.parameters(found.p).mass.sum(-1)
    assert bool(((total > 5.0) & (total < 6.0)).all())
    assert float(found.phi.max()) <= 1e-18


@pytest.mark.nightly
def test_one_bad_start_leaves_the_others_alone() -> None:
    given = problem("3r")
    start = given.physical(
        torch.rand(3, given.size, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    )
    alone = extract_log_cholesky(given, start[:1])
    start[1] = torch.nan
    start[2] = 1e6
    found = extract_log_cholesky(given, start)
    assert found.converged.tolist() == [True, False, True]
    assert bool(torch.isnan(found.p[1]).all())
    assert bool(torch.isnan(found.phi[1]))
    # Where the torque decides nothing, the last steps follow the rounding of the batch.
    assert float((given.unit(found.p[:1]) - given.unit(alone.p)).abs().max()) < 5e-3
    assert float(found.phi[2]) <= 1e-18


@pytest.mark.nightly
def test_the_same_seed_gives_the_same_sets() -> None:
    given = problem("3r")
    a, b = (extract_log_cholesky(given, runs=2, seed=5, steps=8) for _ in range(2))
    assert torch.equal(a.p, b.p)
    assert a.steps == 8
    assert not bool(a.converged.any())


def test_bad_input() -> None:
    with pytest.raises(TorchidError, match="no room") as caught:
        extract_log_cholesky(problem("kuka_lwr4", "loose"))
    assert "com_7z" in str(caught.value)
    with pytest.raises(TorchidError, match="search vectors"):
        extract_log_cholesky(problem("3r"), torch.zeros(2, 7, dtype=torch.float64))
    with pytest.raises(TorchidError, match="at least one"):
        extract_log_cholesky(problem("3r"), runs=0)
