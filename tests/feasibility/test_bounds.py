"""Groups of bounds from a robot's yaml: read as printed, and refused where they mean nothing."""

from copy import deepcopy
from dataclasses import replace
from typing import Any

import pytest
import torch

from torchid.effects.friction import CoulombFriction, ViscousFriction
from torchid.effects.inertia import RotorInertia
from torchid.errors import RobotError
from torchid.feasibility.bounds import bounds_groups, read_bounds, read_total_mass
from torchid.feasibility.sets import nominal_set
from torchid.robot.library import load_robot
from torchid.robot.model import Robot

NAN, INF = float("nan"), float("inf")


def with_bounds(changes: dict[tuple[str | int, ...], Any], name: str = "3r") -> Robot:
    """The robot with entries of its yaml's bounds replaced; ... removes one."""
    robot = load_robot(name)
    bounds = deepcopy(dict(robot.bounds))
    for path, value in changes.items():
        at: Any = bounds
        for key in path[:-1]:
            at = at[key]
        if value is ...:
            del at[path[-1]]
        else:
            at[path[-1]] = value
    return replace(robot, bounds=bounds)


def test_bounds_of_table_a5_and_a6() -> None:
    """Entries as the report prints them."""
    three = read_bounds(load_robot("3r"), "normal")
    assert three.mass.tolist() == [[0, 5], [0, 2], [0, 3]]
    assert three.com[0].tolist() == [[-0.04, 0.04], [-0.3, 0.0], [-0.04, 0.04]]
    assert three.inertia[2, 1].tolist() == [-0.5, 0.5]
    for group, box in (("loose", [0.4, 0.6]), ("normal", [0.1, 0.2]), ("tight", [0.05, 0.1])):
        assert read_bounds(load_robot("kuka_lwr4"), group).com[6, 2].tolist() == box


@pytest.mark.parametrize("name", ["3r", "3r_friction", "kuka_lwr4", "kuka_lwr4_friction"])
def test_every_built_in_group_can_be_read(name: str) -> None:
    robot = load_robot(name)
    groups = bounds_groups(robot)
    assert {"loose", "normal", "tight"} <= set(groups)
    assert not {"geometry", "total_mass"} & set(groups)
    effects = nominal_set(robot).effects
    for group in groups:
        bounds = read_bounds(robot, group)
        box = bounds.box(effects)
        assert box.shape == (10 * robot.n + len(effects), 2)
        assert bool((box[:, 0] < box[:, 1]).all())
        n = robot.n
        assert torch.equal(box[:n], bounds.mass)
        assert torch.equal(box[n : 4 * n].reshape(n, 3, 2), bounds.com)
        assert torch.equal(box[4 * n : 10 * n].reshape(n, 6, 2), bounds.inertia)


def test_coefficients_are_bounded_joint_by_joint() -> None:
    robot = load_robot("3r_friction")
    lower = {"mass": [0.0] * 3, "com": [[-1.0] * 3] * 3, "inertia": [[-1.0] * 6] * 3}
    upper = {"mass": [1.0] * 3, "com": [[1.0] * 3] * 3, "inertia": [[1.0] * 6] * 3}
    lower |= {"friction_viscous": [0.1, 0.2, 0.3], "rotor_inertia": [0.0] * 3}
    upper |= {"friction_viscous": [1.1, 1.2, 1.3], "rotor_inertia": [2.0] * 3}
    robot = replace(robot, bounds={"own": {"lower": lower, "upper": upper}})
    bounds = read_bounds(robot, "own")
    box = bounds.box([ViscousFriction(2), RotorInertia(0), ViscousFriction(0)])
    assert box[30:].tolist() == [[0.3, 1.3], [0.0, 2.0], [0.1, 1.1]]
    with pytest.raises(RobotError, match="Fc of coulomb_friction") as caught:
        bounds.box([ViscousFriction(0), CoulombFriction(0)])
    assert "friction_coulomb" in str(caught.value)


@pytest.mark.parametrize("group", ["loos", "geometry", "total_mass", ""])
def test_unknown_group_is_refused(group: str) -> None:
    with pytest.raises(RobotError, match="no bounds") as caught:
        read_bounds(load_robot("3r"), group)
    assert caught.value.available == ["loose", "normal", "tight", "from-robot", "wide", "none"]


def test_robot_without_bounds_is_refused() -> None:
    with pytest.raises(RobotError, match="no bounds") as caught:
        read_bounds(load_robot("ur10e"), "normal")
    assert caught.value.available == ["from-robot", "wide", "none"]


NORMAL = "normal"
BAD = {
    "crossed mass": (
        {(NORMAL, "upper", "mass", 1): -1.0},
        "mass of link 2: the bounds are crossed",
    ),
    "equal mass": ({(NORMAL, "upper", "mass", 2): 0.0}, "mass of link 3: the bounds are equal"),
    "crossed com": ({(NORMAL, "lower", "com", 0, 2): 0.3}, "com of link 1: the bounds are crossed"),
    "no mass": ({(NORMAL, "lower", "mass"): ...}, "`lower` has no 'mass'"),
    "no lower": ({(NORMAL, "lower"): ...}, "must have `lower` and `upper`"),
    "a number": ({(NORMAL,): 1.0}, "must have `lower` and `upper`"),
    "wrong size": ({(NORMAL, "lower", "mass"): [0.0, 0.0]}, "wrong size"),
    "ragged": ({(NORMAL, "upper", "com", 1): [1.0]}, "not numbers"),
    "nan": ({(NORMAL, "upper", "mass", 1): NAN}, "not all finite"),
    "friction on one side": (
        {(NORMAL, "lower", "friction_viscous"): [0.0] * 3},
        "`upper` has no 'friction_viscous'",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_bounds_are_refused(case: str) -> None:
    changes, said = BAD[case]
    with pytest.raises(RobotError, match=said) as caught:
        read_bounds(with_bounds(changes), NORMAL)
    assert "3r" in str(caught.value)
    # The other groups are none the worse.
    assert read_bounds(with_bounds(changes), "tight").mass.shape == (3, 2)


def test_total_mass() -> None:
    assert read_total_mass(load_robot("3r")) is None
    assert read_total_mass(with_bounds({("total_mass",): [13, 18.5]})) == (13.0, 18.5)


@pytest.mark.parametrize("value", [[18, 13], [5, 5], [1.0], 5.0, [0, NAN], [0, INF], ["a", "b"]])
def test_bad_total_mass_is_refused(value: object) -> None:
    with pytest.raises(RobotError, match="total_mass"):
        read_total_mass(with_bounds({("total_mass",): value}))
