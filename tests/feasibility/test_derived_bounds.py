"""Bounds from a robot's description: known answers, and bodies sampled in the boxes."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.arms import arm, consistent_parameters
from torchid.errors import RobotError, TorchidError
from torchid.feasibility.derived_bounds import (
    NAME,
    bounds_notes,
    derive_bounds,
    inertia_bounds,
    named_bounds,
    open_bounds,
)
from torchid.feasibility.sets import nominal_set
from torchid.robot.inertia import InertialParameters, six
from torchid.robot.library import load_robot
from torchid.robot.shapes import LinkShapes, link_lengths, typical_bodies

NOWHERE = torch.full((3, 2), torch.nan, dtype=torch.float64)


def shapes_of(boxes):
    known = boxes.isfinite().all(-1).all(-1).tolist()
    volumes = (boxes[..., 1] - boxes[..., 0]).prod(-1)
    return LinkShapes(boxes, volumes, tuple("collision" if k else None for k in known))


@settings(max_examples=30)
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


def test_a_massless_link_is_named():
    robot = load_robot("3r")
    pi = consistent_parameters(3, 0).pi
    pi[1] = 0.0
    with pytest.raises(RobotError, match=r"link 2 \('link_2'\)"):
        derive_bounds(robot.with_parameters(InertialParameters(pi)))


def test_bounds_without_parameters_hold_a_known_arm():
    """The LWR IV+ and the 3R, whose parameters the bounds do not read."""
    for name in ("kuka_lwr4", "3r"):
        known = load_robot(name)
        robot = replace(known, parameters=None)
        wide, none = (open_bounds(robot, wide=w) for w in (True, False))
        own = known.parameters
        for bounds in (wide, none):
            assert bool((bounds.mass[:, 0] == 0).all())
            assert bool((own.mass < bounds.mass[:, 1]).all())
            low, high = bounds.com.unbind(-1)
            assert bool(((low < own.com) & (own.com < high)).all())
        assert bool((none.mass[:, 1] > wide.mass[:, 1]).all())
        assert bool((none.com[..., 1] > wide.com[..., 1]).all())
    for name in ("wide", "none"):
        assert torch.equal(named_bounds(known, name).mass, named_bounds(robot, name).mass)


def test_a_group_of_the_robots_own_may_have_such_a_name():
    robot = load_robot("3r")
    own = replace(robot, bounds={**robot.bounds, "wide": robot.bounds["normal"]})
    assert torch.equal(named_bounds(own, "wide").mass, named_bounds(robot, "normal").mass)


def test_bounds_of_a_link_with_a_shape_are_its_boxs(tmp_path):
    """A box of 0.2 x 0.1 x 0.4 m whose centre is off the joint."""
    robot = load_robot(boxed(tmp_path))
    bounds = open_bounds(robot, wide=True)
    expected = torch.tensor([[-0.15, 0.15], [-0.1, 0.1], [-0.05, 0.45]]).double()
    torch.testing.assert_close(bounds.com[0], expected)
    torch.testing.assert_close(
        bounds.mass[0], torch.tensor([0.0, 12000 * 0.008], dtype=torch.float64)
    )


def test_typical_bodies_are_those_of_a_simulator_that_knows_the_density(tmp_path):
    """MuJoCo's inertia of the same box at 1000 kg/m^3."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint/><geom type='box' size='0.1 0.05 0.2' pos='0 0 0.2' "
        "density='1000'/></body></worldbody></mujoco>"
    )
    own = typical_bodies(load_robot(boxed(tmp_path)))
    assert float(own.mass[0]) == pytest.approx(model.body_mass[1])
    assert own.com[0].tolist() == pytest.approx([0, 0, 0.2])
    about = sorted(own.inertia_about_com[0, [0, 3, 5]].tolist())
    assert about == pytest.approx(sorted(model.body_inertia[1]))


def test_typical_bodies_without_shapes_are_bars_between_the_joints():
    robot = load_robot("ur10e")
    own = typical_bodies(robot)
    assert own.mass.tolist() == pytest.approx((10 * link_lengths(robot)).tolist())
    # The upper arm: 0.6127 m along x, and a radius of sqrt(10 / (1000 pi)), which rounds the ends.
    heavy, square = 6.127, 10 / (1000 * 3.141592653589793)
    across = heavy * (0.6127**2 / 12 + square / 2)
    expected = [heavy * square / 2, 0, 0, across, 0, across]
    assert own.inertia_about_com[1].tolist() == pytest.approx(expected, abs=1e-12)
    assert bool((own.consistency_margin() > 0).all())


def boxed(folder):
    path = folder / "arm.urdf"
    path.write_text(
        "<robot name='boxed'><link name='base'/><link name='a'><collision>"
        "<origin xyz='0 0 0.2'/><geometry><box size='0.2 0.1 0.4'/></geometry></collision></link>"
        "<joint name='j' type='revolute'><parent link='base'/><child link='a'/>"
        "<axis xyz='0 1 0'/><limit lower='-1' upper='1' velocity='1' effort='9'/></joint></robot>"
    )
    return path
