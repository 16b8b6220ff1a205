"""A joint's torque says something where its motion foretells it."""

import pytest
import torch

from tests.gap.motions import ROBOT
from tests.gap.problems import data_of, measured
from torchid.design.columns import Columns, Model
from torchid.design.signal import without_signal
from torchid.effects.friction import ViscousFriction
from torchid.effects.spring import JointSpring
from torchid.gap.data import Data
from torchid.typing import Tensor

PARTS = 4


def parts_of(count: int) -> torch.Tensor:
    return 1 + torch.arange(count) * PARTS // count


def silent(data: Data, torque: Tensor, keep: Tensor | None = None) -> Tensor:
    """Which joints are, beside the 3R as it is."""
    columns = Columns(Model(ROBOT, ()), data.samples)
    predicted = data.samples.of([s.tau.T for s in measured((), noise=0.0).segments])
    keep = data.keep if keep is None else keep
    return without_signal(columns, torque, torque - predicted, keep, parts_of(len(data.samples)))


@pytest.mark.parametrize("joint", range(3))
@pytest.mark.parametrize("bias", [0.0, 3.0])
def test_of_noise_about_any_mean_nothing_is_predicted(joint: int, bias: float) -> None:
    data = measured(((ViscousFriction(0), [1.0]),))
    samples = data.samples
    torque = samples.of([s.tau.T for s in samples.segments])
    noise = torch.randn(len(samples), generator=torch.Generator().manual_seed(joint)).double()
    torque[joint] = bias + 0.05 * noise
    assert silent(data, torque).tolist() == [j == joint for j in range(3)]


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_a_torque_in_other_units_or_with_an_unknown_law_still_follows_the_motion(
    scale: float,
) -> None:
    """Whatever the gap: a gain of -0.9, or a spring as large as the torque itself."""
    data = measured(((JointSpring(1), [20.0, 0.0]),))
    torque = scale * data.samples.of([s.tau.T for s in data.segments])
    assert not silent(data, torque).any()


def test_a_push_in_one_stretch_does_not_make_a_joint_silent() -> None:
    data = measured(())
    torque = data.samples.of([s.tau.T for s in data.segments])
    torque[2, : len(data.samples) // 10] += 50.0
    assert not silent(data, torque).any()


def test_of_no_samples_nothing_is_said() -> None:
    data = data_of(measured(()).segments)
    torque = data.samples.of([s.tau.T for s in data.segments])
    keep = torch.zeros_like(data.keep)
    assert not silent(data, torque, keep).any()


def test_a_joint_that_holds_one_load_is_not_silent() -> None:
    """Its torque varies by its noise alone, and so does the model's gap."""
    data = measured(())
    torque = data.samples.of([s.tau.T for s in data.segments])
    predicted = torch.full_like(torque, 20.0)
    noise = 0.05 * torch.randn(torque.shape, generator=torch.Generator().manual_seed(1)).double()
    columns = Columns(Model(ROBOT, ()), data.samples)
    parts = parts_of(len(data.samples))
    found = without_signal(columns, predicted + noise, noise, data.keep, parts)
    assert not found.any()
