"""Single axes by formula: what turns on, and a loop over position."""

import numpy as np
import pytest

import torchid
from tests.arms import single_axis


def turning(seconds: float = 40.0, *, velocity: bool = True) -> torchid.Log:
    """A motor of 1.2 g m^2 with dry friction .1 N m and viscous .002 N m s, up to 150 rad/s and
    1,500 rad away."""
    t = np.arange(0.0, seconds, 1 / 200)
    q = 40 * t - 180 * np.cos(0.5 * t) - 20 / 1.3 * np.cos(1.3 * t)
    dq = 40 + 90 * np.sin(0.5 * t) + 20 * np.sin(1.3 * t)
    ddq = 45 * np.cos(0.5 * t) + 26 * np.cos(1.3 * t)
    noise = 0.002 * np.random.default_rng(0).standard_normal(len(t))
    tau = 1.2e-3 * ddq + 0.1 * np.tanh(dq / 0.5) + 0.002 * dq + noise
    return torchid.Log(t, q[:, None], dq=dq[:, None] if velocity else None, tau=tau[:, None])


@pytest.mark.parametrize("velocity", [True, False])
def test_a_motor_that_turns_on_is_no_fault(velocity):
    result = torchid.examine(single_axis(), turning(velocity=velocity))
    assert result.silent
    assert result.repairs == ()


@pytest.mark.slow
def test_friction_of_a_motor_that_turns_on():
    settings = torchid.GapSettings(rollout=False)
    found = torchid.diagnose(single_axis(), turning(), settings=settings)
    sizes = {c.effect: c.sizes[0].value for c in found.answer.causes}
    assert sizes == {
        "viscous_friction": pytest.approx(0.002, rel=0.01),
        "coulomb_friction": pytest.approx(0.1, rel=0.02),
    }
    assert not found.doubt
