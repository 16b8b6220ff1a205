"""Which part of the error each cause takes away: Shapley's value, which adds up.

At the values that are said, causes add their torques T_k to the model's, and what is left of the
gap y is e = y - sum_k T_k. By how much a cause lowers the sum of squares depends on which others
are there already; the mean over all orders in which they may join (Shapley 1953) is, for squares,

    phi_k = sum_t T_k (y + e),    sum_k phi_k = sum_t (y^2 - e^2),

without visiting any order. A cause that cancels against others may take less than nothing.
"""

from dataclasses import dataclass

import torch

from torchid.gap.search.evidence import rows_of
from torchid.gap.search.explain import Explanation
from torchid.typing import Float, Tensor


@dataclass(frozen=True, eq=False)
class Shares:
    """What K causes take of n joints' error.

    Attributes:
        falls: (K, n) part of the fall of each joint's sum of squares.
        alone: (K, n) the fall with each cause by itself.
        refit: (n,) the part of the parameters that are fitted in any case, one player of its own.
    """

    falls: Float[Tensor, "K n"]
    alone: Float[Tensor, "K n"]
    refit: Float[Tensor, " n"]

    @property
    def whole(self) -> Float[Tensor, " n"]:
        """Fall (n,) of each joint's sum of squares: all parts together."""
        return self.falls.sum(0) + self.refit

    def of_all(self, closed: float) -> tuple[list[float], list[float]]:
        """Share of each cause, and of each alone, of an error of which all close so much."""
        whole = float(self.whole.sum())
        scale = closed / whole if whole > 0 else 0.0
        return (scale * self.falls.sum(1)).tolist(), (scale * self.alone.sum(1)).tolist()

    def of_bars(
        self, before: Float[Tensor, " n"], after: Float[Tensor, " n"]
    ) -> Float[Tensor, "K n"]:
        """What each takes of bars (n,) that fall from before to after [N m; N]: with the refit the
        columns add up to the falls; zero where all together take nothing."""
        scale = torch.where(self.whole > 0, (before - after) / self.whole, 0.0)
        return self.falls * scale


def shares_of(found: Explanation, *, fitted_first: bool = False) -> Shares:
    """What each term of an explanation takes.

    Args:
        found: with its fixed terms, which are always fitted.
        fitted_first: whether the error is that of a model whose fixed terms are fitted already.
    """
    question, solution = found.question, found.solution
    keep = question.candidates.keep
    torques = []
    for k, (term, values) in enumerate(zip(solution.terms, solution.values, strict=True)):
        torque = torch.tensordot(values, solution.a[solution.at(k)], 1)
        # What stands in the place of the model's own takes that away.
        for joint, own, size in term.instead:
            torque[joint] -= torch.tensordot(size, rows_of(question, own)[:, 0], 1)
        torques.append(torque * keep)
    first, none = len(question.fixed), torch.zeros_like(question.candidates.gap)
    gap = question.candidates.gap * keep
    refit, every = sum(torques[:first], none), torch.stack([none, *torques[first:]])[1:]
    if fitted_first:
        gap, refit = gap - refit, none
    both = 2 * gap - refit - every.sum(0)
    alone = every * (2 * (gap - refit) - every)
    return Shares((every * both).sum(2), alone.sum(2), (refit * both).sum(1))
