"""Events, sought before any law: windows of time in which a force at the tool explains what stands
out from all the rest of the log.

A contact is no law: in its window the torque is otherwise, elsewhere it is as ever. So the gap is
first freed from whatever laws might explain of it (bodies, friction, offsets on every joint), well
or badly; windows are then compared with each other. What a wrong law leaves at reversals or at
speed happens again and again, and sets the scale: a contact must stand out from that, by chance
corrected for all windows that were looked at.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from scipy.special import chdtri, fdtrc

from torchid.effects.motion import Motion
from torchid.effects.surroundings import PlaneContact
from torchid.effects.transient import Contact
from torchid.gap.search.evidence import Question, fit_terms, residual
from torchid.gap.search.terms import BASE
from torchid.statistics.autocorrelation import correlation_instants
from torchid.statistics.blocks import FEWEST_BLOCKS
from torchid.statistics.resampling import LEVEL
from torchid.statistics.robust import robust_std
from torchid.typing import Bool, Float, Int, Tensor

LAWS = ("viscous_friction", "coulomb_friction", "torque_offset", "rotor_inertia")
"""What is taken out of the gap on every joint before windows are compared."""

LENGTHS = (3, 6, 12, 24, 48, 96, 192)
"""Lengths of windows [samples], up to a quarter of a trajectory."""

MOST = 5
"""Contacts at most; the search decides which of them stay."""

CLOSELY = 3
"""Windows of each length that are looked at closely for each contact."""

MOST_PLANES = 2
"""Planes that the search is offered."""

FINER = 5
"""Times that the height of a plane is refined: to 0.4 mm."""


def contacts(question: Question) -> list[Contact]:
    """Contacts that stand out from the rest of a log, the clearest first; they do not overlap."""
    candidates = question.candidates
    columns, samples = candidates.columns, candidates.columns.samples
    # Laws on every joint, and bodies, are taken out of the gap.
    left, unit = _beside_laws(question)
    # What remains, and the pull of a force at the tool, in units of the joints' usual misfit.
    r = left / unit
    pull = columns.on_all_joints(Contact()) * candidates.keep / unit
    # Windows that stand out, as contacts that do not overlap.
    found = _windows(pull, r, samples.bounds, question.settings.alpha)
    half = 0.5 * samples.interval
    out: list[Contact] = []
    for first, last in found:
        contact = Contact(float(samples.t[first]) - half, float(samples.t[last - 1]) + half)
        apart = all(
            contact.start >= c.stop or contact.stop <= c.start  # type: ignore[operator]
            for c in out
        )
        if apart and len(out) < MOST:
            out.append(contact)
    return out


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
        for level in range(FINER):
            around = plane.around(level, samples.interval)
            gain, plane = max(
                [(gain, plane), *zip(gains(around), around, strict=True)], key=lambda x: x[0]
            )
        out.append(plane)
    return out


def _beside_laws(question: Question) -> tuple[Float[Tensor, "n N"], Float[Tensor, "n 1"]]:
    """What laws on every joint, and bodies, leave of the gap, and the joints' usual misfit."""
    candidates = question.candidates
    ones = torch.ones(candidates.columns.n, dtype=torch.float64)
    laws = [t for t in candidates.terms if t.name in LAWS and len(t.effects) == 1]
    base = [t for t in (*candidates.terms, *candidates.fixed) if t.name == BASE]
    fixed = {id(t) for t in candidates.fixed}
    fit = fit_terms(question, [t for t in (*base, *laws) if id(t) not in fixed], ones)
    left = residual(question, fit.terms, fit.x)
    unit = torch.nan_to_num(robust_std(left), nan=torch.inf).clamp(min=1e-12).unsqueeze(1)
    return left, unit


def _windows(
    columns: Float[Tensor, "C n N"], r: Float[Tensor, "n N"], bounds: Sequence[slice], alpha: float
) -> list[tuple[int, int]]:
    """Samples (first, last + 1) of windows apart whose gain stands out, the clearest first. Sums
    over windows are differences of running sums."""
    c = len(columns)
    products = (columns.unsqueeze(0) * columns.unsqueeze(1)).sum(2)
    pulls = (columns * r).sum(1)
    running = [torch.nn.functional.pad(x.cumsum(-1), (1, 0)) for x in (products, pulls)]
    looked: list[tuple[Tensor, Tensor, int]] = []
    for length in LENGTHS:
        starts = [
            torch.arange(b.start, b.stop - length + 1, max(1, length // 2))
            for b in bounds
            if length <= max(LENGTHS[0], (b.stop - b.start) // 4)
        ]
        if not starts:
            continue
        # The force that fits best within each window, and what it gains there.
        start = torch.cat(starts)
        gram = (running[0][..., start + length] - running[0][..., start]).permute(2, 0, 1)
        pull = (running[1][:, start + length] - running[1][:, start]).T.unsqueeze(-1)
        inner = torch.linalg.pinv(gram, rtol=1e-6, hermitian=True)
        looked.append(((pull.transpose(1, 2) @ inner @ pull).flatten(), start, length))
    total = sum(len(gain) for gain, _, _ in looked)

    def level_of(gain: Tensor, start: Tensor, length: int, k: int, beside: Spans) -> Level | None:
        """Chance of window k, and its score, with the windows `beside` left out of the scale; None
        where too few others are there."""
        free = _free(start, length, beside)
        # The scale of chance is that of the log's other windows, heavy tails included: chi^2
        # through their 95 % quantile. Those next to it may be of the same push.
        others = gain[free & ((start - start[k]).abs() >= 2 * length)]
        if not free[k] or len(others) < FEWEST_BLOCKS:
            return None
        # How slow chance is there, too: a push in the window is no noise.
        outside = _outside(bounds, [(int(start[k]), int(start[k]) + length), *beside])
        slow = correlation_instants(r.T, outside)
        apart = len(others) * max(1, length // 2) / max(length, slow)
        usual = max(1.0, float(others.quantile(LEVEL)) / float(chdtri(c, 1 - LEVEL)))
        # A scale known from so many windows apart: F in the place of chi^2.
        chance = float(fdtrc(c, max(apart, 1.0), float(gain[k]) / (c * usual)))
        return Level(total * chance, float(gain[k]) / usual - c * math.log(length))

    # The windows that stand out most, one after the other.
    likely: list[tuple[int, int, int]] = []
    spans: Spans = []
    while len(likely) < MOST:
        best: tuple[bool, float, int, int] | None = None
        for i, (gain, start, length) in enumerate(looked):
            masked = gain.masked_fill(~_free(start, length, spans), -math.inf)
            for k in masked.argsort(descending=True)[:CLOSELY].tolist():
                level = level_of(gain, start, length, k, spans)
                if level is None:
                    continue
                # One that stands out already comes before one that others may hide.
                now = level.chance < alpha, level.score, i, k
                best = max(best, now) if best else now
        if best is None:
            break
        i, k = best[2:]
        _, start, length = looked[i]
        likely.append((i, k, length))
        spans.append((int(start[k]), int(start[k]) + length))
    # Several pushes hide each other, for each is part of the scale of the others: as many are
    # taken as the last of them stands out beside a log without any of them (Rosner 1983, Percentage
    # points for a generalized ESD many-outlier procedure).
    for count in range(len(likely), 0, -1):
        i, k, length = likely[count - 1]
        gain, start, _ = looked[i]
        level = level_of(gain, start, length, k, spans[: count - 1])
        if level is not None and level.chance < alpha:
            return spans[:count]
    return []


Spans = list[tuple[int, int]]
"""Windows: first sample, and the one after the last."""


class Level(NamedTuple):
    """How a window stands out.

    Attributes:
        chance: of it in a log without pushes, corrected for all windows that were looked at.
        score: by which windows of several lengths are ranked.
    """

    chance: float
    score: float


def _free(start: Int[Tensor, " W"], length: int, found: Spans) -> Bool[Tensor, " W"]:
    """Windows apart from those found, with as much on either side, for a push may be longer."""
    free = torch.ones(len(start), dtype=torch.bool)
    for first, last in found:
        free &= (start >= 2 * last - first) | (start + length <= 2 * first - last)
    return free


def _outside(bounds: Sequence[slice], windows: Sequence[tuple[int, int]]) -> list[slice]:
    """What is left of stretches of samples without windows and as much on either side of each."""
    left = list(bounds)
    for first, last in windows:
        low, high = 2 * first - last, 2 * last - first
        cut = [(slice(b.start, min(b.stop, low)), slice(max(b.start, high), b.stop)) for b in left]
        left = [s for pair in cut for s in pair if s.stop > s.start]
    return left
