"""Reference motions: within limits, smooth, at rest at both ends."""

import numpy as np
import pytest

from tests.torchid_bench.withheld.plant.conftest import SHORT
from torchid_bench.withheld.plant.arms import ARMS, arm_named
from torchid_bench.withheld.plant.draw import draw_case
from torchid_bench.withheld.plant.motion import sums


@pytest.fixture(scope="module")
def motion():
    return sums(arm_named("3r"), SHORT)[0]


def test_derivatives_are_those_of_the_position(motion):
    t = np.arange(-0.5, 4.5, 1e-4)
    q, dq, ddq = motion.state(t)
    np.testing.assert_allclose(np.gradient(q, t, axis=0)[1:-1], dq[1:-1], atol=1e-5)
    np.testing.assert_allclose(np.gradient(dq, t, axis=0)[1:-1], ddq[1:-1], atol=1e-3)


def test_jerk_has_no_steps(motion):
    t = np.arange(-0.5, 4.5, 1e-4)
    ddq = motion.state(t)[2]
    jerk = np.diff(ddq, axis=0) / 1e-4
    assert np.abs(np.diff(jerk, axis=0)).max() < 0.02 * np.abs(jerk).max()


@pytest.mark.parametrize("name", list(ARMS))
def test_limits_are_kept(name):
    arm = arm_named(name)
    for number in range(5):
        plan = draw_case(2, number, arm=name).motion
        for motion, level in zip(sums(arm, plan), plan.levels, strict=True):
            q, dq, _ = motion.state(np.arange(0, motion.seconds, 0.003))
            assert (q >= [j.lower for j in arm.joints]).all()
            assert (q <= [j.upper for j in arm.joints]).all()
            assert (np.abs(dq) <= 1.01 * level * np.array([j.velocity for j in arm.joints])).all()
            assert (np.abs(dq).max(0) > 0.1 * level).all()
