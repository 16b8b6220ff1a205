"""Conditions beside physics: boxes, cylinders, spheres and total mass from a robot's yaml."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch

from torchid.errors import RobotError
from torchid.feasibility.bounds import read_bounds
from torchid.feasibility.conditions import conditions, physics_only
from torchid.robot.library import load_robot
from torchid.robot.model import Robot

NAN = float("nan")


def with_geometry(geometry: Any) -> Robot:
    robot = load_robot("3r")
    return replace(robot, bounds={**robot.bounds, "geometry": geometry})


def test_physics_only_asks_for_nothing() -> None:
    none = physics_only(4)
    assert none.com_box.shape == (4, 3, 2)
    assert bool((none.com_box[..., 0] == -torch.inf).all())
    assert bool((none.com_box[..., 1] == torch.inf).all())
    assert bool((none.round_radius == torch.inf).all())
    assert none.total_mass.tolist() == [-math.inf, math.inf]


def test_boxes_are_those_of_the_group_normal() -> None:
    robot = load_robot("kuka_lwr4")
    assert torch.equal(conditions(robot).com_box, read_bounds(robot, "normal").com)
    own = read_bounds(robot, "tight").com
    assert torch.equal(conditions(robot, com_box=own).com_box, own)
    bare = replace(robot, bounds={})
    assert bool(conditions(bare).com_box.isinf().all())


def test_cylinder_of_the_3r_lies_along_the_long_side() -> None:
    """Link 1 is 0.3 m along y (its box -0.3..0), links 2 and 3 are 0.22 and 0.15 m along x."""
    shapes = conditions(load_robot("3r"), shapes=True)
    assert shapes.round_axes.tolist() == [[1, 0, 1], [0, 1, 1], [0, 1, 1]]
    assert shapes.round_radius.tolist() == [0.04, 0.035, 0.03]
    expected = torch.tensor([[0, -0.15, 0], [-0.11, 0, 0], [-0.075, 0, 0]], dtype=torch.float64)
    torch.testing.assert_close(shapes.round_centre, expected, rtol=0, atol=1e-15)


def test_shapes_one_by_one() -> None:
    robot = with_geometry(
        {
            "cylinders": [{"link": 1, "axis": "y", "radius": 0.05}],
            "spheres": [{"link": 3, "radius": 0.2, "centre": [0.1, 0.0, -0.1]}],
        }
    )
    shapes = conditions(robot, shapes=True)
    assert shapes.round_axes.tolist() == [[1, 0, 1], [0, 0, 0], [1, 1, 1]]
    assert shapes.round_radius.tolist() == [0.05, math.inf, 0.2]
    assert shapes.round_centre.tolist() == [[0, 0, 0], [0, 0, 0], [0.1, 0, -0.1]]
    # Not asked for: not there.
    assert bool(conditions(robot).round_radius.isinf().all())


def test_conditions_move_to_a_device(device: torch.device) -> None:
    asked = conditions(load_robot("3r"), shapes=True, total_mass=(4.0, 6.0))
    moved = asked.to(device)
    assert moved.com_box.device.type == device.type
    assert moved.total_mass.cpu().tolist() == [4.0, 6.0]


def test_robot_without_shapes_is_refused() -> None:
    with pytest.raises(RobotError, match="no shapes of its links"):
        conditions(load_robot("kuka_lwr4"), shapes=True)


@pytest.mark.parametrize("total", [(6.0, 4.0), (5.0, 5.0), (NAN, 4.0), (1.0, NAN)])
def test_empty_total_mass_is_refused(total: tuple[float, float]) -> None:
    with pytest.raises(RobotError, match="total mass is empty"):
        conditions(load_robot("3r"), total_mass=total)


BAD = {
    "a list": ([1], "no shapes"),
    "radius alone": ({"cylinder_radius": [0.1] * 3}, "cylinder_length"),
    "too few": ({"cylinder_radius": [0.1] * 2, "cylinder_length": [0.3] * 3}, "wrong size"),
    "nan": ({"cylinder_radius": [0.1, NAN, 0.1], "cylinder_length": [0.3] * 3}, "not all finite"),
    "no axis": ({"cylinders": [{"link": 1, "radius": 0.1}]}, "not a cylinder"),
    "sphere with an axis": (
        {"spheres": [{"link": 1, "axis": "x", "radius": 0.1}]},
        "not a cylinder or sphere",
    ),
    "no radius": ({"spheres": [{"link": 1}]}, "not a cylinder or sphere"),
    "no link": ({"spheres": [{"radius": 0.1}]}, "not a cylinder or sphere"),
    "link 0": ({"spheres": [{"link": 0, "radius": 0.1}]}, "no such link"),
    "link 4": ({"spheres": [{"link": 4, "radius": 0.1}]}, "no such link"),
    "radius 0": ({"spheres": [{"link": 1, "radius": 0.0}]}, "no such radius"),
    "centre of two": ({"spheres": [{"link": 1, "radius": 1, "centre": [0, 0]}]}, "wrong size"),
    "no list": ({"spheres": None}, "must be a list"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_geometry_is_refused(case: str) -> None:
    geometry, said = BAD[case]
    with pytest.raises(RobotError, match=said):
        conditions(with_geometry(geometry), shapes=True)


def test_lengths_without_boxes_are_refused() -> None:
    robot = load_robot("3r")
    alone = replace(robot, bounds={"geometry": robot.bounds["geometry"]})
    with pytest.raises(RobotError, match="need the boxes"):
        conditions(alone, shapes=True)
