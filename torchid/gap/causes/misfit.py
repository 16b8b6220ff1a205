"""What an explanation leaves that is no noise: over what repeats, or what a flexible predictor
foresees.

The predictor is ridge regression on random Fourier features of the state (Rahimi and Recht 2007),
each part of the log foreseen by the others.
"""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import solve

from torchid.design.segments import Samples
from torchid.gap.problem import Problem

FEATURES = 150
RIDGE = 30.0
WIDTH = 0.7
OTHERS = 0.3
"""Weight of the other joints' states beside the own one's [1]."""

FEWEST = 50
"""Samples of repeats below which they tell nothing."""

MEDIAN = 0.4549
"""Median of the square of a standard normal variable [1]."""


def foreseen(problem: Problem, left: np.ndarray) -> np.ndarray:
    """Share (n,) of the squares left that a flexible predictor foresees on parts it has not seen.

    Args:
        problem: of the log.
        left: (n, N) what is left, zero where samples do not count [N m; N].
    """
    rng = np.random.default_rng(problem.settings.seed)
    part, keep = problem.folds.fold.numpy(), problem.data.keep.numpy().astype(float)
    motions, samples = problem.given.motions, problem.data.samples
    q, dq, ddq = (
        samples.pick([getattr(m, k) for m in motions]).numpy() for k in ("q", "dq", "ddq")
    )
    tau = samples.of([m.require("torque", "a predictor").T for m in motions]).numpy().T

    def unit(x: np.ndarray) -> np.ndarray:
        return (x - x.mean(0)) / (x.std(0) + 1e-9)

    share = np.zeros(len(left))
    for j in range(len(left)):
        if not keep[j].any():
            continue
        speed = np.tanh(dq[:, j] / (0.05 * dq[:, j].std() + 1e-9))
        turned = since_reversal(q[:, j], dq[:, j], samples.bounds)
        near = np.tanh(turned / (0.2 * np.abs(turned).std() + 1e-9))
        own = unit(np.stack([q[:, j], dq[:, j], speed, ddq[:, j], tau[:, j], turned, near], 1))
        state = np.concatenate([own, OTHERS * unit(q), OTHERS * unit(dq)], 1)
        waves = rng.normal(size=(state.shape[1], FEATURES)) * WIDTH
        x = np.cos(state @ waves + rng.uniform(0, 2 * np.pi, FEATURES))
        x = np.concatenate([x, own], 1) * keep[j][:, None]
        y, told = left[j], np.zeros(len(left[j]))
        for k in np.unique(part):
            a, b = part != k, part == k
            normal = x[a].T @ x[a] + RIDGE * np.eye(x.shape[1])
            told[b] = x[b] @ solve(normal, x[a].T @ y[a], assume_a="pos")
        share[j] = max(0.0, 1 - ((y - told) ** 2).sum() / max((y**2).sum(), 1e-300))
    return share


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
    columns, samples = problem.given, problem.data.samples
    nothing = np.full(columns.n, np.nan)
    if not len(problem.repeats.pairs):
        return nothing
    pairs = zip(samples.segments, columns.motions, strict=True)
    left = [s.tau - columns.model.torque(s, samples, m.torque) for s, m in pairs]
    shortest = 2 * samples.edge + samples.step
    found = [s for s in problem.repeats.segments(samples.segments, left) if s.length > shortest]
    if not found:
        return nothing
    own = Samples(found, samples.cutoff)
    x = own.of([s.tau.T for s in found]).numpy()
    return np.sqrt(np.median(x**2, 1) / MEDIAN) if x.shape[1] > FEWEST else nothing
