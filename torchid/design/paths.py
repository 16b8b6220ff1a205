"""Motions along one path, timed otherwise: they tell friction by speed, and nothing of the noise.

A path is a sequence of postures, whatever the time between them. A motion has the path of another
one if all of it can be walked within the other, both forwards, without ever being apart: what
Fréchet's distance asks. The shorter one may be a part of the longer.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchid.design.repeats import spread_of
from torchid.design.segments import Segment
from torchid.typing import Float, Samples, Tensor

APART = 0.1
"""Distance at which two postures are the same, in standard deviations of each joint (of the
liveliest one's a tenth at least): about 3 % of its range, more than an arm lags when it is fast."""

LONGEST = 5_000
"""Postures of a motion beyond which it is not compared."""


@dataclass(frozen=True)
class SamePath:
    """Two segments, by number, along one path; how often b is as fast as a."""

    a: int
    b: int
    speed: float


def same_paths(segments: Sequence[Segment]) -> list[SamePath]:
    """Pairs of segments along one path, those of most similar speeds first.

    Args:
        segments: in the order of recording.
    """
    found = []
    ends = [torch.stack([*s.motion.q[:].aminmax(dim=0)]) for s in segments]
    for b, two in enumerate(segments):
        # 10: motions before one that it is compared with
        for a in range(max(0, b - 10), b):
            one = segments[a]
            spread = spread_of(one.motion.q)
            if bool(((ends[a] - ends[b]).abs() > 2 * APART * spread).any()):
                continue
            shorter, longer = sorted((_postures(s, spread) for s in (one, two)), key=len)
            if len(longer) <= LONGEST and _walks(shorter, longer):
                found.append(SamePath(a, b, _speed(two, spread) / _speed(one, spread)))
    return sorted(found, key=lambda pair: max(pair.speed, 1 / pair.speed))


def _postures(segment: Segment, spread: Float[Tensor, " n"]) -> Samples:
    """Where a motion goes, a posture each time that a joint has gone half of `APART`."""
    q = segment.motion.q[:] / spread
    cell = (2 * q / APART).round()
    changes = (cell.diff(dim=0) != 0).any(1)
    return q[torch.nn.functional.pad(changes, (1, 0), value=True)]


def _walks(shorter: Float[Tensor, "T n"], longer: Float[Tensor, "U n"]) -> bool:
    """Whether all of one path can be walked within another."""
    index = torch.arange(len(longer))
    reached = torch.ones(len(longer), dtype=torch.bool)
    for posture in shorter:
        near = ((longer - posture).abs() <= APART).all(1)
        # A place is entered from where one was, or from one place before it; from there one goes on
        # while places are near.
        entered = reached.clone()
        entered[1:] |= reached[:-1]
        entry = torch.where(entered & near, index, -1).cummax(0).values
        barred = torch.where(near, -1, index).cummax(0).values
        reached = entry > barred
        if not bool(reached.any()):
            return False
    return True


def _speed(segment: Segment, spread: Float[Tensor, " n"]) -> float:
    """Mean speed over the path [standard deviations/s], in which rests do not count."""
    speed = (segment.motion.dq[:] / spread).norm(dim=1)
    return float(speed.square().sum() / speed.sum().clamp(min=1e-300))
