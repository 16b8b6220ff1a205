"""Bodies near to the nominal ones: the minimum against a conic solver's, its slopes against
automatic derivatives, and what physics and a person ask of them."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.arms import arm
from tests.marks import quick_first
from torchid.extraction.entropic import (
    Quadratic,
    Room,
    _Question,
    nearest_bodies,
    response,
    room_of,
)
from torchid.robot.inertia import InertialParameters, pseudo_inertia_basis
from torchid.robot.model import Robot
from torchid.typing import Tensor


def asked(
    robot: Robot, pi: Tensor, rank: int, seed: int = 0, weight: float = 1.0, second: float = -1.0
) -> Quadratic:
    """Torque of parameters and of two coefficients, 1 and a second one (-1, which physics forbids),
    that sees some of their combinations, with noise."""
    g = torch.Generator().manual_seed(seed)
    count = pi.numel() + 2
    size = torch.cat([pi.flatten().abs() + 0.05, torch.ones(2)]).double()
    seen = torch.randn(rank, count, generator=g, dtype=torch.float64) / size
    a = seen.repeat(6, 1)
    x = torch.cat([pi.flatten().double(), torch.tensor([1.0, second])])
    y = a @ x + torch.randn(len(a), generator=g, dtype=torch.float64) / weight
    return Quadratic(a.T @ a, a.T @ y, float(y @ y), torch.eye(2).double())


def heavier(robot: Robot, factor: float) -> Tensor:
    return factor * robot.require_parameters("a test").pi.double()


@pytest.mark.parametrize("name", ["3r", "mixed"])
@pytest.mark.parametrize("bounded", [True, False])
def test_slopes_are_the_functions(name, bounded):
    robot = arm(name)
    room = room_of(robot)
    room = room if bounded else room.bodies_alone
    torque = asked(robot, heavier(robot, 1.2), 12)
    sums = torch.tensor([[1.0, 0.0], [0.5, 2.0]], dtype=torch.float64)
    question = _Question.of(replace(torque, positive=sums), room)
    g = torch.Generator().manual_seed(1)
    x = question.start * (1 + 0.02 * torch.rand(question.start.shape, generator=g).double())
    gradient, hessian = question.slopes(x, 0.3)
    for k in torch.randperm(len(x), generator=g)[:8].tolist():
        h = 1e-6 * max(1e-3, abs(float(x[k])))
        step = torch.zeros_like(x)
        step[k] = h
        up, down = question.value(x + step, 0.3), question.value(x - step, 0.3)
        assert (up - down) / (2 * h) == pytest.approx(float(gradient[k]), rel=1e-4, abs=1e-5)
        rise = (question.slopes(x + step, 0.3)[0] - question.slopes(x - step, 0.3)[0]) / (2 * h)
        torch.testing.assert_close(
            rise, hessian[k], rtol=1e-4, atol=1e-4 * float(hessian.abs().max())
        )


@pytest.mark.parametrize("strength", [1.0, 1e-3])
def test_the_minimum_is_that_of_a_conic_solver(strength):
    """The same function, written as it stands in the module's head, given to CVXPY."""
    cp = pytest.importorskip("cvxpy")
    robot = arm("3r")
    room = room_of(robot).bodies_alone
    torque = asked(robot, heavier(robot, 1.3), 20)
    torque = replace(torque, positive=torch.zeros(0, 2).double())
    question = _Question.of(torque, room)
    mine = question.start
    for value in (1.0, 0.1, 0.01, 1e-3):
        mine = question.minimum(mine, value) if value >= strength else mine
    x = cp.Variable(len(mine))
    root = np.linalg.cholesky(torque.h.numpy() / question.unit + 1e-7 * np.eye(len(mine)))
    value = cp.sum_squares(root.T @ x) / 2 - (torque.b.numpy() / question.unit) @ x
    basis = pseudo_inertia_basis().numpy()
    for k in range(robot.n):
        near = InertialParameters(room.nominal[k] + room.small[k]).pseudo_inertia.numpy()
        small = InertialParameters(room.small[k]).pseudo_inertia.numpy()
        inner = np.linalg.inv(np.linalg.cholesky(near))
        p = sum(x[10 * k + a] * (inner @ basis[a] @ inner.T) for a in range(10))
        both = p + inner @ small @ inner.T
        value += strength * (cp.trace(both) - cp.log_det(both))
        value -= (strength * 1e-3 + 1e-6) * cp.log_det(p - 1e-3 * inner @ small @ inner.T)
    cp.Problem(cp.Minimize(value)).solve(solver=cp.CLARABEL)
    assert x.value is not None
    theirs = torch.from_numpy(np.asarray(x.value))
    found, other = question.value(mine, strength), question.value(theirs, strength)
    assert found == pytest.approx(other, rel=1e-4)
    torch.testing.assert_close(mine, theirs, rtol=0.02, atol=0.02)


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["3r", "kuka_lwr4", "mixed"])
def test_what_the_torque_shows_is_found_and_the_rest_stays_nominal(name):
    robot = arm(name)
    true = heavier(robot, 1.0)
    true[-1] *= 1.4
    torque = asked(robot, true, 40 * robot.n, weight=100.0, second=0.5)
    assert (rough := nearest_bodies(torque, room_of(robot).bodies_alone)).error < 1.02 * rough.least
    found = nearest_bodies(torque, room_of(robot).bodies_alone, spent=1e-4)
    assert found.strength <= rough.strength
    assert float(found.pi[-1, 0] / robot.require_parameters("a test").pi[-1, 0]) == pytest.approx(
        1.4, rel=0.1
    )
    assert found.coefficients.tolist() == pytest.approx([1.0, 0.5], abs=0.05)
    # What physics forbids is next to nothing, and never negative.
    wrong = nearest_bodies(asked(robot, true, 40 * robot.n), room_of(robot).bodies_alone)
    assert 0 < float(wrong.coefficients[1]) < 0.05
    # Of a sum that is forbidden the one may be negative where the other makes up for it.
    sums = torch.tensor([[1.0, 0.0], [1.0, 2.0]], dtype=torch.float64)
    wrong = replace(asked(robot, true, 40 * robot.n), positive=sums)
    first, second = nearest_bodies(wrong, room_of(robot).bodies_alone).coefficients.tolist()
    assert -0.6 < second < -0.4 < 0.8 < first
    blind = nearest_bodies(replace(torque, h=0 * torque.h, b=0 * torque.b), room_of(robot))
    nominal = robot.require_parameters("a test").pi.double()
    assert float((blind.pi[:, 0] / nominal[:, 0] - 1).abs().max()) < 0.05


@pytest.mark.parametrize("factor", [0.1, 10.0, -1.0])
@pytest.mark.parametrize("name", quick_first(["3r", "ur10e"], 1))
def test_bodies_stay_bodies_and_believable_whatever_the_torque_asks(name, factor):
    robot = arm(name)
    torque = asked(robot, heavier(robot, factor), 40 * robot.n, weight=1e3)
    room = room_of(robot)
    found = nearest_bodies(torque, room)
    parameters, nominal = InertialParameters(found.pi), InertialParameters(room.nominal)
    # Off the boundary: a fifth of the nominal body is in each, along any direction.
    held = InertialParameters(found.pi - room.nominal / 5 - 1e-3 * room.small)
    assert bool((held.consistency_margin() > 0).all())
    alone = nearest_bodies(torque, room.bodies_alone)
    held = InertialParameters(alone.pi - 1e-3 * room.small)
    assert bool((held.consistency_margin() > 0).all())
    ratio = parameters.mass / torch.maximum(nominal.mass, InertialParameters(room.small).mass)
    assert bool((ratio < 2.0).all())
    assert bool((parameters.mass > 0.49 * nominal.mass).all())
    # Who is asked for ten times the mass says where it stops.
    walls = {10.0: "mass of link 2 (upper)", 0.1: "mass of link 2 (lower)"}
    assert factor not in walls or walls[factor] in room.touched(found.pi)
    assert room.touched(room.nominal) == room.bodies_alone.touched(found.pi) == ()
    # Bodies alone come nearer to what is asked.
    assert alone.least < found.least


@pytest.mark.nightly
def test_a_nominal_robot_that_is_none_has_a_room_all_the_same():
    robot = arm("3r")
    pi = heavier(robot, 1.0)
    pi[1, 4:] *= -1
    pi[2] = 0
    room = room_of(robot.with_parameters(InertialParameters(pi)))
    assert isinstance(room, Room)
    found = nearest_bodies(asked(robot, heavier(robot, 1.0), 32, weight=10.0), room)
    assert bool((InertialParameters(found.pi).consistency_margin() > 0).all())
    bare = nearest_bodies(
        asked(robot, heavier(robot, 1.0), 32, weight=10.0), room_of(replace(robot, parameters=None))
    )
    assert bool((InertialParameters(bare.pi).consistency_margin() > 0).all())


def test_a_further_torque_adds_what_the_response_says():
    robot = arm("3r")
    torque = asked(robot, heavier(robot, 1.1), 16)
    room = room_of(robot)
    found = nearest_bodies(torque, room)
    g = torch.Generator().manual_seed(2)
    pull = 1e-4 * torque.b.norm() * (torque.h @ torch.randn(32, generator=g).double())
    pull = pull / pull.norm() * 1e-4 * torque.b.norm()
    x = torch.cat([found.pi.flatten(), found.coefficients])
    question = _Question.of(torque, room)
    question = question.about(x)
    moved = replace(question, torque=replace(torque, b=torque.b + pull))
    after = moved.minimum(x, found.strength)
    before = question.minimum(x, found.strength)
    seen = torque.h.diagonal().sqrt()
    left = (seen * (after - before - response(torque, room, found, pull))).norm()
    assert float(left) < 0.05 * float((seen * (after - before)).norm())
