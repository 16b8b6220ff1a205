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

ROUNDS, CONVERGED = 30, 1e-4
"""Times that coefficients and the sizes of the noise are fitted in turn at most, and the relative
change of what is left from which on they are not."""

DEPENDENT = 1e-9
"""Singular value of what coefficients have in common, each in units of its own, that is rounding
[1]."""

ROUNDED = 1e-13
"""What is added to the unit diagonal of a matrix before it is factored: rounding."""


def solved(
    g: np.ndarray,
    spread: np.ndarray,
    samples: np.ndarray,
    floor: np.ndarray,
    pinned: np.ndarray | None = None,
    at: np.ndarray | None = None,
    centre: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Coefficients (K,), squares left (n,), and half of the coefficients' squares in units of their
    slabs and of the log determinant of what the data say over what was known.

    Args:
        g: (n, K + 1, K + 1) normal matrices, the gap last.
        spread: (K, K) root of the slabs' covariance.
        samples, floor: (n,) that the squares count as, and squares that are rounding.
        pinned, at: (K,) coefficients that are held, and where; none if None.
        centre: (K,) of the slabs; at zero if None.
    """
    count = len(spread)
    losses = np.maximum(g[:, -1, -1], floor)
    if not count:
        return np.zeros(0), losses, 0.0
    free = np.ones(count, bool) if pinned is None else ~pinned
    x = np.zeros(count) if at is None else at.copy()
    if not free.any():
        return x, np.maximum(np.append(x, -1.0) @ g @ np.append(x, -1.0), floor), 0.0
    if not free.all():
        # The slab of the others beside those that are held, of which some may be known exactly:
        # what of the root leaves these where they are.
        held = spread[~free]
        size = np.linalg.norm(held, axis=1, keepdims=True)
        _, shown, axes = np.linalg.svd(held / np.where(size > 0, size, 1.0))
        spread = spread[free] @ axes[(shown > DEPENDENT).sum() :].T
    half, centre = 0.0, np.zeros(count) if centre is None else centre
    middle = centre[free]
    for _ in range(ROUNDS):
        h = np.tensordot(samples / losses, g, 1)
        a, b = h[:-1, :-1], h[:-1, -1]
        if not free.all():
            a, b = a[np.ix_(free, free)], b[free] - a[np.ix_(free, ~free)] @ x[~free]
        z, half = posterior(spread.T @ a @ spread, (b - a @ middle) @ spread)
        x[free] = middle + spread @ z
        v = np.append(x, -1.0)
        before, losses = losses, np.maximum((v @ g) @ v, floor)
        half += 0.5 * float(z @ z)
        if (np.abs(losses - before) <= CONVERGED * before).all():
            break
    return x, losses, half


def posterior(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, float]:
    """Solution (K,) of (I + a) z = b, and half of the log determinant of I + a."""
    root, size = whitening(a)
    z = dpotrs(root, b / size, lower=1)[0] / size
    return z, float(np.log(np.diagonal(root)).sum() + np.log(size).sum())


def whitening(a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cholesky factor of I + a in units of its diagonal, and the root of that: sizes differ by many
    orders."""
    size = np.sqrt(1.0 + np.diagonal(a))
    unit = (a + np.eye(len(a))) / size / size[:, None]
    unit.flat[:: len(a) + 1] += ROUNDED
    root, failed = dpotrf(unit, lower=1)
    if failed:
        raise FloatingPointError("normal equations that are not finite")
    return root, size


def price_of(looks: int) -> float:
    """Of looking at so many causes [nats]."""
    return math.log(max(1, looks) / EXPECTED)


def probabilities_of(rises: np.ndarray) -> list[float]:
    """Probabilities of K explanations, one of which is there, from their evidence (K, M) on M logs
    [nats]."""
    weights = np.exp(rises - rises.max(0))
    return (weights / weights.sum(0)).mean(1).tolist()


def most_sure(told: np.ndarray, fall: np.ndarray, rest: np.ndarray, whole: float) -> float:
    """How sure a cause can be beside what is left without one: of the squares that it and the rest
    take on the joints that tell of it, and of the whole arm's.

    Args:
        told: (n,) likelihood by which each joint tells of it [nats].
        fall, rest: (n,) mean squares that it takes, and that are left.
        whole: share of the arm's squares that is left.
    """
    shares = rest / np.maximum(fall + rest, 1e-300)
    share = float((told * shares).sum() / max(told.sum(), 1e-300))
    return 1 / (1 + DOUBT * max(share, whole))
