"""The losses of an extraction against the regressor and the log they stand for."""

from dataclasses import replace
from functools import lru_cache

import pytest
import torch

from tests.arms import arm, relative, states
from tests.extraction.setups import BUILT_IN, base_of, problem_of, random_vectors
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.dynamics.regressor import regressor
from torchid.effects.base import Motion
from torchid.errors import TorchidError
from torchid.excitation.synthetic import HonestNoise, synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.extraction.problem import (
    Target,
    extraction_problem,
    one_step,
    two_step,
    with_coefficient_bounds,
)
from torchid.feasibility.bounds import read_bounds
from torchid.feasibility.conditions import conditions
from torchid.feasibility.sets import nominal_set
from torchid.identification.identify import identify
from torchid.identification.result import Identification
from torchid.identification.settings import Settings
from torchid.log.model import Log
from torchid.robot.inertia import InertialParameters


@pytest.mark.parametrize("name", BUILT_IN)
def test_residual_is_the_distance_of_the_base_parameters(name: str) -> None:
    """G pi(p) - beta, with J = I + m (c'c E - c c') written out link by link."""
    p = problem_of(name)
    n = p.n
    for q in random_vectors(p, 3):
        mass, com, inertia = q[:n], q[n : 4 * n].reshape(n, 3), q[4 * n : 10 * n].reshape(n, 6)
        tensors = []
        for m, c, (xx, xy, xz, yy, yz, zz) in zip(mass, com, inertia, strict=True):
            i = torch.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz]).reshape(3, 3)
            j = i + m * (c @ c * torch.eye(3, dtype=torch.float64) - torch.outer(c, c))
            tensors.append(torch.stack([j[0, 0], j[0, 1], j[0, 2], j[1, 1], j[1, 2], j[2, 2]]))
        moments = (mass.unsqueeze(-1) * com).flatten()
        pi = torch.cat([mass, moments, torch.stack(tensors).flatten(), q[10 * n :]])
        expected = base_of(name).grouping @ pi - p.target.values
        torch.testing.assert_close(p.residual(q), expected, rtol=1e-12, atol=1e-13)
        torch.testing.assert_close(p.phi(q), expected @ expected, rtol=1e-12, atol=0)


@pytest.mark.parametrize("name", ["3r", "kuka_lwr4"])
def test_loss_is_zero_where_torques_are_equal(name: str) -> None:
    """The nominal set, and it moved along the null space of the regressor: Newton-Euler sees no
    difference, and neither does phi."""
    p, robot = problem_of(name), arm(name)
    sets = nominal_set(robot)
    motion = states(robot, 200)
    y = regressor(robot, *motion).flatten(0, 1)
    null = torch.linalg.svd(y, full_matrices=True)[2][len(base_of(name)) :]
    x = sets.vector[0] + 0.1 * torch.randn(5, len(null), dtype=torch.float64) @ null
    assert float(p.residual_of_vector(x).square().sum(-1).max()) < 1e-24
    assert float(p.phi(sets.search_vector).max()) < 1e-24
    tau = inverse_dynamics(robot, *motion)
    moved = robot.with_parameters(InertialParameters.from_paper_order(x[0]))
    torch.testing.assert_close(inverse_dynamics(moved, *motion), tau, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", BUILT_IN)
def test_unit_box_and_back(name: str) -> None:
    p = problem_of(name)
    u = torch.rand(20, p.size, dtype=torch.float64)
    assert relative(p.unit(p.physical(u)), u) < 1e-12
    low, high = p.box.unbind(-1)
    assert torch.equal(p.physical(torch.zeros(p.size, dtype=torch.float64)), low)
    torch.testing.assert_close(
        p.physical(torch.ones(p.size, dtype=torch.float64)), high, rtol=1e-15, atol=1e-16
    )
    inside = p.physical(u)
    assert bool(((inside >= low) & (inside <= high)).all())
    assert p.unit(high + 1.0).tolist() == [1.0] * p.size
    assert torch.equal(p.physical(torch.full((p.size,), 1.0 + 1e-9, dtype=torch.float64)), high)


@pytest.mark.parametrize("name", BUILT_IN)
def test_sets_and_search_vectors_are_two_forms_of_one(name: str) -> None:
    p = problem_of(name)
    q = random_vectors(p, 4)
    sets = p.sets(q, ["a", "b", "c", "d"])
    assert sets.ids == ("a", "b", "c", "d")
    assert sets.effects == nominal_set(arm(name)).effects
    torch.testing.assert_close(sets.search_vector, q, rtol=1e-9, atol=1e-12)
    torch.testing.assert_close(sets.vector, p.vector(q), rtol=1e-13, atol=1e-15)
    torch.testing.assert_close(sets.parameters.com, p.split(q)[1], rtol=1e-12, atol=1e-14)


# ---- the one-step loss ----------------------------------------------------------------------


@lru_cache
def identified(name: str, noise: bool) -> tuple[Log, Identification]:
    robot = arm(name)
    motion = trajectory_log(random_trajectory(robot, 1, count=2, duration=4.0), 50.0)
    log = synthetic_log(robot, motion)
    if noise:
        g = torch.Generator().manual_seed(2)
        assert log.tau is not None
        log = log.replace(
            tau=log.tau + torch.randn(log.tau.shape, generator=g, dtype=torch.float64)
        )
    effects = tuple(dict.fromkeys(str(e["effect"]) for e in robot.effects))
    chosen = Settings(effects=effects, cutoff=None, reversal=0.0, rows="all", method="ols")
    return log, identify(robot, log, settings=chosen)


def log_target(result: Identification) -> Target:
    return one_step(result.base, result.effects, result.values, result.factor)


@pytest.mark.parametrize("noise", [False, True])
@pytest.mark.parametrize("name", ["3r", "3r_friction"])
def test_one_step_loss_is_that_of_the_log(name: str, noise: bool) -> None:
    """|| Y pi - tau ||^2 less its minimum, with Y made here, sample by sample."""
    log, result = identified(name, noise)
    robot = arm(name)
    p = extraction_problem(
        robot, log_target(result), read_bounds(robot, "normal"), conditions(robot)
    )
    motion = Motion(log.q, log.dq, log.ddq)
    y = regressor(robot, log.q, log.dq, log.ddq)
    for effect in result.effects:
        wide = torch.zeros(*y.shape[:-1], len(effect.coefficients), dtype=torch.float64)
        wide[:, effect.joint] = effect.columns(motion)
        y = torch.cat([y, wide], -1)
    rows, tau = y.flatten(0, 1), log.tau.flatten()
    # A full-rank copy of the columns: base parameters reproduce every torque.
    columns = rows[:, list(result.base.independent)]
    found = torch.linalg.lstsq(columns, tau.unsqueeze(-1)).solution.squeeze(-1)
    least = (columns @ found - tau).square().sum()
    for q in random_vectors(p, 4):
        loss = (rows @ p.vector(q) - tau).square().sum()
        torch.testing.assert_close(p.phi(q), loss - least, rtol=1e-6, atol=1e-9)
    nominal = p.phi(nominal_set(robot).search_vector)
    assert float(nominal) < (1e-1 if noise else 1e-12) * float(tau.square().sum())


@pytest.mark.parametrize("name", ["3r_friction", "ur10e"])
def test_one_step_loss_is_the_same_in_both_bases(name: str) -> None:
    """What a log says of physical parameters does not depend on which combinations were fitted."""
    robot = arm(name)
    log = synthetic_log(
        robot, trajectory_log(random_trajectory(robot, 3, fill=True), 50.0), HonestNoise(), 1
    )
    targets = []
    for basis in ("report", "conditioned"):
        settings = Settings(cutoff=None, effects=("viscous_friction",), method="ols", basis=basis)
        found = identify(robot, log, settings=settings)
        targets.append(one_step(found.base, found.effects, found.values, found.factor))
    g = torch.Generator().manual_seed(0)
    x = torch.randn(5, targets[0].matrix.shape[1], generator=g, dtype=torch.float64)
    one, two = ((x @ t.matrix.T - t.offset).square().sum(-1) for t in targets)
    torch.testing.assert_close(one, two, rtol=1e-9, atol=0)


def test_both_losses_are_least_at_the_identified_values() -> None:
    _, result = identified("3r", False)
    for target in (log_target(result), two_step(result.base, result.effects, result.values)):
        at = (target.weight @ result.values - target.offset).square().sum()
        assert float(at) < 1e-16
        for k in range(len(result.base)):
            step = torch.zeros(len(result.base), dtype=torch.float64)
            step[k] = 1e-3
            moved = target.weight @ (result.values + step) - target.offset
            assert float(moved.square().sum()) > float(at)


def test_coefficients_that_are_not_known_ask_for_nothing() -> None:
    base, values = base_of("3r"), problem_of("3r").target.values
    known = torch.ones(len(base), dtype=torch.bool)
    known[[2, 7]] = False
    some = two_step(base, (), values, known)
    q = random_vectors(problem_of("3r"), 5)
    one = replace(problem_of("3r"), target=some)
    whole = problem_of("3r").residual(q).square()
    torch.testing.assert_close(one.phi(q), whole[:, known].sum(-1), rtol=1e-12, atol=0)


def test_bounds_made_for_coefficients() -> None:
    """Twice each one's size; from 0 where physics forbids less."""
    base, p = base_of("3r_friction"), problem_of("3r_friction")
    effects, values = p.target.effects, p.target.values
    bare = read_bounds(arm("3r"), "normal")
    bounds, added = with_coefficient_bounds(bare, base, effects, values)
    assert added == ("Fv", "Fc", "F0")
    viscous = torch.tensor([[0.0, 2 * v] for v in (0.0665, 0.1987, 0.0399)], dtype=torch.float64)
    torch.testing.assert_close(bounds.coefficients["Fv"], viscous)
    offsets = torch.tensor([[-2 * v, 2 * v] for v in (0.1073, 0.1566, 0.0686)], dtype=torch.float64)
    torch.testing.assert_close(bounds.coefficients["F0"], offsets)
    # One that was held at zero keeps room: a tenth of the largest of its kind.
    held = values.clone()
    held[base.names.index("Fv1")] = 0.0
    assert with_coefficient_bounds(bare, base, effects, held)[0].coefficients["Fv"][0, 1] == (
        pytest.approx(2 * 0.01987)
    )
    own, none = with_coefficient_bounds(p.bounds, base, effects, values)
    assert none == ()
    assert torch.equal(own.box(effects), p.box)
    assert bounds.box(effects).shape == p.box.shape


# ---- what is refused ------------------------------------------------------------------------


def test_base_parameters_of_another_robot_are_refused() -> None:
    robot, other = arm("3r"), problem_of("kuka_lwr4").target
    with pytest.raises(TorchidError, match="do not belong to robot '3r'") as caught:
        extraction_problem(robot, other, read_bounds(robot, "normal"), conditions(robot))
    assert "70" in str(caught.value)
    assert "30" in str(caught.value)


@pytest.mark.usefixtures("types_unchecked")
@pytest.mark.parametrize("bad", ["nan", "inf", "short", "long", "matrix"])
def test_targets_that_are_none_are_refused(bad: str) -> None:
    base = base_of("3r")
    values = torch.ones(len(base), dtype=torch.float64)
    if bad in ("nan", "inf"):
        values[3] = float(bad)
    shaped = {
        "short": values[1:],
        "long": torch.ones(16, dtype=torch.float64),
        "matrix": values.unsqueeze(0),
    }
    with pytest.raises(TorchidError, match="not finite"):
        two_step(base, (), shaped.get(bad, values))


@pytest.mark.usefixtures("types_unchecked")
@pytest.mark.parametrize("bad", ["nan value", "nan factor", "another robot"])
def test_factors_that_are_none_are_refused(bad: str) -> None:
    base = base_of("3r")
    size = len(base) + (3 if bad == "another robot" else 1)
    values, factor = (
        torch.ones(len(base), dtype=torch.float64),
        torch.eye(size, dtype=torch.float64),
    )
    if bad == "nan value":
        values[0] = torch.nan
    if bad == "nan factor":
        factor[0, 3] = torch.nan
    with pytest.raises(TorchidError, match="not finite"):
        one_step(base, (), values, factor)
