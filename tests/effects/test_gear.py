"""Links behind gears against scipy's integration of the two masses."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.effects.two_masses import INERTIA, driven, gear_torque, pendulum
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.backlash import Backlash
from torchid.effects.gear import Driven, Gear, joint_load, link_lag, link_lags
from torchid.effects.phase import JointElasticity
from torchid.log.filtering import ZeroPhaseFilter

RATE = 250.0


@pytest.mark.parametrize("hertz", [5.0, 9.0, 25.0])
def test_an_elastic_joint_rings_as_it_does(tmp_path: Path, hertz: float) -> None:
    robot = pendulum(tmp_path)
    motion, at = driven([0.4, 0.1, 0.01], [0.3, 1.1, 6.0], 6.0, RATE)
    assert motion.t is not None
    gear = Gear.ringing(INERTIA, hertz, 0.05)
    true = gear_torque(at, motion.t, float(gear.stiffness[0]), float(gear.damping[0]))
    rigid = inverse_dynamics(robot, *motion.state)[:, 0]
    effect = JointElasticity(0, at=1 / float(gear.stiffness[0]), damping=float(gear.damping[0]))
    found = effect.all_torques(motion._replace(torque=rigid.unsqueeze(1)), [effect.at], robot)[:, 0]
    later = motion.t > 3.0
    assert float((true - rigid)[later].norm()) > 0.01 * float(rigid[later].norm())
    assert float((true - rigid - found)[later].norm()) < 0.04 * float((true - rigid)[later].norm())


@pytest.mark.parametrize(("play", "share"), [(0.002, 0.3), (0.02, 0.2)])
def test_a_play_is_crossed_as_it_is(tmp_path: Path, play: float, share: float) -> None:
    """Below 8 Hz, where a fit looks, and below 20 Hz, where its impacts are heard. One landing on
    the small play grazes the flank, and how it bounces depends on the last digits."""
    robot = pendulum(tmp_path)
    motion, at = driven([1.9, 0.6], [0.25, 0.7], 8.0, RATE, centre=math.pi / 2)
    assert motion.t is not None
    gear = Gear.ringing(INERTIA, 20.0, 0.1)
    true = gear_torque(at, motion.t, float(gear.stiffness[0]), float(gear.damping[0]), play)
    rigid = inverse_dynamics(robot, *motion.state)[:, 0]
    effect = Backlash(0, at=play, contact=20.0, ratio=0.1, drag=0.1)
    found = effect.all_torques(motion, [play], robot)[:, 0]
    assert float(rigid.sign().diff().abs().sum()) > 4
    for band in (8.0, 20.0):
        low = ZeroPhaseFilter(RATE, band)
        before, after = (low.apply(x)[100:-100] for x in (true - rigid, true - rigid - found))
        assert float(after.norm()) < share * float(before.norm())


def test_a_flank_pushes_and_does_not_pull(tmp_path: Path) -> None:
    """However it is damped, the link leaves the flank where the load changes its sign."""
    robot = pendulum(tmp_path)
    motion, _ = driven([1.9], [0.25], 8.0, RATE, centre=math.pi / 2)
    assert motion.t is not None
    load, column = (x[:, None] for x in joint_load(robot, motion.state, 0))
    for ratio in (0.05, 0.5, 2.0):
        gear = Gear.ringing(INERTIA, 40.0, ratio, 0.02)
        lag = link_lag(load, column[..., 0], motion.t, gear)
        transmitted = load - column[..., 0] * lag.acceleration
        flying = lag.angle.abs() < 0.009
        # In flight nothing is handed on; on a flank its sign is the flank's.
        assert float(transmitted[flying].abs().max()) < 0.02 * float(load.abs().max())
        on = lag.angle.abs() > 0.0101
        wrong = (transmitted * lag.angle.sign())[on] < -0.05 * float(load.abs().max())
        assert float(wrong.double().mean()) < 0.01


def test_gears_side_by_side_are_gears_alone(tmp_path: Path) -> None:
    robot = pendulum(tmp_path)
    motion, _ = driven([0.8, 0.3], [0.4, 1.3], 5.0, RATE)
    assert motion.t is not None
    load, column = joint_load(robot, motion.state, 0)
    torch.testing.assert_close(column[:, 0], torch.full_like(load, INERTIA))
    torch.testing.assert_close(load, inverse_dynamics(robot, *motion.state)[:, 0])
    for plays in ([0.0, 0.0], [1e-3, 1e-2]):
        together = Gear.ringing(INERTIA, [8.0, 20.0], [0.05, 0.1], plays)
        both = link_lag(load[:, None], column[:, :1], motion.t, together)
        for k in range(2):
            own = Gear(*(x[k : k + 1] for x in together))
            alone = link_lag(load[:, None], column[:, :1], motion.t, own)
            # Steps are as fine as the stiffest gear needs.
            for x, y in zip(both, alone, strict=True):
                torch.testing.assert_close(
                    x[:, k], y[:, 0], rtol=0.05, atol=0.05 * float(y.abs().max())
                )


def test_a_joint_that_no_body_has_stays_finite() -> None:
    t = torch.arange(500, dtype=torch.float64) / RATE
    gear = Gear.ringing(1.0, [5.0, 20.0], 0.1, [0.0, 0.01])
    lag = link_lag(torch.sin(5 * t)[:, None], torch.cos(t)[:, None], t, gear)
    assert all(bool(torch.isfinite(x).all()) for x in lag)
    assert lag.angle.shape == (500, 2)
    assert np.isfinite(gear.stiffness).all()


def test_swings_side_by_side_are_swings_alone(tmp_path: Path) -> None:
    """And the shapes that are tried hold the true one: resonance and damping."""
    robot = pendulum(tmp_path)
    motion, at = driven([0.4, 0.1, 0.01], [0.3, 1.1, 6.0], 6.0, RATE)
    assert motion.t is not None
    rigid = inverse_dynamics(robot, *motion.state)
    motion = motion._replace(torque=rigid)
    gear = Gear.ringing(INERTIA, 9.0, 0.05)
    compliance, damping = 1 / float(gear.stiffness[0]), float(gear.damping[0])
    tried = JointElasticity(0, at=1.5 * compliance).sharp()
    columns = list(JointElasticity.columns_of(tried, motion, robot))
    for e, column in list(zip(tried, columns, strict=True))[::20]:
        torch.testing.assert_close(column, e.torque_columns(motion, robot))
    true = gear_torque(at, motion.t, 1 / compliance, damping) - rigid[:, 0]
    left = [
        float((true - e.at * x[:, 0, 0])[500:].norm()) for e, x in zip(tried, columns, strict=True)
    ]
    best = tried[int(np.argmin(left))]
    assert abs(math.log(best.at / compliance)) < math.log(1.2)
    assert abs(math.log(best.damping / damping)) < math.log(2.1)
    finer = best.around(0, 0.01)
    assert {e.joint for e in finer} == {0}
    assert len(finer) == 8
    assert JointElasticity(0).around(0, 0.01) == []


def test_links_of_several_joints_are_those_of_each() -> None:
    """With and without play, of light and of heavy links: other steps of integration."""
    t = torch.arange(0, 1.5, 0.004, dtype=torch.float64)
    load, inertia = torch.sin(9 * t)[:, None], 0.5 + 0.2 * torch.cos(t)[:, None]
    gears = [
        Gear.ringing(0.5, [20.0, 30.0], 0.1, [1e-3, 2e-3], 0.1),
        Gear.ringing(0.5, 8.0, 0.2),
        Gear.ringing(0.5, [20.0, 25.0, 30.0], 0.1, 5e-4, 0.1),
        Gear.ringing(0.5, 60.0, 0.1, 1e-3, 0.1),
    ]
    links = [
        Driven((k + 1) * load, inertia if k < 2 else inertia.expand(-1, len(g.play)), t, g)
        for k, g in enumerate(gears)
    ]
    # One more along another trajectory.
    links.append(Driven(-load[:250], inertia[:250], 10 + t[:250], gears[0]))
    for found, link in zip(link_lags(links), links, strict=True):
        alone = link_lag(*link)
        assert all(map(torch.equal, found, alone))
        assert len(found.angle) == len(link.t)
    assert not torch.equal(link_lags(links)[0].angle[:, :1], link_lags(links)[1].angle)
