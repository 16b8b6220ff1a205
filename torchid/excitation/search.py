"""The search for the next motion.

Of motions that keep what they must, those are looked for that lower a cost most. Costs are
logarithms of standard deviations, up to a constant, and these fall with the root of the time
driven: a motion whose cost is lower by g tells as much as the other one driven exp(2 g) times as
long, and a search that does not gain a tenth of the driving time is not worth its own.

Fourier series are improved on the way: by Adam on a batch where the cost has a gradient, by CMA-ES
(Hansen 2016) where it jumps. Both move the same numbers, from which a series within the joints'
limits is made, so no penalty is needed for these. What couples joints is in `restriction`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from torchid.excitation.fourier import FourierTrajectory
from torchid.excitation.limits import MotionLimits, largest_scale
from torchid.excitation.restriction import AllOf
from torchid.typing import Bool, Float, Tensor

Progress = Callable[[int, int], None]
Cost = Callable[[FourierTrajectory], Float[Tensor, " K"]]

LONGER = 1.1
"""Times the driving time: a motion that tells less than this much more hardly beats another."""

HARDLY = math.log(LONGER) / 2
"""The same as a gain in the cost."""

POPULATION = 16
"""Of CMA-ES."""

_FIRST, _SECOND, _LEAST = 0.9, 0.999, 1e-8  # of Adam: decay of its two moments, and its epsilon
_SLOWEST, _FASTEST = 0.02, 0.98  # shares of the scale between which a search starts


@dataclass(frozen=True, eq=False)
class _Numbers:
    """Series within limits, by numbers without bounds (K, n, 2 L + 2): the direction of a joint's
    coefficients, of any length; where it is centred; its share of the scale to the limits.

    Attributes:
        like: length, ramps and pulsation of the series.
        limits: of motion.
        full: whether every joint goes to its limits, whatever its share.
    """

    like: FourierTrajectory
    limits: MotionLimits
    full: bool

    @property
    def _reach(self) -> Float[Tensor, " n"]:
        # 0.9: of the half range that q0 may use, so that no scale is lost to 0
        return 0.9 * self.limits.half_range

    def of(self, x: FourierTrajectory) -> Float[Tensor, "K n C"]:
        """Numbers of series within the limits."""
        size = x.coefficients.norm(dim=-1, keepdim=True).clamp(min=1e-12)
        place = torch.atanh(((x.q0 - self.limits.middle) / self._reach).clamp(-0.99, 0.99))
        share = torch.logit((1 / largest_scale(x, self.limits)).clamp(_SLOWEST, _FASTEST))
        return torch.cat([x.coefficients / size, torch.stack([place, share], -1)], -1)

    def series(self, numbers: Float[Tensor, "K n C"]) -> FourierTrajectory:
        """Trajectories of the numbers that are tried; differentiable."""
        a, b = numbers[..., :-2].chunk(2, -1)
        place, share = numbers[..., -2:].unbind(-1)
        q0 = self.limits.middle + self._reach * torch.tanh(place)
        raw = replace(self.like, a=a, b=b, q0=q0)
        scale = largest_scale(raw, self.limits)
        return raw.scaled(scale if self.full else scale * torch.sigmoid(share))


class Adam:
    """Steps of Kingma and Ba, Adam (2015), from all starts at once: those of torch.optim, which
    takes a second to load."""

    def __init__(self, start: Float[Tensor, "K n C"], seed: int):
        self._now, self._count = start.clone().requires_grad_(), 0
        self._first, self._second = torch.zeros_like(start), torch.zeros_like(start)

    def ask(self) -> Float[Tensor, "K n C"]:
        """Numbers to be tried."""
        return self._now

    def tell(self, costs: Float[Tensor, " K"], done: float) -> None:
        """One step down the gradients.

        Args:
            costs: of what was tried.
            done: share of the search before it.
        """
        (g,) = torch.autograd.grad(costs.sum(), self._now)
        self._count += 1
        # Along a cosine to zero.
        # 0.1: learning rate at the start
        rate = 0.1 * (1 + math.cos(math.pi * done)) / 2
        size, root = rate / (1 - _FIRST**self._count), math.sqrt(1 - _SECOND**self._count)
        self._first.lerp_(g, 1 - _FIRST)
        self._second.mul_(_SECOND).addcmul_(g, g, value=1 - _SECOND)
        self._now.data.addcdiv_(self._first, (self._second.sqrt() / root).add_(_LEAST), value=-size)


class Evolution:
    """CMA-ES from the last of the starts, for costs without a gradient."""

    def __init__(self, start: Float[Tensor, "K n C"], seed: int):
        import cma

        stds = torch.ones_like(start[-1])
        # Coefficients of length one are smaller than the other numbers.
        stds[:, :-2] = (start.shape[-1] / 2 - 1) ** -0.5
        options = {
            "seed": seed + 1, "popsize": POPULATION, "verbose": -9, "CMA_diagonal": True,
            "CMA_stds": stds.flatten().numpy(),
        }  # fmt: skip
        self._shape, self._tried = start.shape[1:], [start[-1].flatten().numpy()]
        # 0.3: of CMA-ES
        self._search: Any = cma.CMAEvolutionStrategy(self._tried[0], 0.3, options)

    def ask(self) -> Float[Tensor, "K n C"]:
        """Numbers to be tried."""
        self._tried = self._search.ask()
        return torch.tensor(np.stack(self._tried)).reshape(-1, *self._shape)

    def tell(self, costs: Float[Tensor, " K"], done: float) -> None:
        """What they cost; `done` is of no account."""
        self._search.tell(self._tried, costs.tolist())


def search(
    start: FourierTrajectory,
    limits: MotionLimits,
    quick: Cost,
    whole: Cost,
    steps: int,
    progress: Progress | None = None,
    *,
    kept: AllOf,
    way: type[Adam | Evolution] = Adam,
    hardly: Callable[[FourierTrajectory, float], bool] = lambda best, gain: gain < HARDLY,
    seed: int = 0,
) -> tuple[FourierTrajectory, FourierTrajectory, Float[Tensor, " K"]]:
    """The series of least cost among the starts and the best of those that a search tries: one that
    found nothing better returns the best start.

    Half-way the search stops where its best hardly beats what it must.

    Args:
        start: series (K, n, L) within the limits of motion.
        limits: to which every series is scaled.
        quick: cost that the search lowers; for `Adam` differentiable.
        whole: cost by which the result is chosen.
        steps: of the search.
        progress: called with (steps done, all steps).
        kept: what the result keeps too. Where that is something every joint also has a share of the
            scale to its limits, and what breaks it is penalised.
        way: of searching. By `Evolution` joints have shares anyway: slow motion shows some causes.
        hardly: asked with the best series and how much its cost is below that of the first step.
        seed: of the search.

    Returns:
        The starts within the restrictions (K, n, L), the best (n, L), and the whole costs of all,
        the starts' first.

    Raises:
        RobotError: no motion keeps the restrictions.
    """
    begun = kept.within(start)
    # One half of the searches comes from within the restrictions, the other from beyond.
    start = _merged(torch.arange(len(start.q0)) % 2 == 1, begun, start)
    numbers = _Numbers(start, limits, full=way is Adam and not kept.parts)
    optimiser = way(numbers.of(start), seed)
    best, lowest, first = start, torch.zeros(len(start.q0)), math.inf
    for done in range(steps):
        now = numbers.series(optimiser.ask())
        costs = quick(now) + kept.penalty(now)
        if done == 0:
            best, first = now, float(costs.detach().min())
            lowest = torch.full_like(costs.detach(), math.inf)
        better = costs.detach() < lowest
        best, lowest = _merged(better, now, best), torch.where(better, costs.detach(), lowest)
        optimiser.tell(costs, done / steps)
        if progress is not None:
            progress(done + 1, steps)
        top = int(lowest.argmin())
        if done + 1 == steps // 2 and hardly(best.select(top), first - float(lowest[top])):
            break
    parts = begun, kept.within(best.select(lowest.argsort()[: len(start.q0)]))
    with torch.no_grad():
        costs = torch.cat([whole(x) for x in parts]).nan_to_num(nan=math.inf)
    part, k = divmod(int(costs.argmin()), len(start.q0))
    return begun, parts[part].select(k), costs


def most_telling(
    known: Tensor, told: Tensor, cost: Callable[[Tensor], Float[Tensor, " C"]], count: int
) -> list[int]:
    """The motions whose information, beside what is known, lowers a cost most, one after the other.

    Args:
        known: information before any of them (...).
        told: information of each (C, ...).
        cost: of information (C, ...).
        count: motions at most.
    """
    chosen: list[int] = []
    for _ in range(min(count, len(told))):
        costs = cost(known + told)
        costs[chosen] = math.inf
        chosen.append(int(costs.argmin()))
        known = known + told[chosen[-1]]
    return chosen


def _merged(
    chosen: Bool[Tensor, " K"], first: FourierTrajectory, second: FourierTrajectory
) -> FourierTrajectory:
    """`first` where chosen, else `second`."""
    wide = chosen[:, None, None]
    return replace(
        first,
        a=torch.where(wide, first.a, second.a).detach(),
        b=torch.where(wide, first.b, second.b).detach(),
        q0=torch.where(chosen[:, None], first.q0, second.q0).detach(),
    )
