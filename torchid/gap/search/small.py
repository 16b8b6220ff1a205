"""What the evidence has and nobody asked for: causes that are too small to be worth a name."""

from msgspec import structs

from torchid.gap.data import Data
from torchid.gap.diagnosis import unit_of
from torchid.gap.record import SmallEffect
from torchid.gap.search.climb import allowed
from torchid.gap.search.evidence import Fitted, Question, apart, fit_terms
from torchid.gap.search.explain import Explanation
from torchid.gap.search.odds import LIKELY, odds, probability
from torchid.gap.search.replication import own_torque, replication
from torchid.gap.search.solve import solved
from torchid.gap.search.terms import Term
from torchid.json_data import plain
from torchid.robot.model import Robot
from torchid.typing import Float, Int, Tensor


def small_effects(
    found: Explanation,
    data: Data,
    block: Int[Tensor, " N"],
    robot: Robot,
    misfit: Float[Tensor, " n"],
) -> tuple[SmallEffect, ...]:
    """Causes that the evidence has beside what is told, each likelier there than not, the largest
    first; bodies are none of them.

    Args:
        found: what is told, and what was not worth a name.
        data, block: of the log, as for `solved`.
        robot: for units.
        misfit: (n,) mean square of what the answer leaves and is no noise.
    """
    question, fit = found.question, found.fit
    named = {t.key for t in found.terms}
    last = {t.key: t for t in found.unworthy if t.key not in named and not t.inertial}
    whole = allowed(question, fit_terms(question, [*found.terms, *last.values()], fit.effective))
    # Causes that stand for each other: the least needed leaves first.
    without: dict[int, tuple[float, Tensor, Fitted]] = {}
    while own := [t for t in whole.terms[len(question.fixed) :] if t.key in last]:
        without = {id(t): _without(question, whole, t) for t in own}
        gone = max(own, key=lambda t: without[id(t)][0])
        if probability([without[id(gone)][0]]) >= LIKELY:
            break
        rest = [t for t in whole.terms[len(question.fixed) :] if t is not gone]
        whole = allowed(question, fit_terms(question, rest, whole.effective, whole.weight))
    if not own:
        return ()
    # Their sizes, fitted together with what is told.
    columns = question.candidates.columns.at(found.solution.start)
    values = whole.values()
    solution = solved(
        columns, whole.terms, values, data, found.solution.wanted, block, whole.effective
    )
    out = []
    for k, term in enumerate(whole.terms):
        if id(term) not in without:
            continue
        _, closes, other = without[id(term)]
        own_part = own_torque(solution, k)
        sure = odds(question, (whole, other), solution, k, own_part, misfit).sure
        if sure >= LIKELY:
            own_values, std = solution.values[k], solution.std[k]
            again = replication(own_part, solution, k, question.candidates.columns.samples)
            one = _entry(solution.terms[k], own_values, std, closes, sure, robot)
            out.append(structs.replace(one, replication=again))
    return tuple(sorted(out, key=lambda e: -e.closes_rms))


def _without(question: Question, whole: Fitted, term: Term) -> tuple[float, Tensor, Fitted]:
    """Rise of the evidence without a term, the error (n,) that it takes away [N m; N], and the fit
    without it."""
    rest = [t for t in whole.terms[len(question.fixed) :] if t is not term]
    without = fit_terms(question, rest, whole.effective, whole.weight)
    now, then = apart(question, whole, without)
    fall = (without.losses - whole.losses).clamp(min=0) / question.normal.rows.clamp(min=1.0)
    return then.evidence - now.evidence, fall.sqrt(), without


def _entry(
    term: Term, values: Tensor, std: Tensor, closes: Tensor, sure: float, robot: Robot
) -> SmallEffect:
    effect = term.effects[0]
    joints = effect.joints if len(term.effects) == 1 else ()
    felt = joints or (int(closes.argmax()),)
    names = [c.name for c in effect.coefficients]
    shapes = dict(zip((s.name for s in effect.shapes), effect.shape_values, strict=True))
    return SmallEffect(
        effect=effect.name,
        family=effect.family,
        joints=joints,
        parameters=plain(dict(zip(names, values.tolist(), strict=True)) | shapes),
        std=plain(dict(zip(names, std.tolist(), strict=True))),
        unit={c.name: unit_of(c.unit, felt, robot) for c in effect.coefficients},
        closes_rms=float(closes.max()),
        how_sure=sure,
    )
