"""What an explanation leaves that is no noise: over what repeats, or what a flexible predictor
foresees.

The predictor is ridge regression on random Fourier features (Rahimi and Recht 2007), each part of
the log foreseen by the others. It is a sum of functions of few variables (Duvenaud et al. 2011): of
the joint's own state, and of its position beside each other joint's. One function of all states at
once knows nothing outside the motions it was trained on, and hardly sees another joint. It sees
motion and the model's torque only, never a measured torque, whose noise would predict itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.linalg import solve
from scipy.special import stdtrit

from torchid.design.segments import Samples
from torchid.gap.problem import Problem
from torchid.statistics.blocks import block_sums
from torchid.statistics.resampling import tails
from torchid.typing import Float, Tensor

FEATURES = 40
"""Waves of each function."""
RIDGE = 30.0
WIDTH = 0.5

FEWEST = 50
"""Samples of repeats below which they tell nothing."""

MEDIAN = 0.4549
"""Median of the square of a standard normal variable [1]."""


@dataclass(frozen=True, eq=False)
class Foreseen:
    """What is left, as the rest of the log foresees it.

    Attributes:
        torque: (n, N) [N m; N].
        share: (n,) of the squares left; below zero where it foresees worse than nothing does.
        low: (n,) lower end of its 95 % interval, from the spread between blocks.
    """

    torque: Float[Tensor, "n N"]
    share: Float[Tensor, " n"]
    low: Float[Tensor, " n"]

    def beyond(self, left: Float[Tensor, "n N"]) -> Float[Tensor, "n N"]:
        """What is left without what is foreseen, where that helps at all."""
        return left - self.torque * (self.share > 0).to(left).unsqueeze(1)


def foreseen(problem: Problem, left: Float[Tensor, "n N"]) -> Foreseen:
    """What a flexible predictor foresees on parts it has not seen.

    Args:
        problem: of the log.
        left: (n, N) what is left, zero where samples do not count [N m; N].
    """
    rng = np.random.default_rng(problem.settings.seed)
    part, keep = problem.folds.parts.numpy(), problem.data.keep.numpy().astype(float)
    motions, samples = problem.given.motions, problem.data.samples
    # The motion and the torque of the model as given, which holds no measured torque.
    q, dq, ddq = (
        samples.pick([getattr(m, k) for m in motions]).numpy() for k in ("q", "dq", "ddq")
    )
    tau = samples.of([m.require("torque", "a predictor").T for m in motions]).numpy().T

    def unit(x: np.ndarray) -> np.ndarray:
        return (x - x.mean(0)) / (x.std(0) + 1e-9)

    out, places = np.zeros(left.shape), unit(q)
    for j, y in enumerate(left.numpy()):
        if not y.any():
            continue
        # Friction turns with the sign of the speed and comes back after a reversal: both are
        # states, as smooth steps of a width of their own.
        speed = np.tanh(dq[:, j] / (0.05 * dq[:, j].std() + 1e-9))
        turned = since_reversal(q[:, j], dq[:, j], samples.bounds)
        near = np.tanh(turned / (0.2 * np.abs(turned).std() + 1e-9))
        own = unit(np.stack([q[:, j], dq[:, j], speed, ddq[:, j], tau[:, j], turned, near], 1))
        columns = [own]  # straight lines in the state need no waves
        for state in (own, *(places[:, [j, k]] for k in range(len(left)) if k != j)):
            # Cosines of random directions stand for a Gaussian kernel of this width.
            waves = rng.normal(size=(state.shape[1], FEATURES)) * WIDTH
            columns.append(np.cos(state @ waves + rng.uniform(0, 2 * np.pi, FEATURES)))
        x = np.concatenate(columns, 1) * keep[j][:, None]
        for k in range(1, problem.folds.count + 1):
            # Samples at a border are of no part, and foreseen by none.
            a, b = (part != k) & (part > 0), part == k
            normal = x[a].T @ x[a] + RIDGE * np.eye(x.shape[1])
            out[j, b] = x[b] @ solve(normal, x[a].T @ y[a], assume_a="pos")
    told = torch.from_numpy(out)
    # Shares, and their intervals by Student's t over what each block gains.
    total = (left.square() * torch.from_numpy(part > 0)).sum(1).clamp(min=1e-300)
    # A block gains what its squares fall by; blocks are as long as what is left is correlated.
    gains = block_sums(left.square() - (left - told).square(), problem.block).T / total
    count = len(gains)
    spread = gains.std(0) * count**0.5 if count > 1 else torch.full_like(total, torch.inf)
    share, half = gains.sum(0), float(stdtrit(max(1, count - 1), tails()[1])) * spread
    return Foreseen(told, share, share - half)


def since_reversal(q: np.ndarray, dq: np.ndarray, bounds: Sequence[slice]) -> np.ndarray:
    """Displacement (N,) of a joint since it last turned, or since its trajectory began [rad; m]."""
    out = np.zeros_like(q)
    for own in bounds:
        turns = np.flatnonzero(np.diff(np.sign(dq[own])) != 0) + 1
        begin = np.zeros(own.stop - own.start, int)
        begin[turns] = turns
        out[own] = q[own] - q[own][np.maximum.accumulate(begin)]
    return out


def noise_of_repeats(problem: Problem) -> np.ndarray:
    """RMS (n,) of what differs between repeats of a motion [N m; N]; nan without repeats."""
    samples, nothing = problem.data.samples, np.full(problem.given.n, np.nan)
    shortest = 2 * samples.edge + samples.step
    found = [s for s in problem.apart if s.length > shortest]
    if not found:
        return nothing
    own = Samples(found, samples.cutoff)
    x = own.of([s.tau.T for s in found]).numpy()
    # By the median: what differs between two runs for a reason, as a push does, is no noise.
    return np.sqrt(np.median(x**2, 1) / MEDIAN) if x.shape[1] > FEWEST else nothing
