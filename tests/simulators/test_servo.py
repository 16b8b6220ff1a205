"""Set-points at run time are those of the simulation of servos."""

import math

import numpy as np
import pytest
import torch

from torchid.errors import TorchidError
from torchid.simulation.servo import INDEX, Servos
from torchid.simulation.servo_loop import PROFILE, Tracks, set_points
from torchid.simulators.servo import SetPoints

DT = 0.02


def commands(samples: int, seed: int, *, repeated: bool) -> np.ndarray:
    """(T, 3) steps and slopes, some of them sent again."""
    rng = np.random.default_rng(seed)
    u = np.cumsum(rng.normal(0, 0.03, (samples, 3)), 0) + 0.5 * (rng.random((samples, 3)) < 0.05)
    if repeated:
        for k in range(1, samples):
            u[k] = np.where(rng.random(3) < 0.5, u[k - 1], u[k])
    return u


@pytest.mark.parametrize("repeated", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_limited_set_points_are_those_of_the_simulation(seed, repeated):
    servos = Servos.neutral(3, kp=10.0, kd=0.0, scale=1.1)
    servos.joint[0, INDEX["acceleration"]] = 8.0
    servos.joint[1, INDEX["acceleration"]] = 8.0
    servos.joint[1, INDEX["speed"]] = 0.6
    servos = Servos(servos.joint, servos.plane, repeated=repeated)
    u = commands(120, seed, repeated=repeated)
    ends = torch.tensor([0]), torch.tensor([119])
    tracks = Tracks(torch.from_numpy(u), *ends, DT)
    expected = set_points(
        servos.joint[None][..., [INDEX[name] for name in PROFILE]], tracks, repeated=repeated
    )[:, 0].T.numpy()
    points = SetPoints(servos, DT)
    fed = np.array([points.feed(row, 4) for row in u])
    # From one sample's set-point to the next in a line; what is not limited holds.
    assert np.allclose(1.1 * fed[:, 0, :2], expected[:, :2], atol=1e-12)
    middle = (expected[:-1] + expected[1:]) / 2
    assert np.allclose(1.1 * fed[:-1, 2, :2], middle[:, :2], atol=1e-12)
    assert np.allclose(fed[:, :, 2], u[:, None, 2])
    assert points.late.tolist() == [0.0, 0.0, DT / 2]


def test_the_rate_is_fed_forwards():
    """kp (x + kd / kp dx - q) is what answers to both errors."""
    servos = Servos.neutral(2, kp=20.0, kd=1.5)
    servos.joint[0, INDEX["speed"]] = 1.0
    points = SetPoints(servos, DT)
    assert np.allclose(points.feed([0.2, 0.2], 2), 0.2)
    ctrl = points.feed([0.3, 0.3], 2)
    assert np.allclose(ctrl[0], 0.2 + 1.5 / 20 * np.array([1.0, 0.1 / DT]), atol=1e-3)
    assert np.allclose(ctrl[1] - ctrl[0], np.array([1.0, 0.1 / DT]) * DT / 2, atol=1e-3)
    assert points.late.tolist() == [0.0, DT]


def test_environments_are_apart_and_begin_anew():
    servos = Servos.neutral(3, kp=10.0, acceleration=5.0)
    u = np.stack([commands(30, seed, repeated=False) for seed in (1, 2)], 1)
    both, single = SetPoints(servos, DT), SetPoints(servos, DT)
    for row in u:
        assert np.allclose(both.feed(row, 3)[:, 1], single.feed(row[1], 3))
    both.reset([0])
    single.reset()
    assert np.allclose(both.feed(u[0], 1)[0, 0], u[0, 0])
    assert not np.allclose(both.feed(u[0], 1)[0, 1], u[0, 1])
    assert np.allclose(single.feed(u[0, 1], 1), u[0, 1])


@pytest.mark.parametrize("dt", [0.0, -1.0, math.nan, math.inf])
def test_a_time_that_is_none(dt):
    with pytest.raises(TorchidError, match="expected: dt > 0 s"):
        SetPoints(Servos.neutral(2, kp=1.0), dt)
