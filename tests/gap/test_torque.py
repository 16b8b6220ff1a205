"""The recommended model has bodies, and says what they cost."""

import pytest
import torch

from tests.gap.motions import ROBOT
from tests.gap.problems import measured
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.gap.torque import with_bodies_nearest
from torchid.robot.inertia import InertialParameters

SEGMENTS = measured([]).segments


def changed(size: float):
    """The 3R whose last link has so much less inertia about its y axis [kg m^2]."""
    pi = ROBOT.require_parameters("a test").pi.clone()
    pi[-1, 7] -= size
    return ROBOT.with_parameters(InertialParameters(pi))


def test_bodies_stay_as_they_are():
    robot, cost = with_bodies_nearest(ROBOT, SEGMENTS)
    assert robot is ROBOT
    assert cost.tolist() == [0.0] * ROBOT.n


@pytest.mark.parametrize("times", [1.5, 3.0])
def test_links_that_are_no_bodies_become_those_nearest_in_torque(times: float):
    own = float(ROBOT.require_parameters("a test").pi[-1, 7])
    strange = changed(times * own)
    assert bool((strange.require_parameters("it").consistency_margin() < 0).any())
    robot, cost = with_bodies_nearest(strange, SEGMENTS)
    assert bool((robot.require_parameters("it").consistency_margin() >= 0).all())
    # By the equations of motion, not by a regressor; the log's states were thinned.
    states = [torch.cat(x).double() for x in zip(*(s.motion.state for s in SEGMENTS), strict=True)]
    change = inverse_dynamics(robot, *states) - inverse_dynamics(strange, *states)
    assert change.square().mean(0).sqrt().tolist() == pytest.approx(cost.tolist(), rel=0.2)
    # Nearer than the nominal bodies, and at some cost.
    nominal = inverse_dynamics(ROBOT, *states) - inverse_dynamics(strange, *states)
    assert 0 < float(change.norm()) < float(nominal.norm())
