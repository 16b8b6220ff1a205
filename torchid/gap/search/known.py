"""What was known of a model before a log, and what the log adds to it."""

import math
from dataclasses import replace

import torch

from torchid.gap.diagnosis import unit_of
from torchid.gap.problem import Problem
from torchid.gap.record import Known, KnownCoefficient, Open
from torchid.gap.search.explain import Explanation
from torchid.gap.search.terms import BASE, LINK
from torchid.identification.knowledge import known_names, learned
from torchid.robot.knowledge import BETWEEN, Knowledge
from torchid.typing import Float, Tensor

AS_CAD = (
    "the model carries no uncertainties: its inertias are taken as right to ±10 %, its friction as "
    "exact"
)


def after_log(found: Explanation, problem: Problem) -> Knowledge:
    """What was known of the model, as far as it has not changed, and what the log adds."""
    data, wanted = problem.data, problem.wanted
    at = found.question.candidates.columns.at(found.solution.model)
    source = ", ".join(dict.fromkeys(s.name for s in data.segments))
    now = learned(at, data.keep, problem.block, found.fit.effective, wanted.base, source)
    if wanted.knowledge is None:
        return now
    changed = [n for t in found.terms for e in t.effects for n in known_names(e)]
    robot = at.model.robot
    links = [robot.own_links[t.effects[0].joints[0]] for t in found.terms if t.name == LINK]
    if any(t.name == BASE for t in found.terms):
        links = list(range(robot.n_links))
    both = wanted.knowledge.without(changed, links).plus(now)
    # What is named now is not left any more.
    return replace(both, left=now.left) if found.terms else both


def known_of(
    found: Explanation, problem: Problem, after: Knowledge, least: Float[Tensor, " n"]
) -> Known | None:
    """What was known before, and what the log adds to it; None where there is nothing to say.

    Args:
        found: the answered explanation.
        problem: with the knowledge before.
        after: the knowledge with this log.
        least: (n,) torque that is worth a name [N m; N].
    """
    before = problem.wanted.knowledge
    if before is None:
        # Parameters were given that nobody vouches for.
        as_cad = problem.settings.parameters == "auto" and not problem.fitted_first
        return Known(sources=(), notes=(AS_CAD,)) if as_cad else None
    solution = found.solution
    robot = solution.start.robot
    named = {n for t in found.terms for e in t.effects for n in known_names(e)}
    # Coefficients, as the model had them and has them now.
    ends = [
        {name: (v, unit_of(c.unit, e.joints, robot))
         for e, values in model.effects
         for name, v, c in zip(known_names(e), values, e.coefficients, strict=True)}
        for model in (solution.start, solution.model)
    ]  # fmt: skip
    coefficients = [
        KnownCoefficient(
            name=name,
            unit=unit,
            before=v,
            before_std=finite(before.std(name)),
            after=ends[1][name][0],
            after_std=finite(after.std(name)),
            changed=name in named,
        )
        for name, (v, unit) in ends[0].items()
        if name in before.coefficients and name in ends[1]
    ]
    # Torque of the corrections within what was known, joint by joint.
    fixed = len(found.question.fixed)
    held = sum(len(v) for v in solution.values[:fixed])
    slack = torch.cat([torch.zeros(0, dtype=torch.float64), *solution.values[:fixed]])
    moved = torch.tensordot(slack, solution.a[:held], 1)
    added, left = (found.question.mean(x.square().sum(1)).sqrt() for x in (moved, solution.left))
    joints = tuple(
        Open(
            joint=j,
            added_rms=float(added[j]),
            hides=bool(added[j] > torch.maximum(left[j], least[j])),
            motion=closing_motion(j) if added[j] > torch.maximum(left[j], least[j]) else "",
        )
        for j in range(len(added))
    )
    if before.between:
        note = "changes from one session to the next by itself are as large as sessions have shown"
    else:
        note = (
            f"friction is assumed to change by {BETWEEN:.0%} from one session to the next by "
            "itself: several sessions show how much it does (`torchid fleet identify`)"
        )
    return Known(
        sources=before.sources,
        coefficients=tuple(coefficients),
        joints=joints,
        between_sessions=None if before.between else BETWEEN,
        notes=(note,),
    )


def closing_motion(joint: int) -> str:
    """What to drive so that a joint's torque is known."""
    return (
        f"drive joint {joint + 1} and those behind it through their whole range, slowly and fast: "
        "`torchid excite --for` designs the motion"
    )


def finite(value: float) -> float | None:
    """None of what is infinite: unknown."""
    return value if math.isfinite(value) else None
