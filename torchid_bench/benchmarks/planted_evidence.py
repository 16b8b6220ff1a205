"""Evidence of sets of linear terms, for ground truth that stays: nothing here is a diagnosis'.

    E(S) = -1/2 sum_j n_j log L_j - 1/2 x'Px - 1/2 log|I + P^-1/2 G P^-1/2|

(MacKay 1992, Bayesian interpolation) with L_j the squares that a set S leaves on joint j, x its
coefficients, P their inverse covariance beforehand, G = sum_j n_j/L_j X_j'X_j, and n_j samples that
tell two sets apart: rows over the correlation time of (what the better one leaves) x (the difference
of the two torques) (Bayley and Hammersley 1946), fewer where the noise is louder where they differ
(White 1980). Both sets of a comparison have the same. Nothing is paid for having looked.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch

from torchid.statistics.autocorrelation import autocorrelation, time_of

DEPENDENT = 1e-9
"""Share of the largest variance below which a direction of columns is rounding [1]."""


@dataclass(frozen=True, eq=False)
class Gap:
    """What is to be explained.

    Attributes:
        y: (n, N) samples of measured torque less the model's, zero where none counts [N m; N].
        rows: (n,) samples that count.
        bounds: samples of each trajectory.
        fold: (N,) stretch that is held out together, from 0.
    """

    y: np.ndarray
    rows: np.ndarray
    bounds: tuple[slice, ...]
    fold: np.ndarray


@dataclass(frozen=True, eq=False)
class Fit:
    """Coefficients z (K,) in standard deviations, squares left (n,), E, covariance of z (K, K)."""

    z: np.ndarray
    losses: np.ndarray
    evidence: float
    covariance: np.ndarray


@dataclass(frozen=True, eq=False)
class Terms:
    """A set of terms.

    Attributes:
        gap: what they explain.
        columns: (K, n, N) torque per standard deviation of each coefficient [N m; N].
    """

    gap: Gap
    columns: np.ndarray

    @cached_property
    def grams(self) -> np.ndarray:
        """(F, n, K + 1, K + 1) products of columns and gap, fold by fold, joint by joint."""
        a = np.concatenate([self.columns, self.gap.y[None]]).transpose(1, 0, 2)
        parts = (a[..., self.gap.fold == k] for k in range(self.gap.fold.max() + 1))
        return np.stack([x @ x.transpose(0, 2, 1) for x in parts])

    def with_(self, more: np.ndarray) -> "Terms":
        """These terms and more columns."""
        return Terms(self.gap, np.concatenate([self.columns, more]))

    def fit(self, effective: np.ndarray) -> Fit:
        """The maximum of E with so many samples (n,)."""
        return fit(self.grams.sum(0), effective)

    def left(self, of: Fit) -> np.ndarray:
        """(n, N) torque that a fit of them leaves."""
        return self.gap.y - np.tensordot(of.z, self.columns, 1)


def fit(gram: np.ndarray, effective: np.ndarray) -> Fit:
    """The maximum of -1/2 sum_j n_j log L_j(z) - 1/2 z'z over z, and its evidence.

    Args:
        gram: (n, K + 1, K + 1) products of K columns, in units of their standard deviations, and of
            the gap, joint by joint.
        effective: (n,) samples.
    """
    k = gram.shape[1] - 1
    floor = 1e-12 * gram[:, k, k] + 1e-300
    losses, eye = gram[:, k, k] + floor, np.eye(k)
    for _ in range(200):
        h = np.tensordot(effective / losses, gram, 1)
        inverse = np.linalg.inv(eye + h[:k, :k])
        z = inverse @ h[:k, k]
        v = np.append(-z, 1.0)
        before, losses = losses, np.maximum(np.einsum("a,nab,b->n", v, gram, v), floor)
        if np.abs(losses - before).max(where=effective > 0, initial=0.0) <= 0:
            break
        if (np.abs(losses / before - 1) < 1e-11)[effective > 0].all():
            break
    h = np.tensordot(effective / losses, gram, 1)[:k, :k]
    occam = np.linalg.slogdet(eye + h)[1]
    evidence = -0.5 * float((effective * np.log(losses)).sum() + z @ z + occam)
    return Fit(z, losses, evidence, np.linalg.inv(eye + h))


def telling(gap: Gap, left: np.ndarray, difference: np.ndarray | None = None) -> np.ndarray:
    """Samples (n,) that tell of a torque in such noise.

    Args:
        gap: with its trajectories.
        left: (n, N) noise.
        difference: (n, N) torque; a constant one if None, or where it is rounding.
    """
    slow = autocorrelation(torch.from_numpy(left), gap.bounds)
    times = time_of(slow).numpy()
    if difference is not None:
        along = autocorrelation(torch.from_numpy(difference), gap.bounds)
        a, b = difference**2, left**2
        product = np.maximum(a.sum(1) * b.sum(1), 1e-300)
        loud = np.maximum((a * b).sum(1) * gap.rows / product, 1.0)
        there = a.sum(1) > DEPENDENT**2 * b.sum(1)
        times = np.where(there, time_of(slow * along).numpy() * loud, times)
    return gap.rows / np.maximum(times, 1.0)


def comparable(one: Terms, other: Terms) -> np.ndarray:
    """Samples (n,) with which both are fitted: those that tell one from the other."""
    effective = one.gap.rows
    for _ in range(2):
        fits = [s.fit(effective) for s in (one, other)]
        left = [s.left(f) for s, f in zip((one, other), fits, strict=True)]
        losses = [float((effective * np.log(f.losses)).sum()) for f in fits]
        effective = telling(one.gap, left[int(losses[1] < losses[0])], left[1] - left[0])
    return effective


def nats(one: Terms, other: Terms) -> float:
    """Evidence of one set over another, with the same samples."""
    effective = comparable(one, other)
    return one.fit(effective).evidence - other.fit(effective).evidence


def held_out(one: Terms, other: Terms) -> float:
    """1/2 sum_j n_j log(L_j(other) / L_j(one)) of squares that both leave on the folds that they are
    not fitted on, fold by fold."""
    effective, losses = comparable(one, other), []
    for terms in (one, other):
        whole, total = terms.grams.sum(0), np.zeros(len(effective))
        for out in terms.grams:
            v = np.append(-fit(whole - out, effective * (1 - 1 / len(terms.grams))).z, 1.0)
            total += np.einsum("a,nab,b->n", v, out, v)
        losses.append(np.maximum(total, 1e-300))
    return 0.5 * float((effective * np.log(losses[1] / losses[0])).sum())


def independent(precision: np.ndarray) -> np.ndarray:
    """T (C, K) with T' precision T = 1: coefficients x = T z of independent standard deviations z;
    without the directions of which the precision (C, C) is rounding."""
    size = np.sqrt(np.maximum(precision.diagonal(), 0))
    if not size.any():
        return np.zeros((len(size), 0))
    unit = np.where(size > 0, 1 / np.where(size > 0, size, 1.0), 0.0)
    values, axes = np.linalg.eigh(precision * unit * unit[:, None])
    there = values > DEPENDENT * values[-1]
    return unit[:, None] * axes[:, there] / np.sqrt(values[there])
