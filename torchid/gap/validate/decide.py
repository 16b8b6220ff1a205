"""From the search's explanation to the answered one: what does harm leaves, what is not likely
stays without a name."""

from collections.abc import Sequence
from dataclasses import dataclass

from torchid.gap.diagnosis import worse_than_none
from torchid.gap.problem import Problem
from torchid.gap.search.explain import Explanation, without_terms
from torchid.gap.search.findings import Judged, unsure_terms
from torchid.gap.search.odds import Misfit
from torchid.gap.search.shares import Shares
from torchid.gap.search.terms import BASE
from torchid.gap.validate.judge import Checked, check, misfit_of
from torchid.typing import Float, Tensor


@dataclass(frozen=True, eq=False)
class Decision:
    """The answered explanation.

    Attributes:
        found: which.
        checked: on data that it was not fitted on.
        judged: its terms.
        dropped: an explanation none of whose terms is likely, and these; nothing of it is answered.
        misfit: what it leaves without a name, terms that are not likely among it.
        least: (n,) torque that is worth a name [N m; N].
        taken_back: whether something that the evidence had has left for the harm that it did: it
            was no explanation, but the gap is there.
    """

    found: Explanation
    checked: Checked
    judged: tuple[Judged, ...]
    dropped: tuple[Explanation, tuple[Judged, ...]] | None
    misfit: Misfit
    least: Float[Tensor, " n"]
    taken_back: bool

    def unnamed_squares(self, taken: Shares) -> Float[Tensor, " n"]:
        """What terms without a name take (n,) of the mean squares of the error, on data that was
        not fitted."""
        far = self.checked.far
        squares = taken.of_bars(far.rms_before.square(), far.rms_after.square())
        return squares[[one.unnamed for one in self.judged]].sum(0)


def decide(found: Explanation, judged: Sequence[Judged], problem: Problem) -> Decision:
    """What is less likely than not stays in the model without a name, as long as something else has
    one. A held-out log takes part in no choice: it judges what was chosen, and a cause that does no
    good there loses its name."""
    question = found.question
    least = question.least(question.mean(found.empty.losses))
    checked = check(found, problem)
    misfit = misfit_of(found, checked, problem)
    checked = _on_held_out(found, checked, problem)
    # Where most joints' torque follows neither model nothing is confirmed, on no joint; nor where
    # the model as given is worse than none there, and other bodies altogether take its place.
    replaced = any(t.name == BASE for t in found.terms) and worse_than_none(checked.shown)
    shrinks = checked.far.shrinks * (not (replaced or bool(checked.alien.any())))
    likely, judged = judged, [one.confirmed(shrinks) for one in judged]
    dropped, taken_back = None, False
    if judged and len(unsure_terms(judged)) == len(judged):
        dropped = found, tuple(judged)
        taken_back = not all(one.unnamed for one in likely)
        found = without_terms(found, found.terms, problem)
        checked = check(found, problem)
        judged, misfit = [], misfit_of(found, checked, problem)
        checked = _on_held_out(found, checked, problem)
    return Decision(found, checked, tuple(judged), dropped, misfit, least, taken_back)


def _on_held_out(found: Explanation, checked: Checked, problem: Problem) -> Checked:
    """The same on the held-out log, where there is one."""
    if problem.judged is None:
        return checked
    return check(found, problem, problem.judged, checked)
