"""The search for a motion by gradient: Adam on a batch of Fourier series within limits.

Costs are logarithms of standard deviations, up to a constant, and these fall with the root of the
time driven. So a motion whose cost is lower by g tells as much as the other one driven exp(2 g)
times as long, and a search that does not gain a tenth of the driving time is not worth its own.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import torch

from torchid.excitation.fourier import FourierTrajectory, midpoints
from torchid.excitation.limits import MotionLimits, largest_scale
from torchid.excitation.restriction import Restriction
from torchid.typing import Float, Tensor

Progress = Callable[[int, int], None]

LONGER = 1.1
"""Times the driving time: a motion that tells less than this much more hardly beats another."""

HARDLY = math.log(LONGER) / 2
"""The same as a gain in the cost."""

_SAMPLES = 100  # instants during the search: five a second, the regressor's fastest harmonics need
_LEARNING_RATE = 0.1
_FIRST, _SECOND, _LEAST = 0.9, 0.999, 1e-8  # of Adam: decay of its two moments, and its epsilon
_CENTRE_SHARE = 0.9  # of the half range that q0 may use, so that no scale is lost to 0
_SLOWEST, _FASTEST = 0.02, 0.98  # shares of the scale between which a search starts


def descend(
    start: FourierTrajectory,
    limits: MotionLimits,
    cost: Callable[[FourierTrajectory, Tensor], Tensor],
    iterations: int,
    progress: Progress | None,
    kept: Restriction | None = None,
) -> FourierTrajectory:
    """The best iterate of each restart under Adam, (restarts, n, L).

    The search stops half-way if all iterates hardly beat the best start.

    Args:
        start: the restarts, within the limits of motion.
        limits: to which every candidate is scaled.
        cost: of trajectories at times t, (restarts,), differentiable.
        iterations: of Adam.
        progress: called with (iterations done, all iterations).
        kept: restrictions that the result keeps too. Then every joint also has a share of the
            scale to the limits, and what breaks them is penalised.

    Raises:
        RobotError: no motion keeps the restrictions.
    """
    if kept is not None:
        # One half of the searches comes from within the restrictions, the other from beyond.
        half = torch.arange(len(start.q0)) % 2 == 1
        start = _merge(half, kept.within(start), start)
    middle, reach = limits.middle, _CENTRE_SHARE * limits.half_range
    # Directions (a, b) have any size: the scale to the limits takes it out again.
    size = torch.linalg.vector_norm(start.coefficients, dim=-1, keepdim=True).clamp(min=1e-12)
    shape = (start.coefficients / size).clone().requires_grad_()
    place = torch.atanh(((start.q0 - middle) / reach).clamp(-0.99, 0.99)).requires_grad_()
    searched = [shape, place]
    if kept is not None:
        used = (1 / largest_scale(start, limits)).clamp(_SLOWEST, _FASTEST)
        share = torch.logit(used).requires_grad_()
        searched.append(share)
    optimiser, rate = _Adam(searched), _LEARNING_RATE
    t = midpoints(start.duration, _SAMPLES)

    def candidate() -> FourierTrajectory:
        a, b = shape.chunk(2, -1)
        raw = replace(start, a=a, b=b, q0=middle + reach * torch.tanh(place))
        scale = largest_scale(raw, limits)
        return raw.scaled(scale if kept is None else scale * torch.sigmoid(share))

    lowest = torch.full((start.q0.shape[0],), math.inf, dtype=torch.float64)
    best = start
    for done in range(1, iterations + 1):
        now = candidate()
        costs = cost(now, t) if kept is None else cost(now, t) + kept.penalty(now)
        better = costs.detach() < lowest
        lowest = torch.where(better, costs.detach(), lowest)
        best = _merge(better, now, best)
        optimiser.step(torch.autograd.grad(costs.sum(), searched, allow_unused=True), rate)
        # Along a cosine to zero.
        before, now_at = (1 + math.cos(math.pi * k / iterations) for k in (done - 1, done))
        rate *= now_at / before
        if progress is not None:
            progress(done, iterations)
        if done == 1:
            first = float(lowest.min())
        if done == iterations // 2 and float(lowest.min()) > first - HARDLY:
            break
    return best if kept is None else kept.within(best)


class _Adam:
    """Steps of Kingma and Ba, Adam (2015): those of torch.optim, which takes a second to load."""

    def __init__(self, searched: list[Tensor]):
        self._searched, self._count = searched, 0
        self._moments = [(torch.zeros_like(x), torch.zeros_like(x)) for x in searched]

    def step(self, gradients: Sequence[Tensor | None], rate: float) -> None:
        """One step down the gradients."""
        self._count += 1
        size = rate / (1 - _FIRST**self._count)
        root = math.sqrt(1 - _SECOND**self._count)
        for x, g, (first, second) in zip(self._searched, gradients, self._moments, strict=True):
            if g is None:  # the costs do not depend on it
                continue
            first.lerp_(g, 1 - _FIRST)
            second.mul_(_SECOND).addcmul_(g, g, value=1 - _SECOND)
            x.data.addcdiv_(first, (second.sqrt() / root).add_(_LEAST), value=-size)


def _merge(
    chosen: Tensor, first: FourierTrajectory, second: FourierTrajectory
) -> FourierTrajectory:
    """`first` where chosen (restarts,), else `second`."""
    wide = chosen[:, None, None]
    return replace(
        first,
        a=torch.where(wide, first.a, second.a).detach(),
        b=torch.where(wide, first.b, second.b).detach(),
        q0=torch.where(chosen[:, None], first.q0, second.q0).detach(),
    )


def improved(
    start: FourierTrajectory,
    limits: MotionLimits,
    cost: Callable[[FourierTrajectory, Tensor], Tensor],
    t: Float[Tensor, " T"],
    iterations: int,
    progress: Progress | None,
    kept: Restriction | None = None,
) -> tuple[FourierTrajectory, FourierTrajectory, Float[Tensor, " K"]]:
    """The trajectory of least cost at times t among the starts and what `descend` makes of them:
    a search that found nothing better returns the best start.

    Returns:
        The starts within the restrictions (restarts, n, L), the best (n, L), and the costs of all,
        the starts' first.

    Raises:
        RobotError: no motion keeps the restrictions.
    """
    begun = start if kept is None else kept.within(start)
    parts = begun, descend(start, limits, cost, iterations, progress, kept)
    with torch.no_grad():
        costs = torch.cat([cost(x, t) for x in parts]).nan_to_num(nan=math.inf)
    part, k = divmod(int(costs.argmin()), len(start.q0))
    return begun, parts[part].select(k), costs
