"""Bodies added to links, against Pinocchio's torque of the arm that carries them."""

from dataclasses import replace

import pytest
import torch

from tests.arms import QUICK_ARMS, arm, consistent_parameters
from tests.effects.exact_logs import closed, smooth_motion
from tests.oracles import PinocchioOracle
from torchid.effects.base import ModelEffect
from torchid.effects.gravity import EncoderOffset
from torchid.effects.inertia import LinkInertia, Payload
from torchid.effects.model import ArmModel
from torchid.effects.registry import Valued, model_torque
from torchid.effects.variation import with_joint
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot

BODY = consistent_parameters(1, seed=11).pi[0].tolist()


def carrying(robot: Robot, link: int) -> Robot:
    assert robot.parameters is not None
    pi = robot.parameters.pi.clone()
    pi[link] += torch.tensor(BODY, dtype=torch.float64)
    return robot.with_parameters(InertialParameters(pi))


@pytest.mark.parametrize("name", QUICK_ARMS)
@pytest.mark.parametrize("link", [0, 1, -1])
def test_torque_of_a_body_on_a_link(name: str, link: int) -> None:
    robot = arm(name)
    motion = smooth_motion(robot, 20)
    effect: ModelEffect = Payload() if link == -1 else LinkInertia(link)
    change = PinocchioOracle(carrying(robot, link)).inverse_dynamics(*motion.state)
    change = change - PinocchioOracle(robot).inverse_dynamics(*motion.state)
    torch.testing.assert_close(effect.all_torques(motion, BODY, robot), change)


@pytest.mark.parametrize("effect", [Payload(), LinkInertia(2)])
def test_plant_and_columns_agree_exactly(effect: ModelEffect) -> None:
    assert closed(effect, arm("panda"), BODY) < 1e-10


def test_links_after_the_body_feel_nothing() -> None:
    robot = arm("panda")
    columns = LinkInertia(2).torque_columns(smooth_motion(robot, 20), robot)
    assert columns.shape == (20, 7, 10)
    assert not columns[:, 3:].any()


def test_payload_is_the_last_link() -> None:
    robot = arm("ur10e")
    motion = smooth_motion(robot, 20)
    last = LinkInertia(robot.n - 1).torque_columns(motion, robot)
    torch.testing.assert_close(
        Payload().torque_columns(motion, robot), last, rtol=1e-12, atol=1e-12
    )


def test_only_a_payloads_mass_has_a_sign() -> None:
    assert [c.name for c in Payload.coefficients if c.non_negative] == ["m"]
    assert not any(c.non_negative for c in LinkInertia.coefficients)
    units = [c.unit_for(prismatic=True) for c in Payload.coefficients]
    assert units == ["kg"] + ["kg m"] * 3 + ["kg m^2"] * 6
    assert len(LinkInertia.candidates(arm("panda"))) == 7
    assert Payload().joints == ()


def test_long_motions_are_handled_in_pieces() -> None:
    robot = arm("3r")
    motion = smooth_motion(robot, 40_000)
    some = motion.part(slice(39_990, None))
    whole = LinkInertia(1).torque_columns(motion, robot)
    torch.testing.assert_close(whole[39_990:], LinkInertia(1).torque_columns(some, robot))


@pytest.mark.parametrize("late", [False, True])
def test_an_offset_moves_a_load_as_well(late: bool) -> None:
    """Torque of the arm that carries the body, at the true position."""
    robot = arm("panda")
    motion = smooth_motion(robot, 20)
    offset = EncoderOffset(3, at=0.05)
    valued: list[Valued] = [(Payload(), BODY), (offset, [0.05])]
    q = with_joint(motion.q, offset.joint, 0.05)
    loaded = PinocchioOracle(carrying(robot, -1))
    expected = loaded.inverse_dynamics(q, motion.dq, motion.ddq)
    torque = model_torque(robot, valued[::-1] if late else valued, motion)
    torch.testing.assert_close(torque, expected)
    records = tuple(e.record(v) for e, v in valued)
    torch.testing.assert_close(
        ArmModel(replace(robot, effects=records)).torque(*motion.state), expected
    )
