"""One law for straight, hardening and counterbalance springs."""

import math

import pytest
import torch
from torch import Tensor

from torchid.effects.base import Motion
from torchid.effects.periodic import Cogging
from torchid.effects.spring import JointSpring, stumpff

CURVATURES = [-4.0, -1.0, -1e-5, 0.0, 1e-5, 0.3, 1.0, 2.0]


def along(q: Tensor) -> Motion:
    q = q.unsqueeze(-1)
    return Motion(q, torch.zeros_like(q), torch.zeros_like(q))


def columns(q: Tensor, curvature: float) -> Tensor:
    return JointSpring(0, curvature=curvature).columns(along(q))


def misfit(a: Tensor, tau: Tensor) -> float:
    """Part of the torque's size that the columns cannot make."""
    found = torch.linalg.lstsq(a, tau.unsqueeze(-1)).solution
    return float((tau - (a @ found).squeeze(-1)).norm() / tau.norm())


def test_a_straight_spring_pulls_to_its_rest_position() -> None:
    q = torch.tensor([0.2, 0.5, 1.2], dtype=torch.float64)
    torque = JointSpring(0).torque(along(q), [10.0, -5.0])
    torch.testing.assert_close(torque, 10.0 * (q - 0.5), rtol=1e-14, atol=1e-14)


@pytest.mark.parametrize("turns", [0.5, 3.0, 55.0, 1e4])
def test_springs_that_are_sought_have_torques_that_numbers_hold(turns: float) -> None:
    """On an axis that turns on none hardens: e to the number of radians, squared, is no number."""
    motion = along(2 * math.pi * turns * torch.linspace(-1, 1, 50, dtype=torch.float64))
    rows = JointSpring.grid([motion], 0, 8.0)
    assert 0.0 in rows
    assert 1.0 in rows
    assert bool((rows < 0).any()) == (turns < 4)
    for (curvature,) in rows.tolist():
        a = JointSpring(0, curvature=curvature).columns(motion)
        assert bool((a.mT @ a).isfinite().all())


def test_a_counterbalance_is_a_wave_of_one_period_a_turn() -> None:
    q = torch.linspace(-7, 7, 50, dtype=torch.float64)
    lever = 3.0 * torch.sin(q - 0.4)
    values = [3.0 * math.cos(0.4), -3.0 * math.sin(0.4)]
    found = JointSpring(0, curvature=1.0).torque(along(q), values)
    torch.testing.assert_close(found, lever, rtol=1e-13, atol=1e-13)
    torch.testing.assert_close(columns(q, 1.0), Cogging(0, k=1.0).columns(along(q)))


@pytest.mark.parametrize("curvature", CURVATURES)
def test_its_second_derivative_is_minus_curvature_times_itself(curvature: float) -> None:
    q = torch.linspace(-2, 2, 41, requires_grad=True, dtype=torch.float64)
    for k, at_zero in enumerate([(0, 1), (1, 0)]):
        column = columns(q, curvature)[:, k]
        (slope,) = torch.autograd.grad(column.sum(), q, create_graph=True)
        (bend,) = torch.autograd.grad(slope.sum(), q, materialize_grads=True)
        torch.testing.assert_close(bend, -curvature * column, rtol=1e-8, atol=1e-8)
        here = [float(x[20].detach()) for x in (column, slope)]
        assert here == pytest.approx(at_zero, abs=1e-14)


@pytest.mark.parametrize("x", [-1.0, 1.0])
def test_series_and_closed_forms_meet(x: float) -> None:
    inside, outside = (
        stumpff(torch.tensor(x * s, dtype=torch.float64)) for s in (0.999e-3, 1.001e-3)
    )
    for a, b, slope in zip(inside, outside, (-0.5, -1 / 6), strict=True):
        assert float(b - a) == pytest.approx(slope * x * 2e-6, rel=1e-3)


@pytest.mark.parametrize("curvature", CURVATURES)
def test_the_rest_position_needs_no_search(curvature: float) -> None:
    """A spring about any position is made of the same two columns."""
    q = torch.linspace(-1.5, 1.0, 80, dtype=torch.float64)
    shifted = columns(q - 0.7, curvature) @ torch.tensor([2.0, 0.0], dtype=torch.float64)
    assert misfit(columns(q, curvature), shifted) < 1e-11


@pytest.mark.parametrize(("rest", "k3"), [(0.0, 1.0), (0.3, 1.0), (-0.5, 3.0)])
def test_a_cubic_spring_is_nearly_a_hardening_one(rest: float, k3: float) -> None:
    q = torch.linspace(-1.5, 1.5, 200, dtype=torch.float64)
    tau = (q - rest) + k3 * (q - rest) ** 3
    low, high = JointSpring.shapes[0].low, JointSpring.shapes[0].high
    left = [
        misfit(columns(q, c), tau)
        for c in torch.linspace(low, high, 41, dtype=torch.float64).tolist()
    ]
    assert min(left) < 0.06
    assert min(left) < 0.2 * misfit(columns(q, 0.0), tau)


@pytest.mark.parametrize("curvature", JointSpring.shapes[0].grid)
def test_columns_are_well_conditioned_half_a_turn_away(curvature: float) -> None:
    a = columns(torch.linspace(2.6, 3.6, 100, dtype=torch.float64), curvature)
    assert float(torch.linalg.cond(a / a.norm(dim=0))) < 1e6
