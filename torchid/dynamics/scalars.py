"""Arithmetic on components: each number is a tensor over samples, or a Python float.

The dynamics is written once in this style. A Python float is a constant of the robot's geometry;
products with 0 and 1 vanish before any kernel runs, so a DH robot with right angles costs what its
hand-simplified equations would. The same code runs eagerly and under autograd.
"""

from typing import NamedTuple

import torch
from torch import Tensor

Scalar = Tensor | float


class Vec3(NamedTuple):
    """Three components, each a tensor of the same shape or a float."""

    x: Scalar
    y: Scalar
    z: Scalar


ZERO = Vec3(0.0, 0.0, 0.0)


def fma(acc: Scalar, a: Scalar, b: Scalar, scale: float = 1.0) -> Scalar:
    """acc + scale * a * b, in one kernel where it can be, in none where it is known."""
    if type(a) is float:
        a, b = b, a
    if type(b) is float:
        scale *= b
        if scale == 0.0:
            return acc
        return acc + scale * a if type(a) is float else _axpy(acc, a, scale)
    if scale == 0.0:
        return acc
    if type(acc) is float:
        product = a * b
        return product if scale == 1.0 and acc == 0.0 else product * scale + acc
    return torch.addcmul(acc, a, b, value=scale)  # type: ignore[arg-type]  # b is no float here


def _axpy(acc: Scalar, a: Scalar, scale: float) -> Scalar:
    if type(acc) is float:
        if acc == 0.0:
            return a if scale == 1.0 else (-a if scale == -1.0 else a * scale)
        return a * scale + acc
    return torch.add(acc, a, alpha=scale)


def mul(a: Scalar, b: Scalar, scale: float = 1.0) -> Scalar:
    """scale * a * b."""
    return fma(0.0, a, b, scale)


def add(a: Scalar, b: Scalar) -> Scalar:
    """a + b."""
    if type(b) is float:
        a, b = b, a
    return _axpy(a, b, 1.0) if type(b) is not float else a + b


def add3(a: Vec3, b: Vec3) -> Vec3:
    """Sum of two vectors."""
    return Vec3(add(a.x, b.x), add(a.y, b.y), add(a.z, b.z))


def add_scaled(acc: Vec3, a: Vec3, k: Scalar, scale: float = 1.0) -> Vec3:
    """acc + scale * k * a."""
    return Vec3(fma(acc.x, a.x, k, scale), fma(acc.y, a.y, k, scale), fma(acc.z, a.z, k, scale))


def dot(a: Vec3, b: Vec3) -> Scalar:
    """Scalar product."""
    return fma(fma(mul(a.x, b.x), a.y, b.y), a.z, b.z)


def add_cross(acc: Vec3, a: Vec3, b: Vec3) -> Vec3:
    """acc + a x b."""
    return Vec3(
        fma(fma(acc.x, a.y, b.z), a.z, b.y, -1.0),
        fma(fma(acc.y, a.z, b.x), a.x, b.z, -1.0),
        fma(fma(acc.z, a.x, b.y), a.y, b.x, -1.0),
    )


def cross(a: Vec3, b: Vec3) -> Vec3:
    """a x b."""
    return add_cross(ZERO, a, b)
