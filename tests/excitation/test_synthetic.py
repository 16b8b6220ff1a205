import math
from dataclasses import replace

import pytest
import torch

from tests.excitation.test_excitation import random_arm
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Motion
from torchid.errors import LogError, RobotError, TorchidError
from torchid.excitation.synthetic import (
    HonestNoise,
    PaperNoise,
    nominal_torque,
    synthetic_log,
)
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.log.model import Log
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot
from torchid.simulation.sensors import ENCODER_STEP

ROBOT = load_robot("3r_friction")
PLAN = trajectory_log(random_trajectory(ROBOT, 0, count=2, duration=20.0), 500.0)


def rms(x: torch.Tensor) -> torch.Tensor:
    return x.square().mean(0).sqrt()


def test_without_noise_it_is_the_model():
    log = synthetic_log(ROBOT, PLAN)
    assert torch.equal(log.q, PLAN.q)
    assert torch.equal(log.ddq, PLAN.ddq)
    rigid = inverse_dynamics(ROBOT, PLAN.q, PLAN.dq, PLAN.ddq)
    viscous, coulomb, offset = (
        torch.tensor([r[key] for r in ROBOT.effects if key in r], dtype=torch.float64)
        for key in ("Fv", "Fc", "F0")
    )
    friction = viscous * PLAN.dq + coulomb * torch.sign(PLAN.dq) + offset
    assert torch.allclose(log.tau, rigid + friction, atol=1e-12, rtol=0)
    assert log.names == PLAN.names
    assert log.source == "simulated 3r_friction"


def test_a_delay_of_the_robots_own():
    """The product's own corrected model: effects that need the time are simulated, too."""
    late = replace(ROBOT, effects=({"effect": "time_delay", "joint": 2, "delay": 0.004},))
    log, rigid = (synthetic_log(r, PLAN).tau[:, 1] for r in (late, replace(ROBOT, effects=())))
    inside = slice(10, 9000)
    assert torch.allclose(log[inside], rigid[8:8998], atol=2e-3 * float(rigid.std()))
    noisy = synthetic_log(late, PLAN, PaperNoise(60.0))
    assert noisy.samples == log.shape[0]


def test_the_papers_noise_is_in_the_trajectory():
    log = synthetic_log(ROBOT, PLAN, PaperNoise(30.0), seed=1)
    expected = nominal_torque(ROBOT, Motion(log.q, log.dq, log.ddq))
    assert torch.allclose(log.tau, expected, atol=1e-12, rtol=0)
    for rows in PLAN.slices():
        for name in ("q", "dq", "ddq"):
            true, noisy = getattr(PLAN, name)[rows], getattr(log, name)[rows]
            snr = 20 * torch.log10(rms(true) / rms(noisy - true))
            assert (snr - 30.0).abs().max() < 0.3


def test_honest_positions_are_counted():
    log = synthetic_log(ROBOT, PLAN, HonestNoise(), seed=1)
    assert log.dq is None
    assert log.ddq is None
    steps = log.q / ENCODER_STEP
    assert (steps - steps.round()).abs().max() < 1e-6
    assert (log.q - PLAN.q).abs().max() <= ENCODER_STEP / 2 * (1 + 1e-6)
    # Rounding is uniform over a step.
    assert float(rms((log.q - PLAN.q).flatten())) == pytest.approx(
        ENCODER_STEP / math.sqrt(12), rel=0.03
    )


def test_honest_torque_is_that_of_the_true_motion_and_noise():
    true = synthetic_log(ROBOT, PLAN).tau
    log = synthetic_log(ROBOT, PLAN, HonestNoise(torque_relative=0.02), seed=3)
    for rows in PLAN.slices():
        level = rms((log.tau - true)[rows]) / rms(true[rows])
        assert (level / 0.02 - 1).abs().max() < 0.03


def test_measured_velocities():
    exact = synthetic_log(ROBOT, PLAN, HonestNoise(include_velocity=True), seed=0)
    assert torch.equal(exact.dq, PLAN.dq)
    noisy = synthetic_log(
        ROBOT, PLAN, HonestNoise(include_velocity=True, velocity_relative=0.05), seed=0
    )
    rows = PLAN.slices()[1]
    level = rms((noisy.dq - PLAN.dq)[rows]) / rms(PLAN.dq[rows])
    assert (level / 0.05 - 1).abs().max() < 0.03


def test_steps_of_each_joint():
    noise = HonestNoise(encoder_step=(0.0, 0.1, 0.01), torque_relative=0.0)
    log = synthetic_log(ROBOT, PLAN, noise)
    assert torch.equal(log.q[:, 0], PLAN.q[:, 0])
    for j, step in ((1, 0.1), (2, 0.01)):
        counts = log.q[:, j] / step
        assert (counts - counts.round()).abs().max() < 1e-9
    assert torch.allclose(log.tau, synthetic_log(ROBOT, PLAN).tau, atol=1e-12, rtol=0)


def test_coloured_noise_has_its_level_and_spectrum():
    cutoff, rate = 20.0, 500.0
    noise = HonestNoise(torque_relative=0.01, colour_hz=cutoff)
    true = synthetic_log(ROBOT, PLAN).tau
    excess = []
    for seed in range(6):
        log = synthetic_log(ROBOT, PLAN, noise, seed)
        for rows in PLAN.slices():
            excess.append(((log.tau - true)[rows] / (0.01 * rms(true[rows])))[:8192].T)
    x = torch.cat(excess)
    assert float(x.square().mean()) == pytest.approx(1.0, rel=0.05)
    assert float(x[:, 0].square().mean()) == pytest.approx(1.0, rel=0.7), "stationary at once"
    phi = math.exp(-2 * math.pi * cutoff / rate)
    assert float((x[:, 1:] * x[:, :-1]).mean()) == pytest.approx(phi, rel=0.05)
    power = torch.fft.rfft(x).abs().square().mean(0) / x.shape[1]
    f = torch.fft.rfftfreq(x.shape[1], 1 / rate)
    expected = (1 - phi**2) / (1 + phi**2 - 2 * phi * torch.cos(2 * math.pi * f / rate))
    for low, high in ((1, 10), (15, 25), (50, 100), (150, 240)):
        band = (f > low) & (f < high)
        assert float(power[band].mean() / expected[band].mean()) == pytest.approx(1, abs=0.12)


def test_noise_is_that_of_the_seed():
    for noise in (PaperNoise(), HonestNoise(), HonestNoise(colour_hz=10.0)):
        first, again, other = (synthetic_log(ROBOT, PLAN, noise, seed) for seed in (2, 2, 3))
        assert torch.equal(first.tau, again.tau)
        assert torch.equal(first.q, again.q)
        assert not torch.equal(first.tau, other.tau)


def test_a_prismatic_robot():
    bare = random_arm(5, "PRP")
    pi = torch.rand((3, 10), generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    robot = bare.with_parameters(InertialParameters(pi))
    plan = trajectory_log(random_trajectory(robot, 0), 100)
    log = synthetic_log(robot, plan, HonestNoise(encoder_step=(1e-6, ENCODER_STEP, 1e-6)))
    assert log.tau.shape == (2001, 3)
    assert (log.q - plan.q)[:, 0].abs().max() <= 0.51e-6


def test_what_does_not_fit_is_named():
    with pytest.raises(RobotError, match="no inertial parameters, which simulation needs"):
        synthetic_log(ROBOT.with_parameters(None), PLAN)
    with pytest.raises(LogError, match="does not fit robot 'kuka_lwr4'"):
        synthetic_log(load_robot("kuka_lwr4"), PLAN)
    with pytest.raises(LogError, match="no ddq, from which torque is computed"):
        synthetic_log(ROBOT, replace(PLAN, ddq=None))
    with pytest.raises(TorchidError, match="one encoder step, or one a joint"):
        synthetic_log(ROBOT, PLAN, HonestNoise(encoder_step=(1e-3, 1e-3)))
    with pytest.raises(TorchidError, match="above half the sampling rate"):
        synthetic_log(ROBOT, PLAN, HonestNoise(colour_hz=400.0))
    for wrong in ({"torque_relative": -0.1}, {"encoder_step": math.nan}, {"colour_hz": 0.0}):
        with pytest.raises(TorchidError):
            HonestNoise(**wrong)
    with pytest.raises(TorchidError, match="signal-to-noise"):
        PaperNoise(math.inf)


def test_other_signals_of_the_motion_are_left_behind():
    plan = replace(PLAN, tau=PLAN.q, current=PLAN.q)
    log = synthetic_log(ROBOT, plan, HonestNoise())
    assert isinstance(log, Log)
    assert list(log.signals) == ["q", "tau"]
