"""What sensors make of a true motion: effects, noise, jitter, decimation."""

import math

import pytest
import torch

from tests.simulation.bodies import bare, effect, reference
from torchid.effects.base import Motion
from torchid.effects.registry import model_torque, nominal_effects
from torchid.errors import LogError, TorchidError
from torchid.log.model import Log
from torchid.robot.model import Robot
from torchid.simulation.sensors import HonestNoise, Sensors, measured_log, sensed_log

EXACT = HonestNoise(encoder_step=0.0, torque_relative=0.0, include_velocity=True)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return bare("3r")


@pytest.fixture(scope="module")
def true(robot: Robot) -> Log:
    log = reference(robot, 4.0)
    tau = model_torque(robot, nominal_effects(robot), Motion(log.q, log.dq, log.ddq, t=log.t))
    return log.replace(tau=tau)


def test_exact_sensors_change_nothing(robot: Robot, true: Log) -> None:
    seen = measured_log(robot, true, [], Sensors(EXACT))
    assert torch.equal(seen.q, true.q)
    assert torch.equal(seen.dq, true.dq)
    assert torch.equal(seen.tau, true.tau)
    assert seen.names == true.names


def test_effects_in_the_sensors_show_and_those_of_the_arm_do_not(robot: Robot, true: Log) -> None:
    law = [
        effect(robot, "coulomb_friction", joint=1, Fc=5.0),
        effect(robot, "torque_gain", joint=2, gain=0.1),
        effect(robot, "encoder_offset", joint=3, offset=0.05),
        effect(robot, "time_delay", joint=3, delay=0.004),
    ]
    seen = sensed_log(robot, true, law)
    assert torch.allclose(seen.tau[:, 1], 1.1 * true.tau[:, 1])
    assert torch.allclose(seen.q[:, 2], true.q[:, 2] - 0.05)
    # Two samples at 500 Hz.
    assert torch.allclose(seen.tau[10:-10, 2], true.tau[8:-12, 2], atol=1e-12)
    assert torch.equal(seen.tau[:, 0], true.tau[:, 0])


def test_the_clock_of_effects_starts_with_each_trajectory(robot: Robot, true: Log) -> None:
    late = true.replace(t=true.t + 1000.0)
    law = [effect(robot, "dropped_samples", joint=1, hold=1.0, rate=2.0, length=0.05, seed=3)]
    two = sensed_log(robot, Log.concatenate([true, late]), law)
    first, second = two.trajectories()
    assert torch.allclose(first.tau, second.tau, atol=1e-9)
    assert float((first.tau - true.tau)[:, 0].abs().max()) > 1e-3


def test_torque_noise_has_the_given_size(robot: Robot, true: Log) -> None:
    sensors = Sensors(HonestNoise(encoder_step=0.0), torque_std=(0.1, 0.2, 0.4))
    noise = measured_log(robot, true, [], sensors, seed=1).tau - true.tau
    assert torch.allclose(
        noise.std(0), torch.tensor([0.1, 0.2, 0.4], dtype=torch.float64), rtol=0.1
    )
    coloured = Sensors(HonestNoise(encoder_step=0.0, colour_hz=10.0), torque_std=0.1)
    slow = (measured_log(robot, true, [], coloured, seed=1).tau - true.tau)[:, 0]
    correlation = float((slow[1:] * slow[:-1]).mean() / slow.square().mean())
    assert correlation == pytest.approx(math.exp(-2 * math.pi * 10 / 500), abs=0.05)


def test_every_other_sample_is_kept(robot: Robot, true: Log) -> None:
    seen = measured_log(robot, true, [], Sensors(EXACT, every=5))
    assert torch.equal(seen.t, true.t[::5])
    assert torch.equal(seen.q, true.q[::5])


def test_jitter_moves_the_instants_and_the_stamps_say_so(robot: Robot, true: Log) -> None:
    seen = measured_log(robot, true, [], Sensors(EXACT, jitter=2e-4), seed=2)
    (steps,) = seen.steps
    assert steps.shortest < 1.8e-3 < 2.2e-3 < steps.longest
    # The motion 1 - cos in closed form, at the instants that the stamps name.
    period = torch.linspace(0.9, 1.7, 3, dtype=torch.float64)
    w = 2 * math.pi / period
    start = torch.linspace(-0.4, 0.5, 3, dtype=torch.float64)
    exact = start + 0.8 / w * (1 - torch.cos(w * seen.t.unsqueeze(-1)))
    assert float((seen.q - exact)[2:-2].abs().max()) < 1e-6


def test_the_log_is_a_function_of_the_seed(robot: Robot, true: Log) -> None:
    a, b, c = (measured_log(robot, true, [], Sensors(), seed=s).tau for s in (1, 1, 2))
    assert torch.equal(a, b)
    assert not torch.equal(a, c)


def test_errors(robot: Robot, true: Log) -> None:
    with pytest.raises(LogError, match="q, dq, ddq and tau"):
        measured_log(robot, true.replace(tau=None), [], Sensors())
    with pytest.raises(TorchidError, match="torque noise"):
        measured_log(robot, true, [], Sensors(torque_std=(0.1, 0.2)))
    with pytest.raises(TorchidError, match="negative"):
        Sensors(jitter=-1.0)
