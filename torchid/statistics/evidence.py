"""How likely explanations are, whatever they are of: coefficients with Gaussian slabs, what these
leave and cost, and how sure one explanation is beside others.

Slabs make ten numbers of a body, or six of a law, pay for themselves (MacKay 1992, Neural
Computation 4(3); Zellner 1986); the size of the noise is profiled out, sensor by sensor. On logs
that might have been every explanation has its evidence, and its probability is a mean over them
(`statistics.bagging`). What is left without a cause bounds how sure the others can be: odds against
are at least `DOUBT` times its share of the squares.
"""

import math

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs

from torchid.statistics.criteria import DOUBT, EXPECTED

ROUNDS, CONVERGED = 300, 1e-3
"""Times that coefficients and the sizes of the noise are fitted in turn at most, and the evidence
that an answer may miss because it ends before [nats]: a round that adds a tenth of it is the last,
for the following ones add less, each nine tenths of the one before at most."""

DEPENDENT = 1e-9
"""Singular value of what coefficients have in common, each in units of its own, that is rounding
[1]."""

ROUNDED = 1e-13
"""What is added to the diagonal of a matrix, of each entry, before it is factored: rounding."""


def solved(
    g: np.ndarray,
    samples: np.ndarray,
    floor: np.ndarray,
    middle: np.ndarray | None = None,
    free: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Coefficients (K,) in units of their slabs, squares left (n,), and half of the coefficients'
    squares and of the log determinant of what the data say over what was known.

    Args:
        g: (n, K + 1, K + 1) normal matrices of columns in units of their slabs, the gap last.
        samples, floor: (n,) that the squares count as, and squares that are rounding.
        middle: (K,) where the slabs are centred, and coefficients held; at zero if None.
        free: (K, F) orthonormal directions that are not held, see `beside`; all if None.
    """
    count = g.shape[1] - 1
    losses = np.maximum(g[:, -1, -1], floor)
    axes = None
    if free is not None or (middle is not None and middle.any()):
        free = np.eye(count) if free is None else free
        axes = np.zeros((count + 1, free.shape[1] + 1))
        axes[:-1, :-1], axes[-1, -1] = free, 1.0
        axes[:-1, -1] = 0.0 if middle is None else -middle
        g, count = axes.T @ g @ axes, free.shape[1]
    v, half = np.append(np.zeros(count), -1.0), 0.0
    if not count:
        losses = np.maximum((g @ v) @ v, floor)
        return v[:0] if axes is None else (axes @ v)[:-1], losses, half
    flat, last = g.reshape(len(g), -1), np.inf
    for _ in range(ROUNDS):
        h = (samples / losses @ flat).reshape(count + 1, count + 1)
        root = root_of(h[:-1, :-1])
        v[:-1] = z = dpotrs(root, h[:-1, -1], lower=1)[0]
        losses = np.maximum((g @ v) @ v, floor)
        half = float(np.log(np.diagonal(root)).sum()) + 0.5 * float(z @ z)
        before, last = last, half + 0.5 * float(samples @ np.log(losses))
        if abs(before - last) <= 0.1 * CONVERGED:
            break
    return v[:-1] if axes is None else (axes @ v)[:-1], losses, half


def beside(spread: np.ndarray, pinned: np.ndarray) -> np.ndarray:
    """Orthonormal directions (K, F), in units of slabs of root (K, K), that leave the pinned
    coefficients (K,) where they are, of which some may be known exactly."""
    held = spread[pinned]
    size = np.linalg.norm(held, axis=1, keepdims=True)
    _, shown, axes = np.linalg.svd(held / np.where(size > 0, size, 1.0))
    return axes[(shown > DEPENDENT).sum() :].T


def in_slabs(spread: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Coefficients (K,) in units of slabs of root (K, K): zero of those that are known exactly."""
    size = np.linalg.norm(spread, axis=1)
    size = np.where(size > 0, size, 1.0)
    return np.linalg.lstsq(spread / size[:, None], x / size)[0]


def root_of(a: np.ndarray) -> np.ndarray:
    """Lower Cholesky factor of I + a."""
    whole = a.copy()
    whole.flat[:: len(a) + 1] = (1.0 + np.diagonal(a)) * (1.0 + ROUNDED)
    root, failed = dpotrf(whole, lower=1)
    if failed:
        raise FloatingPointError("normal equations that are not finite")
    return root


def price_of(looks: int) -> float:
    """What looking at so many causes costs [nats]."""
    return math.log(max(1, looks) / EXPECTED)


def probabilities_of(rises: np.ndarray) -> list[float]:
    """Probabilities of K explanations, one of which is there, from their evidence (K, M) on M logs
    [nats]."""
    weights = np.exp(rises - rises.max(0))
    return (weights / weights.sum(0)).mean(1).tolist()


def most_sure(likelihoods: np.ndarray, fall: np.ndarray, rest: np.ndarray, whole: float) -> float:
    """How sure a cause can be beside what is left without one: of the squares that it and the rest
    take on the joints that tell of it, and of the whole arm's.

    Args:
        likelihoods: (n,) likelihood by which each joint tells of it [nats].
        fall, rest: (n,) mean squares that it takes, and that are left.
        whole: share of the arm's squares that is left.
    """
    shares = rest / np.maximum(fall + rest, 1e-300)
    share = float((likelihoods * shares).sum() / max(likelihoods.sum(), 1e-300))
    return 1 / (1 + DOUBT * max(share, whole))
