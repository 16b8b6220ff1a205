"""A flexible predictor: nothing in noise, much in what is a function of the motion."""

import time

import pytest
import torch
from torchid.gap.passages import Passage, Rows

from tests.gap.motions import motion_at, noises, passage_of, times
from torchid.gap.noise.flexible import predict_out_of_fold


def passages_of_seed(seed: int, robot: str = "3r", duration: float = 20.0) -> list[Passage]:
    out = []
    for k in range(3):
        m = motion_at(times(duration), 10 * seed + k, robot)
        m = m._replace(t=m.t + 30 * k, torque=20 * m.q.sin() + m.ddq)
        out.append(passage_of(m, name=f"run{k}"))
    return out


@pytest.mark.parametrize("hz", [None, 2.0, 0.5])
def test_noise_is_not_predicted(hz):
    """Of 15 joints at most two have a positive lower bound (2.5 % each), and R^2 is about zero."""
    r2, lower = [], []
    for seed in range(5):
        passages = passages_of_seed(seed)
        rows = Rows(passages, 8.0)
        found = predict_out_of_fold(
            passages, rows, rows.apply([x.T for x in noises(passages, seed, hz)])
        )
        r2.append(found.r2)
        lower.append(found.interval[:, 0])
    r2, lower = torch.cat(r2), torch.cat(lower)
    assert int((lower > 0).sum()) <= 2
    assert float(r2.abs().median()) < 0.01
    assert float(r2.min()) > -0.1
    assert float(r2.max()) < 0.1


@pytest.mark.parametrize("seed", range(2))
def test_a_hidden_function_of_the_motion_is_found(seed):
    """On joint 2 only, of its position and speed; what remains is near the noise."""
    passages = passages_of_seed(seed)
    rows = Rows(passages, 8.0)
    noise = rows.apply([x.T for x in noises(passages, seed, 5.0)])
    hidden = rows.apply(
        [
            (torch.tensor([0.0, 1.0, 0.0]) * (3 * torch.tanh(4 * p.motion.dq) * p.motion.q.cos())).T
            for p in passages
        ]
    )
    found = predict_out_of_fold(passages, rows, noise + hidden)
    best = 1 - noise[1].square().sum() / (noise + hidden)[1].square().sum()
    assert float(found.r2[1]) > 0.7 * float(best)
    assert float(found.interval[1, 0]) > 0.3
    assert float(found.r2[[0, 2]].abs().max()) < 0.05
    left = found.left(noise + hidden)
    assert float(left[1].square().mean() / noise[1].square().mean()) < 2.5


def test_it_never_sees_the_measured_torque_and_is_reproducible():
    passages = passages_of_seed(0)
    rows = Rows(passages, 8.0)
    noise = rows.apply([x.T for x in noises(passages, 0, 5.0)])
    other = [
        Passage(p.name, p.trajectory, p.rate, p.band, p.motion, p.tau + torch.inf, p.own_velocity)
        for p in passages
    ]
    one, two = (predict_out_of_fold(p, rows, noise, seed=3) for p in (passages, other))
    assert torch.equal(one.prediction, two.prediction)


def test_a_row_does_not_predict_itself():
    """A spike changes no prediction within its own block, where its fold is held out; the shrinkage
    may move by as little as one row weighs."""
    passages = passages_of_seed(1)
    rows = Rows(passages, 8.0)
    noise = rows.apply([x.T for x in noises(passages, 1)])
    smooth = rows.apply([3 * torch.tanh(4 * p.motion.dq).T for p in passages])
    spiked = noise + smooth
    spiked[0, 600] += 5.0
    a, b = (predict_out_of_fold(passages, rows, r).prediction for r in (noise + smooth, spiked))
    assert float((a - b)[0, 598:603].abs().max()) < 0.05
    assert torch.equal(a[1:], b[1:])


def test_autocorrelation_time_of_an_autoregression():
    """1 + 2 sum rho^k = (1 + rho) / (1 - rho), the tail below 0.05 left out."""
    g = torch.Generator().manual_seed(0)
    rho, count = 0.8, 100_000
    x = torch.zeros(count)
    e = torch.randn(count, generator=g)
    for t in range(1, count):
        x[t] = rho * x[t - 1] + e[t]
    expected = (1 + rho) / (1 - rho) - 2 * 0.05 / (1 - rho)
    assert autocorrelation_rows(x, (slice(0, count),)) == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("duration", [1.5, 4.0])
def test_short_logs_do_not_break_it(duration):
    passages = passages_of_seed(0, duration=duration)
    rows = Rows(passages, 8.0)
    noise = rows.apply([x.T for x in noises(passages, 0)])
    found = predict_out_of_fold(passages, rows, noise)
    assert bool(found.prediction.isfinite().all())
    assert float(found.r2.max()) < 0.3


@pytest.mark.slow
def test_seven_joints_take_three_seconds():
    passages = passages_of_seed(0, "kuka_lwr4")
    rows = Rows(passages, 8.0)
    noise = rows.apply([x.T for x in noises(passages, 0)])
    assert len(rows) > 1200
    # Processor time of all threads: neither another process nor more threads than one count.
    start = time.process_time()
    predict_out_of_fold(passages, rows, noise)
    assert time.process_time() - start < 3
