"""A robot with other limits, or with a payload: how they may be given, and what is none."""

import numpy as np
import pytest
import torch

from tests.arms import mixed_arm
from torchid.dynamics.forward import mass_matrix
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.errors import RobotError, TorchidError
from torchid.robot.library import load_robot
from torchid.robot.model import error_unit, link_poses


@pytest.mark.parametrize(("kinds", "unit"), [("RR", "mrad"), ("P", "mm"), ("RP", "mrad, mm")])
def test_position_errors_have_the_unit_of_their_joints(kinds: str, unit: str) -> None:
    assert error_unit(mixed_arm(kinds)) == unit


@pytest.mark.parametrize("given", [2.0, [2.0] * 3, np.full(3, 2.0), [[-2.0, 2.0]] * 3])
def test_limits_are_numbers_of_any_form(given: object) -> None:
    robot = load_robot("3r")
    changed = robot.with_limits(acceleration=given).limits  # type: ignore[arg-type]
    assert changed.acceleration is not None
    assert changed.acceleration.tolist() == [[-2.0, 2.0]] * 3
    assert changed.velocity is robot.limits.velocity


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("acceleration", 0.0),
        ("acceleration", float("nan")),
        ("velocity", [1.0, 2.0]),
        ("velocity", [1.0, -2.0, 1.0]),
        ("position", [1.0, 2.0, 3.0]),
        ("torque", "strong"),
        ("speed", 1.0),
    ],
)
@pytest.mark.usefixtures("types_unchecked")
def test_what_is_no_limit_is_refused(name: str, given: object) -> None:
    robot = load_robot("3r")
    with pytest.raises(TorchidError, match=name):
        robot.with_limits(**{name: given})  # type: ignore[arg-type]
    assert torch.isfinite(robot.limits.velocity).all()


@pytest.mark.parametrize("name", ["3r", "kuka_lwr4"])
def test_a_payload_weighs_and_resists_as_its_own_kinematics_say(name: str) -> None:
    """Mass matrix and gravity differ by those of a body at the pose of the last link: Jacobians by
    automatic differentiation of the pose, no inertial parameters."""
    robot = load_robot(name)
    com, inertia = torch.tensor([0.1, -0.05, 0.2]).double(), torch.tensor([3.0, 2.0, 2.5]).double()
    mass, body = 1.7, torch.diag(inertia) * 1e-2
    loaded = robot.with_payload(mass, com, [0.03, 0.0, 0.0, 0.02, 0.0, 0.025])
    q = torch.linspace(-0.7, 0.9, robot.n, dtype=torch.float64)

    def place(angles: torch.Tensor) -> torch.Tensor:
        pose = link_poses(robot, angles)[-1]
        return pose[:3, :3] @ com + pose[:3, 3]

    def turned(angles: torch.Tensor) -> torch.Tensor:
        return link_poses(robot, angles)[-1][:3, :3]

    slide = torch.autograd.functional.jacobian(place, q)  # (3, n)
    spin = torch.autograd.functional.jacobian(turned, q)  # (3, 3, n): S(w) R
    rotation = turned(q)
    skew = torch.einsum("ijn,kj->ikn", spin, rotation)
    turn = torch.stack([skew[2, 1], skew[0, 2], skew[1, 0]])
    about = rotation @ body @ rotation.T
    expected = mass * slide.T @ slide + turn.T @ about @ turn
    found = mass_matrix(loaded, q) - mass_matrix(robot, q)
    torch.testing.assert_close(found, expected, rtol=1e-10, atol=1e-12)
    zero = torch.zeros_like(q)
    weight = [inverse_dynamics(r, q, zero, zero) for r in (loaded, robot)]
    held = -mass * slide.T @ robot.gravity
    torch.testing.assert_close(weight[0] - weight[1], held, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize(
    ("mass", "com", "inertia"),
    [
        (0.0, [0, 0, 0], None),
        (-1.0, [0, 0, 0], None),
        (float("nan"), [0, 0, 0], None),
        (1.0, [0, 0], None),
        (1.0, [0, 0, 0], [1, 0, 0]),
        (1.0, [0, 0, 0], [1.0, 0, 0, 0, 0, 0]),
        (1.0, "here", None),
    ],
)
@pytest.mark.usefixtures("types_unchecked")
def test_what_no_body_has_is_no_payload(mass: float, com: object, inertia: object) -> None:
    with pytest.raises(RobotError):
        load_robot("3r").with_payload(mass, com, inertia)  # type: ignore[arg-type]


def test_a_robot_without_parameters_carries_nothing() -> None:
    with pytest.raises(RobotError, match="no inertial parameters"):
        load_robot("panda").with_payload(1.0)
