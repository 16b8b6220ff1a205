"""What pulls at joints as two of them stand, like cables: smooth, of no usual law, and no one
potential's."""

import numpy as np

from torchid_bench.withheld.plant.bodies import Array


def drawn_waves(rng: np.random.Generator, n: int) -> Array:
    """Plane waves (n, 5, 3) of each joint: numbers along its position and its neighbour's, and
    phase [rad]."""
    numbers, phase = rng.standard_normal((n, 5, 2)), rng.uniform(0, 2 * np.pi, (n, 5, 1))
    return np.concatenate([2.0 * numbers, phase], 2)


def pull_of(waves: Array, q: Array) -> Array:
    """(.., n) about 1: five plane waves, a draw of a Gaussian process (Rahimi and Recht 2007) over
    a joint's position and its neighbour's (.., n)."""
    beside = q[..., np.arange(-1, q.shape[-1] - 1)]
    angle = waves[..., 0] * q[..., None] + waves[..., 1] * beside[..., None] + waves[..., 2]
    return np.asarray(0.63 * np.sin(angle).sum(-1))
