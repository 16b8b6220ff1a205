"""Sums that no body can make negative, or positive."""

import pytest
import torch

from torchid.effects.registry import on_every_joint
from torchid.identification.base_parameters import base_parameters, physical_signs
from torchid.robot.inertia import InertialParameters, parallel_axis
from torchid.robot.library import load_robot

EFFECTS = ("viscous_friction", "torque_offset", "rotor_inertia")


def points(n: int, count: int) -> torch.Tensor:
    """(count, n, 10) bodies of one point each, some far away, some light: the cone's edges."""
    generator = torch.Generator().manual_seed(0)
    size = 10 ** (4 * torch.rand(count, n, 1, generator=generator, dtype=torch.float64) - 2)
    place = size * torch.randn(count, n, 3, generator=generator, dtype=torch.float64)
    # Only some directions: what matters may lie along one axis.
    place = place * (torch.rand(count, n, 3, generator=generator, dtype=torch.float64) < 0.5)
    mass = 10 ** (2 * torch.rand(count, n, generator=generator, dtype=torch.float64) - 1)
    mass = mass * (torch.rand(count, n, generator=generator, dtype=torch.float64) < 0.5)
    return InertialParameters.from_link_frame(
        mass, place, parallel_axis(mass, place)
    ).to_paper_order()


@pytest.mark.parametrize("name", ["3r", "kuka_lwr4", "panda", "ur10e"])
def test_signs_are_those_of_bodies_and_no_others(name):
    robot = load_robot(name)
    effects = tuple(on_every_joint(EFFECTS, robot.n))
    base = base_parameters(robot, effects)
    signs = physical_signs(base, effects)
    rigid = points(robot.n, 20_000)
    generator = torch.Generator().manual_seed(1)
    rest = torch.rand(len(rigid), 3 * robot.n, generator=generator, dtype=torch.float64)
    rest[:, robot.n : 2 * robot.n] -= 0.5  # offsets have either sign
    rest = rest * (torch.rand(rest.shape, generator=generator, dtype=torch.float64) < 0.5)
    values = base.project(torch.cat([rigid, rest], -1))
    slack = 1e-3 * values.abs().amax(0)
    for k, sign in enumerate(signs.tolist()):
        low, high = float(values[:, k].min()), float(values[:, k].max())
        if sign:
            assert min(sign * low, sign * high) >= -slack[k] * 1e-6, base.names[k]
        else:
            assert low < 0 < high, base.names[k]
    assert int((signs != 0).sum()) > robot.n


def test_what_the_sums_of_a_wrist_say():
    robot = load_robot("kuka_lwr4")
    effects = tuple(on_every_joint(EFFECTS, 7))
    base = base_parameters(robot, effects)
    of = dict(zip(base.names, physical_signs(base, effects).tolist(), strict=True))
    for name, sign in of.items():
        if name.startswith(("Fv", "J7zz")):
            assert sign == 1, name
        if name.startswith("F0") or name == "m7c7x":
            assert sign == 0, name
