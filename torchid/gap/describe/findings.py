"""Causes as a person and a file can use them: effects, joints, alternatives, shares."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from msgspec import UNSET, UnsetType

from torchid.design.gram import VISIBLE
from torchid.design.segments import Samples, when
from torchid.effects.base import Effect
from torchid.gap.cause_records import body_cause, body_change, effect_cause, how_named
from torchid.gap.causes.candidates import Term
from torchid.gap.causes.search import same_columns
from torchid.gap.describe.claims import Claim, at_an_end, kind_of, with_a_name
from torchid.gap.describe.model import Explanation, Solution
from torchid.gap.describe.replication import replication
from torchid.gap.describe.shares import Shares
from torchid.gap.diagnosis import HowFar
from torchid.gap.wanted import BASE
from torchid.results.cause import LINK, Cause, JudgedOn, Window
from torchid.results.words import PAYLOAD, count
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.statistics.criteria import LIKELY
from torchid.typing import Float, Tensor


@dataclass(frozen=True, eq=False)
class Findings:
    """What is said of an explanation.

    Attributes:
        causes: the largest share first.
        open: (cause, best alternative that other data could separate from it).
    """

    causes: tuple[Cause, ...]
    open: tuple[tuple[Term, Term], ...]


@dataclass(frozen=True, eq=False)
class Taken:
    """What the causes of an explanation take of the error that it closes.

    Attributes:
        shares, alone: (K) of the whole error, with the others and by itself.
        removes: (K, n) of each joint's error [N m; N].
    """

    shares: list[float]
    alone: list[float]
    removes: Float[Tensor, "K n"]

    @classmethod
    def of(cls, taken: Shares, far: HowFar, shown: HowFar) -> "Taken":
        """Shares of the error of a log's parts left out in turn, and of the bars that are shown, of
        the held-out log where there is one."""
        return cls(*taken.of_all(far.less), taken.of_bars(shown.rms_before, shown.rms_after))


def describe_findings(
    found: Explanation, claims: Sequence[Claim], taken: Taken, corrected: Robot
) -> Findings:
    """Findings of an explanation, each with what it cannot be told from; of the causes that have a
    name.

    Args:
        found: the explanation.
        claims: its causes.
        taken: what each takes of the error.
        corrected: the robot that is recommended.
    """
    causes, undecided, judged = [], [], found.problem.left_out
    named = with_a_name(claims, taken.shares)
    for k, one in enumerate(claims):
        if not named[k]:
            continue
        # A curve over position that is none of the library's is told as the term that takes most.
        alike = [i for i, x in enumerate(claims) if one.curve and x.law == one.law and not named[i]]
        own = {
            "ambiguous_with": (*one.ambiguous_with, *(claims[i].term.name for i in alike)),
            "probabilities": one.probabilities,
            "share": sum(taken.shares[i] for i in (k, *alike)),
            "alone": taken.alone[k],
            "removes": tuple(taken.removes[[k, *alike]].sum(0).tolist()),
            "when": one.judged.when or UNSET,
            "judged": judged if one.asked_again else JudgedOn(on=judged.on, how="fitted"),
        }
        causes.append(_cause(found, k, one, corrected, own))
        separable = None if one.term.parametric else _separable(found, one)
        if separable is not None:
            undecided.append((one.term, separable))
    return Findings(tuple(sorted(causes, key=lambda c: -c.share)), tuple(undecided))


def _cause(found: Explanation, k: int, one: Claim, corrected: Robot, own: dict[str, Any]) -> Cause:
    """The k-th cause of an explanation, with what else is told of it."""
    solution, at, samples = found.solution, found.fixed + k, found.problem.data.samples
    sure = one.sure if one.named else one.law_sure
    # Of a set, and of a law none of whose terms is likely, no member is sure alone.
    alone = 0.0 if one.one_of_a_set or not one.named else sure
    narrow = one.curve or one.term.parametric
    wide = one.branch_sure if narrow else max(one.branch_sure, one.law_sure)
    own |= how_named(kind_of(one.term).branch, sure, alone, wide)
    # What to do is said of what is likely by itself; of a set what would tell its members apart.
    if own["probabilities"][one.name] < LIKELY:
        own["remedy"] = f"To tell which it is, {kind_of(one.term).experiment}."
    if one.term.parametric:
        links = one.term.joints if one.term.name == LINK else ()
        own.setdefault("remedy", _change(found, links, corrected))
        return body_cause(links, **own)
    part, values, std = solution.parts[at], solution.values[at], solution.std[at]
    effect, many, given = part.effects[0], len(part.effects) > 1, solution.start
    if part.rows is not None and any(part.known):
        given = replace(given, effects=(*given.effects, (effect, list(part.known))))
    return effect_cause(
        (effect, values.tolist()), std.tolist(), given, solution.model, solution.main(at),
        solution.of_shapes(at),
        joints=_felt(found, at), located=() if many else effect.joints, common=many,
        replication=replication(solution, at, samples), window=_window(samples, effect),
        notes=_notes(found, at), **own,
    )  # fmt: skip


def _window(samples: Samples, effect: Effect) -> Window | UnsetType:
    """When a push was, in the time of its log."""
    if effect.span is None:
        return UNSET
    name, start = when(samples.segments, effect.span[0])
    return Window(name, start, start + effect.span[1] - effect.span[0])


def _change(found: Explanation, links: Sequence[int], corrected: Robot) -> str:
    """Of a link, from the model that is corrected to the recommended one; empty of no link."""
    start = found.solution.start.robot
    own = [start.own_links[joint] for joint in links]
    every = [r.require_parameters("a change").pi[own] for r in (start, corrected)]
    return body_change(*(InertialParameters(pi[0]) for pi in every)) if own else ""


def _separable(found: Explanation, one: Claim) -> Term | None:
    """The best alternative that other data could separate from a cause."""
    for other, _ in one.others:
        if other.name in (one.term.name, BASE) or same_columns(other, one.term):
            continue
        again, fit = found.instead(one.term, other), found.fit
        differs = 0.5 * fit.samples * np.log(again.losses / fit.losses)
        # 0.05: difference of evidence below which another cause leaves the same, and no data of
        # this kind tell the two apart [nats]
        if np.abs(differs).sum() >= 0.05:
            return other
    return None


def _felt(found: Explanation, k: int) -> tuple[int, ...]:
    """Joints of the k-th part; of a global effect those whose torque it changes by as much as is
    worth a name."""
    if joints := found.solution.parts[k].joints:
        return joints
    felt = found.mean(found.solution.torque(k).square()).sqrt() >= found.least
    return tuple(felt.nonzero().flatten().tolist())


def _known_directions(solution: Solution, k: int) -> int:
    """Directions of the k-th part's columns that the samples tell apart."""
    a = solution.a[solution.at(k)].flatten(1)
    gram = a @ a.T
    size = gram.diagonal().clamp(min=1e-300).sqrt()
    return max(1, int((torch.linalg.eigvalsh(gram / size / size.unsqueeze(1)) > VISIBLE).sum()))


def _notes(found: Explanation, k: int) -> tuple[str, ...]:
    """Coefficients that the data leave open, those that correct one of the model's own, and when a
    contact was."""
    solution, samples = found.solution, found.problem.data.samples
    part, values, std = solution.parts[k], solution.values[k], solution.std[k]
    assert part.term is not None
    effect, out = part.effects[0], []
    # Of a load only what the motion determines is known.
    some_of_load = part.name == PAYLOAD and (told := _known_directions(solution, k)) < len(values)
    if some_of_load:
        out.append(
            f"the motion determines {count(told, 'combination')} of the ten parameters only; these "
            "values are one choice of many with the same torque"
        )
    for c, v, s in zip(part.coefficients, values.tolist(), std.tolist(), strict=True):
        if s > abs(v) and not some_of_load:
            out.append(f"{c.name} is not determined: {v:.3g} ± {s:.2g}")
    out += [
        f"{name} is at the end of its range: what lies beyond was not looked at"
        for name in at_an_end(found.search.library, part.term)
    ]
    if part.seen is not None:
        out.append(part.seen.sentence)
    if part.instead is not None:
        out.append("it stands in the place of the model's own, whose shape is another")
    q = samples.of([s.motion.q.T for s in samples.segments]).T
    out += effect.remarks(values.tolist(), q)
    window = _window(samples, effect)
    if window is not UNSET:
        said = f"from {window.from_s:.2f} to {window.to_s:.2f} s of '{window.trajectory}'"
        out.append(effect.point + said)
    return tuple(out)
