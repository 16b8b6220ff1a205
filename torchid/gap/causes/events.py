"""Contacts: windows of time in which a force at an end of the arm, or on a link, explains most of
what is left; and planes that the tool presses into.

Beside a fit each window's force that fits best has its evidence, from differences of running sums.
A push must stand out from the other windows in which the arm moves alike. What is there again when
the motion is repeated is no event, whatever it is. The windows that were looked at are the price of
one: the search decides which stay.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, cast

import numpy as np
import torch
from scipy.special import chdtri, fdtrc

from torchid.design.repeats import counterparts
from torchid.effects.motion import Motion
from torchid.effects.surroundings import PlaneContact
from torchid.effects.transient import Contact
from torchid.gap.causes.candidates import Library, Term
from torchid.gap.causes.windows import Span
from torchid.statistics.autocorrelation import correlation_instants, integrated_time
from torchid.statistics.blocks import FEWEST_BLOCKS
from torchid.statistics.criteria import SAME_FACTOR
from torchid.statistics.resampling import LEVEL

PUSHES = 3
"""Windows of pushes that are offered at most, each at the likeliest end and on the likeliest
link."""

FALSE_PUSH = 0.01
"""Level of a false push among all windows [1]."""

MOST_PLANES = 2
"""Planes that are offered at most."""

HEIGHT_STEPS = 5
"""Times that the height of a plane is refined: to 0.4 mm."""

AGAIN = 0.5
"""Share of a push that is felt when the motion is there again, from which it is no push [1]."""


class _Sums(NamedTuple):
    """Running sums of the products of a force's columns (N + 1, C, C), and of those with what is
    left (N + 1, C); in units of the force's slab."""

    squares: np.ndarray
    right: np.ndarray

    @classmethod
    def of(cls, pull: np.ndarray, left: np.ndarray, weight: np.ndarray) -> "_Sums":
        """Of columns (C, n, N) beside samples (n, N), joints by their weights (n,)."""
        heavy = pull * weight[:, None]
        squares = np.einsum("anN,bnN->Nab", heavy, pull, optimize=True).cumsum(0)
        right = np.einsum("anN,nN->Na", heavy, left, optimize=True).cumsum(0)
        return cls(*(np.concatenate([np.zeros_like(x[:1]), x]) for x in (squares, right)))

    def over(self, spans: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(W, C, C) and (W, C) over windows."""
        first, last = spans.T
        return self.squares[last] - self.squares[first], self.right[last] - self.right[first]


class _Force:
    """A force at a place, and what it explains in any window.

    Args:
        library: of the candidates.
        place: where it acts.
        left: (n, N) what is left [N m; N].
        weight: (n,) of its squares.
        again: samples at which the motion is the same again, -1 where it is not.
    """

    def __init__(
        self,
        library: Library,
        place: Contact,
        left: np.ndarray,
        weight: np.ndarray,
        again: Sequence[torch.Tensor],
    ):
        self.place, self.bounds = place, library.samples.bounds
        self.least = math.ceil(library.windows.shortest / library.samples.interval)
        pull = library.columns.on_all_joints(place).numpy() * library.keep
        pull = pull * (0.5 * library.scale.largest([place]).numpy())[:, None, None]
        self.own = _Sums.of(pull, left, weight)
        self.again = [
            _Sums.of(pull * (at >= 0), left[:, at.clip(min=0)], weight)
            for at in (there.numpy() for there in again)
        ]

    def gains(self, spans: np.ndarray) -> np.ndarray:
        """Evidence of the force that fits best in each window, and how much it is felt there, its
        likelihood, (2, W) [nats]; none of one that is felt when the motion is there again."""
        squares, right = self.own.over(spans)
        a = squares + np.eye(squares.shape[1])
        force = np.linalg.solve(a, right[..., None])[..., 0]
        out = np.tile(0.5 * (right * force).sum(1), (2, 1))
        out[0] -= 0.5 * np.linalg.slogdet(a)[1]
        for sums in self.again:
            squares, right = sums.over(spans)
            expected = np.einsum("wa,wab,wb->w", force, squares, force)
            felt = (right * force).sum(1)
            out[:, (felt >= AGAIN * expected) & (expected > 0)] = -np.inf
        return out

    def extent(self, window: Span) -> Span:
        """A window with the ends that gain most, ever finer, to a sample; within its trajectory."""
        first, last = window
        run = next(b for b in self.bounds if b.start <= first < b.stop)
        step = max(1, (last - first) // 4)
        while step:
            moves = itertools.product((-step, 0, step), repeat=2)
            ends = [(first + a, last + b) for a, b in moves]
            ends = [e for e in ends if run.start <= e[0] and e[0] + self.least <= e[1] < run.stop]
            best = ends[int(self.gains(np.array(ends))[0].argmax())] if ends else (first, last)
            if best == (first, last):
                step //= 2
            first, last = best
        return first, last


def pushes(library: Library, left: np.ndarray, weight: np.ndarray) -> list[Term]:
    """Windows in which a constant force at an end, or on a link, explains most of what is left.

    Args:
        library: whose candidates they become.
        left: (n, N) what is left [N m; N].
        weight: (n,) of its squares.
    """
    windows, spans = library.windows, library.windows.spans
    if Contact.name not in library.problem.wanted.names or not len(spans):
        return []
    robot = library.columns.model.robot
    ends = cast(list[Contact], Contact.candidates(robot))
    again = counterparts(library.problem.given.samples, library.problem.repeats)
    kinds = [[_Force(library, place, left, weight, again) for place in some]
             for some in (ends, Contact.links(robot)) if some]  # fmt: skip
    t, half, out = library.samples.t.numpy(), 0.5 * library.samples.interval, list[Term]()
    sizes = np.unique(spans[:, 1] - spans[:, 0])
    speed = _speeds(library, spans)
    for some in kinds:
        gains, felt = np.stack([force.gains(spans) for force in some], 1)
        which, best = gains.argmax(0), felt.max(0)
        found = _apart(gains.max(0), spans)
        # How long the pushes may be: none of their windows are of the usual ones.
        extents = [some[which[k]].extent((int(spans[k, 0]), int(spans[k, 1]))) for k in found]
        # For how long what is left is felt as the same force: of the shortest windows, which lie a
        # quarter of their length apart; of no window a zero.
        short = (spans[:, 1] - spans[:, 0] == sizes[0]) & _clear(spans, extents)
        series = torch.from_numpy(np.append(0.0, np.maximum(best[short], 0.0)))
        slow = max(1, sizes[0] // 4) * float(integrated_time(series))
        # Windows overlap: as many are looked at as are independent, of each length.
        looks = (windows.asked.sum() / np.maximum(sizes, slow)).sum()
        for k, (first, last) in zip(found, extents, strict=True):
            # Some forces are always felt like what a law leaves, the more the faster the arm moves.
            like = (speed <= SAME_FACTOR * speed[k]) & (speed[k] <= SAME_FACTOR * speed)
            like = like if like.sum() >= FEWEST_BLOCKS * len(sizes) else np.ones_like(like)
            chance = _chance(best[like], spans[like], (first, last), extents, slow)
            begin, end = float(t[first]) - half, float(t[last - 1]) + half
            term = library.of_event(replace(some[which[k]].place, start=begin, stop=end))
            if term is not None and chance * looks <= FALSE_PUSH:
                out.append(replace(term, shapes=windows.count * len(some)))
    return out


def _speeds(library: Library, spans: np.ndarray) -> np.ndarray:
    """RMS speed (W,) of the joints in windows (W, 2), each in units of its own over the log."""
    squares = library.samples.of([m.dq.T for m in library.columns.motions]).square()
    own = (squares / squares.mean(1, keepdim=True).clamp(min=1e-300)).mean(0)
    sums = np.append(0.0, own.cumsum(0).numpy())
    first, last = spans.T
    return np.sqrt((sums[last] - sums[first]) / (last - first))


def _apart(gains: np.ndarray, spans: np.ndarray) -> list[int]:
    """Numbers of the windows (W, 2) that gain (W,) most, apart from each other."""
    out: list[int] = []
    for k in np.argsort(-gains).tolist():
        if len(out) >= PUSHES or gains[k] < math.log(len(spans)):
            break
        if all(spans[k, 1] <= spans[o, 0] or spans[k, 0] >= spans[o, 1] for o in out):
            out.append(k)
    return out


def _clear(spans: np.ndarray, extents: Sequence[Span]) -> np.ndarray:
    """Which windows (W, 2) are apart from all pushes, by half of their own length."""
    (first, last), out = spans.T, np.ones(len(spans), bool)
    half = (last - first) // 2
    for a, b in extents:
        out &= (first >= b + half) | (last <= a - half)
    return out


def _chance(
    gains: np.ndarray, spans: np.ndarray, push: Span, extents: Sequence[Span], slow: float
) -> float:
    """Of as large a gain as a push has in the windows (W, 2), beside those of its length apart from
    all pushes: what a wrong law leaves happens again and again, and sets the scale (chi^2 through
    their 95 % quantile), which is known from so many windows as are independent. Of its own windows
    the clearest counts, for of long ones there are few.

    Args:
        gains: (W,) [nats].
        spans: (W, 2) windows.
        push: whose chance it is.
        extents: of all pushes.
        slow: samples over which gains are alike.
    """
    first, last = spans.T
    length, out, clear = last - first, 1.0, _clear(spans, extents)
    for size in np.unique(length):
        own = gains[(length == size) & (first < push[1]) & (last > push[0])]
        usual = (length == size) & clear
        if usual.sum() < FEWEST_BLOCKS or not len(own):
            continue
        # Where a force is there again there is no push, and the gain is -inf: it counts as none.
        usually = np.maximum(gains[usual], 0.0)
        scale = max(1.0, 2 * float(np.quantile(usually, LEVEL)) / chdtri(3, 1 - LEVEL))
        apart = usual.sum() * max(1, size // 4) / max(size, slow)
        out = min(out, float(fdtrc(3, max(apart, 1.0), 2 * own.max() / (3 * scale))))
    return out


def planes(library: Library, left: np.ndarray, weight: np.ndarray) -> list[Term]:
    """Planes that the tool may press into, the likeliest first: of those near the ends of its
    travel the ones whose push fits best what is left, at the height that fits best.

    Args:
        library, left, weight: as for `pushes`.
    """
    if PlaneContact.name not in library.problem.wanted.names:
        return []
    columns, samples = library.columns, library.samples
    robot = columns.model.robot
    # At the samples themselves: for a proposal the filter does not matter.
    signals = zip(*(m.state for m in columns.motions), strict=True)
    motion = Motion(*(samples.of([x.T for x in some]).T for some in signals))
    heavy = torch.from_numpy(library.keep * np.sqrt(weight)[:, None]).T
    target = torch.from_numpy(left).T * heavy

    def gains(some: Sequence[PlaneContact]) -> list[float]:
        """Squares that the push of each takes, in nats."""
        out = []
        for x in PlaneContact.columns_of(some, motion, robot):
            push = x[..., 0] * heavy
            square, pull = float(push.square().sum()), float((push * target).sum())
            out.append(0.5 * max(pull, 0.0) ** 2 / square if square > 0 else 0.0)
        return out

    tried = PlaneContact.near_ends(robot, [motion])
    if not tried:
        return []
    # What chance does, of samples that are alike for a while, over all planes that are looked at.
    slow = correlation_instants(torch.from_numpy(left).T, samples.bounds)
    least = 0.5 * slow * float(chdtri(1, FALSE_PUSH / len(tried)))
    best: dict[str, tuple[float, PlaneContact]] = {}
    for plane, gain in zip(tried, gains(tried), strict=True):
        if gain > best.get(plane.side, (least, plane))[0]:
            best[plane.side] = gain, plane
    out = []
    for likely in sorted(best.values(), key=lambda x: -x[0])[:MOST_PLANES]:
        now = likely
        for level in range(HEIGHT_STEPS):
            around = now[1].around(level, samples.interval)
            now = max([now, *zip(gains(around), around, strict=True)], key=lambda x: x[0])
        out.append(library.of_event(now[1]))
    return [replace(t, shapes=len(tried)) for t in out if t is not None]
