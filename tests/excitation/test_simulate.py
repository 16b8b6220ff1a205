"""`simulate`: the arm on its trajectory, under control with effects, and what is refused."""

import pytest
import torch

from tests.arms import arm
from torchid.effects.friction import CoulombFriction
from torchid.excitation.design import excite
from torchid.excitation.synthetic import simulate, synthetic_log
from torchid.log.model import Log


@pytest.fixture(scope="module")
def motion() -> Log:
    return excite(arm("3r"), duration=3.0, restarts=1, iterations=0).log()


def test_without_effects_the_log_is_that_of_the_nominal_arm(motion: Log) -> None:
    robot = arm("3r")
    made, wanted = simulate(robot, motion, noise=None), synthetic_log(robot, motion)
    torch.testing.assert_close(made.tau, wanted.tau, rtol=1e-12, atol=1e-12)
    assert torch.equal(made.q, motion.q)
    first, again, other = (simulate(robot, motion, seed=k).tau for k in (1, 1, 2))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


@pytest.mark.nightly
def test_an_effect_is_a_record_or_an_object_and_adds_its_torque(motion: Log) -> None:
    """Friction of a joint is the torque that is not the rigid body's along the same motion."""
    robot = arm("3r")
    record = {"effect": "coulomb_friction", "joint": 2, "Fc": 0.6}
    one, two = (
        simulate(robot, motion, effects=[effect], noise=None)
        for effect in (record, (CoulombFriction(1), [0.6]))
    )
    torch.testing.assert_close(one.tau, two.tau, rtol=1e-12, atol=1e-12)
    alone = one.tau - synthetic_log(robot, one).tau
    moving = one.dq[:, 1].abs() > 0.05
    assert (alone[moving, 1] - 0.6 * one.dq[moving, 1].sign()).abs().max() < 1e-3
    assert alone[:, [0, 2]].abs().max() < 1e-3
