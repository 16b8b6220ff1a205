"""An earlier log beside the one that is asked, as one problem (`torchid.gap.causes.earlier`); and
whether it may be."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from scipy.interpolate import make_interp_spline

from torchid.design.bands import sharp_direction
from torchid.design.columns import Columns
from torchid.design.motion import HARDLY, moves
from torchid.design.repeats import Repeats, find_repeats
from torchid.design.segments import Samples, Segment, moving_samples
from torchid.gap.data import prepare
from torchid.gap.describe.model import blocks_of
from torchid.gap.describe.noise import sliding_only
from torchid.gap.folds import make_folds
from torchid.gap.problem import Problem
from torchid.gap.rows import LogRows, source_of, trajectories
from torchid.log.model import Log
from torchid.robot.model import torque_unit
from torchid.typing import Bool, Float, Tensor

LEFT_OUT = "Earlier log left out, so that nothing counts as new:"
"""How the warning begins that an earlier log is left out."""

MISFIT = 0.1
"""Error, over the torque of the whole arm, beyond which a model does not explain its own log, and
no two logs [1]: on six real arms models leave .03 to .1 of the torque."""


@dataclass(frozen=True, eq=False)
class Earlier:
    """An earlier log of the arm.

    Attributes:
        segments: its trajectories.
        cutoff: up to which they say anything [Hz].
        source: of the log, in words.
        own: whether the model was made from it.
    """

    segments: tuple[Segment, ...]
    cutoff: float
    source: str
    own: bool = False


def beside(problem: Problem, earlier: Earlier) -> Problem:
    """A problem over an earlier log as well as its own."""
    data = problem.data
    before = [at_rate(s, data.samples.rate) for s in earlier.segments]
    segments = in_common([*before, *data.segments])
    samples = Samples(segments, min(earlier.cutoff, data.samples.cutoff))
    given = Columns(problem.given.model, samples)
    keep, robot = moving_samples(samples), problem.robot
    keep[list(robot.free)] = True
    keep[list(data.silent)] = False
    # Between the logs something may have changed: what differs there is no noise.
    first = len(before)
    later = (replace(p, a=p.a + first, b=p.b + first) for p in problem.repeats.pairs)
    repeats = Repeats((*find_repeats(segments[:first]).pairs, *later))
    apart = tuple(repeats.segments(segments, given.gaps))
    keep = sliding_only(given, keep, data.band, apart)
    missing = data.missing
    missing |= {"velocity"} if not all(s.own_velocity for s in segments) else set()
    missing |= {"age"} if segments[0].motion.age is None else set()
    both = replace(data, samples=samples, keep=keep, missing=missing, lag=None)
    asked = torch.arange(len(samples)) >= samples.bounds[first].start
    # Parts of the log that is asked are left out, beside all of the earlier one.
    own = Samples(segments[first:], samples.cutoff)
    groups = problem.repeats.groups(len(data.segments))
    folds = make_folds(own, problem.settings.folds, groups)
    held = torch.full((len(samples) - len(own),), -1)
    border = torch.cat([held > 0, folds.border])
    folds = replace(folds, fold=torch.cat([held, folds.fold]), border=border)
    return replace(
        problem, given=given, data=both, folds=folds, block=blocks_of(both, given),
        repeats=repeats, apart=apart, asked=asked,
    )  # fmt: skip


def earlier_of(before: Log | LogRows, problem: Problem, force: bool = False) -> Earlier:
    """An earlier log as trajectories in the bands of a problem's.

    Args:
        before: the log, or what a model's file has kept of it.
        problem: of the log that is asked.
        force: whether units that look wrong are said, and not refused.

    Raises:
        LogError: what `torchid.gap.data.prepare` refuses.
    """
    if isinstance(before, LogRows):
        return Earlier(trajectories(before), before.cutoff, before.source, own=True)
    own = problem.data
    data = prepare(
        problem.robot, before, own.samples.cutoff, 0.0, own.band, own.gain_std, own.samples.rate,
        force,
    )  # fmt: skip
    return Earlier(data.segments, data.samples.cutoff, source_of(before.names))


def why_left_out(earlier: Earlier, problem: Problem) -> str:
    """A sentence that an earlier log says nothing of what is new: no joint moves, or the torque is
    not of the size that the model has; empty where it does.

    A model explains the log that it was made from. Of any other an earlier log may differ as an arm
    differs from its model (`errors_of`).
    """
    segments, known = earlier.segments, problem.robot.knowledge
    samples = Samples(segments, earlier.cutoff)
    slides = torch.cat([moves(s.motion, s.moving) for s in segments]).double().mean(0) >= HARDLY
    keep = moving_samples(samples) & slides[:, None]
    if not bool(keep.any()):
        return f"{LEFT_OUT} {earlier.source}. No joint moves in it."
    if not earlier.own:
        return ""
    gap = Columns(problem.given.model, samples).gap
    torque = samples.of([s.tau.T for s in segments])
    error, measured = (_arm_rms(x, keep) for x in (gap, torque))
    left = 0.0 if known is None or known.left is None else float(known.left[slides].norm())
    expected = math.hypot(MISFIT * measured, left)
    if error <= expected:
        return ""
    unit = torque_unit(problem.robot)
    return (
        f"{LEFT_OUT} {earlier.source}. Beside its torque of {measured:.3g} "
        f"{unit} the model errs by {error:.3g}, where {expected:.2g} was to be expected. Is it of "
        "this arm, and in this unit? `before=...` gives another log."
    )


def errors_of(left: np.ndarray, problem: Problem) -> list[float]:
    """What an explanation leaves over the torque, of the whole arm: on an earlier log, if there is
    one, and on the log that is asked [1].

    Args:
        left: (n, N) samples [N m; N].
        problem: that is explained.
    """
    samples = problem.data.samples
    # Of joints that do not slide in the log that is asked nothing is looked for.
    keep = problem.data.keep & problem.data.slides[:, None]
    torque = samples.of([s.tau.T for s in samples.segments])
    asked = keep.new_ones(keep.shape[1]) if problem.asked is None else problem.asked
    parts = [keep * part for part in (~asked, asked) if bool(part.any())]
    return [
        _arm_rms(torch.from_numpy(left), part) / max(_arm_rms(torque, part), 1e-300)
        for part in parts
    ]


def _arm_rms(x: Float[Tensor, "n N"], keep: Bool[Tensor, "n N"]) -> float:
    """RMS of the whole arm, in which joints that hold most of the torque say most."""
    squares = (x.square() * keep).sum(1) / keep.sum(1).clamp(min=1)
    return float(squares.sum().sqrt())


def in_common(segments: Sequence[Segment]) -> list[Segment]:
    """Segments with those signals alone that all of them have."""
    fields = segments[0].motion._fields
    gone = [k for k in fields if any(getattr(s.motion, k) is None for s in segments)]
    nothing: dict[str, Any] = dict.fromkeys(gone)
    return [replace(s, motion=s.motion._replace(**nothing)) for s in segments]


def at_rate(segment: Segment, rate: float) -> Segment:
    """A segment on a grid of another rate [Hz]."""
    if abs(rate / segment.rate - 1) < 1e-9:
        return replace(segment, rate=rate)
    motion = segment.motion
    count = int((segment.length - 1) / segment.rate * rate) + 1
    old, new = (np.arange(k) / r for k, r in ((segment.length, segment.rate), (count, rate)))

    def read(x: torch.Tensor) -> torch.Tensor:
        return torch.from_numpy(make_interp_spline(old, x.numpy(), k=3)(new))

    q, dq, ddq = (read(x) for x in motion.state)
    t = motion.require("t", "a segment")[0] + torch.from_numpy(new)
    motion = motion._replace(q=q, dq=dq, ddq=ddq, t=t, direction=None, age=None, lag=None)
    made = replace(segment, rate=rate, motion=motion, tau=read(segment.tau))
    slow = torch.as_tensor(segment.moving, dtype=torch.float64).expand(segment.n)
    direction = sharp_direction(made, slow)
    return replace(made, motion=motion._replace(direction=direction))
