"""Bounds from a robot's description: known answers, and bodies sampled in the boxes."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.arms import arm, consistent_parameters
from torchid.errors import RobotError, TorchidError
from torchid.feasibility.derived_bounds import NAME, bounds_notes, derive_bounds, inertia_bounds
from torchid.feasibility.sets import nominal_set
from torchid.robot.inertia import InertialParameters, six
from torchid.robot.library import load_robot
from torchid.robot.shapes import LinkShapes, link_lengths

NOWHERE = torch.full((3, 2), torch.nan, dtype=torch.float64)


def shapes_of(boxes):
    known = boxes.isfinite().all(-1).all(-1).tolist()
    volumes = (boxes[..., 1] - boxes[..., 0]).prod(-1)
    return LinkShapes(boxes, volumes, tuple("collision" if k else None for k in known))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.lists(st.floats(0.01, 2), min_size=3, max_size=3))
def test_no_cloud_of_points_in_a_box_breaks_the_inertia_bounds(seed, sides):
    g = torch.Generator().manual_seed(seed)
    size = torch.tensor(sides, dtype=torch.float64)
    # Half of the points at corners: the bounds are reached there.
    where = torch.rand(50, 8, 3, generator=g, dtype=torch.float64)
    where = (
        torch.where(
            torch.rand(50, 8, 1, generator=g, dtype=torch.float64) < 0.5, where.round(), where
        )
        * size
    )
    mass = torch.rand(50, 8, generator=g, dtype=torch.float64)
    total = mass.sum(-1)
    com = (mass.unsqueeze(-1) * where).sum(-2) / total.unsqueeze(-1)
    away = where - com.unsqueeze(-2)
    second = torch.einsum("kp,kpa,kpb->kab", mass, away, away)
    trace = second.diagonal(dim1=-2, dim2=-1).sum(-1)
    inertia = six(trace[:, None, None] * torch.eye(3, dtype=torch.float64) - second)
    low, high = inertia_bounds(total, size.expand(50, 3)).unbind(-1)
    assert (inertia >= low - 1e-12).all()
    assert (inertia <= high + 1e-12).all()


def test_inertia_bounds_are_reached():
    sides = torch.tensor([0.2, 0.4, 0.6], dtype=torch.float64)
    corner = sides / 2
    # Half of the mass in each of two opposite corners.
    second = 3.0 * corner[:, None] * corner[None, :]
    inertia = six(second.trace() * torch.eye(3, dtype=torch.float64) - second)
    low, high = inertia_bounds(torch.tensor(3.0, dtype=torch.float64), sides).unbind(-1)
    torch.testing.assert_close(inertia[[0, 3, 5]], high[[0, 3, 5]])
    torch.testing.assert_close(inertia[[1, 2, 4]], low[[1, 2, 4]])
    assert low[[0, 3, 5]].tolist() == [0, 0, 0]


def test_bounds_of_the_3r_without_shapes():
    robot = load_robot("3r")
    bounds = derive_bounds(robot)
    nominal = robot.parameters
    assert bounds.name == NAME
    torch.testing.assert_close(
        bounds.mass, nominal.mass[:, None] * torch.tensor([0.7, 1.3], dtype=torch.float64)
    )
    half = (link_lengths(robot) / 2).unsqueeze(-1)
    torch.testing.assert_close(bounds.com[..., 0], nominal.com - half)
    torch.testing.assert_close(bounds.com[..., 1], nominal.com + half)
    # Link 1: joints at (0, -0.3, 0) and the origin, centre of mass at (0.001, -0.12, 0.002).
    x, y, z = 0.001 + 0.3, 0.3 + 0.3, 0.002 + 0.3
    expected = torch.tensor(
        [y**2 + z**2, x * y, x * z, x**2 + z**2, y * z, x**2 + y**2], dtype=torch.float64
    )
    torch.testing.assert_close(bounds.inertia[0, :, 1], 3.5 * 1.3 / 4 * expected)
    assert bounds.coefficients == {}


def test_shapes_set_the_boxes_where_they_are_known():
    robot = load_robot("3r")
    boxes = torch.stack(
        [
            torch.tensor([[-0.1, 0.3], [-0.2, 0.0], [0.0, 0.5]], dtype=torch.float64),
            NOWHERE,
            NOWHERE,
        ]
    )
    bounds = derive_bounds(robot, mass_percent=50, com_margin=0.07, shapes=shapes_of(boxes))
    assert torch.equal(bounds.com[0], boxes[0])
    torch.testing.assert_close(
        bounds.com[1, :, 1] - bounds.com[1, :, 0], torch.full((3,), 0.14, dtype=torch.float64)
    )
    torch.testing.assert_close(
        bounds.inertia[0, 0, 1], torch.tensor(3.5 * 1.5 / 4 * 0.29, dtype=torch.float64)
    )
    torch.testing.assert_close(
        bounds.inertia[0, 4, 0], torch.tensor(-3.5 * 1.5 / 4 * 0.1, dtype=torch.float64)
    )
    notes = bounds_notes(robot, bounds, shapes_of(boxes))
    assert any("links 2, 3: no shape" in note for note in notes)
    # The nominal centre of mass of link 1 is at y = -0.12, z = 0.002: inside.
    assert not any("outside" in note for note in notes)


def test_a_flat_shape_still_has_lower_below_upper():
    robot = load_robot("3r")
    flat = torch.tensor([[-0.1, 0.1], [0.0, 0.0], [0.0, 0.2]], dtype=torch.float64).repeat(3, 1, 1)
    bounds = derive_bounds(robot, shapes=shapes_of(flat))
    box = bounds.box()
    assert (box[:, 0] < box[:, 1]).all()
    assert box.isfinite().all()


@pytest.mark.parametrize("name", ["3r", "3r_friction", "mixed", "kuka_lwr4_friction"])
def test_bounds_are_a_proper_box_for_any_arm(name):
    robot = arm(name)
    bounds = derive_bounds(robot)
    box = bounds.box(nominal_set(robot).effects)
    assert box.isfinite().all()
    assert (box[:, 0] < box[:, 1]).all()


def test_friction_is_bounded_by_ten_times_nominal_and_offsets_on_both_sides():
    robot = load_robot("kuka_lwr4_friction")
    found = derive_bounds(robot).coefficients
    assert set(found) == {"Fv", "Fc", "F0"}
    assert found["Fv"][1].tolist() == [0, pytest.approx(1.987)]
    assert found["Fv"][5].tolist() == [0, pytest.approx(0.132)]
    assert found["F0"][0].tolist() == [pytest.approx(-1.073), pytest.approx(1.073)]
    notes = bounds_notes(robot, derive_bounds(robot))
    assert any("Fv6" in note and "I3xx" in note and "outside" in note for note in notes)


def test_joints_without_friction_have_the_largest_bound_and_one_if_all_are_zero():
    robot = replace(
        load_robot("3r"),
        effects=(
            {"effect": "viscous_friction", "joint": 2, "Fv": 0.3},
            {"effect": "coulomb_friction", "joint": 1, "Fc": 0.0},
            {"effect": "torque_offset", "joint": 3, "F0": -0.5},
        ),
    )
    found = derive_bounds(robot).coefficients
    assert found["Fv"].tolist() == [[0, 3], [0, 3], [0, 3]]
    assert found["Fc"].tolist() == [[0, 1], [0, 1], [0, 1]]
    assert found["F0"].tolist() == [[-5, 5]] * 3


def test_masses_stop_at_zero():
    assert derive_bounds(load_robot("3r"), mass_percent=150).mass[:, 0].tolist() == [0, 0, 0]


@pytest.mark.parametrize("percent", [0.0, -5.0, float("nan"), float("inf")])
def test_a_percentage_is_positive(percent):
    with pytest.raises(TorchidError, match="mass_percent"):
        derive_bounds(load_robot("3r"), mass_percent=percent)
    with pytest.raises(TorchidError, match="com_margin"):
        derive_bounds(load_robot("3r"), com_margin=percent)


def test_a_robot_without_parameters_is_one_clear_error():
    with pytest.raises(RobotError, match="no inertial parameters, which deriving bounds needs"):
        derive_bounds(load_robot("panda"))


def test_a_massless_link_is_named():
    robot = load_robot("3r")
    pi = consistent_parameters(3, 0).pi
    pi[1] = 0.0
    with pytest.raises(RobotError, match=r"link 2 \('link_2'\)"):
        derive_bounds(robot.with_parameters(InertialParameters(pi)))
