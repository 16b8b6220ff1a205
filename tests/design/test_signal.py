"""A joint's torque says something where its motion foretells it."""

import pytest
import torch

from tests.gap.motions import ROBOT
from tests.gap.problems import data_of, measured
from torchid.design.columns import Columns, Model
from torchid.design.signal import without_signal
from torchid.effects.friction import ViscousFriction
from torchid.effects.spring import JointSpring

PARTS = 4


def parts_of(count: int) -> torch.Tensor:
    return 1 + torch.arange(count) * PARTS // count


@pytest.mark.parametrize("joint", range(3))
@pytest.mark.parametrize("bias", [0.0, 3.0])
def test_of_noise_about_any_mean_nothing_is_foretold(joint: int, bias: float) -> None:
    data = measured(((ViscousFriction(0), [1.0]),))
    samples = data.samples
    torque = samples.of([s.tau.T for s in samples.segments])
    noise = torch.randn(len(samples), generator=torch.Generator().manual_seed(joint)).double()
    torque[joint] = bias + noise
    found = without_signal(
        Columns(Model(ROBOT, ()), samples), torque, data.keep, parts_of(len(samples))
    )
    assert found.tolist() == [j == joint for j in range(3)]


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_a_torque_in_other_units_or_with_an_unknown_law_still_follows_the_motion(
    scale: float,
) -> None:
    """Whatever the gap: a gain of -0.9, or a spring as large as the torque itself."""
    data = measured(((JointSpring(1), [20.0, 0.0]),))
    torque = scale * data.samples.of([s.tau.T for s in data.segments])
    columns = Columns(Model(ROBOT, ()), data.samples)
    assert not without_signal(columns, torque, data.keep, parts_of(len(data.samples))).any()


def test_a_push_in_one_stretch_does_not_make_a_joint_silent() -> None:
    data = measured(())
    torque = data.samples.of([s.tau.T for s in data.segments])
    torque[2, : len(data.samples) // 10] += 50.0
    columns = Columns(Model(ROBOT, ()), data.samples)
    assert not without_signal(columns, torque, data.keep, parts_of(len(data.samples))).any()


def test_of_no_samples_nothing_is_said() -> None:
    data = data_of(measured(()).segments)
    torque = data.samples.of([s.tau.T for s in data.segments])
    keep = torch.zeros_like(data.keep)
    columns = Columns(Model(ROBOT, ()), data.samples)
    assert not without_signal(columns, torque, keep, parts_of(len(data.samples))).any()
