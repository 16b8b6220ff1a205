"""A first answer while the search goes on: each joint's gap, and what explains most of it so far.

Its errors are those of the fit, on the data that were fitted, below the fit's cut-off.
"""

from collections.abc import Callable
from dataclasses import replace

from torchid.gap.problem import Problem
from torchid.gap.search.climb import climb_from, fit_anew
from torchid.gap.search.evidence import Fitted, Question
from torchid.gap.search.terms import Term, candidates_of
from torchid.results.answer import Answer, Cause, Size
from torchid.robot.model import Robot, torque_unit

Watch = Callable[[Answer], None]
"""Takes what is known so far."""

USUAL = (
    "viscous_friction", "coulomb_friction", "rotor_inertia", "torque_offset", "torque_gain",
    "payload", "joint_spring", "load_dependent_friction", "time_delay",
)  # fmt: skip
"""Effects that a first answer looks for: the commonest ones, whose columns cost little."""


def first_answer(problem: Problem) -> Answer:
    """What the usual effects and other bodies explain, by one climb."""
    wanted, given = problem.wanted, problem.given
    usual = replace(wanted, names=tuple(name for name in wanted.names if name in USUAL))
    parts = problem.folds.parts
    candidates = candidates_of(given, given.gap, problem.data, usual, parts, given.model, [])
    question = Question(candidates, candidates.gram.over(), problem.settings)
    return so_far(question, climb_from(question, ()), problem.robot)


def so_far(question: Question, fit: Fitted, robot: Robot) -> Answer:
    """What a fit that is not finished says."""
    before, after = (question.mean(f.losses).sqrt() for f in (fit_anew(question), fit))
    levels = zip(robot.joint_names, before.tolist(), after.tolist(), strict=True)
    first = len(question.fixed)
    causes = zip(fit.terms[first:], fit.values()[first:], strict=True)
    whole = float(before.norm()), float(after.norm())
    every = (_cause(term, values.tolist()) for term, values in causes)
    return Answer.so_far("the gap", torque_unit(robot), whole, levels, every)


def _cause(term: Term, values: list[float]) -> Cause:
    """A term of a fit."""
    effect = term.effects[0] if term.effects else None
    body = effect is None or term.inertial
    joints = () if effect is None else effect.joints
    sizes = (
        Size(name=c.name, unit=c.unit, value=v)
        for c, v in zip(term.coefficients, values, strict=False)
    )
    return Cause(
        effect="link_inertia" if body else term.name,
        joints=joints,
        sizes=() if body else tuple(sizes),
    )
