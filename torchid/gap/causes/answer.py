"""From a problem to causes: the whole road, and the answer as JSON has it."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from torchid.gap.causes.candidates import Library
from torchid.gap.causes.judge import Judged, judge
from torchid.gap.causes.misfit import foreseen
from torchid.gap.causes.search import Found, Search
from torchid.effects.registry import KINDS
from torchid.gap.problem import Problem
from torchid.statistics.blocks import block_numbers
from torchid.statistics.criteria import LIKELY

EXCESS = 1.35
FEATURE_SHARE = 0.15


@dataclass(frozen=True, eq=False)
class Explained:
    """Causes of a gap, and how far they close it.

    Attributes:
        search, found: of which.
        judged: terms of the explanation.
        before, after, noise: (n,) RMS of the gap, of what is left on motions left out, and of what
            nothing can foresee [N m; N].
        foreseen: (n,) share of the squares left that a flexible predictor foresees.
    """

    search: Search
    found: Found
    judged: list[Judged]
    before: np.ndarray
    after: np.ndarray
    noise: np.ndarray
    foreseen: np.ndarray


def explain(problem: Problem, watch: Any = None) -> Explained:
    """Which causes make the gap of a model on a log."""
    library = Library(problem)
    search = Search(library, watch)
    found = search.explanation()
    evidence, rows = search.evidence, library.rows
    fit = search.again(found.fit)
    # Whole motions left out say how far the gap closes; noise is what repeats, or a flexible
    # predictor, leave of that.
    part = problem.folds.fold.numpy()
    after = np.sqrt(search.left_out(fit.terms, part, fit.samples) / rows)
    before = np.sqrt((library.gap**2).sum(1) / rows)
    share = foreseen(problem, evidence.left(fit))
    noise = np.minimum(library.noise, after)
    noise = np.where(np.isnan(noise), after * np.sqrt(1 - share), noise)
    left = np.maximum(after**2 - noise**2, 0.0)
    shares = left / np.maximum(before**2, 1e-300)
    unit = np.maximum(noise, 1e-2 * library.torque) ** 2
    whole = float((left / unit).sum() / max((before**2 / unit).sum(), 1e-300))
    shares = np.minimum(np.append(shares, whole), 1.0)
    return Explained(
        search, found, judge(search, fit, shares, problem.draws), before, after, noise, share
    )


def plain(explained: Explained) -> dict[str, Any]:
    """The answer as torchid.gap/1 has the part of it that is scored."""
    e, library = explained, explained.search.library
    which, suspects = [], []
    total = float(np.sqrt((e.before**2).sum()))
    for one in e.judged:
        claim = _claim(one, library.n, total)
        there = {(w["effect"], tuple(w["joints"])) for w in which}
        if (claim["effect"], tuple(claim["joints"])) in there:
            continue
        (which if one.there >= LIKELY and claim["how_sure"] >= 0.1 else suspects).append(claim)
    which.sort(key=lambda w: -w["share"])
    names = {w["effect"] for w in which}
    excess = e.after**2 / np.maximum(e.noise**2, 1e-300)
    size = 0.35 * np.maximum(e.noise, library.problem.settings.worthwhile_torque * library.torque)
    big = e.after**2 - e.noise**2 > size**2
    odd = (excess > EXCESS) & big & ((e.foreseen > FEATURE_SHARE) | (excess > 2.0)) & library.keep.any(1)
    if odd.any():
        status = "detected_unexplained"
    elif not which:
        status = "no_gap"
    elif names <= {"link_inertia", "payload", "all_base"}:
        status = "parametric_only"
    else:
        status = "explained"
    b, a, z = (float(np.sqrt((x**2).sum())) for x in (e.before, e.after, np.minimum(e.noise, e.after)))
    above = np.maximum(e.before**2 - np.minimum(e.noise, e.before) ** 2, 0)
    return {
        "schema": "torchid.gap/1",
        "status": status,
        "where": {
            "joints": [
                {"joint": j + 1, "share": float(above[j] / max(above.sum(), 1e-300))}
                for j in range(library.n)
            ]
        },
        "which": which,
        "suspects": suspects,
        "small": [_small(t) for t in e.found.small],
        "how_far": {
            "rms_before": b,
            "rms_after": a,
            "closed": float(np.clip((b - a) / max(b - z, 1e-12), 0, 1)) if which else None,
            "per_joint": [
                {"joint": j + 1, "before": float(x), "after": float(y)}
                for j, (x, y) in enumerate(zip(e.before, e.after, strict=True))
            ],
        },
    }


def _small(term: Any) -> dict[str, Any]:
    return {"effect": term.name, "joints": [j + 1 for j in term.joints]}


def _claim(one: Judged, n: int, total: float) -> dict[str, Any]:
    """A cause as the answer has it."""
    name = one.name
    members = {t.name for t, _ in one.members} | {name.name}
    label = name.name
    if label in ("payload", "link_inertia") and name.joints in ((), (n - 1,)):
        members |= {"payload", "link_inertia"}
    alone = one.sure >= LIKELY
    kind = KINDS.get(label)
    return {
        "effect": label,
        "family": None if kind is None else kind.family,
        "branch": None if kind is None else kind.branch,
        "joints": [j + 1 for j in name.joints],
        "ambiguous_with": sorted(members - {label}),
        "how_sure": round(float(one.sure if alone else min(one.there, max(one.law, sum(p for _, p in one.members)))), 3),
        "one_of_a_set": not alone,
        "share": float(np.sqrt(one.fall).max() / max(total, 1e-300)),
        "parameters": {},
    }
