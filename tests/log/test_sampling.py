import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from torchid.errors import LogError
from torchid.log.model import Log
from torchid.log.sampling import at_rate
from torchid.log.stamps import rates_of

from .examples import is_uniform, log_at, motion, same, snapshot, uniform


def stamps(seed: int, samples: int = 3000, low: float = 0.7, high: float = 1.3) -> np.ndarray:
    return np.cumsum(0.01 * np.random.default_rng(seed).uniform(low, high, samples))


def drop(t: np.ndarray, *gaps: tuple[int, int]) -> np.ndarray:
    """t without `count` samples from `start` on, for each (start, count)."""
    return np.delete(t, [k for start, count in gaps for k in range(start, start + count)])


def errors(log: Log) -> dict[str, float]:
    q, dq, ddq = motion(log.t.numpy(), log.n)
    true = {"q": q, "dq": dq, "ddq": ddq, "tau": 3 * ddq + np.sin(q), "current": ddq}
    return {k: float(np.abs(v.numpy() - true[k]).max()) for k, v in log.signals.items()}


def test_uniform_log_is_returned_as_it_was() -> None:
    log = uniform()
    result = log.even
    assert same(result, snapshot(log))
    assert result.warnings == ()
    assert is_uniform(log)
    assert log.rates == (pytest.approx(100.0),)


def test_tiny_jitter_moves_only_the_stamps() -> None:
    t = 0.01 * np.arange(2000) + 4e-6 * np.random.default_rng(0).uniform(-1, 1, 2000)
    log = log_at(t)
    result = log.even
    assert is_uniform(log)
    assert torch.equal(result.q, log.q)
    assert torch.equal(result.tau, log.tau)
    assert result.warnings == ()
    assert not torch.equal(result.t, log.t)
    assert result.t.diff().max() - result.t.diff().min() < 1e-12


@pytest.mark.parametrize("seed", range(3))
def test_jitter(seed: int) -> None:
    log = log_at(stamps(seed), warnings=("kept",))
    before = snapshot(log)
    result = log.even
    assert same(log, before)
    assert not is_uniform(log)
    assert is_uniform(result)
    error = errors(result)
    assert error["q"] < 1e-6
    assert error["dq"] < 1e-5
    assert error["tau"] < 1e-2  # linear; accelerations are up to 5 rad/s^2
    assert result.warnings[0] == "kept"
    assert "7 / " in result.warnings[1]
    assert "resampled" in result.warnings[1]
    assert result.names == log.names
    assert result.source == log.source


def test_alternating_steps_as_on_a_ur10e() -> None:
    t = np.concatenate([[0.0], np.cumsum(np.tile([0.010, 0.012, 0.010], 1000))])
    result = log_at(t).even
    assert result.rates == (pytest.approx(100.0),)
    assert errors(result)["q"] < 1e-7
    assert result.duration[0] == pytest.approx(t[-1], abs=0.01)


def test_dropped_packets() -> None:
    t = drop(0.01 * np.arange(2001), (300, 1), (800, 4), (1500, 8))
    result = log_at(t).even
    assert result.samples == 2001
    assert result.trajectory_count == 1
    assert errors(result)["q"] < 2e-3
    assert "2 gaps of more than 3 steps" in result.warnings[0]
    assert "90 ms" in result.warnings[0]


def test_torque_never_overshoots() -> None:
    log = log_at(drop(stamps(3), (800, 4), (1500, 8)))
    step = torch.sign(log.dq)
    result = log.replace(tau=step).even
    assert result.tau.abs().max() <= 1.0


@pytest.mark.parametrize("count", [25, 200])
def test_long_gap_splits(count: int) -> None:
    t = drop(0.01 * np.arange(2001), (500, count))
    result = log_at(t).even
    assert result.names == ("example[part 1]", "example[part 2]")
    assert result.samples == 2001 - count
    assert is_uniform(result)
    assert errors(result)["tau"] < 1e-12
    assert "a gap of up to" in result.warnings[0]
    assert "at 4.990 s" in result.warnings[0]
    assert result.trajectories()[1].t[0] == pytest.approx(0.01 * (500 + count))


def test_fast_log_splits_at_twenty_steps() -> None:
    t = drop(0.001 * np.arange(4001), (2000, 25))
    assert log_at(t).even.trajectory_count == 2
    assert log_at(drop(0.001 * np.arange(4001), (2000, 15))).even.trajectory_count == 1


def test_slow_log_does_not_split_at_every_sample() -> None:
    t = 0.3 * np.arange(100) + 0.05 * np.random.default_rng(0).uniform(size=100)
    assert log_at(t).even.trajectory_count == 1


def test_short_pieces_are_dropped() -> None:
    t = drop(0.01 * np.arange(2001), (500, 50), (600, 50))
    result = log_at(t).even
    assert result.trajectory_count == 2
    assert (
        "split there into 3 pieces, of which 1 shorter than 1 s were dropped" in result.warnings[0]
    )


def test_nothing_left() -> None:
    t = np.concatenate([k + 0.01 * np.arange(20) for k in range(10)])
    with pytest.raises(LogError, match="no piece of 1 s"):
        _ = log_at(t).even


def test_one_step_for_trajectories_that_agree() -> None:
    log = Log.concatenate([uniform(step=0.01), uniform(step=0.01005), uniform(step=0.01)])
    result = log.even
    assert result.rates == pytest.approx([100.0] * 3)
    assert errors(result)["q"] < 1e-6
    assert len(result.warnings) == 1


def test_stamps_far_from_zero_have_one_rate() -> None:
    parts = [
        log_at(start + 0.001 * np.arange(4001 + k)) for k, start in enumerate((843.513, 1.7e9))
    ]
    rates = Log.concatenate(parts).even.rates
    assert rates[0] == rates[1]
    assert rates[0] == pytest.approx(1000.0, rel=1e-6)


def test_a_step_each_for_those_that_do_not() -> None:
    log = Log.concatenate([uniform(step=0.01), uniform(step=0.02), log_at(stamps(0))])
    result = log.even
    assert result.rates[:2] == pytest.approx([100.0, 50.0])
    assert torch.equal(result.q[:1002], log.q[:1002])
    assert result.trajectory_count == 3


def test_rates_on_either_side_of_one_percent_become_one() -> None:
    log = Log.concatenate([uniform(step=1 / rate) for rate in (165.5, 166.7, 168.4)])
    even = log.even
    result = at_rate(even, min(even.rates))
    assert len(set(result.rates)) == 1
    assert result.rates[0] == pytest.approx(165.5)
    assert errors(result)["q"] < 1e-3
    assert at_rate(result, 165.5) is result


def test_trajectories_are_not_interpolated_across() -> None:
    later = uniform(t=5.01 + 0.01 * torch.arange(501.0, dtype=torch.float64))
    log = Log.concatenate([log_at(stamps(1, 500)), later])
    result = log.even
    assert torch.equal(result.trajectories()[1].q, later.q)


def test_only_positions() -> None:
    log = log_at(stamps(0), dq=None, ddq=None, tau=None, current=None)
    assert list(log.even.signals) == ["q"]


def test_nan_stays_where_it_is() -> None:
    log = log_at(stamps(0))
    q = log.q.clone()
    q[1000, 0] = math.nan
    result = log.replace(q=q).even
    assert 1 <= int(result.q.isnan().sum()) <= 3


@pytest.mark.parametrize("function", [lambda log: log.even, rates_of, lambda log: log.steps])
def test_time_must_increase(function: object) -> None:
    t = uniform().t.clone()
    t[10] = t[9]
    with pytest.raises(LogError, match="does not increase in row 11") as info:
        function(uniform(t=t))  # type: ignore[operator]
    assert "0.09 s, then 0.09 s" in str(info.value)
    t[10] = math.nan
    with pytest.raises(LogError, match="does not increase in row 11"):
        function(uniform(t=t))  # type: ignore[operator]
    with pytest.raises(LogError, match="one sample only"):
        function(uniform(samples=1))  # type: ignore[operator]
    assert not is_uniform(uniform(t=t))
    assert not is_uniform(uniform(samples=1))


def test_time_steps() -> None:
    (steps,) = log_at(drop(0.01 * np.arange(501), (100, 5))).steps
    assert (steps.shortest, steps.median, steps.longest) == pytest.approx((0.01, 0.01, 0.06))
    assert str(steps).endswith("1 gap of more than 3 steps")


@settings(max_examples=50)
@given(
    seed=st.integers(0, 1000),
    start=st.sampled_from([0.0, -3.0, 1.7e9]),
    low=st.floats(0.3, 1.0),
)
def test_grid_covers_the_log_and_resampling_twice_changes_nothing(
    seed: int, start: float, low: float
) -> None:
    t = start + stamps(seed, 400, low, 2.0 - low)
    result = log_at(t).even
    step = 1.0 / result.rates[0]
    assert result.t[0] == t[0]
    assert t[-1] - step * 1.001 < result.t[-1] <= t[-1] + 1e-4 * step
    again = result.even
    assert torch.equal(again.q, result.q)
    assert torch.allclose(again.t, result.t, rtol=0, atol=1e-6)


def test_parts_of_one_uneven_trajectory_have_one_step() -> None:
    """Slow before a gap and fast after it: one rate, for it was one log."""
    t = np.r_[np.arange(0, 10, 0.02), np.arange(11, 21, 0.01)]
    even = log_at(t).even
    assert len(even.names) == 2
    assert len(set(even.rates)) == 1


@pytest.mark.parametrize("lost", [0, 40])
@pytest.mark.parametrize("jitter", [20e-6, 80e-6, 400e-6])
def test_stamps_that_jitter_about_a_regular_clock_are_put_right(jitter: float, lost: int) -> None:
    """At face value a joint's acceleration would be wrong by a part that grows with the rate."""
    draw = np.random.default_rng(5)
    t = np.delete(np.arange(3000) / 250, draw.choice(np.arange(9, 2990), lost, replace=False))
    log = log_at(t, 2)
    even = log.replace(t=log.t + torch.from_numpy(jitter * draw.normal(size=len(t)))).even
    assert even.rates == (pytest.approx(250.0, rel=1e-5),)
    q = torch.from_numpy(motion(even.t.numpy(), 2)[0])
    for k, most in ((1, 1e-3), (2, 1e-2)):
        error = (even.q - q).diff(k, dim=0) * 250**k
        assert error[50:-50].std() < most


@pytest.mark.parametrize("jitter", [20e-6, 80e-6, 400e-6])
def test_stamps_of_rows_that_were_taken_unevenly_are_kept(jitter: float) -> None:
    t = np.arange(3000) / 250 + jitter * np.random.default_rng(6).normal(size=3000)
    even = log_at(t, 2).even
    assert errors(even)["q"] < 1e-6
