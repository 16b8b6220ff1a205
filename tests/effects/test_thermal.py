"""Warming: nothing at first, all of it after many time constants."""

import math

import pytest
import torch

from torchid.effects.base import Motion
from torchid.effects.friction import CoulombFriction, ViscousFriction
from torchid.effects.friction_laws import ThermalFrictionDrift


def motion(t: torch.Tensor, *batch: int) -> Motion:
    dq = torch.randn(*batch, 2, dtype=torch.float64)
    return Motion(dq, dq, dq, t=t)


def test_it_starts_at_nothing_and_ends_as_friction() -> None:
    state = motion(torch.tensor([0.0, 20.0, 1e6], dtype=torch.float64), 3)
    found = ThermalFrictionDrift(1, T=20.0).torque(state, [-0.2, -0.7])
    full = ViscousFriction(1).torque(state, [-0.2]) + CoulombFriction(1).torque(state, [-0.7])
    share = torch.tensor([0.0, 1 - 1 / math.e, 1.0], dtype=torch.float64)
    torch.testing.assert_close(found, share * full, rtol=1e-14, atol=1e-14)


def test_short_logs_show_the_slope_only() -> None:
    state = motion(torch.linspace(0, 1, 20, dtype=torch.float64), 20)
    for constant in (1e4, 2e4):
        slope = constant * ThermalFrictionDrift(0, T=constant).columns(state)[:, 1]
        expected = state.t * torch.sign(state.dq[:, 0])
        torch.testing.assert_close(slope, expected, rtol=1e-4, atol=0)


def test_it_needs_time_and_a_time_constant() -> None:
    state = motion(torch.tensor(0.0, dtype=torch.float64))._replace(t=None)
    with pytest.raises(ValueError, match="thermal_friction_drift needs the motion's t"):
        ThermalFrictionDrift(0).columns(state)
    with pytest.raises(ValueError, match="positive"):
        ThermalFrictionDrift(0, T=0.0)
