"""Dahl's friction against its closed forms and its differential equation."""

import math

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from torch import Tensor

from torchid.effects.base import Motion
from torchid.effects.hysteresis import PreslidingHysteresis


def deflection(q: Tensor, length: float) -> Tensor:
    """z (T,) along positions (T,)."""
    q = q.unsqueeze(-1)
    zero = torch.zeros_like(q)
    return PreslidingHysteresis(0, length=length).columns(Motion(q, zero, zero))[:, 0]


def zigzag(amplitude: float, turns: int, each: int) -> Tensor:
    corners = torch.tensor(
        [0.0] + [amplitude * (-1.0) ** k for k in range(2 * turns + 1)], dtype=torch.float64
    )
    legs = [
        torch.linspace(float(a), float(b), each, dtype=torch.float64)[:-1]
        for a, b in corners.unfold(0, 2, 1)
    ]
    return torch.cat([*legs, corners[-1:]])


@pytest.mark.parametrize("ratio", [0.1, 1.0, 5.0])
def test_a_steady_loop_has_the_known_tip_and_area(ratio: float) -> None:
    """Between +-A the loop's tips are at tanh(A/L), and a turn takes 4 (A - L tanh(A/L))."""
    length, each = 0.2, 2001
    amplitude = ratio * length
    q = zigzag(amplitude, turns=40, each=each)
    z = deflection(q, length)
    turn = slice(len(q) - 2 * (each - 1) - 1, None)
    tip = math.tanh(ratio)
    assert float(z[-1]) == pytest.approx(tip, rel=1e-6)
    area = float(torch.trapezoid(z[turn], q[turn]))
    assert area == pytest.approx(4 * (amplitude - length * tip), rel=1e-4)
    assert area > 0


def test_it_solves_dahls_equation() -> None:
    length = 0.07

    def speed(t: float) -> float:
        return 0.5 * math.cos(3 * t) + 0.4 * math.cos(7 * t + 1)

    def slope(t: float, z: np.ndarray) -> np.ndarray:
        return (speed(t) - abs(speed(t)) * z) / length

    t = torch.linspace(0, 4, 4001, dtype=torch.float64)
    q = 0.5 / 3 * torch.sin(3 * t) + 0.4 / 7 * torch.sin(7 * t + 1)
    truth = solve_ivp(slope, (0, 4), [0.0], t_eval=t.numpy(), rtol=1e-10, atol=1e-12).y[0]
    # A step that holds a reversal misses its tip, by up to ddq dt^2 / 8 of travel: 2e-5 lengths.
    np.testing.assert_allclose(deflection(q, length).numpy(), truth, atol=3e-5)


def test_torque_depends_on_the_path_not_on_its_sampling() -> None:
    q = zigzag(0.1, turns=3, each=33)
    coarse = deflection(q[::32], 0.05)
    torch.testing.assert_close(coarse, deflection(q, 0.05)[::32], rtol=1e-12, atol=1e-12)


def test_it_never_exceeds_its_limit_and_rests_at_rest() -> None:
    q = torch.cat(
        [
            0.3 * torch.randn(500, dtype=torch.float64).cumsum(0),
            torch.full((50,), 7.0, dtype=torch.float64),
        ]
    )
    z = deflection(q, 0.01)
    assert float(z.abs().max()) <= 1.0
    assert torch.equal(z[501:], z[500].expand(49))


def test_an_empty_trajectory_has_no_rows() -> None:
    none = torch.zeros(0, 2, dtype=torch.float64)
    motion = Motion(none, none, none)
    assert PreslidingHysteresis(1).columns(motion).shape == (0, 1)


def test_reading_the_torque_is_no_step() -> None:
    one = torch.ones(3, 2, dtype=torch.float64)
    motion = Motion(one, one, one)
    state = 0.3 * one
    columns, after = PreslidingHysteresis.advance(
        motion, 0.0, state, torch.tensor(0.1, dtype=torch.float64)
    )
    assert torch.equal(columns[..., 0], state)
    assert after is not None
    assert torch.equal(after, state)


def test_a_length_must_be_positive() -> None:
    with pytest.raises(ValueError, match="positive"):
        PreslidingHysteresis(0, length=0.0)
