"""Which part of the error each cause takes away: Shapley's value, which adds up.

At the values that are said, causes add their torques T_k to the model's, and what is left of the
gap y is e = y - sum_k T_k. By how much a cause lowers the sum of squares depends on which others
are there already; the mean over all orders in which they may join (Shapley 1953) is, for squares,

    phi_k = sum_t T_k (y + e),    sum_k phi_k = sum_t (y^2 - e^2),

without visiting any order. A cause that cancels against others may take less than nothing.
"""

from dataclasses import dataclass

import torch

from torchid.gap.describe.model import Explanation
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


def shares_of(found: Explanation) -> Shares:
    """What each cause of an explanation takes. What is always fitted has a part as well, unless the
    error is that of a model in which it is fitted already."""
    problem, solution = found.problem, found.solution
    keep, given = problem.data.keep, problem.given
    torques = []
    for k, part in enumerate(solution.parts):
        torque = solution.torque(k)
        # What stands in the place of the model's own takes that away.
        if part.instead is not None:
            effect, values = part.instead
            torque -= torch.tensordot(torch.tensor(values).double(), given.on_all_joints(effect), 1)
        torques.append(torque * keep)
    first, none = found.fixed, torch.zeros_like(given.gap)
    gap = given.gap * keep
    refit, every = sum(torques[:first], none), torch.stack([none, *torques[first:]])[1:]
    if problem.fitted_first:
        gap, refit = gap - refit, none
    both = 2 * gap - refit - every.sum(0)
    alone = every * (2 * (gap - refit) - every)
    return Shares((every * both).sum(2), alone.sum(2), (refit * both).sum(1))
