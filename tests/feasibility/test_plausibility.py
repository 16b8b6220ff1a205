"""Findings beyond feasibility, on uniform bodies whose answers are known."""

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.arms import arm, consistent_parameters
from torchid.feasibility.bounds import Bounds
from torchid.feasibility.plausibility import (
    bodies,
    own_inertial_findings,
    plausibility,
    search_names,
)
from torchid.feasibility.sets import ParameterSets, nominal_set
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot
from torchid.robot.model import Limits
from torchid.robot.shapes import LinkShapes, OwnInertial

SIDES = torch.tensor([[0.1, 0.1, 0.3], [0.12, 0.2, 0.1], [0.1, 0.15, 0.1]], dtype=torch.float64)


def uniform_boxes(density=1000.0, sides=SIDES, com=None):
    """Parameters of three uniform boxes (the 3R's links)."""
    mass = density * sides.prod(-1)
    square = sides.square()
    i = mass.unsqueeze(-1) / 12 * (square.sum(-1, keepdim=True) - square)
    zero = torch.zeros(3, dtype=torch.float64)
    inertia = torch.stack([i[:, 0], zero, zero, i[:, 1], zero, i[:, 2]], -1)
    return InertialParameters.from_com(
        mass, torch.zeros(3, 3, dtype=torch.float64) if com is None else com, inertia
    )


def findings(parameters, robot=None, **more):
    robot = load_robot("3r") if robot is None else robot
    pi = parameters.pi
    sets = ParameterSets(
        ("one",), InertialParameters(pi.unsqueeze(0)), (), torch.zeros(1, 0, dtype=torch.float64)
    )
    return plausibility(robot, sets, **more)[0]


def kinds(found):
    return sorted(((f.what, f.link) for f in found), key=str)


def shapes_of(boxes, volumes=None):
    size = (boxes[..., 1] - boxes[..., 0]).prod(-1)
    return LinkShapes(boxes, size if volumes is None else volumes, ("collision",) * len(boxes))


BOXES = torch.stack([-SIDES / 2, SIDES / 2], -1)


def test_solid_boxes_of_water_are_plausible():
    assert findings(uniform_boxes()) == ()
    assert findings(uniform_boxes(), shapes=shapes_of(BOXES)) == ()


@pytest.mark.parametrize("name", ["3r", "3r_friction", "kuka_lwr4", "kuka_lwr4_friction"])
def test_the_papers_arms_have_no_findings(name):
    robot = load_robot(name)
    sets = nominal_set(robot)
    assert plausibility(robot, sets) == ((),)


@settings(max_examples=30)
@given(st.lists(st.floats(0.01, 1), min_size=3, max_size=3), st.floats(10, 20000))
def test_a_uniform_ellipsoid_is_found_back(semi_axes, density):
    semi = torch.tensor(semi_axes, dtype=torch.float64)
    mass = density * 4 / 3 * math.pi * semi.prod()
    square = semi.square()
    i = mass / 5 * (square.sum() - square)
    inertia = torch.stack([i[0], i.new_zeros(()), i.new_zeros(()), i[1], i.new_zeros(()), i[2]])
    own = bodies(
        InertialParameters.from_com(
            mass.reshape(1, 1), torch.zeros(1, 1, 3, dtype=torch.float64), inertia.expand(1, 1, 6)
        )
    )
    torch.testing.assert_close(own.semi_axes[0, 0], semi.sort().values, rtol=1e-5, atol=1e-9)
    assert float(own.density) == pytest.approx(density, rel=1e-4)
    gyration = (i.max() / mass).sqrt()
    assert float(own.gyration) == pytest.approx(float(gyration))


@pytest.mark.parametrize(("density", "limit"), [(30.0, 100.0), (20000.0, 12000.0)])
def test_density(density, limit):
    found = findings(uniform_boxes(density), shapes=shapes_of(BOXES))
    # The ellipsoid with a box's inertia has 4/3 pi (5/12)^1.5 = 1.13 of its volume.
    assert [k for k in kinds(found) if k[0] == "density"] == [("density", i) for i in (1, 2, 3)]
    own = [f for f in found if f.what == "shape_density"]
    assert [f.link for f in own] == [1, 2, 3]
    assert own[0].value == pytest.approx(density)
    assert own[0].threshold == limit
    assert "kg/m^3" in own[0].sentence


def test_inertia_that_the_box_cannot_hold():
    # Twice the size in y: (2 l)^2 / 12 > l^2 / 4.
    wide = SIDES.clone()
    wide[1, 1] *= 2
    found = findings(uniform_boxes(sides=wide), shapes=shapes_of(BOXES))
    assert kinds(found) == [("inertia_size", 2)]
    assert found[0].value == pytest.approx(0.4 / 12**0.5)
    assert found[0].threshold == pytest.approx(0.1)
    assert " y;" in found[0].sentence
    # 1.7 times: less than sqrt(3), so some body in the box has it, not a uniform one.
    wide[1, 1] = 1.7 * SIDES[1, 1]
    assert findings(uniform_boxes(sides=wide), shapes=shapes_of(BOXES)) == ()
    # But not where the centre of mass is at a face.
    com = torch.zeros(3, 3, dtype=torch.float64)
    com[1, 1] = 0.09
    found = findings(uniform_boxes(sides=wide, com=com), shapes=shapes_of(BOXES))
    assert kinds(found) == [("inertia_size", 2)]
    assert found[0].threshold == pytest.approx((0.19 * 0.01) ** 0.5)


def test_inertia_larger_than_a_link_without_shape():
    # 8 kg of 1.2 m in a link of 0.22 m.
    sides = SIDES.clone()
    sides[1] = torch.tensor([0.1, 1.6, 0.05], dtype=torch.float64)
    found = findings(uniform_boxes(sides=sides))
    assert kinds(found) == [("inertia_size", 2)]
    assert found[0].value == pytest.approx(0.8 * (5 / 3) ** 0.5)


def test_a_point_mass_is_infinitely_dense():
    pi = uniform_boxes().pi.clone()
    pi[1] = torch.tensor([1.0, 0, 0, 0, 0, 0, 0, 0, 0, 0], dtype=torch.float64)
    found = findings(InertialParameters(pi))
    density = next(f for f in found if f.what == "density")
    assert density.value == math.inf


def test_com_distance():
    com = torch.zeros(3, 3, dtype=torch.float64)
    com[0, 0] = 0.35
    found = findings(uniform_boxes(com=com))
    assert kinds(found) == [("com_distance", 1)]
    assert found[0].value == pytest.approx(0.35)
    assert found[0].threshold == pytest.approx(0.3)
    com[0, 0] = 0.25
    assert findings(uniform_boxes(com=com)) == ()
    found = findings(uniform_boxes(com=com), shapes=shapes_of(BOXES))
    assert kinds(found) == [("com_distance", 1)]
    assert found[0].value == pytest.approx(0.2)


def test_parameters_on_and_outside_bounds():
    parameters = uniform_boxes()
    sets = ParameterSets(
        ("a",), InertialParameters(parameters.pi[None]), (), torch.zeros(1, 0, dtype=torch.float64)
    )
    wide = torch.tensor([-1.0, 1.0], dtype=torch.float64)
    mass = torch.stack([parameters.mass / 2, parameters.mass * 2], -1)
    mass[1, 1] = parameters.mass[1]
    com = wide.repeat(3, 3, 1)
    inertia = wide.repeat(3, 6, 1)
    inertia[2, 3, 0] = 0.5
    found = findings(parameters, bounds=Bounds("b", mass, com, inertia, {}))
    assert [(f.what, f.link) for f in found] == [("bound", 2), ("bound", 3)]
    assert "m2 = 2.4 is on its upper bound" in found[0].sentence
    assert "I3yy" in found[1].sentence
    assert "outside its lower bound" in found[1].sentence
    assert len(search_names(sets)) == 30


def test_an_arm_too_heavy_for_its_joints():
    robot = load_robot("3r")
    strong = Limits(torque=torch.tensor([[-1000.0, 1000.0]] * 3, dtype=torch.float64))
    weak = Limits(
        torque=torch.tensor(
            [[-1000.0, 1000.0], [-1000.0, 1000.0], [-0.01, 0.01]], dtype=torch.float64
        )
    )
    com = torch.full((3, 3), 0.05, dtype=torch.float64)
    parameters = uniform_boxes(com=com)
    assert findings(parameters, replace(robot, limits=strong)) == ()
    found = findings(parameters, replace(robot, limits=weak))
    assert kinds(found) == [("gravity_load", 3)]
    # At most the weight times the distance of the centre of mass from the axis, and nearly that.
    z = robot.parameters.com.new_tensor([0.15 + 0.05, 0.05]).norm()
    most = float(9.81 * parameters.mass[2] * z / 0.01)
    assert 0.95 * most < found[0].value <= most * (1 + 1e-9)


def test_many_sets_are_told_apart():
    robot = load_robot("3r")
    pi = torch.stack([uniform_boxes().pi, uniform_boxes(30.0).pi])
    sets = ParameterSets(
        ("a", "b"), InertialParameters(pi), (), torch.zeros(2, 0, dtype=torch.float64)
    )
    first, second = plausibility(robot, sets)
    assert first == ()
    assert [f.what for f in second] == ["density"] * 3


@pytest.mark.parametrize("name", ["mixed", "kuka_lwr4"])
def test_numbers_that_are_not_finite_do_no_harm(name):
    robot = arm(name)
    pi = consistent_parameters(robot.n, 0, (2,)).pi
    pi[0, 0] = torch.nan
    sets = ParameterSets(
        ("a", "b"), InertialParameters(pi), (), torch.zeros(2, 0, dtype=torch.float64)
    )
    both = plausibility(robot, sets)
    alone = sets.part([1])
    assert both[1] == plausibility(robot, alone)[0]


def own(inertia, mass=1.0, moving=0, alone=False):
    return OwnInertial("hand", moving, alone, mass, torch.tensor(inertia, dtype=torch.float64))


@pytest.mark.parametrize(
    ("inertial", "what", "said"),
    [
        (own([1.0, 0, 0, 1, 0, 3]), "own_triangle", "by 50 %"),
        (own([1.0, 2, 0, 1, 0, 2]), "own_eigenvalue", "eigenvalue -1 "),
        (own([0.0, 0, 0, 0, 0, 1]), "own_triangle", "triangle"),
        (own([1.0, 0, 0, 1, 0, 1], mass=-2.0), "own_mass", "-2 kg"),
    ],
)
def test_an_inertial_behind_a_merge(inertial, what, said):
    (found,) = own_inertial_findings((inertial,))
    assert (found.what, found.link, found.name) == (what, 1, "hand")
    assert said in found.sentence
    assert "'hand' (merged into link 1)" in found.sentence


def test_own_inertials_that_are_bodies_or_checked_as_links():
    good = (
        own([1.0, 0, 0, 1, 0, 2]),
        own([0.0] * 6),
        own([0.0] * 6, mass=0.0),
        own([1.0, 0, 0, 1, 0, 9], alone=True),
    )
    assert own_inertial_findings(good) == ()
    (found,) = own_inertial_findings((own([1.0, 0, 0, 1, 0, 9], moving=None),))
    assert found.link is None
    assert "not part of a moving link" in found.sentence
