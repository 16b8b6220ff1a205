"""Evidence of sets of linear terms, for ground truth that stays: nothing here is a diagnosis'.

    E(S) = -1/2 sum_j n_j log L_j - 1/2 x'Px - 1/2 log|I + P^-1/2 G P^-1/2|

(MacKay 1992, Bayesian interpolation) with L_j the squares that a set S leaves on joint j, x its
coefficients, P their inverse covariance beforehand, G = sum_j n_j/L_j X_j'X_j, and n_j samples that
tell two sets apart: rows over the correlation time of (what the better one leaves) x (the
difference of the two torques) (Bayley and Hammersley 1946), fewer where the noise is louder where
they differ (White 1980). Both sets of a comparison have the same. Nothing is paid for having
looked.
"""

from dataclasses import dataclass

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
    """

    y: np.ndarray
    rows: np.ndarray
    bounds: tuple[slice, ...]


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
        signals: (n, 1 + K, N) the gap, then torque per standard deviation of each coefficient
            [N m; N].
        gram: (n, 1 + K, 1 + K) their products, joint by joint.
    """

    gap: Gap
    signals: np.ndarray
    gram: np.ndarray

    @classmethod
    def of(cls, gap: Gap, columns: np.ndarray) -> "Terms":
        """Terms with columns (K, n, N)."""
        y = gap.y[:, None]
        return cls(gap, y, y @ y.transpose(0, 2, 1)).with_(columns)

    @property
    def columns(self) -> np.ndarray:
        """(n, K, N), without the gap."""
        return self.signals[:, 1:]

    def with_(self, more: np.ndarray) -> "Terms":
        """These terms and more columns (C, n, N)."""
        new = more.transpose(1, 0, 2)
        signals = np.concatenate([self.signals, new], 1)
        first, products = self.gram.shape[1], signals @ new.transpose(0, 2, 1)
        gram = np.concatenate([self.gram, products[:, :first].transpose(0, 2, 1)], 1)
        return Terms(self.gap, signals, np.concatenate([gram, products], 2))

    def fit(self, effective: np.ndarray) -> Fit:
        """The maximum over z of -1/2 sum_j n_j log L_j(z) - 1/2 z'z, with so many samples (n,), and
        its evidence."""
        gram, eye = self.gram, np.eye(self.gram.shape[1] - 1)
        floor = 1e-12 * gram[:, 0, 0] + 1e-300
        z: np.ndarray = np.zeros(len(eye))
        losses: np.ndarray = gram[:, 0, 0] + floor
        for _ in range(200):
            h = np.tensordot(effective / losses, gram, 1)
            z = np.linalg.solve(eye + h[1:, 1:], h[1:, 0])
            v = np.append(1.0, -z)
            before, losses = losses, np.maximum((gram @ v) @ v, floor)
            if (np.abs(losses - before) <= 1e-11 * before)[effective > 0].all():
                break
        h = eye + np.tensordot(effective / losses, gram, 1)[1:, 1:]
        occam = np.linalg.slogdet(h)[1]
        evidence = -0.5 * float((effective * np.log(losses)).sum() + z @ z + occam)
        return Fit(z, losses, evidence, np.linalg.inv(h))

    def left(self, of: Fit) -> np.ndarray:
        """(n, N) torque that a fit of them leaves."""
        return np.append(1.0, -of.z) @ self.signals


def telling(gap: Gap, left: np.ndarray, difference: np.ndarray) -> np.ndarray:
    """Samples (n,) that tell of a torque in such noise.

    Args:
        gap: with its trajectories.
        left: (n, N) noise.
        difference: (n, N) torque; where it is rounding, a constant one.
    """
    slow = autocorrelation(torch.from_numpy(left), gap.bounds)
    along = autocorrelation(torch.from_numpy(difference), gap.bounds)
    a, b = difference**2, left**2
    product = np.maximum(a.sum(1) * b.sum(1), 1e-300)
    loud = np.maximum((a * b).sum(1) * gap.rows / product, 1.0)
    there = a.sum(1) > DEPENDENT**2 * b.sum(1)
    times = np.where(there, time_of(slow * along).numpy() * loud, time_of(slow).numpy())
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


def independent(precision: np.ndarray) -> np.ndarray:
    """T (..., C, C) with T' precision T = 1: coefficients x = T z of independent standard
    deviations z; zeros for the directions of which the precision (..., C, C) is rounding."""
    size = np.sqrt(np.maximum(np.diagonal(precision, axis1=-2, axis2=-1), 0))
    unit = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)[..., None]
    values, axes = np.linalg.eigh(precision * unit * unit.swapaxes(-1, -2))
    there = values > DEPENDENT * values[..., -1:]
    root = np.divide(1.0, np.sqrt(np.abs(values)), out=np.zeros_like(values), where=there)
    return unit * axes * root[..., None, :]
