"""What the logger does to the truth."""

from dataclasses import replace

import numpy as np

from torchid_bench.withheld.plant.arms import arm_named
from torchid_bench.withheld.plant.logger import Logger, logged, noise
from torchid_bench.withheld.plant.model import plant_of
from torchid_bench.withheld.plant.plan import Plan, Signals
from torchid_bench.withheld.plant.sensing import Windows, with_held_torque

LOGGER = Logger(500, 17, None, 0.03, False, 1e-3, 100.0, 5)


def truth(seconds=20.0):
    t = np.arange(0, seconds, 5e-4)
    q = np.stack([np.sin(t + k) for k in range(3)], 1)
    dq = np.stack([np.cos(t + k) for k in range(3)], 1)
    return Signals(t, q, dq, -q, 10 * dq)


def plan():
    zeros = np.zeros(3)
    return Plan(plant_of(arm_named("3r"), zeros, zeros), zeros, zeros)


def log(logger, std=0.0, which=None):
    return logged(logger, which or plan(), [truth()], np.full(3, std))


def test_columns():
    columns = log(LOGGER)
    assert list(columns) == ["t", *(f"q{k}" for k in (1, 2, 3)), "tau1", "tau2", "tau3", "traj"]
    assert len(columns["t"]) == 20 * 500
    assert "dq3" in log(replace(LOGGER, own_velocity=True))
    assert "dq3" in log(LOGGER, which=replace(plan(), own_velocity=True))


def test_positions_are_ticks_and_stamps_go_forwards():
    columns = log(replace(LOGGER, jitter=0.3))
    tick = 2 * np.pi / 2**17
    np.testing.assert_allclose(columns["q1"] / tick, np.round(columns["q1"] / tick), atol=1e-6)
    assert np.abs(columns["q1"] - truth().q[::4, 0]).max() <= tick / 2 * 1.001
    steps = np.diff(columns["t"])
    assert steps.min() > 0
    assert steps.std() > 1e-4
    assert columns["t"][0] > 99


def test_noise_has_its_size_and_colour():
    rng = np.random.default_rng(0)
    for corner in (None, 5.0):
        x = noise(rng, (400_000, 2), 500.0, corner)
        assert np.abs(x.std(0) - 1).max() < 0.03
        power = np.abs(np.fft.rfft(x[:, 0])) ** 2
        f = np.fft.rfftfreq(len(x), 1 / 500)
        low, at = power[(f > 0) & (f < 0.5)].mean(), power[(f > 4.9) & (f < 5.1)].mean()
        assert abs(at / low - (1.0 if corner is None else 0.5)) < 0.1
    residual = log(LOGGER, std=0.2)["tau2"] - truth().tau[::4, 1]
    assert abs(residual.std() / 0.2 - 1) < 0.05


def test_held_samples_are_copies():
    windows = Windows(1, (((2.0, 2.1), (5.0, 5.2)),))
    columns = log(LOGGER, std=0.2, which=replace(plan(), held=(windows,)))
    rows = (columns["t"] > 102.001) & (columns["t"] < 102.099)
    assert len(set(columns["tau2"][rows])) == 1
    assert len(set(columns["tau1"][rows])) > 40
    x, t = np.arange(10.0)[:, None], np.arange(10.0)
    held = with_held_torque(x, t, [Windows(0, (((2.5, 6.0),),))], 0)
    assert held[:, 0].tolist() == [0, 1, 2, 3, 3, 3, 6, 7, 8, 9]


def test_noise_grows_with_speed_and_is_as_large_in_all():
    logger = replace(LOGGER, jitter=0.0, grows=4.0)
    made, clean = (log(x, std)["tau1"] for x, std in ((logger, 0.5), (logger, 0.0)))
    left, speed = made - clean, np.abs(truth().dq[::4, 0])
    assert abs(left.std() / 0.5 - 1) < 0.05
    fast, slow = left[speed > 0.9].std(), left[speed < 0.1].std()
    assert 3.0 < fast / slow < 7.0
