"""An explanation as a person and a file can use it: effects, joints, alternatives, shares."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from scipy.special import chdtrc

from torchid.design.gram import VISIBLE
from torchid.design.segments import when
from torchid.effects.base import Effect, JointEffect, ModelEffect
from torchid.effects.registry import KINDS
from torchid.effects.spring import JointSpring
from torchid.effects.transient import Contact
from torchid.gap.data import Data
from torchid.gap.diagnosis import Finding, HowFar, body_change, unit_of
from torchid.gap.record import Experiment, Informative, Parametric
from torchid.gap.search.evidence import (
    SET_ODDS,
    Fitted,
    Question,
    common_names,
    comparable,
    directions,
    log_likelihood_ratio,
    refit,
    residual,
)
from torchid.gap.search.explain import Explanation
from torchid.gap.search.odds import Odds, Place
from torchid.gap.search.replication import replication
from torchid.gap.search.shares import Shares
from torchid.gap.search.terms import BASE, LINK, PAYLOAD, Term, are_bodies, excluding
from torchid.results.answer import NotTestable
from torchid.results.words import count
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.statistics.criteria import LIKELY
from torchid.typing import Float, Int, Tensor

LARGE_SHARE = 0.5
"""Torque, as a share of the joint's own, below which a testable effect must be detectable."""

HOPELESS_SECONDS = 3600.0
"""Seconds of the same motion beyond which only another motion can help."""


@dataclass(frozen=True, eq=False)
class Judged:
    """A term of an explanation, and what may be there in its place.

    Attributes:
        place: of the term.
        others: what may stand there instead, the likeliest first.
        odds: of everything that may be there.
        at_an_end: whether its shape is at the end of its range.
        law: the place of the law of its joint, friction say, of which it is one term of several.
        law_sure: probability that there is any.
    """

    place: Place
    others: tuple[Term, ...]
    odds: Odds
    at_an_end: bool = False
    law: Place | None = None
    law_sure: float = 0.0

    @property
    def term(self) -> Term:
        """Which it is."""
        return self.place.term

    def confirmed(self, shrinks: Float[Tensor, " n"]) -> "Judged":
        """The same beside data that were not fitted.

        Args:
            shrinks: (n,) probability that each joint's error is less with what is told.
        """
        term, (fit, without) = self.place.term, self.place.fits
        # What happened once, or shows on another sensor, cannot be asked there.
        if self.place.question.shows(term) or any(e.event or e.at_ends for e in term.effects):
            return self
        joint = term.place
        if joint is None:
            joint = int(self.place.question.fall(fit, without).argmax())
        share = float(shrinks[joint])
        return replace(self, odds=self.odds.confirmed(share), law_sure=share * self.law_sure)

    @property
    def one_of_a_set(self) -> bool:
        """Whether it is the likeliest of a set none of which is likely by itself."""
        return self.odds.sure < LIKELY <= self.odds.set_sure and bool(self.others)

    @property
    def sure(self) -> float:
        """Probability of it, or of the set."""
        return self.odds.set_sure if self.one_of_a_set else self.odds.sure

    @property
    def named(self) -> bool:
        """Whether it, or one of its set, is likelier there than not."""
        return self.sure >= LIKELY

    @property
    def unnamed(self) -> bool:
        """Whether neither it, nor the law of its joint as a whole, has a name."""
        return not self.named and self.law_sure < LIKELY

    @property
    def ambiguous_with(self) -> tuple[str, ...]:
        """Names of the others of its set, the same effect elsewhere with the number of its joint or
        link; at the end of a shape's range at least the best other,
        for what lies beyond nobody has looked at."""
        numbers = self.odds.in_set
        if self.at_an_end and self.others and not numbers:
            numbers = [0]
        names = (_name_beside(self.others[k], self.term) for k in numbers)
        return tuple(dict.fromkeys(names))

    @property
    def branch_sure(self) -> float:
        """Probability that the cause is of this branch at this place, whichever it is."""
        mine = _branch(self.term)
        return self.odds.sure + sum(
            mass
            for other, mass in zip(self.others, self.odds.others, strict=True)
            if _branch(other) == mine and _near(other, self.term)
        )


def _name_beside(other: Term, term: Term) -> str:
    """Of another term in the place of one."""
    name = LINK if other.name == BASE else other.name
    return f"{name} {other.joints[0] + 1}" if name == term.name and other.joints else name


def _branch(term: Term) -> str:
    return KINDS[LINK if term.name == BASE else term.name].branch


def _near(one: Term, two: Term) -> bool:
    """Whether two terms are at one place of an arm: joints in common, or both all of it."""
    return bool(set(one.joints) & set(two.joints)) or not (one.joints or two.joints)


def at_an_end(question: Question, term: Term) -> tuple[str, ...]:
    """Shapes at the end of their range: a term with one has become another effect there."""
    shaped = (e for e in term.effects if term.shapes and isinstance(e, JointEffect))
    motions = question.candidates.columns.motions
    return tuple(dict.fromkeys(name for e in shaped for name in e.at_an_end(motions)))


def unsure_terms(judged: Sequence[Judged]) -> list[Term]:
    """Terms that are less likely there than not: no names."""
    return [j.term for j in judged if j.unnamed]


@dataclass(frozen=True, eq=False)
class Findings:
    """What is said of an explanation.

    Attributes:
        effects: the largest share first.
        parametric: corrections of inertial parameters.
        open: (term, best alternative that other data could separate from it).
        rivals: (odds against the answer, term, alternative in its place), as far as they count.
    """

    effects: tuple[Finding, ...]
    parametric: tuple[Parametric, ...]
    open: tuple[tuple[Term, Term], ...]
    rivals: tuple[tuple[float, Term, Term], ...]


def describe_findings(
    found: Explanation, judged: Sequence[Judged], taken: Shares, far: HowFar, corrected: Robot
) -> Findings:
    """Findings of an explanation, each with what it cannot be told from; of the terms that have a
    name.

    Args:
        found: the explanation.
        judged: its terms.
        taken: what each takes of the error.
        far: how far all of them close it together.
        corrected: the robot that is recommended.
    """
    question, fixed = found.question, len(found.question.fixed)
    samples = question.candidates.columns.samples
    shares, alone = taken.of_all(far.less)
    removes = taken.of_bars(far.rms_before, far.rms_after)
    effects, parametric, undecided, rivals = [], [], [], []
    named = with_a_name(judged, shares)
    for k, (term, one) in enumerate(zip(found.terms, judged, strict=True)):
        if not named[k]:
            continue
        names = one.ambiguous_with
        odds = [mass / max(one.odds.sure, 1e-12) for mass in one.odds.others]
        near = zip(odds, one.others, strict=True)
        rivals += [(o, term, other) for o, other in near if o > 1 / SET_ODDS]
        p = p_value(question, *_without_bodies(found, one), term)
        if term.inertial:
            links = term.effects[0].joints if term.name == LINK else ()
            took = alone[k], tuple(removes[k].tolist()), one.branch_sure
            every = shares[k], p, names, one.sure, *took
            parametric.append(Parametric(links, *every, change=_change(found, links, corrected)))
            continue
        separable = _separable(found, one)
        if separable is not None:
            undecided.append((term, separable))
        values, std = (x[fixed + k] for x in (found.solution.values, found.solution.std))
        own = found.solution.terms[fixed + k].effects
        # A curve over position that is none of the library's is told as the term that takes most.
        curve = one.law is not None and one.law.curve
        parts = [i for i, x in enumerate(judged) if curve and x.law is one.law and not named[i]]
        effects.append(
            Finding(
                effect=own[0],
                values=tuple(values.tolist()),
                main=found.solution.main(fixed + k),
                joints=_felt(found, fixed + k),
                ambiguous_with=(*names, *(judged[i].term.name for i in parts)),
                std=tuple(std.tolist()),
                p_value=p,
                how_sure=one.sure if one.named else one.law_sure,
                one_of_a_set=one.one_of_a_set or not one.named,
                branch_sure=one.branch_sure if curve else max(one.branch_sure, one.law_sure),
                replication=replication(one.place.own, found.solution, fixed + k, samples),
                share=sum(shares[i] for i in (k, *parts)),
                alone=alone[k],
                removes=tuple(removes[[k, *parts]].sum(0).tolist()),
                notes=_notes(found, term, own[0], values, std),
                common=len(own) > 1,
            )
        )
    return Findings(
        tuple(sorted(effects, key=lambda f: -f.share)),
        tuple(parametric),
        tuple(undecided),
        tuple(rivals),
    )


def with_a_name(judged: Sequence[Judged], shares: Sequence[float]) -> list[bool]:
    """Which terms are told by name: those that are likely; and of the law of a joint that is there,
    while none of its terms is likely by itself, the one that takes most.

    Args:
        judged: terms.
        shares: of the error that each takes.
    """
    out = [one.named for one in judged]
    laws: dict[Place, list[int]] = {}
    for k, one in enumerate(judged):
        if one.law is not None and one.law_sure >= LIKELY:
            laws.setdefault(one.law, []).append(k)
    for numbers in laws.values():
        if not any(out[k] for k in numbers):
            out[max(numbers, key=lambda k: shares[k])] = True
    return out


def _change(found: Explanation, links: Sequence[int], corrected: Robot) -> str:
    """Of a link, from the model that is corrected to the recommended one; empty of no link."""
    start = found.solution.start.robot
    own = [start.own_links[joint] for joint in links]
    every = [r.require_parameters("a change").pi[own] for r in (start, corrected)]
    return body_change(*(InertialParameters(pi[0]) for pi in every)) if own else ""


def _separable(found: Explanation, one: Judged) -> Term | None:
    """The best alternative that other data could separate from a term: one that leaves the same is
    the same, and no data of this kind tell them apart."""
    question, fit = found.question, found.fit
    rest = excluding(found.terms, [one.term])
    for other in one.others:
        if other.name == one.term.name:
            continue
        again = refit(question, fit, (*rest, other))
        differs = log_likelihood_ratio(fit.effective, again.losses, fit.losses)
        if other.name != BASE and float(differs.abs().sum()) >= 0.1:
            return other
    return None


def _without_bodies(found: Explanation, one: Judged) -> tuple[Fitted, Fitted]:
    """The explanation with a term and without it; of a load beside the effects alone, for all base
    parameters hold whatever it does."""
    question, fit = found.question, found.fit
    if one.term.name != PAYLOAD:
        return comparable(question, *one.place.fits)
    effects = [t for t in found.terms if t.name != BASE]
    lighter = excluding(effects, [one.term])
    both = (refit(question, fit, e, 10) for e in (effects, lighter))
    return comparable(question, *both)


def p_value(question: Question, fit: Fitted, without: Fitted, term: Term) -> float:
    """Family-wise p-value of a term beside the others: of the likelihood ratio with the effective
    number of samples (Wilks 1938), times all candidates. A joint of what most joints have was not
    searched for."""
    # Twice the logarithm of the likelihoods' ratio, over the directions that the term has.
    ratio = float(log_likelihood_ratio(fit.effective, without.losses, fit.losses).sum())
    if term.seen is not None or question.known:
        ratio += without.known - fit.known
    df = directions(question, term) + term.shapes
    own = question.own(fit)
    searched = term.name not in common_names(own, question.joints)
    looks = question.looks if searched else 1.0
    return min(1.0, looks * float(chdtrc(df, max(0.0, ratio))))


def _felt(found: Explanation, k: int) -> tuple[int, ...]:
    """Joints of the k-th term; of a global effect those whose torque it changes by as much as is
    worth a name."""
    solution = found.solution
    if joints := solution.terms[k].joints:
        return joints
    # Where its torque is worth a name.
    torque = torch.tensordot(solution.values[k], solution.a[solution.at(k)], 1)
    mean = found.question.mean
    felt = mean(torque.square().sum(1)).sqrt() >= found.question.least(mean(found.empty.losses))
    return tuple(felt.nonzero().flatten().tolist())


def _notes(
    found: Explanation, term: Term, effect: Effect, values: Tensor, std: Tensor
) -> tuple[str, ...]:
    """Coefficients that the data leave open, those that correct one of the model's own, and when a
    contact was."""
    out = []
    # Of a load only what the motion determines is known.
    told = directions(found.question, term)
    if term.name == PAYLOAD and told < len(values):
        out.append(
            f"the motion determines {count(told, 'combination')} of the ten parameters only; these "
            "values are one choice of many with the same torque"
        )
    if term.name == PAYLOAD:
        # Ten numbers are a body only if their pseudo-inertia is.
        margin = InertialParameters(values.unsqueeze(0)).consistency_margin()
        if float(margin) < 0:
            out.append(
                "these ten load parameters fit the torque but are not physically possible; use "
                "`torchid payload`"
            )
    pairs = zip(term.coefficients, values.tolist(), std.tolist(), term.known, strict=True)
    for c, v, s, own in pairs:
        if s > abs(v) and not (term.name == PAYLOAD and told < len(values)):
            out.append(f"{c.name} is not determined: {v:.3g} ± {s:.2g}")
        if own:
            out.append(f"{c.name} is a correction: the model has {own:.4g}, the arm {own + v:.4g}")
    out += [
        f"{name} is at the end of its range: what lies beyond was not looked at"
        for name in at_an_end(found.question, term)
    ]
    if term.seen is not None:
        out.append(term.seen.said)
    if term.instead:
        out.append("it stands in the place of the model's own, whose shape is another")
    if isinstance(effect, JointSpring) and effect.curvature:
        samples = found.question.candidates.columns.samples
        q = samples.of([s.motion.q[:, [effect.joint]].T for s in samples.segments])[0]
        least, most = torch.aminmax(effect.stiffness(values.tolist(), q))
        out.append(
            f"k is the stiffness at q = 0; where the joint moved, from {float(q.min()):.3g} to "
            f"{float(q.max()):.3g}, it is {float(least):.3g} to {float(most):.3g}"
        )
    if isinstance(effect, Contact) and effect.start is not None and effect.stop is not None:
        segments = found.question.candidates.columns.samples.segments
        name, start = when(segments, effect.start)
        place = "" if effect.along is None else f"{effect.along:.0%} of the way along "
        of_tip = "" if effect.tip is None else f"at {place}'{effect.tip}', "
        stop = start + effect.stop - effect.start
        out.append(f"{of_tip}from {start:.2f} to {stop:.2f} s of '{name}'")
    return tuple(out)


def next_experiment(
    found: Explanation, said: Findings, block: Int[Tensor, " N"]
) -> Experiment | None:
    """What would separate the largest ambiguity: in words, and where this log comes closest."""
    if not said.open:
        return None
    question, fit = found.question, found.fit
    samples = question.candidates.columns.samples
    # Of the ambiguous causes that which holds most.
    held = []
    for term, _ in said.open:
        rest = excluding(found.terms, [term])
        without = refit(question, fit, rest)
        held.append(float((fit.weight * without.losses).sum()))
    term, other = said.open[max(range(len(held)), key=held.__getitem__)]
    # Where the two explanations differ most, block by block.
    rest = excluding(found.terms, [term])
    again = refit(question, fit, (*rest, other))
    mine = residual(question, fit.terms, fit.x) - residual(question, again.terms, again.x)
    # Squared difference of the two, block by block; the clearest block is named.
    left = torch.zeros(int(block.max()) + 1, dtype=torch.float64)
    left.index_add_(0, block, (fit.weight.unsqueeze(1) * mine.square()).sum(0))
    best = int(left.argmax())
    instants = (block == best).nonzero().flatten()
    t = samples.t
    name, start = when(samples.segments, float(t[instants[0]]))
    total = float(left.sum())
    # As much more of the same motion as makes the odds, if it is as clear as here.
    seconds = len(block) * samples.interval * 2 * math.log(SET_ODDS) / max(1e-12, total)
    joints = next((e.joints for e in (*term.effects, *other.effects) if e.joints), ())
    # What to do, from the effects' own descriptions.
    advice = dict.fromkeys(KINDS[n].experiment for n in (term.name, other.name))
    both = "; and ".join(advice)
    return Experiment(
        separates=(term.name, other.name),
        joint=joints[0] if joints else None,
        do=both[:1].upper() + both[1:] + ".",
        most_informative=Informative(
            trajectory=name,
            from_s=start,
            to_s=start + float(t[instants[-1]] - t[instants[0]]),
            share=float(left[best]) / max(1e-12, total),
        ),
        seconds_of_the_same_motion=seconds if seconds < HOPELESS_SECONDS else None,
    )


def not_testable(found: Explanation, data: Data) -> list[NotTestable]:
    """Effects that these data cannot show, one entry an effect and place: with the smallest first
    coefficient whose evidence would be positive on average."""
    question, fit = found.question, found.fit
    normal, weight, robot = question.normal, fit.weight, found.solution.start.robot
    accepted = {t.key for t in found.terms}
    best: dict[tuple[object, ...], tuple[float, float, Term]] = {}
    for term in question.candidates.terms:
        if term.of_links or term.key in accepted:
            continue
        # Of the first column's square, what no combination of the model's columns holds.
        size, row = 0.0, int(term.at[0])
        held = torch.zeros(fit.root.shape[1], dtype=torch.float64)
        for j in range(len(normal.g)) if term.place is None else (term.place,):
            g, at = normal.g[j], fit.subset.at[j]
            size += float(weight[j] * g[row, row])
            held += weight[j] * ((g[row, at] * (at >= 0)) @ fit.root)
        left = size - float(held @ held)
        if term.key not in best or left > best[term.key][1]:
            best[term.key] = size, left, term
    out, wanted = [], found.solution.wanted
    for size, left, term in best.values():
        # From which coefficient on its evidence would be positive on average.
        effect, share = term.effects[0], left / size if size > 0 else 0.0
        n = float(fit.effective.sum() if term.place is None else fit.effective[term.place])
        needed = question.price() + (1 + term.shapes) * math.log(max(n, 2.0))
        smallest: float | None = math.sqrt(needed / max(left, 1e-300))
        reason = ""
        # Why it cannot be told: not measured, not excited, hidden behind what is fitted, or below
        # the noise.
        if term.place in data.silent:
            smallest, reason = None, "the joint's torque holds no signal"
        elif size <= 1e-9:
            smallest, reason = None, "the motion does not excite it"
        elif share < 1e-6:
            smallest, reason = None, "indistinguishable from a change of the inertial parameters"
        elif share < VISIBLE:
            reason = "indistinguishable from a change of the inertial parameters"
        elif term.place is not None:
            square = size / float(weight[term.place] * normal.rows[term.place].clamp(min=1))
            torque = float(question.torque[term.place].sqrt())
            if math.sqrt(needed / left * square) > LARGE_SHARE * torque:
                reason = "noise hides it up to half of the joint's torque"
        if reason:
            unit = unit_of(effect.coefficients[0].unit, effect.joints[:1], robot)
            out.append(NotTestable(effect.name, term.joints, smallest, unit, reason))
    # Effects whose columns need bodies, where only base parameters are known.
    bodies = are_bodies(question.candidates.columns.model.robot)
    for kind in () if bodies else (KINDS[n] for n in wanted.names if KINDS[n].of_bodies):
        asked = issubclass(kind, ModelEffect) and bool(kind.starts(robot))
        if asked and not kind.needs & data.missing:
            reason = "the model's links are no bodies (`torchid extract` finds some)"
            unit = kind.coefficients[0].unit_for(False)
            out.append(NotTestable(kind.name, (), None, unit, reason))
    # Effects that were no candidates on joints that do not slide.
    known = {*accepted, *best}
    still = (~data.slides).nonzero().flatten().tolist()
    for j, kind in ((j, KINDS[name]) for j in still if j in robot.driven for name in wanted.names):
        asked = issubclass(kind, JointEffect) and not kind.needs & data.missing
        if asked and (kind.name, (j,)) not in known and wanted.asks(kind.name, (j,)):
            unit = unit_of(kind.coefficients[0].unit, (j,), robot)
            out.append(NotTestable(kind.name, (j,), None, unit, "the motion does not excite it"))
    return out
