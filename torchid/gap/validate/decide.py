"""From the search's explanation to the answered one: what does harm, or is not likely, leaves."""

from dataclasses import dataclass

from torchid.gap.problem import Problem
from torchid.gap.search.explain import Explanation, search_again_without, without_terms
from torchid.gap.search.findings import Judged, judge_terms, unsure_terms
from torchid.gap.search.odds import Misfit
from torchid.gap.validate.judge import Checked, check, harmful, misfit_of
from torchid.typing import Float, Tensor


@dataclass(frozen=True, eq=False)
class Decision:
    """The answered explanation.

    Attributes:
        found: which.
        checked: on data that it was not fitted on.
        judged: its terms.
        misfit: what it leaves without a name.
        least: (n,) torque that is worth a name [N m; N].
        taken_back: whether something that the evidence had has left for the harm that it did: it
            was no explanation, but the gap is there.
    """

    found: Explanation
    checked: Checked
    judged: tuple[Judged, ...]
    misfit: Misfit
    least: Float[Tensor, " n"]
    taken_back: bool


def decide(found: Explanation, problem: Problem) -> Decision:
    """Without what makes a fold worse that it was not fitted on, and what is least likely there, if
    it is less likely than not, the search goes on, until nothing leaves: one at a time, for others
    are likelier beside what the search finds in its place. A held-out log takes part in no choice:
    it judges what was chosen."""
    question = found.question
    least = question.least(question.mean(found.empty.losses))
    taken_back = False
    while True:
        checked = check(found, problem)
        refused = harmful(found, checked, least)
        taken_back |= bool(refused)
        if refused:
            found = without_terms(found, refused, problem)
        misfit = misfit_of(found, checked, problem)
        judged = judge_terms(found, misfit, problem.draws)
        if unsure := unsure_terms(judged)[:1]:
            refused += unsure
            found = without_terms(found, unsure, problem, small=True)
        if not refused:
            break
        found = search_again_without(found, refused, problem)
    if problem.judged is not None:
        checked = check(found, problem, problem.judged, checked)
    return Decision(found, checked, tuple(judged), misfit, least, taken_back)
