"""Held torque samples: ages exact, quantisers and limits left alone."""

import pytest
import torch

from tests.gap.motions import RATE, motion_at, noise, times
from tests.real_logs import FOLDER, NO_LOGS
from torchid.design.held import held_ages, held_ages_of
from torchid.design.motion import measurements
from torchid.design.segments import segments_of
from torchid.log.model import Log
from torchid.log.readers import read_log


def moving_log(seed: int = 0, *, rate: float = RATE, sigma: float = 0.1) -> Log:
    g = torch.Generator().manual_seed(seed)
    m = motion_at(times(20.0, rate=rate), seed)
    tau = 20 * m.q.sin() + 2 * m.dq + sigma * noise(*m.q.shape, g)
    return Log(t=m.t, q=m.q, tau=tau)


def hold(tau: torch.Tensor, joint: int, start: int, length: int) -> None:
    tau[start : start + length, joint] = tau[start, joint]


@pytest.mark.parametrize("quantum", [0.0, 0.05])
def test_ages_are_exact(quantum):
    log = moving_log()
    tau = log.tau.clone()
    if quantum:
        tau = quantum * torch.round(tau / quantum)
    expected = torch.zeros_like(tau)
    for joint, start, length in ((0, 710, 12), (1, 1500, 20), (0, 2500, 9), (2, 4000, 30)):
        assert float((tau[start + length, joint] - tau[start, joint]).abs()) > 0.15
        hold(tau, joint, start, length)
        expected[start : start + length, joint] = torch.arange(length) / RATE
    found = held_ages(log.replace(tau=tau))
    assert torch.allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("sigma", [0.0, 0.02, 0.1, 1.0])
def test_quantised_torque_is_not_held(seed, sigma):
    """Steps of 0.12 N m at 50 Hz, also of slow motion: long runs that end in the next step."""
    log = moving_log(seed, rate=50.0, sigma=sigma)
    for speed in (1.0, 0.1):
        tau = 0.12 * torch.round(speed * log.tau / 0.12)
        assert float((tau.diff(dim=0) == 0).double().mean()) > 0.005
        assert float(held_ages(log.replace(tau=tau)).max()) == 0


def test_a_limit_and_a_brake_are_not_holds():
    log = moving_log(sigma=0.0)
    limit = torch.quantile(log.tau.abs(), 0.9, dim=0)
    clipped = torch.minimum(torch.maximum(log.tau, -limit), limit)
    assert float(held_ages(log.replace(tau=clipped)).max()) == 0
    q, tau = log.q.clone(), log.tau.clone()
    q[1000:2000], tau[1000:2000] = q[1000], tau[1000]
    assert float(held_ages(log.replace(q=q, tau=tau)).max()) == 0


def test_ages_follow_resampling_and_the_segments_grid():
    """Stamps that jitter, a log at 1 kHz: on the grid the age is that of the raw hold to within a
    step, and the segments' torque and ages go through one filter."""
    log = moving_log(rate=1000.0)
    tau = log.tau.clone()
    hold(tau, 1, 9000, 60)
    jitter = 3e-4 * torch.rand(log.samples, generator=torch.Generator().manual_seed(1))
    even = log.replace(t=log.t + jitter, tau=tau).even
    found = held_ages(even)
    assert float(found[:, 1].max()) == pytest.approx(0.059, abs=2e-3)
    assert int((found > 0).sum()) == pytest.approx(59, abs=2)
    segments = segments_of(measurements(even, 40.0), 40.0)
    (ages,) = held_ages_of(even, segments)
    assert ages.shape == segments[0].tau.shape
    area = float(ages.sum()) / segments[0].rate
    assert area == pytest.approx(0.5 * 0.06**2, rel=0.1)


@pytest.mark.real
@pytest.mark.skipif(not FOLDER.is_dir(), reason=NO_LOGS)
@pytest.mark.parametrize(
    "name",
    ["xmate7p/log_traj1", "xmate7p/log_traj3", "xmate7p/log_traj1_5periods",
     "panda_unisa/log_exciting", "ur10_unisa/log_exciting", "emps/log_train"],
)  # fmt: skip
def test_real_quantised_logs_have_no_holds(name):
    log = read_log([FOLDER / f"{name}.parquet"]).even
    assert float((held_ages(log) > 0).double().mean()) < 1e-3
