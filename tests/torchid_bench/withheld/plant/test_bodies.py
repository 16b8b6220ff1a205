"""Bodies from solids, and bodies that were changed."""

import numpy as np

from torchid_bench.withheld.plant.bodies import Box, Cylinder, combined


def test_two_halves_make_a_box():
    whole = Box(1000.0, (0.2, 0.1, 0.3), (0.0, 0.0, 0.15)).inertial()
    halves = [Box(1000.0, (0.2, 0.1, 0.15), (0.0, 0.0, z)).inertial() for z in (0.075, 0.225)]
    both = combined(halves)
    np.testing.assert_allclose(both.mass, whole.mass)
    np.testing.assert_allclose(both.com, whole.com)
    np.testing.assert_allclose(both.inertia, whole.inertia, atol=1e-12)


def test_a_cylinder_is_its_integral():
    body = Cylinder(800.0, 0.05, 0.4, (0.1, 0.0, 0.0), "x").inertial()
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (400_000, 3)) * (0.2, 0.05, 0.05)
    points = points[np.hypot(points[:, 1], points[:, 2]) < 0.05]
    second = np.cov(points.T, bias=True) * body.mass
    np.testing.assert_allclose(
        body.inertia, np.eye(3) * np.trace(second) - second, rtol=0.02, atol=2e-4 * body.mass
    )
    np.testing.assert_allclose(body.mass, 800 * np.pi * 0.05**2 * 0.4)
