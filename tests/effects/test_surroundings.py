"""Planes and stops against potentials, and loads of bearings against statics."""

import math
from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

from tests.arms import arm
from torchid.effects.bearing import AxialLoadFriction, BearingMomentFriction
from torchid.effects.motion import Motion
from torchid.effects.surroundings import SIDES, EndStop, PlaneContact
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot, tool_pose
from torchid.robot.yaml_file import from_mapping


def motion(n: int, count: int = 40) -> Motion:
    g = torch.Generator().manual_seed(3)
    q, dq, ddq = (torch.randn(count, n, generator=g, dtype=torch.float64) for _ in range(3))
    return Motion(q, dq, ddq)


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("reach", [0.0, 0.15])
def test_a_plane_pushes_with_the_slope_of_its_potential(side: str, reach: float) -> None:
    """The drives hold 1/2 k depth^2: their torque is its derivative by q."""
    robot = arm("kuka_lwr4")
    m = motion(robot.n)
    q = m.q.clone().requires_grad_()
    pose = tool_pose(robot, q)
    place = (pose[:, :3, 3] + reach * pose[:, :3, 2])[:, "xyz".index(side[1])]
    sign = 1.0 if side[0] == "+" else -1.0
    height = float(place.detach().median()) + 1e-3  # at no sample exactly
    depth = (sign * (height - place)).clamp(min=0)
    (slope,) = torch.autograd.grad(0.5 * depth.square().sum(), q)
    columns = PlaneContact(height, side, reach).torque_columns(m, robot)
    assert_close(columns[..., 0], slope)
    # Damping takes energy out: the power of its torque is that of a force against the approach.
    power = (columns[..., 1] * m.dq).sum(-1)
    assert bool((power >= -1e-12).all())
    assert bool((columns[depth == 0] == 0).all())


def test_a_stop_holds_its_potential() -> None:
    m = motion(3)
    for towards in (1.0, -1.0):
        q = m.q.clone().requires_grad_()
        depth = (towards * (q[:, 1] - 0.3)).clamp(min=0)
        (slope,) = torch.autograd.grad(0.5 * depth.square().sum(), q)
        assert_close(EndStop(1, 0.3, towards).torque_columns(m)[..., 0], slope)


@pytest.fixture
def column() -> Robot:
    """A vertical axis that carries 2 kg at 0.5 m beside it and 0.3 m above its origin."""
    robot = from_mapping(
        {
            "name": "column",
            "dh": {
                "convention": "modified",
                "joints": [{"type": "R", "a": 0, "alpha": 0, "d": 0, "theta": 0}],
            },
            "gravity": [0, 0, -9.81],
        },
        "column",
    )
    mass, com = torch.tensor([2.0]).double(), torch.tensor([[0.5, 0.0, 0.3]]).double()
    inertia = torch.zeros(1, 6, dtype=torch.float64)
    return robot.with_parameters(InertialParameters.from_com(mass, com, inertia))


def test_loads_of_a_bearing_are_those_of_statics(column: Robot) -> None:
    """At rest: the weight along the axis, the weight times its lever across it. At speed w the
    centripetal force m r w^2 bends the axis, too."""
    still = torch.tensor([[0.7]], dtype=torch.float64)
    for w in (0.0, 3.0):
        speed = torch.full_like(still, w)
        moving = Motion(still, speed, 0 * still, direction=torch.ones_like(still))
        moment = BearingMomentFriction(0).torque_columns(moving, column).item()
        axial = AxialLoadFriction(0).torque_columns(moving, column).item()
        assert axial == pytest.approx(2 * 9.81)
        # The axis pulls the mass inwards with m r w^2 at a lever of 0.3 m, which bends it as the
        # weight at its lever of 0.5 m does.
        assert moment == pytest.approx(2 * 9.81 * 0.5 + 2 * 0.5 * w**2 * 0.3, rel=1e-6)


def test_friction_by_load_has_the_sign_of_the_speed(column: Robot) -> None:
    q = torch.zeros(2, 1, dtype=torch.float64)
    dq = torch.tensor([[0.4], [-0.4]], dtype=torch.float64)
    columns = BearingMomentFriction(0).torque_columns(Motion(q, dq, 0 * q), column)
    assert float(columns[0]) == pytest.approx(-float(columns[1]))
    assert math.copysign(1, float(columns[0])) == 1


def test_planes_near_the_ends_of_the_travel() -> None:
    robot = arm("3r")
    m = motion(3, 400)
    place = tool_pose(robot, m.q)[:, :3, 3]
    for plane in PlaneContact.near_ends(robot, [m]):
        own, sign = place[:, "xyz".index(plane.side[1])], 1.0 if plane.side[0] == "+" else -1.0
        inside = sign * (plane.height - own) > 0
        assert 1 <= int(inside.sum()) < 0.7 * len(own)
    assert replace(PlaneContact(0.2), reach=0.1).identity == PlaneContact(0.1).identity
