"""Tilt, gains, offsets and geometry against Pinocchio's torque of the changed arm."""

import math
from dataclasses import replace

import pytest
import torch

from tests.arms import QUICK_ARMS, arm
from tests.effects.exact_logs import closed, gap, order, smooth_motion
from tests.oracles import PinocchioOracle
from torchid.effects.gravity import (
    BaseTilt,
    EncoderOffset,
    KinematicError,
    TorqueCrosstalk,
    TorqueGain,
)
from torchid.effects.registry import effect_from_record
from torchid.errors import RobotError

SMALL = 1e-4
every_arm = pytest.mark.parametrize("name", QUICK_ARMS)


@every_arm
@pytest.mark.parametrize(
    "effect", [BaseTilt(), KinematicError(0), KinematicError(2)], ids=lambda e: f"{e.name}"
)
def test_columns_are_derivatives_of_pinocchios_torque(name: str, effect) -> None:
    robot = arm(name)
    motion = smooth_motion(robot, 30)
    columns = effect.torque_columns(motion, robot)
    for k in range(len(effect.coefficients)):
        torques = []
        for sign in (1, -1):
            values = [0.0] * len(effect.coefficients)
            values[k] = sign * SMALL
            plant = PinocchioOracle(effect.plant(robot, values))
            torques.append(plant.inverse_dynamics(*motion.state))
        slope = (torques[0] - torques[1]) / (2 * SMALL)
        torch.testing.assert_close(columns[..., k], slope, rtol=1e-5, atol=1e-5)


@every_arm
def test_encoder_offset_is_a_secant_of_pinocchios_torque(name: str) -> None:
    robot = arm(name)
    motion = smooth_motion(robot, 30)
    oracle = PinocchioOracle(robot)
    for at in (0.03, -0.08):
        q = motion.q.clone()
        q[:, 1] += at
        change = oracle.inverse_dynamics(q, motion.dq, motion.ddq)
        change = change - oracle.inverse_dynamics(*motion.state)
        column = EncoderOffset(1, at).torque_columns(motion, robot)[..., 0]
        torch.testing.assert_close(at * column, change, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        (BaseTilt(), [0.02, -0.03]),
        (EncoderOffset(1, 1e-6), [0.03]),
        (KinematicError(2), [0.002, -0.003, 0.001, 0.01, -0.02]),
    ],
    ids=lambda x: getattr(x, "name", ""),
)
@pytest.mark.parametrize("name", ["panda", "mixed"])
def test_rest_is_of_second_order(name: str, effect, values) -> None:
    assert closed(effect, arm(name), values) < 0.06
    assert order(effect, arm(name), values) == pytest.approx(2, abs=0.15)


@pytest.mark.parametrize("offset", [0.05, -0.2])
def test_encoder_offset_is_exact_where_its_secant_is(offset: float) -> None:
    assert closed(EncoderOffset(1, offset), arm("panda"), [offset]) < 1e-10


@pytest.mark.parametrize(
    ("effect", "value"), [(TorqueGain(1), 0.1), (TorqueCrosstalk(2, 1), -0.05)]
)
def test_torque_sensors_are_linear_and_disturb_one_joint(effect, value: float) -> None:
    robot = arm("panda")
    before, after = gap(effect, robot, [value])
    assert after.abs().max() < 1e-12 * before.abs().max()
    others = [j for j in range(robot.n) if j != effect.joint]
    assert before[:, effect.joint].abs().max() > 0.1
    assert before[:, others].abs().max() < 1e-12


def test_gain_and_crosstalk_scale_the_torque() -> None:
    motion = smooth_motion(arm("3r"), 10)
    assert motion.torque is not None
    gained = TorqueGain(1).measured(motion, [0.1]).torque
    assert gained is not None
    torch.testing.assert_close(gained[:, 1], 1.1 * motion.torque[:, 1])
    mixed = TorqueCrosstalk(0, 2).measured(motion, [0.1]).torque
    assert mixed is not None
    torch.testing.assert_close(mixed[:, 0], motion.torque[:, 0] + 0.1 * motion.torque[:, 2])


def test_tilt_turns_gravity_about_base_axes() -> None:
    robot = arm("panda")
    tilted = BaseTilt().plant(robot, [0.1, 0.0]).gravity
    assert tilted.tolist() == pytest.approx([0.0, 9.81 * math.sin(0.1), -9.81 * math.cos(0.1)])
    tilted = BaseTilt().plant(robot, [0.0, 0.1]).gravity
    assert tilted.tolist() == pytest.approx([-9.81 * math.sin(0.1), 0.0, -9.81 * math.cos(0.1)])
    assert float(BaseTilt().plant(robot, [0.2, -0.3]).gravity.norm()) == pytest.approx(9.81)


def test_tilt_without_gravity_is_nothing() -> None:
    floating = replace(arm("3r"), gravity=torch.zeros(3, dtype=torch.float64))
    assert BaseTilt.candidates(floating) == []
    motion = smooth_motion(floating, 5)
    assert not BaseTilt().torque_columns(motion, floating).any()
    assert BaseTilt().plant(floating, [0.1, 0.1]) is floating


def test_first_joints_axis_and_base_tilt_are_the_same_thing() -> None:
    """Turning the whole arm about its base is turning gravity the other way."""
    robot = arm("panda")
    motion = smooth_motion(robot, 50)
    pose_columns = KinematicError(0).torque_columns(motion, robot)
    assert pose_columns[..., :3].abs().max() < 1e-8
    tilt = BaseTilt().torque_columns(motion, robot).flatten(0, 1)
    turn = pose_columns[..., 3:].flatten(0, 1)
    solution = torch.linalg.lstsq(tilt, turn).solution
    torch.testing.assert_close(tilt @ solution, turn, rtol=1e-6, atol=1e-6)


def test_vertical_joint_hides_its_offset() -> None:
    robot = arm("panda")
    motion = smooth_motion(robot, 50)
    assert EncoderOffset(0).torque_columns(motion, robot).abs().max() < 1e-9


def test_places() -> None:
    robot = arm("panda")
    assert len(TorqueCrosstalk.candidates(robot)) == 42
    assert [e.joints for e in EncoderOffset.candidates(robot)] == [(j,) for j in range(7)]
    assert BaseTilt().joints == ()
    effect, values = effect_from_record(
        {"effect": "torque_crosstalk", "joint": 3, "source_joint": 2, "C": 0.1}, robot
    )
    assert effect == TorqueCrosstalk(2, 1)
    assert effect.record(values) == {
        "effect": "torque_crosstalk",
        "joint": 3,
        "source_joint": 2,
        "C": 0.1,
    }
    with pytest.raises(RobotError, match="must differ"):
        effect_from_record(
            {"effect": "torque_crosstalk", "joint": 2, "source_joint": 2, "C": 0.1}, robot
        )


def test_units_of_poses_do_not_depend_on_the_joint() -> None:
    units = {c.name: c.unit_for(prismatic=True) for c in KinematicError.coefficients}
    assert units == {"dx": "m", "dy": "m", "dz": "m", "rx": "rad", "ry": "rad"}
    assert EncoderOffset.coefficients[0].unit_for(prismatic=True) == "m"
