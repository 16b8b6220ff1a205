"""Torque over a joint's position: several effects are one law, unless the log tells them apart."""

import numpy as np
import pytest

import torchid
from tests.arms import single_axis

SETTINGS = torchid.GapSettings(effects=("joint_spring", "cogging"))


def diagnosed(torque: np.ndarray, noise: float = 0.02) -> torchid.Diagnosis:
    """A hub of .1 kg m^2 whose joint feels such a torque over 2.4 rad."""
    ddq = np.gradient(np.gradient(Q, T), T)
    tau = 0.1 * ddq + torque + noise * np.random.default_rng(0).standard_normal(len(T))
    log = torchid.Log(T, Q[:, None], tau=tau[:, None])
    return torchid.diagnose(single_axis(inertia=0.1), log, settings=SETTINGS, force=True)


T = np.arange(0.0, 30.0, 1 / 100)
Q = 0.1 + 0.8 * np.sin(0.7 * T) + 0.4 * np.sin(1.9 * T)


def test_a_curve_that_no_effect_is_is_one_cause():
    """A cable: a spring and a slow ripple are together near it, and no smooth curve is not."""
    found = diagnosed(3 * np.tanh(3 * (Q - 0.1)))
    (law,) = found.which
    assert {law.effect, *law.ambiguous_with} == {"joint_spring", "cogging"}
    assert law.one_of_a_set
    assert law.how_sure > 0.9
    (cause,) = found.answer.causes
    assert cause.share == pytest.approx(found.how_far.less)
    assert len(found.corrected.effects) > 1


def test_a_spring_and_a_ripple_that_no_smooth_curve_holds_are_two():
    found = diagnosed(4 * Q + 0.5 * np.sin(12 * Q))
    assert {f.effect for f in found.which} == {"joint_spring", "cogging"}
    assert all(f.how_sure > 0.9 and not f.ambiguous_with for f in found.which)
