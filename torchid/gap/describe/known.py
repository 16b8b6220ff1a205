"""What was known of a model before a log, and what the log adds to it."""

import math
from collections.abc import Sequence
from dataclasses import replace

import torch

from torchid.gap.cause_records import unit_of
from torchid.gap.causes.candidates import Term
from torchid.gap.describe.model import Explanation
from torchid.gap.record import Known, KnownCoefficient, Open
from torchid.gap.wanted import BASE
from torchid.identification.knowledge import known_names, learned
from torchid.results.cause import LINK
from torchid.robot.knowledge import BETWEEN, Knowledge
from torchid.typing import Float, Tensor

AS_CAD = (
    "the model carries no uncertainties: its inertias are taken as right to ±10 %, its friction as "
    "exact"
)


def after_log(found: Explanation) -> Knowledge:
    """What was known of the model, as far as it has not changed, and what the log adds."""
    data, wanted = found.problem.data, found.problem.wanted
    at, samples = found.solution.columns, torch.from_numpy(found.fit.samples)
    source = ", ".join(dict.fromkeys(s.name for s in data.segments))
    now = learned(at, data.keep, found.problem.block, samples, wanted.base, source)
    if wanted.knowledge is None:
        return now
    robot, changed = at.model.robot, _names(found.terms)
    links = [robot.own_links[t.joints[0]] for t in found.terms if t.name == LINK]
    if any(t.name == BASE for t in found.terms):
        links = list(range(robot.n_links))
    both = wanted.knowledge.without(changed, links).plus(now)
    # What is named now is not left any more.
    return replace(both, left=now.left) if found.terms else both


def _names(terms: Sequence[Term]) -> list[str]:
    """Names by which coefficients of causes are known."""
    return [name for t in terms if t.effect is not None for name in known_names(t.effect)]


def known_of(found: Explanation, after: Knowledge, least: Float[Tensor, " n"]) -> Known | None:
    """What was known before, and what the log adds to it; None where there is nothing to say.

    Args:
        found: the answered explanation.
        after: the knowledge with this log.
        least: (n,) torque that is worth a name [N m; N].
    """
    problem, before = found.problem, found.problem.wanted.knowledge
    if before is None:
        return Known(sources=(), notes=(AS_CAD,)) if problem.as_cad else None
    solution = found.solution
    robot = solution.start.robot
    named = set(_names(found.terms))
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
    none = torch.zeros_like(solution.left)
    moved = sum((solution.torque(k) for k in range(found.fixed)), none)
    added, left = (found.mean(x.square()).sqrt() for x in (moved, solution.left))
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
        "`torchid excite --for gap.json --max-acceleration 5 --out next` designs the motion"
    )


def finite(value: float) -> float | None:
    """A number, or None where it is infinite: unknown."""
    return value if math.isfinite(value) else None
