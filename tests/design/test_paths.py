"""One path at two speeds is found, whatever the time between its postures; other paths are not."""

import math

import pytest
import torch

from tests.gap.motions import RATE, motion_at, segment_of, times
from torchid.design.paths import same_paths
from torchid.design.repeats import find_repeats
from torchid.design.segments import Segment
from torchid.effects.base import Motion


def back_and_forth(degrees: float, rest: float = 1.0, to: float = 60.0) -> Segment:
    """One joint goes to several angles at constant speed, and rests at each."""
    legs, speed = (to, -50.0, 30.0, 10.0 - to), math.radians(degrees)
    parts: list[float] = []
    for leg in legs:
        parts += [0.0] * round(rest * RATE)
        parts += [math.copysign(speed, leg)] * round(math.radians(abs(leg)) / speed * RATE)
    dq = torch.tensor(parts, dtype=torch.float64)[:, None]
    q = dq.cumsum(0) / RATE
    return segment_of(Motion(q, dq, torch.zeros_like(q), t=times(len(q) / RATE)))


@pytest.mark.parametrize("faster", [0.5, 2.0, 5.0])
def test_a_path_at_another_speed_is_found(faster):
    segments = [back_and_forth(10.0), back_and_forth(10.0 * faster)]
    assert len(find_repeats(segments)) == 0
    (pair,) = same_paths(segments)
    assert (pair.a, pair.b) == (0, 1)
    assert pair.speed == pytest.approx(faster, rel=0.02)


def test_other_rests_are_the_same_path_at_the_same_speed():
    (pair,) = same_paths([back_and_forth(20.0), back_and_forth(20.0, rest=2.5)])
    assert pair.speed == pytest.approx(1.0, rel=0.02)


@pytest.mark.parametrize("seed", range(3))
def test_a_motion_of_three_joints_at_three_speeds(seed):
    """A part of it at the highest speed, with time that runs unevenly."""
    t = times(12.0)
    motions = [motion_at(t, seed)]
    for speed, count in ((0.5, 24.0), (1.5, 6.0)):
        s = times(count)
        own = speed * (s + 0.2 * s.sin())
        rate = speed * (1 + 0.2 * s.cos())
        there = motion_at(own, seed)
        motions.append(Motion(there.q, there.dq * rate[:, None], there.ddq, t=s))
    pairs = same_paths([segment_of(m) for m in motions])
    assert (0, 1) in [(p.a, p.b) for p in pairs]


@pytest.mark.parametrize("seed", range(4))
def test_other_motions_have_other_paths(seed):
    others = [segment_of(motion_at(times(), s)) for s in (seed, seed + 10, seed + 20)]
    reverse = others[0].motion
    back = Motion(reverse.q.flip(0), -reverse.dq.flip(0), reverse.ddq, t=reverse.t)
    assert not same_paths([*others, segment_of(back)])
    assert not same_paths([back_and_forth(10.0), back_and_forth(20.0, to=90.0)])
