"""Segments and their samples: one filter for all signals, and the samples that count."""

import math
from dataclasses import replace

import pytest
import torch

from tests.gap.motions import RATE, motion_at, noise, segment_of, times
from torchid.design.motion import measurements, moves
from torchid.design.segments import (
    REACH,
    Samples,
    Segment,
    moving_instants,
    moving_samples,
    reach_of,
    segments_of,
    still_joints,
    when,
    widened,
)
from torchid.effects.base import Motion
from torchid.log.model import Log

CUTOFF = 8.0


def sines(*frequencies: float, seconds: float = 12.0) -> Segment:
    """Joints that swing with these angular frequencies, about which everything is known."""
    t = times(seconds)
    w = torch.tensor(frequencies, dtype=torch.float64)
    angle = t[:, None] * w
    return segment_of(Motion(angle.sin(), w * angle.cos(), -(w**2) * angle.sin(), t=t))


def log_of(segment: Segment, rows: slice = slice(None)) -> Log:
    t = segment.motion.t[rows]
    return Log(t - t[0], segment.motion.q[rows], tau=segment.motion.q[rows].cos())


def test_segments_hold_the_log_and_their_time_runs_on():
    run = sines(2.0, 3.0)
    log = Log.concatenate([log_of(run), log_of(run, slice(0, 2000))])
    one, two = segments_of(measurements(log, 40.0), 40.0, clock=5.0)
    assert one.start == 5.0
    assert two.start == pytest.approx(5.0 + 12.0)
    assert (one.length, two.length, one.n) == (3000, 2000, 2)
    assert not one.own_velocity
    inner = slice(100, -100)
    assert torch.allclose(one.motion.q[inner], run.motion.q[inner], atol=1e-4)
    assert torch.allclose(one.motion.ddq[inner], run.motion.ddq[inner], atol=0.02)
    assert when([one, two], 18.5) == (two.name, pytest.approx(1.5))
    assert when([one, two], 5.5) == (one.name, pytest.approx(0.5))
    later = replace(two, stamp=1000.0)  # as the clock of its log has it
    assert when([one, later], 18.5) == (two.name, pytest.approx(1001.5))


def test_a_fast_log_is_put_on_a_coarser_grid():
    t = times(6.0, rate=1000.0)
    q = torch.stack([(2 * t).sin(), (3 * t).sin()], -1)
    (found,) = segments_of(measurements(Log(t, q, tau=q.cos()), 40.0), 40.0)
    assert found.rate == 250.0
    assert torch.allclose(found.tau[50:-50], q.cos()[::4][50:-50], atol=1e-4)


def test_samples_are_those_of_the_filtered_signal():
    """Noise and jumps, filtered on the segment's grid and read there."""
    runs = [segment_of(motion_at(times(s), seed=k)) for k, s in enumerate((6.0, 9.0))]
    samples = Samples(runs, CUTOFF)
    g = torch.Generator().manual_seed(0)
    signals = [noise(s.length, 3, g) + s.motion.dq.sign() for s in runs]
    found = samples.of([x.T for x in signals])
    expected = samples.pick([samples.low_passed(x) for x in signals]).T
    assert found.shape == (3, len(samples)) == (3, samples.bounds[-1].stop)
    assert torch.allclose(found, expected, atol=0.01)
    assert samples.interval == pytest.approx(1 / (2.5 * CUTOFF), rel=0.1)
    own = samples.t[samples.bounds[1]]
    assert float(own[0]) == pytest.approx(samples.edge / RATE)
    assert torch.allclose(own.diff(), torch.tensor(samples.interval))


def test_what_is_slow_passes_and_what_is_fast_does_not():
    run = sines(1.0)
    samples = Samples([run], CUTOFF)
    t = run.motion.t
    slow, fast = ((2 * math.pi * f * t).sin()[None] for f in (0.5, 30.0))
    assert torch.allclose(samples.of([slow])[0], samples.pick([slow[0]]), atol=1e-3)
    assert float(samples.of([fast]).abs().max()) < 1e-3


def test_a_narrow_log_is_not_filtered():
    run = segment_of(sines(1.0).motion.every(10), rate=25.0)
    samples = Samples([run], 12.0)
    assert torch.equal(samples.of([run.motion.q.T]), samples.pick([run.motion.q]).T)


def test_segments_of_different_rates_are_a_mistake():
    with pytest.raises(AssertionError, match="one rate"):
        Samples([sines(1.0), segment_of(sines(1.0).motion, rate=100.0)], CUTOFF)


def test_samples_at_reversals_do_not_slide():
    """A sine reverses at its peaks: it moves but for an instant, and slides away from there."""
    run = sines(2.0, 3.0)
    samples = Samples([run], CUTOFF)
    moves, slides = moving_samples(samples), moving_samples(samples, REACH / CUTOFF)
    assert not bool((slides & ~moves).any())
    for j, w in enumerate((2.0, 3.0)):
        away = (samples.t * w / math.pi - 0.5) % 1.0 * math.pi / w  # since the last peak [s]
        away = torch.minimum(away, math.pi / w - away)
        assert bool(moves[j][away > 0.02].all())
        assert not bool(slides[j][away < 0.9 * REACH / CUTOFF].any())
        assert bool(slides[j][away > 1.1 * REACH / CUTOFF].all())


def test_each_joint_has_its_own_reach():
    samples = Samples([sines(2.0, 3.0)], CUTOFF)
    near, far = (moving_samples(samples, k * REACH / CUTOFF) for k in (1, 2))
    mixed = moving_samples(samples, torch.tensor([1.0, 2.0]) * REACH / CUTOFF)
    assert torch.equal(mixed[0], near[0])
    assert torch.equal(mixed[1], far[1])
    assert int(far.sum()) < int(near.sum())
    assert not bool((far & ~near).any())


def test_a_reversal_reaches_as_far_as_it_is_heard_beside_the_noise():
    """The filtered pulse of a direction that is wrong for an eighth of a period, by hand."""
    samples, dry = Samples([sines(2.0, 3.0)], CUTOFF), torch.tensor([50.0, 400.0])
    far = reach_of(samples, dry) * CUTOFF
    assert REACH <= float(far[0]) < float(far[1]) < 4.0
    pulse = torch.zeros(4001, 1)
    half = round(0.0625 * RATE / CUTOFF)
    pulse[2000 - half : 2001 + half] = 2.0
    heard = samples.low_passed(pulse)[2000:, 0].abs()
    for own, ratio in zip(far.tolist(), dry.tolist(), strict=True):
        last = round(own * RATE / CUTOFF)
        assert float(heard[last - 1] * ratio) > 1.0
        assert float(heard[last:].max() * ratio) <= 1.0
    little = reach_of(samples, torch.tensor([0.0, 1.0])) * CUTOFF
    assert little.tolist() == pytest.approx([REACH, REACH])


def test_a_joint_at_rest_counts_only_if_it_hardly_ever_moves():
    run = sines(2.0, 2.0, 2.0)
    dq = run.motion.dq.clone()
    half = run.length // 2
    dq[half:, 1] = 0.0
    dq[:, 2] = 0.0
    counts = moving_instants(segment_of(run.motion._replace(dq=dq)))
    assert not bool(counts[half:, 1].any())
    assert float(counts[:half, 1].double().mean()) > 0.9
    assert bool(counts[:, 2].all())


def test_a_slow_joint_rests_by_its_own_speeds_and_a_held_one_by_absolute_ones():
    """Joint 1 at 18 mrad/s, to and fro with pauses of a third of the time; joint 2 is held, and its
    velocity is noise."""
    t = torch.arange(0, 48.0, 1 / RATE, dtype=torch.float64)
    pause = (t % 3.0) < 1.0
    dq = 0.018 * torch.where(((t / 3).floor() % 2) == 0, 1.0, -1.0) * ~pause
    noise = 0.006 * torch.randn(len(t), generator=torch.Generator().manual_seed(0)).double()
    dq = torch.stack([dq, noise], 1)
    q = dq.cumsum(0) / RATE
    motion = Motion(q, dq, torch.zeros_like(q), torch.sign(dq))
    counts = moving_instants(segment_of(motion))
    assert torch.equal(counts[:, 0], ~pause)
    assert bool(counts[:, 1].all()), "it hardly moves: all of its samples tell what holds it"


def stretched(times: float, size: float = 1.0, noise: float = 0.0) -> Log:
    """A log of 20 s, driven so many times as slowly and as far: joint 1 goes to and fro, joint 2
    half as far with dwells, joint 3 is held, and all positions have noise."""
    g = torch.Generator().manual_seed(0)
    t = torch.arange(0, 20.0 * times, times / RATE, dtype=torch.float64)
    s = t / times
    dwelling = 0.25 * (1 - (math.pi * (s % 4).clamp(max=2.0)).cos())
    q = size * torch.stack([0.5 * (1.3 * s).sin(), dwelling, torch.zeros_like(s)], -1)
    q = q + noise * torch.randn(q.shape, generator=g, dtype=torch.float64)
    return Log(t, q, tau=torch.zeros_like(q))


@pytest.mark.parametrize("size", [1.0, 0.02])
@pytest.mark.parametrize("times", [1.0, 5.0, 20.0])
def test_what_moves_is_told_by_the_speeds_of_the_log(times: float, size: float):
    """Twenty times as slow, and fifty times as far: the same instants move."""
    before, log = stretched(1.0), stretched(times, size, 1e-6 * size / times)
    seen = []
    for one in (before, log):
        made = segments_of(measurements(one, 0.1 * one.rates[0]), 0.1 * one.rates[0])
        assert still_joints(made) == (2,)
        inner = slice(made[0].length // 20, -made[0].length // 20)
        seen.append(moves(made[0].motion, made[0].moving)[inner, :2].double())
    assert torch.allclose(*(x.mean(0) for x in seen), atol=0.07)
    assert 0.4 < float(seen[1][:, 1].mean()) < 0.6


def test_noise_of_a_standing_arm_is_no_slow_motion():
    log = stretched(1.0, size=0.0, noise=1e-5)
    assert still_joints(segments_of(measurements(log, 40.0), 40.0)) == (0, 1, 2)
    rough = stretched(1.0, size=0.0, noise=1e-4)
    assert still_joints(segments_of(measurements(rough, 40.0), 40.0)) == (0, 1, 2)


def test_joints_that_never_move():
    run = sines(2.0, 3.0)
    q = run.motion.q * torch.tensor([1.0, 1e-4])
    assert still_joints([segment_of(run.motion._replace(q=q))]) == (1,)
    assert still_joints([run]) == ()


def test_a_mask_is_widened_on_both_sides():
    mask = torch.zeros(11, 2)
    mask[5, 0] = mask[0, 1] = 1.0
    found = widened(mask, 2.2).nonzero().tolist()
    assert found == [[0, 1], [1, 1], [2, 1], [3, 0], [4, 0], [5, 0], [6, 0], [7, 0]]
