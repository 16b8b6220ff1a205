"""Repeats of a motion: found where they are, and only there; aligned better than noise."""

import math

import pytest
import torch

from tests.gap.motions import RATE, motion_at, noise, segment_of, times
from tests.log.examples import log_at, uniform
from torchid.design.repeats import delayed, find_repeats, repeated_motion
from torchid.design.segments import Segment
from torchid.effects.base import Motion
from torchid.log.model import Log


def periodic(periods: float, period: float, seed: int = 0, rate: float = RATE) -> Motion:
    """Three joints, five harmonics, a ramp of a second in front."""
    g = torch.Generator().manual_seed(seed)
    t = times(periods * period, rate=rate)
    a, b = torch.randn(2, 5, 3, generator=g, dtype=torch.float64) / torch.arange(1, 6)[:, None]
    w = 2 * math.pi / period * torch.arange(1, 6, dtype=torch.float64)
    wt = t[:, None] * w
    q = wt.sin() @ a + wt.cos() @ b
    dq = (w * wt.cos()) @ a - (w * wt.sin()) @ b
    ddq = -(w * w * wt.sin()) @ a - (w * w * wt.cos()) @ b
    return Motion(q, dq, ddq, t=t)


@pytest.mark.parametrize("late", [0.0, 0.5, 1.2345, -0.7011])
def test_a_reference_run_twice_is_found_with_its_lag(late):
    """The second run starts `late` seconds later on the reference, and is shorter."""
    one, two = motion_at(times(16.0, 1.0)), motion_at(times(14.0, 1.0 + late))
    (pair,) = find_repeats([segment_of(one), segment_of(two)]).pairs
    assert (pair.a, pair.b) == (0, 1)
    lag = pair.rows_b.start - pair.rows_a.start + pair.shift
    assert lag == pytest.approx(-late * RATE, abs=2e-3)
    assert pair.rows_a.stop - pair.rows_a.start >= (16 - 2 - abs(late) - 1) * RATE - 2


@pytest.mark.parametrize("period", [5.0, 6.1234])
def test_periods_within_a_trajectory_are_found(period):
    segment = segment_of(periodic(4, period))
    (pair,) = find_repeats([segment]).pairs
    lag = pair.rows_b.start - pair.rows_a.start + pair.shift
    assert lag == pytest.approx(period * RATE, abs=2e-3)
    assert (pair.rows_a.stop - pair.rows_a.start) / RATE == pytest.approx(3 * period, abs=0.6)


def test_what_is_not_repeated_is_left_out():
    """A run that leaves the reference half-way is compared on its first half only."""
    t = times(20.0)
    same, other = motion_at(t), motion_at(t, seed=1)
    share = torch.sigmoid((t - 10) / 0.2)[:, None]
    rate = share * (1 - share) / 0.2
    gap = other.q - same.q
    mixed = Motion(
        same.q + share * gap, same.dq + share * (other.dq - same.dq) + rate * gap, same.ddq, t=t
    )
    (pair,) = find_repeats([segment_of(same), segment_of(mixed)]).pairs
    assert pair.rows_a.start / RATE < 1
    assert 7 < pair.rows_a.stop / RATE < 10


@pytest.mark.parametrize("seed", range(4))
def test_different_motions_and_dwells_are_no_repeats(seed):
    moving = [segment_of(motion_at(times(), s)) for s in (seed, seed + 10)]
    assert len(find_repeats(moving)) == 0
    # Point to point: long dwells at the same place, different motion in between.
    t = times(20.0)
    out = []
    for k in (0, 1):
        rise = torch.stack([torch.tanh(3 * (t - 9 - 2 * k)) * (-1) ** k], -1)
        slope = 3 * (1 - rise**2) * (-1) ** k
        out.append(segment_of(Motion(rise, slope, torch.zeros_like(rise), t=t)))
    assert len(find_repeats(out)) == 0


@pytest.mark.parametrize("late", [0.0, 0.4321])
def test_alignment_adds_no_noise(late):
    """Torque that repeats leaves a difference of a few 1e-4 of its size, whatever the fraction of a
    sample between the runs; noise of either run keeps its size."""
    g = torch.Generator().manual_seed(0)
    motions = [motion_at(times(15.0, 1.0 + x)) for x in (0.0, late)]
    segments = [segment_of(m._replace(q=m.q + 1e-5 * noise(*m.q.shape, g))) for m in motions]
    found = find_repeats(segments)
    torque = [20 * m.q.sin() + 3 * torch.tanh(5 * m.dq) for m in motions]
    (clean,) = found.differences(torque)
    assert float(clean.std() / torque[0].std()) < 3e-4
    (noisy,) = found.differences([x + noise(*x.shape, g) for x in torque])
    assert float(noisy.std()) == pytest.approx(1.0, abs=0.03)


def test_three_runs_make_two_pairs():
    runs = [segment_of(motion_at(times(15.0, 0.1 * k))) for k in range(3)]
    assert [(p.a, p.b) for p in find_repeats(runs).pairs] == [(0, 1), (1, 2)]


def test_delay_by_spectrum_is_a_delay():
    t = times(4.0)
    x = torch.stack([torch.sin(2 * math.pi * f * (t - 2)) for f in (0.5, 3.0)])
    y = torch.stack([torch.sin(2 * math.pi * f * (t - 2 - 0.3 / RATE)) for f in (0.5, 3.0)])
    inner = slice(100, -100)
    assert torch.allclose(delayed(x, 0.3)[:, inner], y[:, inner], atol=2e-5)


@pytest.mark.nightly
def test_ten_minutes():
    motion = periodic(60, 10.0)
    segment = segment_of(Motion(*(torch.cat([x, x.flip(-1), x[:, :1]], -1) for x in motion.state)))
    assert motion.q.shape[0] == 150_000
    found = find_repeats([segment])
    found.differences([segment.tau])
    (pair,) = found.pairs
    assert pair.rows_b.start - pair.rows_a.start + pair.shift == pytest.approx(2500, abs=1e-2)


def test_a_second_run_is_found_where_it_begins() -> None:
    """The second run begins 1.5 s later on the same motion."""
    t = 0.01 * torch.arange(1200, dtype=torch.float64)
    one = log_at(t.numpy())
    two = log_at((t[:900] + 1.5).numpy()).replace(t=t[:900], names=("second",), tau=None)
    (repeat,) = repeated_motion(Log.concatenate([one.replace(tau=None), two]))
    assert (repeat.first, repeat.second) == ("example", "second")
    assert repeat.start_first - repeat.start_second == pytest.approx(1.5, abs=0.02)
    assert repeat.duration > 8.0


def test_nothing_where_nothing_repeats_or_all_is_short() -> None:
    assert repeated_motion(uniform(samples=100)) == ()
    one = uniform(samples=800)
    other = one.replace(q=one.q.flip(-1) * torch.linspace(0.2, 2, 800)[:, None], dq=None, ddq=None)
    assert repeated_motion(Log.concatenate([one.replace(dq=None, ddq=None), other])) == ()


def test_a_motion_does_not_repeat_itself_at_no_lag() -> None:
    """A chirp that begins slowly nearly agrees with what comes a little later, down to no lag."""
    rate, seconds = 50.0, 120.0
    t = torch.arange(round(seconds * rate), dtype=torch.float64) / rate
    phase = 2 * math.pi * (0.01 * t + (2.0 - 0.01) / (2 * seconds) * t * t)
    q = torch.stack([phase.sin(), 0.5 * (phase + 0.3).sin()], 1)
    dq = torch.gradient(q, dim=0)[0] * rate
    motion = Motion(q, dq, torch.zeros_like(q))
    chirp = Segment("chirp", rate, rate / 2, motion, q, own_velocity=False)
    assert len(find_repeats([chirp])) == 0


@pytest.mark.parametrize("seconds", [1.9, 2.0, 2.04, 2.1])
def test_a_motion_as_short_as_a_stretch_repeats_nothing(seconds: float) -> None:
    assert len(find_repeats([segment_of(motion_at(times(seconds)))])) == 0
