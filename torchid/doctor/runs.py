"""Does one run contradict the others, as if a load had hung on the last link in it alone?

The run's own base parameters are then the others' plus those of a body on the last link. Of each
run a part of the time is predicted from its other parts and all other runs: with such a body in
that run, with friction and offsets of its own (a warmer gear), and with neither.
"""

from dataclasses import dataclass, replace

import numpy as np

from torchid.doctor.check import Check, worded_check
from torchid.doctor.cone import Fit, Normal, fit, shares
from torchid.doctor.hypothesis import FEWEST, Hypothesis, Judge
from torchid.statistics.criteria import CLEAR_GAIN

PIECES = 4
"""Parts of a run that are left out in turn,"""
_RUN = np.arange(PIECES)
LEAST_ROWS = 10
"""... of this many rows or more."""


@dataclass(frozen=True)
class _Own:
    """What a run alone may have.

    Attributes:
        columns: of the parameters (P,) that it has once more.
        bodies: (columns, U) what those may be.
    """

    columns: np.ndarray
    bodies: np.ndarray


def check_runs(judge: Judge, hypothesis: Hypothesis) -> list[Check]:
    """A check whether one run agrees with the others with a load of its own alone; nothing where
    there are not two runs that are long enough to be held against each other."""
    runs, pieces = pieces_of_runs(judge)
    if len(runs) < 2 or not judge.live(hypothesis):
        return []
    normal, names = judge.normal(hypothesis, pieces), judge.samples.log.names
    n = judge.robot.n  # columns of the last link's parameters among those of all links
    last = np.r_[n - 1, n + 3 * (n - 1) : 4 * n, 4 * n + 6 * (n - 1) : 10 * n]
    bodies = judge.cone[:, judge.cone[last].any(0)]
    # What all runs have on the last link may be anything: what differs between them counts.
    cone, body = np.hstack([judge.cone, -bodies]), bodies[last]
    plain, looked = fit(normal, cone), []
    for place in range(len(runs)):
        parts = normal.apart(np.arange(PIECES * place, PIECES * (place + 1)))
        # Of two runs one is heavier, or the other lighter: it is said of the heavier one.
        for sign in (1.0, -1.0) if len(runs) > 2 else (1.0,):
            load = _Own(last, sign * body)
            gain = _gain(parts, cone, load, plain)
            looked += [(gain, place, parts, load)] if gain > CLEAR_GAIN else []
    # 3: runs that a load explains best, which alone are looked at with parts left out
    for _, place, parts, load in sorted(looked, key=lambda x: -x[0])[:3]:
        contradiction = _contradicts(parts, cone, names[runs[place]], load)
        # One that agrees with others by itself is not what contradicts: one of these is.
        if contradiction is not None and _contradicts_most(normal, place, len(runs), cone, load):
            return [contradiction]
    return [worded_check("runs", "fine", count=len(runs))]


def _gain(parts: Normal, cone: np.ndarray, load: _Own, plain: Fit) -> float:
    """What a load of its own explains of a run, in log errors; `plain` has none."""
    wide, every = _with_own(parts, cone, load)
    x = fit(wide, every, plain.weights, plain.used).x
    return loss_of(parts, _RUN, plain.x) - loss_of(wide, _RUN, x)


def _contradicts_most(normal: Normal, place: int, count: int, cone: np.ndarray, load: _Own) -> bool:
    """Whether a run differs by a load of its own from more than half of the others, one by one."""
    differs = []
    for other in {*range(count)} - {place}:
        both = normal.part(np.r_[PIECES * place + _RUN, PIECES * other + _RUN]).apart(_RUN)
        differs.append(_gain(both, cone, load, fit(both, cone)) > CLEAR_GAIN)
    return 2 * sum(differs) > len(differs)


def pieces_of_runs(judge: Judge) -> tuple[list[int], list[np.ndarray]]:
    """Runs that are long enough to be held against each other; and which rows are in each of the
    `PIECES` of one after the other, at the end those of no such run."""
    owner = judge.samples.run.numpy()
    count = np.bincount(owner, minlength=len(judge.samples.log.names))
    runs = np.flatnonzero(count >= PIECES * LEAST_ROWS).tolist()
    piece = np.full(len(owner), PIECES * len(runs))
    for place, run in enumerate(runs):
        piece[owner == run] = PIECES * place + np.arange(count[run]) * PIECES // count[run]
    return runs, [piece == k for k in range(piece.max() + 1)]


def _contradicts(parts: Normal, cone: np.ndarray, name: str, load: _Own) -> Check | None:
    """The check of a run that a load of its own explains clearly better than friction of its own or
    nothing, in each part that is left out; None of any other run."""
    rubbing = np.arange(10 * len(parts.spread), len(cone))
    both = np.hstack([np.eye(len(rubbing)), -np.eye(len(rubbing))])
    nothing = _Own(rubbing[:0], np.zeros((0, 0)))
    without, _ = _left_out(parts, cone, nothing)
    loaded, values = _left_out(parts, cone, load)
    mass = np.abs(values[:, 0])
    gain = without - loaded
    # 2.0: largest over smallest mass of a load, a part left out in turn, that is one load
    if mass.max() > 2.0 * mass.min() or gain.min() <= 0 or gain.mean() < CLEAR_GAIN:
        return None
    gain = _left_out(parts, cone, _Own(rubbing, both))[0] - loaded
    if gain.min() <= 0 or gain.mean() < CLEAR_GAIN:
        return None
    left = 100 * np.exp((loaded - without).mean() / max(1, int((parts.spread > 0).sum())))
    words = {"word": "more" if values[0, 0] > 0 else "less", "mass": mass.mean(), "left": left}
    return worded_check("runs", "wrong", estimate=float(values[:, 0].mean()), run=name, **words)


def _left_out(parts: Normal, cone: np.ndarray, own: _Own) -> tuple[np.ndarray, np.ndarray]:
    """(B,) sums of the joints' log errors of a run's parts under the fit to all else, and the
    (B, columns) values of its own parameters."""
    wide, bodies = _with_own(parts, cone, own)
    fits = [fit(wide.without(k), bodies).x for k in range(PIECES)]
    losses = [loss_of(wide, np.array([k]), x) for k, x in enumerate(fits)]
    return np.array(losses), np.stack(fits)[:, parts.gram.shape[-1] :]


def _with_own(parts: Normal, cone: np.ndarray, own: _Own) -> tuple[Normal, np.ndarray]:
    """A run's parts and all other rows, and what may be, with columns once more that act in the run
    alone."""
    size = parts.gram.shape[-1]
    every = np.r_[np.arange(size), own.columns]
    gram, cross = parts.gram[:, :, every][..., every], parts.cross[..., every]
    gram[-1, :, size:], gram[-1, :, :, size:], cross[-1, :, size:] = 0.0, 0.0, 0.0
    bodies = np.zeros((len(every), cone.shape[1] + own.bodies.shape[1]))
    bodies[:size, : cone.shape[1]], bodies[size:, cone.shape[1] :] = cone, own.bodies
    return replace(parts, gram=gram, cross=cross), bodies


def loss_of(normal: Normal, parts: np.ndarray, x: np.ndarray) -> float:
    """Sum of the joints' log errors in some parts."""
    some = normal.part(parts)
    count = some.count.sum(0)
    mean = (some.mean_square(x) * some.count).sum(0) / np.maximum(count, 1)
    return float(np.log(shares(mean, normal.spread))[count >= FEWEST].sum())
