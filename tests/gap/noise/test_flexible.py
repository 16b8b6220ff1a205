"""A flexible predictor: nothing in noise, much in what is a function of the motion."""

import pytest
import torch

from tests.gap.motions import motion_at, noises, segment_of, times
from tests.marks import quick_first, some
from torchid.design.segments import Samples, Segment
from torchid.effects.base import Motion
from torchid.gap.noise.flexible import predict_out_of_fold


def segments_of_seed(seed: int, robot: str = "3r", duration: float = 20.0) -> list[Segment]:
    out = []
    for k in range(3):
        m = motion_at(times(duration), 10 * seed + k, robot)
        m = m._replace(t=m.t + 30 * k, torque=20 * m.q.sin() + m.ddq)
        out.append(segment_of(m, name=f"run{k}"))
    return out


def motions(segments: list[Segment]) -> list[Motion]:
    return [s.motion for s in segments]


@pytest.mark.parametrize("hz", some([2.0, None, 0.5], 1))
def test_noise_is_not_predicted(hz):
    """Of 15 joints at most two have a positive lower bound (2.5 % each), and R^2 is about zero."""
    r2, lower = [], []
    for seed in range(5):
        segments = segments_of_seed(seed)
        samples = Samples(segments, 8.0)
        found = predict_out_of_fold(
            motions(segments), samples, samples.of([x.T for x in noises(segments, seed, hz)])
        )
        r2.append(found.r2)
        lower.append(found.interval[:, 0])
    r2, lower = torch.cat(r2), torch.cat(lower)
    assert int((lower > 0).sum()) <= 2
    assert float(r2.abs().median()) < 0.01
    assert float(r2.min()) > -0.1
    assert float(r2.max()) < 0.1


@pytest.mark.parametrize("seed", quick_first(range(2), 1))
def test_a_hidden_function_of_the_motion_is_found(seed):
    """On joint 2 only, of its position and speed; what remains is near the noise."""
    segments = segments_of_seed(seed)
    samples = Samples(segments, 8.0)
    noise = samples.of([x.T for x in noises(segments, seed, 5.0)])
    hidden = samples.of(
        [
            (torch.tensor([0.0, 1.0, 0.0]) * (3 * torch.tanh(4 * p.motion.dq) * p.motion.q.cos())).T
            for p in segments
        ]
    )
    found = predict_out_of_fold(motions(segments), samples, noise + hidden)
    best = 1 - noise[1].square().sum() / (noise + hidden)[1].square().sum()
    assert float(found.r2[1]) > 0.7 * float(best)
    assert float(found.interval[1, 0]) > 0.3
    assert float(found.r2[[0, 2]].abs().max()) < 0.05
    left = found.left(noise + hidden)
    assert float(left[1].square().mean() / noise[1].square().mean()) < 2.5


@pytest.mark.slow
def test_the_same_seed_gives_the_same():
    segments = segments_of_seed(0)
    samples = Samples(segments, 8.0)
    noise = samples.of([x.T for x in noises(segments, 0, 5.0)])
    one, two = (predict_out_of_fold(motions(segments), samples, noise, seed=3) for _ in range(2))
    assert torch.equal(one.prediction, two.prediction)


@pytest.mark.slow
def test_joints_that_are_not_asked_for_are_not_predicted():
    segments = segments_of_seed(0)
    samples = Samples(segments, 8.0)
    known = samples.of([3 * torch.tanh(4 * s.motion.dq).T for s in segments])
    every = predict_out_of_fold(motions(segments), samples, known)
    some = predict_out_of_fold(motions(segments), samples, known, joints=[1])
    assert torch.equal(some.prediction[1], every.prediction[1])
    assert float(some.prediction[[0, 2]].abs().max()) == 0
    assert some.r2[[0, 2]].tolist() == [0.0, 0.0]
    assert torch.equal(some.left(known)[0], known[0])


@pytest.mark.slow
def test_a_row_does_not_predict_itself():
    """A spike changes no prediction within its own block, where its fold is held out; the shrinkage
    may move by as little as one row weighs."""
    segments = segments_of_seed(1)
    samples = Samples(segments, 8.0)
    noise = samples.of([x.T for x in noises(segments, 1)])
    smooth = samples.of([3 * torch.tanh(4 * p.motion.dq).T for p in segments])
    spiked = noise + smooth
    spiked[0, 600] += 5.0
    found = [predict_out_of_fold(motions(segments), samples, r) for r in (noise + smooth, spiked)]
    a, b = (f.prediction for f in found)
    assert float((a - b)[0, 598:603].abs().max()) < 0.05
    assert torch.equal(a[1:], b[1:])


@pytest.mark.parametrize("duration", [1.5, 4.0])
def test_short_logs_do_not_break_it(duration):
    segments = segments_of_seed(0, duration=duration)
    samples = Samples(segments, 8.0)
    noise = samples.of([x.T for x in noises(segments, 0)])
    found = predict_out_of_fold(motions(segments), samples, noise)
    assert bool(found.prediction.isfinite().all())
    assert float(found.r2.max()) < 0.3
