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

import torch
from scipy.stats import chi2, f

from torchid.effects.transient import Contact
from torchid.gap.search.evidence import Question, fit_terms, residual
from torchid.gap.search.terms import BASE
from torchid.statistics.autocorrelation import correlation_instants
from torchid.statistics.blocks import FEWEST_BLOCKS
from torchid.statistics.resampling import LEVEL
from torchid.statistics.robust import robust_std
from torchid.typing import Float, Tensor

LAWS = ("viscous_friction", "coulomb_friction", "torque_offset", "rotor_inertia")
"""What is taken out of the gap on every joint before windows are compared."""

LENGTHS = (3, 6, 12, 24, 48, 96, 192)
"""Lengths of windows [samples], up to a quarter of a trajectory."""

MOST = 3
"""Contacts at most, and windows of each length that are looked at closely for each; the search
decides which of them stay."""


def contacts(question: Question) -> list[Contact]:
    """Contacts that stand out from the rest of a log, the clearest first; they do not overlap."""
    candidates = question.candidates
    columns, samples = candidates.columns, candidates.columns.samples
    ones = torch.ones(columns.n, dtype=torch.float64)
    # Laws on every joint, and bodies, are taken out of the gap.
    laws = [t for t in candidates.terms if t.name in LAWS and len(t.effects) == 1]
    base = [t for t in (*candidates.terms, *candidates.fixed) if t.name == BASE]
    fixed = {id(t) for t in candidates.fixed}
    fit = fit_terms(question, [t for t in (*base, *laws) if id(t) not in fixed], ones)
    left = residual(question, fit.terms, fit.x)
    # What is left, and the pull of a force at the tool, in units of the joints' usual misfit.
    unit = torch.nan_to_num(robust_std(left), nan=torch.inf).clamp(min=1e-12).unsqueeze(1)
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
    found: list[tuple[int, int]] = []
    # One after the other: a push that is known is no measure of chance for the next.
    while len(found) < MOST:
        best: tuple[float, int, int] | None = None
        for gain, start, length in looked:
            free = torch.ones(len(start), dtype=torch.bool)
            for first, last in found:  # with as much on either side, for a push may be longer
                free &= (start >= 2 * last - first) | (start + length <= 2 * first - last)
            for k in gain.masked_fill(~free, -math.inf).argsort(descending=True)[:MOST].tolist():
                # The scale of chance is that of the log's other windows, heavy tails included:
                # chi^2 through their 95 % quantile. Those beside it may be of the same push.
                others = gain[free & ((start - start[k]).abs() >= 2 * length)]
                if not free[k] or len(others) < FEWEST_BLOCKS:
                    continue
                # How slow chance is there, too: a push in the window is no noise.
                outside = _outside(bounds, [(int(start[k]), int(start[k]) + length), *found])
                slow = correlation_instants(r.T, outside)
                apart = len(others) * max(1, length // 2) / max(length, slow)
                usual = max(1.0, float(others.quantile(LEVEL)) / float(chi2.ppf(LEVEL, c)))
                # A scale known from so many windows apart: F in the place of chi^2.
                level = float(f.sf(float(gain[k]) / (c * usual), c, max(apart, 1.0)))
                score = float(gain[k]) / usual - c * math.log(length)
                if total * level < alpha and (best is None or score > best[0]):
                    best = score, int(start[k]), int(start[k]) + length
        if best is None:
            break
        found.append(best[1:])
    return found


def _outside(bounds: Sequence[slice], windows: Sequence[tuple[int, int]]) -> list[slice]:
    """What is left of stretches of samples without windows and as much on either side of each."""
    left = list(bounds)
    for first, last in windows:
        low, high = 2 * first - last, 2 * last - first
        cut = [(slice(b.start, min(b.stop, low)), slice(max(b.start, high), b.stop)) for b in left]
        left = [s for pair in cut for s in pair if s.stop > s.start]
    return left
