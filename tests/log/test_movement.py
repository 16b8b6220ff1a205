"""What a log tells of its motion is computed once, and handed on with it."""

import pickle

import numpy as np
import pytest
import torch

import torchid
from tests.gap.small_logs import ONCE, ROBOT, Recording, logged
from torchid.log import model, sampling
from torchid.log.model import Log

RATE, SECONDS, NOISE = 200.0, 40.0, 1e-4
"""Of the sampling [Hz]; of the log [s]; standard deviation of the positions' noise [rad]."""


def moving(amplitude: float, noise: float = NOISE) -> Log:
    """Two joints that swing at half a hertz, the second a tenth as far, with velocities."""
    t = torch.arange(RATE * SECONDS, dtype=torch.float64) / RATE
    far = amplitude * torch.tensor([1.0, 0.1], dtype=torch.float64)
    angle = torch.pi * t[:, None]
    white = torch.from_numpy(np.random.default_rng(1).normal(size=(len(t), 2)))
    return Log(t, far * angle.sin() + noise * white, dq=torch.pi * far * angle.cos())


def test_the_noise_of_positions_is_that_which_was_added() -> None:
    density = moving(1.0).noise_density
    # White noise of variance s^2 has the one-sided density 2 s^2 / rate.
    assert density.tolist() == pytest.approx([2 * NOISE**2 / RATE] * 2, rel=0.1)


def test_what_moves_is_told_by_the_log_itself() -> None:
    assert moving(1.0).least_way.tolist() == [0.01, 0.01]
    slight = moving(0.02).least_way  # twenty times the noise, and a tenth of the farthest way
    assert slight.tolist() == pytest.approx([0.1 * 0.04] * 2, rel=0.05)
    assert moving(1.0).moving_speed.tolist() == [0.02, 0.02]
    slow = moving(0.02, noise=0.0).moving_speed
    assert slow.tolist() == pytest.approx([0.1 * 0.02 * torch.pi] * 2, rel=0.05)


def test_velocities_agree_with_positions_up_to_their_unit() -> None:
    log = moving(1.0, noise=0.0)
    ratios = [a.ratio for a in log.replace(dq=1e3 * log.dq).agreements]  # type: ignore[operator]
    assert ratios == pytest.approx([1e3, 1e3], rel=1e-4)
    assert log.replace(dq=None).agreements == ()


def test_runs_of_the_even_log_are_those_that_gaps_have_parted() -> None:
    log = moving(1.0)
    keep = (log.t < 10.0) | (log.t > 12.0)
    two = Log.concatenate([log.select(keep), log])
    assert two.even.trajectory_count == 3
    assert two.even_runs == (0, 0, 1)


def test_a_diagnosis_puts_its_log_on_a_grid_once(monkeypatch: pytest.MonkeyPatch) -> None:
    log, asked = logged(ROBOT, Recording(runs=ONCE)), list[str]()
    jitter = np.random.default_rng(0).uniform(-0.1, 0.1, log.samples) / log.rates[0]
    log = log.replace(t=log.t + torch.from_numpy(jitter))
    resampled, steps = sampling.resampled, model.agreements_of
    monkeypatch.setattr(sampling, "resampled", lambda x: asked.append("even") or resampled(x))
    monkeypatch.setattr(model, "agreements_of", lambda x: asked.append("agree") or steps(x))
    torchid.diagnose(ROBOT, log, settings=torchid.GapSettings(effects=("viscous_friction",)))
    assert asked.count("even") == 1
    # Of the log as it is, and no other.
    assert asked.count("agree") == 1


def test_what_was_computed_is_not_sent_along() -> None:
    log = moving(1.0)
    length = len(pickle.dumps(log))
    jittered = log.replace(t=log.t + 1e-3 * torch.rand(log.samples, dtype=torch.float64) / RATE)
    assert jittered.even is jittered.even
    assert len(pickle.dumps(jittered)) == pytest.approx(length, rel=0.01)
    assert torch.equal(pickle.loads(pickle.dumps(jittered)).q, log.q)
