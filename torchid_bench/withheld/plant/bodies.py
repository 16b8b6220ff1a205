"""Mass, centre of mass and inertia of bodies, from solids of uniform density."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

Array = np.ndarray
_AXES = {"x": 0, "y": 1, "z": 2}


@dataclass(frozen=True)
class Inertial:
    """What a rigid body is to dynamics.

    Attributes:
        mass: [kg].
        com: (3,) centre of mass in the link frame [m].
        inertia: (3, 3) about the centre of mass, axes of the link frame [kg m^2].
    """

    mass: float
    com: Array
    inertia: Array


@dataclass(frozen=True)
class Cylinder:
    """A cylinder along an axis of the link frame: density [kg/m^3], radius, length, centre [m]."""

    density: float
    radius: float
    length: float
    centre: tuple[float, float, float]
    axis: str = "z"

    def inertial(self) -> Inertial:
        """Mass, centre and inertia of the cylinder."""
        mass = self.density * np.pi * self.radius**2 * self.length
        across = mass * (self.radius**2 / 4 + self.length**2 / 12)
        diagonal = np.full(3, across)
        diagonal[_AXES[self.axis]] = mass * self.radius**2 / 2
        return Inertial(mass, np.array(self.centre), np.diag(diagonal))


@dataclass(frozen=True)
class Box:
    """A box along the link frame's axes: density [kg/m^3], sizes and centre [m]."""

    density: float
    sizes: tuple[float, float, float]
    centre: tuple[float, float, float]

    def inertial(self) -> Inertial:
        """Mass, centre and inertia of the box."""
        x, y, z = self.sizes
        mass = self.density * x * y * z
        diagonal = np.array([y * y + z * z, x * x + z * z, x * x + y * y]) * mass / 12
        return Inertial(mass, np.array(self.centre), np.diag(diagonal))


def combined(bodies: Sequence[Inertial]) -> Inertial:
    """Several bodies of one frame as one."""
    mass = sum(b.mass for b in bodies)
    com = sum((b.mass * b.com for b in bodies), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for b in bodies:
        r = b.com - com
        inertia = inertia + (b.inertia + b.mass * (np.eye(3) * (r @ r) - np.outer(r, r)))
    return Inertial(mass, com, inertia)


def deformed(body: Inertial, mass_factor: float, shift: Array, stretch: Array) -> Inertial:
    """The body made heavier, moved and stretched: a body again, whatever the numbers.

    The second moments of the mass, S = tr(J)/2 - J, become E S E' with E = 1 + stretch, which is
    what an affine map of the body's matter does to them.

    Args:
        body: as it is.
        mass_factor: > 0.
        shift: (3,) of the centre of mass [m].
        stretch: (3, 3) symmetric.
    """
    moments = np.eye(3) * np.trace(body.inertia) / 2 - body.inertia
    map_ = np.eye(3) + stretch
    moved = mass_factor * map_ @ moments @ map_.T
    inertia = np.eye(3) * np.trace(moved) - moved
    return Inertial(body.mass * mass_factor, body.com + shift, inertia)
