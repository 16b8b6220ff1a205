"""Accepted terms as a person and a file can use them: effects, joints, alternatives, shares."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from torchid.effects.base import Effect
from torchid.effects.registry import experiment
from torchid.effects.transient import Contact
from torchid.gap.ambiguity import Alternative, aliases, alternatives, separation
from torchid.gap.diagnosis import Finding, Parametric
from torchid.gap.evidence import p_value
from torchid.gap.passages import Passage, Rows, when
from torchid.gap.problem import BASE, LINK, Term
from torchid.gap.select import Search
from torchid.gap.solve import Solution
from torchid.typing import Tensor

FELT = 25.0
"""Whitened sum of squares above which a joint feels a global effect."""

SEPARABLE = 0.1
"""Whitened sum of squares by which two explanations must differ for an experiment to help; less
is an exact alias."""
HOPELESS = 3600.0
"""Seconds of the same motion beyond which only another motion can help."""

FELT_SHARE = 0.01
"""And the share of the effect's whole that it must be."""


@dataclass(frozen=True)
class Findings:
    """What was accepted.

    Attributes:
        effects: findings, the largest share first.
        parametric: corrections of inertial parameters.
        unresolved: (finding's term, best alternative) of those with a runner-up that is not an
            exact alias.
        terms, of_terms: the solution's terms, and the entry of each.
    """

    effects: tuple[Finding, ...]
    parametric: tuple[Parametric, ...]
    unresolved: tuple[tuple[Term, Alternative], ...]
    terms: tuple[Term, ...]
    of_terms: tuple[Finding | Parametric, ...]


def findings(solution: Solution) -> Findings:
    """Findings of a solution, each with what it cannot be told from."""
    problem = solution.problem
    search = Search(problem, list(solution.terms))
    start = Search(problem, []).model().loss
    entries: list[Finding | Parametric] = []
    unresolved = []
    for term in solution.terms:
        others = alternatives(search, term)
        entries.append(_entry(solution, search, term, others, start))
        apart = [a for a in others if float(separation(search, term, a.term).sum()) > SEPARABLE]
        if apart and not term.is_inertial:
            unresolved.append((term, apart[0]))
    found = [e for e in entries if isinstance(e, Finding)]
    inertial = [e for e in entries if isinstance(e, Parametric)]
    return Findings(
        tuple(sorted(found, key=lambda f: -f.share)),
        tuple(inertial),
        tuple(unresolved),
        solution.terms,
        tuple(entries),
    )


def _entry(
    solution: Solution, search: Search, term: Term, others: Sequence[Alternative], start: float
) -> Finding | Parametric:
    """What is told of one term; `start`: loss of the model as given."""
    problem, n = solution.problem, solution.problem.y.shape[0]
    last = search.model().loss
    closable = max(start - problem.noise, start - last, 1e-12)
    names = tuple(dict.fromkeys([*(a.name for a in others), *aliases(term, n)]))
    without = search.model(without=[term])
    gain = without.loss - last
    p = p_value(problem, term, gain, without)
    if term.is_inertial:
        links = term.effects[0].joints if term.name == LINK else ()
        return Parametric(links, gain / closable, p, names)
    values, std = solution.values_of(term)
    return Finding(
        effect=term.effects[0],
        values=tuple(values.tolist()),
        joints=_joints(term, values, n),
        ambiguous_with=names,
        std=tuple(std.tolist()),
        p_value=p,
        share=gain / closable,
        first=(start - _alone(problem, term)) / closable,
        notes=_notes(term, values, std),
        common=len(term.effects) > 1,
    )


def _alone(problem: Any, term: Term) -> float:
    return Search(problem, [term]).model().loss


def _joints(term: Term, values: Tensor, n: int) -> tuple[int, ...]:
    """The effect's joint; of a global one those whose torque it changes beyond noise."""
    effect: Effect = term.effects[0]
    if (effect.joints and len(term.effects) == 1) or term.name == BASE:
        return effect.joints
    share = (values @ term.columns).reshape(n, -1).square().sum(1)
    felt = (share > FELT) & (share > FELT_SHARE * share.sum())
    return tuple(felt.nonzero().flatten().tolist())


def _notes(term: Term, values: Tensor, std: Tensor) -> tuple[str, ...]:
    """Coefficients that the data leave open, and those that correct one of the model's own."""
    out = []
    known = term.known or (0.0,) * len(values)
    columns = zip(term.coefficients, values.tolist(), std.tolist(), known, strict=True)
    for c, v, s, own in columns:
        if s > abs(v):
            out.append(f"{c.name} is not determined: {v:.3g} ± {s:.2g}")
        if own:
            out.append(f"{c.name} is a correction: the model has {own:.4g}, the arm {own + v:.4g}")
    return tuple(out)


def dated(found: Findings, passages: Sequence[Passage]) -> Findings:
    """Findings that say when a contact was."""
    return replace(found, effects=tuple(_dated(f, passages) for f in found.effects))


def _dated(finding: Finding, passages: Sequence[Passage]) -> Finding:
    effect = finding.effect
    if not isinstance(effect, Contact) or effect.start is None or effect.stop is None:
        return finding
    name, start = when(passages, effect.start)
    note = f"from {start:.2f} to {start + effect.stop - effect.start:.2f} s of '{name}'"
    return replace(finding, notes=(*finding.notes, note))


def next_experiment(solution: Solution, found: Findings, rows: Rows) -> dict[str, Any] | None:
    """What would separate the largest ambiguity: in words, and where this log comes closest."""
    if not found.unresolved:
        return None
    problem = solution.problem
    search = Search(problem, list(solution.terms))
    term, other = max(found.unresolved, key=lambda pair: search.model(without=[pair[0]]).loss)
    left = separation(search, term, other.term)
    best = int(left.argmax())
    instants = (problem.block == best).nonzero().flatten()
    t = rows.pick([p.motion.t for p in rows.passages if p.motion.t is not None])
    where = next(k for k, own in enumerate(rows.bounds) if own.start <= int(instants[0]) < own.stop)
    needed = problem.threshold(1)
    total = float(left.sum())
    seconds = len(problem.block) * rows.interval * needed / max(1e-12, total)
    joints = next((e.joints for e in (*term.effects, *other.term.effects) if e.joints), ())
    return {
        "separates": [term.name, other.name],
        "joint": joints[0] + 1 if joints else None,
        "do": experiment(term.name, other.name),
        "most_informative": {
            "trajectory": rows.passages[where].name,
            "from_s": float(t[instants[0]]) - rows.passages[where].start,
            "to_s": float(t[instants[-1]]) - rows.passages[where].start,
            "share": float(left[best]) / max(1e-12, total),
        },
        "seconds_of_the_same_motion": seconds if seconds < HOPELESS else None,
    }
