"""The ripple's period and phase."""

import math

import pytest
import torch

from torchid.effects.base import Motion
from torchid.effects.periodic import Cogging, MotorRipple, PositionDependentFriction, Wave


def ripple(q: torch.Tensor, k: float, values: list[float]) -> torch.Tensor:
    q = q.unsqueeze(-1)
    return Cogging(0, k=k).torque(Motion(q, q, q), values)


@pytest.mark.parametrize("k", [0.5, 12.0, 1000.0])
def test_it_repeats_after_a_period_and_flips_after_half(k: float) -> None:
    q, period = torch.linspace(-6, 6, 101, dtype=torch.float64), 2 * math.pi / k
    here = ripple(q, k, [0.3, -0.4])
    torch.testing.assert_close(ripple(q + period, k, [0.3, -0.4]), here, rtol=0, atol=1e-11)
    torch.testing.assert_close(ripple(q + period / 2, k, [0.3, -0.4]), -here, rtol=0, atol=1e-11)


def long_motion(travel: float = 3.0) -> Motion:
    """One joint there and back along its travel, faster and slower, under a load that changes."""
    t = torch.arange(0, 30, 0.01, dtype=torch.float64)
    q = travel / 2 * torch.sin(2 * math.pi * 0.1 * t + 0.8 * torch.sin(0.9 * t)).unsqueeze(-1)
    dq = torch.gradient(q, spacing=0.01, dim=0)[0]
    load = (3 + 2 * torch.sin(1.7 * t)).unsqueeze(-1)
    return Motion(q, dq, dq, t=t, torque=load)


WAVES = (Cogging, MotorRipple, PositionDependentFriction)


def test_a_wave_longer_than_the_travel_is_no_unevenness_of_friction() -> None:
    """It would stand for dry friction, of which it is a part there."""
    motion = long_motion(travel=1.4)
    grid = PositionDependentFriction.grid([motion], 0, 20.0).flatten()
    tried = PositionDependentFriction(0, k=float(grid[0])).finer([motion], 0, 20.0)
    assert tried is not None
    assert 2 * math.pi / float(tried.min()) <= 1.4 * (1 + 1e-3)


@pytest.mark.parametrize("kind", WAVES)
def test_grids_are_half_a_period_apart_over_the_travel_and_bounded(kind: type[Wave]) -> None:
    motion = long_motion()
    travel = float(motion.q.max() - motion.q.min())
    k = kind.grid([motion], 0, 1e6).flatten()
    assert len(k) == kind.most
    assert kind.most <= {"cogging": 120, "motor_ripple": 40}.get(kind.name, 12)
    torch.testing.assert_close(k.diff() * travel, torch.full_like(k[1:], math.pi))
    assert float(k[0]) * travel == pytest.approx(math.pi * kind.first)


def test_a_ripple_beyond_the_band_is_not_looked_for() -> None:
    motion = long_motion()
    speed = float(motion.dq.abs().median())
    for kind in (Cogging, MotorRipple):
        k = kind.grid([motion], 0, 1.0).flatten()
        assert 0 < len(k) < kind.most
        assert float(k[-1]) * 0.5 * speed <= 2 * math.pi * 1.0


@pytest.mark.parametrize("kind", WAVES)
def test_a_joint_at_rest_has_no_wave_numbers(kind: type[Wave]) -> None:
    still = long_motion()._replace(q=torch.zeros(3000, 1))
    assert kind.grid([still], 0, 8.0).shape == (0, 1)


@pytest.mark.parametrize("kind", WAVES)
@pytest.mark.parametrize("between", [0.0, 0.5])
def test_no_wave_is_lost_between_two_of_the_grid(kind: type[Wave], between: float) -> None:
    """The argument for half a period: midway between two wave numbers the nearer has three
    quarters of the energy, along an even travel; the next but one has hardly any."""
    q = torch.linspace(-1.5, 1.5, 2001).unsqueeze(-1)
    along = Motion(q, torch.ones_like(q), q, torque=torch.ones_like(q))
    grid = kind.grid([along], 0, 1e6).flatten()
    for first in (3, 8):
        k = float(grid[first] + between * (grid[first + 1] - grid[first]))
        wave = kind(0, k=k).torque(along, [1.0, 0.4])
        energies = []
        for step in (0, 2):
            x = kind(0, k=float(grid[first - step])).columns(along)
            fitted = x @ torch.linalg.lstsq(x, wave.unsqueeze(-1)).solution
            energies.append(float(fitted.square().sum() / wave.square().sum()))
        assert energies[0] > 0.75
        assert energies[1] < 0.2


@pytest.mark.parametrize("kind", WAVES)
def test_a_planted_wave_number_is_found_from_the_grid(kind: type[Wave]) -> None:
    """The best of the grid, then the best around it, ever finer."""
    motion = long_motion()
    true = 5.3 if kind is PositionDependentFriction else 24.7
    tau = kind(0, k=true).torque(motion, [0.3, -0.2])

    def best(shapes: torch.Tensor) -> float:
        left = []
        for k in shapes.flatten().tolist():
            x = kind(0, k=k).columns(motion)
            found = torch.linalg.lstsq(x, tau.unsqueeze(-1)).solution
            left.append(float((tau - (x @ found)[:, 0]).square().sum()))
        return float(shapes.flatten()[left.index(min(left))])

    k = best(kind.grid([motion], 0, 20.0))
    assert abs(k - true) < math.pi / 3
    for level in range(6):
        shapes = kind(0, k=k).finer([motion], level, 20.0)
        assert shapes is not None
        k = best(shapes)
    assert k == pytest.approx(true, abs=2e-3)


def test_motor_ripple_follows_the_load_and_uneven_friction_the_direction() -> None:
    q = torch.full((2, 1), 0.4)
    motion = Motion(q, torch.tensor([[1.0], [-1.0]]), q, torque=torch.tensor([[2.0], [6.0]]))
    phase = 7.0 * 0.4
    wave = 0.3 * math.sin(phase) - 0.4 * math.cos(phase)
    ripple = MotorRipple(0, k=7.0).torque(motion, [0.3, -0.4])
    friction = PositionDependentFriction(0, k=7.0).torque(motion, [0.3, -0.4])
    assert ripple.tolist() == pytest.approx([2 * wave, 6 * wave])
    assert friction.tolist() == pytest.approx([wave, -wave])
