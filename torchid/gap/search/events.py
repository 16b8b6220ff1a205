"""Events, sought before any law: windows of time in which a force at the tool, or on a link,
explains what stands out from all the rest of the log.

A contact is no law: in its window the torque is otherwise, elsewhere it is as ever. So the gap is
first freed from whatever laws might explain of it (bodies, friction, offsets on every joint), well
or badly; windows are then compared with each other. What a wrong law leaves at reversals or at
speed happens again and again, and sets the scale: a contact must stand out from that, by chance
corrected for all windows that were looked at. What is there again when the motion is repeated is no
event, whatever it is.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import torch
from scipy.special import chdtri, fdtrc

from torchid.effects.motion import Motion
from torchid.effects.surroundings import PlaneContact
from torchid.effects.transient import Contact
from torchid.gap.search.evidence import (
    SET_ODDS,
    Question,
    fit_terms,
    prior_of,
    residual,
    rows_of,
)
from torchid.gap.search.terms import BASE
from torchid.statistics.autocorrelation import correlation_instants
from torchid.statistics.blocks import FEWEST_BLOCKS
from torchid.statistics.resampling import LEVEL
from torchid.statistics.robust import HUBER, robust_std
from torchid.statistics.tail import tail_probability
from torchid.typing import Bool, Float, Int, Tensor

LAWS = ("viscous_friction", "coulomb_friction", "torque_offset", "rotor_inertia")
"""What is taken out of the gap on every joint before windows are compared."""

LENGTHS = (3, 6, 12, 24, 48, 96, 192)
"""Lengths of windows [samples], up to half of a trajectory."""

MOST_CONTACTS = 5
"""Contacts at most; the search decides which of them stay."""

WINDOWS_EACH = 3
"""Windows of each length that are looked at closely for each contact."""

ROUNDS = 6
"""Times that wild samples are tamed; each leaves a seventh of what a push moves the fit by."""

MOST_PLANES = 2
"""Planes that the search is offered."""

HEIGHT_STEPS = 5
"""Times that the height of a plane is refined: to 0.4 mm."""


Span = tuple[int, int]
"""Window: first sample, and the one after the last."""

Spans = list[Span]

Counterparts = Sequence[Int[Tensor, " N"]]
"""Samples at which the motion is the same again, -1 where it is not; one list a repeat."""


def contacts(question: Question, again: Counterparts = ()) -> list[Contact]:
    """Contacts that stand out from the rest of a log, the clearest first, and other windows for
    the same pushes.

    Args:
        question: what is to be explained.
        again: where the motion repeats itself, as `torchid.design.repeats.counterparts` has it.
    """
    candidates = question.candidates
    columns, samples = candidates.columns, candidates.columns.samples
    # Laws on every joint, and bodies, are taken out of the gap.
    left, unit = _beside_laws(question)
    # What remains, and the pull of a force at an end or on a link, in units of the usual misfit.
    t, half = samples.t, 0.5 * samples.interval
    robot = columns.model.robot
    ends = [c for c in Contact.candidates(robot) if isinstance(c, Contact)]
    links = Contact.links(robot)
    found: list[tuple[Contact, Span, float]] = []
    searched = {}
    for place in (*ends, *links):
        pull = columns.on_all_joints(place) * candidates.keep / unit
        # Windows that stand out; chance has as many more as there are places of one kind.
        kind = ends if place.along is None else links
        windows = searched[place] = Windows(pull, left / unit, samples.bounds, again)
        found += [(place, *x) for x in windows.standing_out(question.settings.alpha / len(kind))]
    # A push is felt as if it were at neighbouring places, too. A link is offered where it explains
    # more of the window than any end, by odds, and than any other link; of several ends the search
    # decides.
    out: list[Contact] = []
    for place, span, usual in found:
        window = torch.tensor([span[0]]), torch.tensor([span[1]])
        gains = {p: float(w.gains(*window)) for p, w in searched.items()}
        rivals = [
            gains[p] + (0.0 if p.along is not None else 2 * usual * math.log(SET_ODDS))
            for p in gains
            if p is not place
        ]
        if place.along is None or gains[place] >= max(rivals):
            for first, last in searched[place].about(span):
                start, stop = float(t[first]) - half, float(t[last - 1]) + half
                out.append(replace(place, start=start, stop=stop))
    return list(dict.fromkeys(out))


def planes(question: Question) -> list[PlaneContact]:
    """Planes that the tool may press into, the likeliest first: of those near the ends of its
    travel the ones whose push fits best what no usual law explains, at the height that fits best.

    Whether there is any is left to the search.
    """
    candidates = question.candidates
    columns, samples = candidates.columns, candidates.columns.samples
    robot = columns.model.robot
    left, unit = _beside_laws(question)
    # At the samples themselves: for a proposal the filter does not matter.
    signals = zip(*(m.state for m in columns.motions), strict=True)
    motion = Motion(*(samples.of([x.T for x in some]).T for some in signals))
    weight, target = (candidates.keep / unit).T, (left * candidates.keep / unit).T

    def gains(some: Sequence[PlaneContact]) -> list[float]:
        """How far the push of each takes the squares down, beside bodies and friction."""
        out = []
        for x in PlaneContact.columns_of(some, motion, robot):
            push = x[..., 0] * weight
            square, pull = float(push.square().sum()), float((push * target).sum())
            out.append(max(pull, 0.0) ** 2 / square if square > 0 else 0.0)
        return out

    tried = PlaneContact.near_ends(robot, [motion])
    if not tried:
        return []
    # What chance does, of samples that are alike for a while, over all planes that were looked at.
    slow = correlation_instants(left.T, samples.bounds)
    least = slow * float(chdtri(1, question.settings.alpha / len(tried)))
    best: dict[str, tuple[float, PlaneContact]] = {}
    for plane, gain in zip(tried, gains(tried), strict=True):
        if gain > best.get(plane.side, (least, plane))[0]:
            best[plane.side] = gain, plane
    out = []
    for likely in sorted(best.values(), key=lambda x: -x[0])[:MOST_PLANES]:
        gain, plane = likely
        for level in range(HEIGHT_STEPS):
            around = plane.around(level, samples.interval)
            gain, plane = max(
                [(gain, plane), *zip(gains(around), around, strict=True)], key=lambda x: x[0]
            )
        out.append(plane)
    return out


def _beside_laws(question: Question) -> tuple[Float[Tensor, "n N"], Float[Tensor, "n 1"]]:
    """What laws on every joint, and bodies, leave of the gap, and the joints' usual misfit.

    The fit is Huber's, by pseudo-values (Huber 1981, Robust Statistics, section 7.8): a push of the
    tenth part of a log would move an offset by a tenth of its force.
    """
    candidates = question.candidates
    ones = torch.ones(candidates.columns.n, dtype=torch.float64)
    laws = [t for t in candidates.terms if t.name in LAWS and t.alone]
    base = [t for t in (*candidates.terms, *candidates.fixed) if t.name == BASE]
    fixed = {id(t) for t in candidates.fixed}
    fit = fit_terms(question, [t for t in (*base, *laws) if id(t) not in fixed], ones)
    prior, equations = prior_of(fit.terms), question.normal.of(fit.subset)
    ends = list(itertools.accumulate((len(t.at) for t in fit.terms), initial=0))
    x, target = fit.x, residual(question, fit.terms, torch.zeros_like(fit.x))
    for _ in range(ROUNDS):
        left = residual(question, fit.terms, x)
        unit = _misfit(left)
        # The gap, its wild samples brought to the edge of the usual misfit.
        tamed = target - left + left.clamp(-HUBER * unit, HUBER * unit)
        right = torch.zeros_like(equations.b)
        for first, last, term in zip(ends, ends[1:], fit.terms, strict=False):
            rows = rows_of(question, term)
            if term.place is None:
                right[:, first:last] = (rows * tamed).sum(-1).T
            else:
                right[term.place, first:last] = rows[:, 0] @ tamed[term.place]
        again = replace(equations, b=right, squares=tamed.square().sum(1))
        x = prior.solve_of(again, unit[:, 0] ** -2).x
    left = residual(question, fit.terms, x)
    unit = _misfit(left)
    return left, unit


def _gains(gram: Float[Tensor, "W C C"], pull: Float[Tensor, "W C 1"]) -> Float[Tensor, " W"]:
    """What the force that fits best gains in each window, from sums of columns' products and of
    those with what is to be explained."""
    inner = torch.linalg.pinv(gram, rtol=1e-6, hermitian=True)
    return (pull.transpose(1, 2) @ inner @ pull).flatten()


def _misfit(left: Float[Tensor, "n N"]) -> Float[Tensor, "n 1"]:
    """The joints' usual misfit; infinite where no sample counts."""
    return torch.nan_to_num(robust_std(left), nan=torch.inf).clamp(min=1e-12).unsqueeze(1)


class Level(NamedTuple):
    """How a window stands out.

    Attributes:
        chance: of it in a log without pushes, corrected for all windows that were looked at.
        score: by which windows of several lengths are ranked.
        usual: scale of the others' gains, over that of noise that is white.
    """

    chance: float
    score: float
    usual: float


class _Running(NamedTuple):
    """Running sums of columns' products (C, C, N + 1), and of those with what they explain."""

    products: Float[Tensor, "C C _"]
    pulls: Float[Tensor, "C _"]

    def over(
        self, start: Int[Tensor, " W"], stop: Int[Tensor, " W"]
    ) -> tuple[Float[Tensor, "W C C"], Float[Tensor, "W C 1"]]:
        """The sums over windows."""
        gram = (self.products[..., stop] - self.products[..., start]).permute(2, 0, 1)
        return gram, (self.pulls[:, stop] - self.pulls[:, start]).T.unsqueeze(-1)


class Windows:
    """Windows of a log, and what the force that fits best within each gains there. Sums over
    windows are differences of running sums.

    Attributes:
        every: per length the gains, first samples, and the length.
        looked: those that may stand out of others like them: up to a quarter of a trajectory.
    """

    def __init__(
        self,
        columns: Float[Tensor, "C n N"],
        r: Float[Tensor, "n N"],
        bounds: Sequence[slice],
        again: Counterparts = (),
    ):
        self.r, self.bounds, self.directions = r, bounds, len(columns)

        def running(columns: Float[Tensor, "C n N"], r: Float[Tensor, "n N"]) -> _Running:
            """Running sums of the columns' products, and of those with r."""
            products = (columns.unsqueeze(0) * columns.unsqueeze(1)).sum(2)
            sums = [x.cumsum(-1) for x in (products, (columns * r).sum(1))]
            return _Running(*(torch.nn.functional.pad(x, (1, 0)) for x in sums))

        self.own = running(columns, r)
        # The same columns beside what is left when the motion is there again.
        self.again = [running(columns * (there >= 0), r[:, there.clamp(min=0)]) for there in again]
        self.every: list[tuple[Tensor, Tensor, int]] = []
        for length in LENGTHS:
            starts = [
                torch.arange(b.start, b.stop - length + 1, max(1, length // 2))
                for b in bounds
                if length <= max(LENGTHS[0], (b.stop - b.start) // 2)
            ]
            start = torch.cat(starts) if starts else torch.zeros(0, dtype=torch.long)
            if len(start):
                self.every.append((self.gains(start, start + length), start, length))
        longest = max(LENGTHS[0], max(b.stop - b.start for b in bounds) // 4)
        self.looked = [x for x in self.every if x[2] <= longest]

    def gains(self, start: Int[Tensor, " W"], stop: Int[Tensor, " W"]) -> Float[Tensor, " W"]:
        """What the force that fits best within each window gains there."""
        return _gains(*self.own.over(start, stop))

    def once(self, start: Int[Tensor, " W"], stop: Int[Tensor, " W"]) -> Bool[Tensor, " W"]:
        """Whether the force that fits best within each window is nowhere felt by half or more when
        the motion is there again."""
        gram, pull = self.own.over(start, stop)
        force = torch.linalg.pinv(gram, rtol=1e-6, hermitian=True) @ pull
        out = torch.ones(len(start), dtype=torch.bool)
        for again in self.again:
            gram, pull = again.over(start, stop)
            expected = (force.transpose(1, 2) @ gram @ force).flatten()
            felt = (force.transpose(1, 2) @ pull).flatten()
            out &= (felt < 0.5 * expected) | (expected <= 0)
        return out

    def level(
        self, window: Span, gain: float, i: int, beside: Spans, extent: Span | None = None
    ) -> "Level | None":
        """How a window stands out of those of the i-th length, with the windows `beside` left out
        of the scale; None where too few others are there. `extent` is how long its push may be."""
        gains, start, length = self.looked[i]
        c = self.directions
        # The scale of chance is that of the log's other windows, heavy tails included: chi^2
        # through their 95 % quantile. Those next to it may be of the same push.
        first, last = extent if extent is not None and _overlap(window, extent) else window
        far = (start >= last) | (start + length <= first)
        far &= (start - window[0]).abs() >= 2 * length
        others = gains[_free(start, length, beside) & far]
        if not _apart(window, beside) or len(others) < FEWEST_BLOCKS:
            return None
        # How slow chance is there, too: a push in the window is no noise.
        slow = correlation_instants(
            self.r.T, _outside(self.bounds, [window, *beside], (first, last))
        )
        apart = len(others) * max(1, length // 2) / max(length, slow)
        usual = max(1.0, float(others.quantile(LEVEL)) / float(chdtri(c, 1 - LEVEL)))
        # The tail of the others leads to how likely so much is, where enough of them are known;
        # else a scale known from so many windows apart does: F in the place of chi^2.
        chance = tail_probability(others, gain)
        if chance is None:
            chance = float(fdtrc(c, max(apart, 1.0), gain / (c * usual)))
        total = sum(len(g) for g, _, _ in self.looked)
        return Level(total * chance, gain / usual - c * math.log(length), usual)

    def standing_out(self, alpha: float) -> list[tuple[Span, float]]:
        """Windows apart that stand out, the clearest first, each with the scale of chance."""
        # The windows that stand out most, one after the other.
        likely: list[tuple[int, float, Span]] = []
        spans: Spans = []
        scales: list[float] = []
        once = [self.once(start, start + length) for _, start, length in self.looked]
        while len(likely) < MOST_CONTACTS:
            best: tuple[bool, float, int, int, float] | None = None
            # Windows of each length that gain most, and how long the push is that gains most.
            closely: list[tuple[float, int, int, Span]] = []
            for i, (gain, start, length) in enumerate(self.looked):
                free = _free(start, length, spans) & once[i]
                masked = gain.masked_fill(~free, -math.inf)
                for k in masked.argsort(descending=True)[:WINDOWS_EACH].tolist():
                    if masked[k] > -math.inf:
                        span = int(start[k]), int(start[k]) + length
                        closely.append((float(gain[k]), i, k, span))
            if not closely:
                break
            extent = self._extent(max(closely)[-1])
            for own, i, k, window in closely:
                level = self.level(window, own, i, spans, extent)
                if level is None:
                    continue
                # One that stands out already comes before one that others may hide.
                now = level.chance < alpha, level.score, i, k, level.usual
                best = max(best, now) if best else now
            if best is None:
                break
            i, k = best[2:4]
            gains, start, length = self.looked[i]
            likely.append((i, float(gains[k]), extent))
            spans.append((int(start[k]), int(start[k]) + length))
            scales.append(best[4])
        # Several pushes hide each other, for each is part of the scale of the others: as many are
        # taken as the last of them stands out beside a log without any of them (Rosner 1983,
        # Percentage points for a generalized ESD many-outlier procedure).
        for count in range(len(likely), 0, -1):
            i, own, extent = likely[count - 1]
            level = self.level(spans[count - 1], own, i, spans[: count - 1], extent)
            if level is not None and level.chance < alpha:
                return list(zip(spans, scales, strict=False))[:count]
        return []

    def about(self, span: Span) -> Spans:
        """A window, and others for the same push: those that gain most near it and among all
        lengths, with their ends moved to where the gain is largest."""
        over = [
            (float(gain[k]), (int(start[k]), int(start[k]) + length))
            for gain, start, length in self.every
            for k in ((start < span[1]) & (start + length > span[0])).nonzero().flatten().tolist()
        ]
        return list(dict.fromkeys([span, *map(self._extent, (span, max(over)[1]))]))

    def _extent(self, window: Span) -> Span:
        """A window with the ends that gain most, ever finer, to a sample; within its trajectory."""
        first, last = window
        run = next(b for b in self.bounds if b.start <= first < b.stop)
        step = max(1, (last - first) // 2)
        while step:
            ends = [(a, b) for a in (first - step, first, first + step)
                    for b in (last - step, last, last + step)
                    if run.start <= a and a + LENGTHS[0] <= b <= run.stop]  # fmt: skip
            start, stop = torch.tensor(ends).unbind(1)
            best = ends[int(self.gains(start, stop).argmax())]
            if best == (first, last):
                step //= 2
            first, last = best
        return first, last


def _free(start: Int[Tensor, " W"], length: int, found: Spans) -> Bool[Tensor, " W"]:
    """Windows apart from those found, with as much on either side, for a push may be longer."""
    free = torch.ones(len(start), dtype=torch.bool)
    for first, last in found:
        free &= (start >= 2 * last - first) | (start + length <= 2 * first - last)
    return free


def _apart(window: Span, found: Spans) -> bool:
    """Whether a window is apart from those found, in the same sense."""
    first, last = window
    return bool(_free(torch.tensor([first]), last - first, found)[0])


def _overlap(one: Span, two: Span) -> bool:
    return one[0] < two[1] and two[0] < one[1]


def _outside(bounds: Sequence[slice], windows: Spans, extent: Span) -> list[slice]:
    """What is left of stretches of samples without windows and as much on either side of each, and
    without the extent of a push."""
    left = list(bounds)
    for low, high in (extent, *((2 * a - b, 2 * b - a) for a, b in windows)):
        cut = [(slice(b.start, min(b.stop, low)), slice(max(b.start, high), b.stop)) for b in left]
        left = [s for pair in cut for s in pair if s.stop > s.start]
    return left
