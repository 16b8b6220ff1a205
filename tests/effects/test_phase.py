"""Delays against exact shifts of analytic signals, elasticity against Pinocchio's torque of the
deflected arm."""

import math

import numpy as np
import pytest
import torch

from tests.arms import arm
from tests.effects.exact_logs import EDGE, closed, gap, order, smooth_motion
from tests.oracles import PinocchioOracle
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Motion
from torchid.effects.instants import derivative, shifted
from torchid.effects.phase import FilterLag, JointElasticity, TimeDelay
from torchid.effects.registry import effect_torque
from torchid.log.filtering import ZeroPhaseFilter

RATE = 500.0
T = torch.arange(1000, dtype=torch.float64) / RATE


def wave(t: torch.Tensor, hertz: float = 5.0) -> torch.Tensor:
    return torch.stack([torch.sin(2 * math.pi * hertz * t), torch.cos(3 + 9 * t)], -1)


@pytest.mark.parametrize("by", [0.004, -0.0053, 0.0001, -0.021])
def test_shift_of_analytic_signals(by: float) -> None:
    inner = slice(20, -20)
    torch.testing.assert_close(
        shifted(wave(T), T, by)[inner], wave(T + by)[inner], rtol=0, atol=1e-8
    )


def test_shift_by_whole_samples_is_exact_and_ends_are_held() -> None:
    x = torch.randn(50, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    t = T[:50]
    back = shifted(x, t, -3 / RATE)
    torch.testing.assert_close(back[3:], x[:-3])
    torch.testing.assert_close(back[:4], x[:1].expand(4, 3))


@pytest.mark.parametrize("samples", [0, 1, 2, 4])
def test_short_records(samples: int) -> None:
    x = torch.ones(samples, 2, dtype=torch.float64)
    torch.testing.assert_close(shifted(x, T[:samples], 0.01), x)
    torch.testing.assert_close(derivative(x, T[:samples]), 0 * x)


def test_derivative_of_analytic_signals() -> None:
    expected = 10 * math.pi * torch.cos(10 * math.pi * T)
    found = derivative(wave(T), T)[:, 0]
    torch.testing.assert_close(found[2:-2], expected[2:-2], rtol=0, atol=2e-5 * 10 * math.pi)


@pytest.mark.parametrize("delay", [0.002, 0.0075])
def test_delay_of_an_analytic_torque(delay: float) -> None:
    motion = Motion(wave(T), wave(T), wave(T), t=T, torque=wave(T))
    late = TimeDelay(0).measured(motion, [delay]).torque
    assert late is not None
    inner = slice(20, -20)
    torch.testing.assert_close(late[inner, 0], wave(T - delay)[inner, 0], rtol=0, atol=1e-8)
    assert torch.equal(late[:, 1], wave(T)[:, 1])
    exact = TimeDelay(0, at=delay).torque_columns(motion)[..., 0] * delay
    torch.testing.assert_close(motion.torque + exact, late)


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        (TimeDelay(1), [0.004]),
        (FilterLag(at=1e-5), [0.004]),
        (JointElasticity(1, at=1e-8), [2e-5]),
    ],
    ids=lambda x: getattr(x, "name", ""),
)
def test_rest_is_of_second_order(effect, values) -> None:
    assert closed(effect, arm("panda"), values) < 0.06
    assert order(effect, arm("panda"), values) == pytest.approx(2, abs=0.1)


def test_secant_of_the_elasticity_at_its_compliance_is_of_third_order() -> None:
    robot = arm("panda")
    rests = []
    for compliance in (2e-4, 1e-4):
        _, after = gap(JointElasticity(1, at=compliance), robot, [compliance])
        rests.append(float(after.square().mean().sqrt()))
    assert math.log2(rests[0] / rests[1]) == pytest.approx(3, abs=0.2)


def test_elasticity_against_pinocchio() -> None:
    robot = arm("kuka_lwr4")
    motion = smooth_motion(robot, 400)
    assert motion.torque is not None
    c, joint = 1e-7, 1
    load = c * motion.torque[:, joint].numpy()
    rate = np.gradient(load, 1e-3, edge_order=2)
    state = [x.clone() for x in motion.state]
    lags = (load, rate, np.gradient(rate, 1e-3, edge_order=2))
    for x, lag in zip(state, lags, strict=True):
        x[:, joint] -= torch.from_numpy(lag)
    oracle = PinocchioOracle(robot)
    slope = (oracle.inverse_dynamics(*state) - oracle.inverse_dynamics(*motion.state)) / c
    column = JointElasticity(joint, at=c).torque_columns(motion, robot)[..., 0]
    inner = slice(EDGE, -EDGE)
    difference = (column - slope)[inner].abs().max()
    assert difference < 2e-4 * slope[inner].abs().max()


@pytest.mark.parametrize("at", [1e-5, 3e-4])
def test_encoder_noise_does_not_grow_in_the_secant(at: float) -> None:
    """White noise of 0.02 mrad in the wide band, seen in the band of a fit."""
    robot, rate = arm("panda"), 240.0
    clean = smooth_motion(robot, 3000, rate)
    assert clean.t is not None
    g = torch.Generator().manual_seed(0)
    noise = 2e-5 * torch.randn(clean.q.shape, generator=g, dtype=torch.float64)
    q = clean.q + ZeroPhaseFilter(rate, 40.0).apply(noise.T.contiguous()).T
    dq = derivative(q, clean.t)
    ddq = derivative(dq, clean.t)
    torque = inverse_dynamics(robot, q, dq, ddq)
    noisy = clean._replace(q=q, dq=dq, ddq=ddq, torque=torque)
    low = ZeroPhaseFilter(rate, 8.0)
    columns = [
        low.apply(JointElasticity(1, at=at).torque_columns(m, robot)[..., 0].T.contiguous())
        for m in (clean, noisy)
    ]
    inner = slice(100, -100)
    difference = (columns[1] - columns[0])[:, inner].norm() / columns[0][:, inner].norm()
    assert float(difference) < 0.05


def test_stiff_joint_needs_no_care() -> None:
    """An estimate at its bound of zero still has a column."""
    robot = arm("3r")
    motion = smooth_motion(robot, 100)
    column = JointElasticity(1, at=0.0).torque_columns(motion, robot)
    near = JointElasticity(1, at=1e-9).torque_columns(motion, robot)
    torch.testing.assert_close(column, near, rtol=1e-3, atol=1e-2)


def test_elastic_joint_under_load_sags_and_keeps_its_torque() -> None:
    robot = arm("panda")
    true = smooth_motion(robot)
    log = JointElasticity(3).measured(true, [1e-4])
    assert true.torque is not None
    assert log.torque is true.torque
    torch.testing.assert_close(log.q[:, 3] - true.q[:, 3], 1e-4 * true.torque[:, 3])
    torch.testing.assert_close(
        derivative(log.q, log.t)[EDGE:-EDGE], log.dq[EDGE:-EDGE], rtol=0, atol=1e-6
    )


def test_torque_is_taken_from_the_model_in_the_second_round() -> None:
    robot = arm("3r")
    motion = smooth_motion(robot, 60)
    rigid = motion.torque
    assert rigid is not None
    effects = [(TimeDelay(1), [0.01])]
    found = effect_torque(robot, effects, motion._replace(torque=None), rigid)
    torch.testing.assert_close(found, TimeDelay(1).torque_columns(motion)[..., 0] * 0.01)


def test_what_is_missing_is_named() -> None:
    robot = arm("3r")
    motion = smooth_motion(robot, 10)
    with pytest.raises(ValueError, match="filter_lag needs the motion's t"):
        FilterLag().torque_columns(motion._replace(t=None), robot)
    with pytest.raises(ValueError, match="joint_elasticity needs the robot"):
        JointElasticity(0).torque_columns(motion)
