"""Margins, reasons and degrees: the report's arms by hand, bodies and non-bodies at random."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from tests.arms import consistent_parameters
from torchid.effects.friction import TorqueOffset, ViscousFriction
from torchid.feasibility.conditions import Conditions, physics_only
from torchid.feasibility.margins import (
    LINK_CONDITIONS,
    Feasibility,
    feasibility,
    inertia_eigenvalues,
    kinds,
)
from torchid.feasibility.sets import ParameterSets, nominal_set
from torchid.robot.inertia import InertialParameters, move
from torchid.robot.library import load_robot
from torchid.robot.placement import pose, roll_pitch_yaw

MASS, EIGENVALUE, TRIANGLE, COM_X, COM_Y, COM_Z, SHAPE = range(7)


def sets_of(
    parameters: InertialParameters, values: Tensor | None = None, effects: tuple = ()
) -> ParameterSets:
    count = parameters.pi.shape[0]
    values = torch.zeros(count, 0, dtype=torch.float64) if values is None else values
    return ParameterSets(tuple(f"p_{k}" for k in range(count)), parameters, effects, values)


def one_link(
    mass: float, com: tuple[float, ...] = (0, 0, 0), inertia: tuple[float, ...] = (1, 0, 0, 1, 0, 1)
) -> ParameterSets:
    return sets_of(
        InertialParameters.from_com(
            torch.tensor([[mass]], dtype=torch.float64),
            torch.tensor([[com]], dtype=torch.float64),
            torch.tensor([[inertia]], dtype=torch.float64),
        )
    )


def physics(sets: ParameterSets) -> Feasibility:
    return feasibility(sets, physics_only(sets.parameters.pi.shape[1]))


def random_parameters(seed: int, batch: int, n: int) -> InertialParameters:
    """Bodies, bent by noise: some of them are none any more."""
    g = torch.Generator().manual_seed(seed)
    pi = consistent_parameters(n, seed, (batch,)).pi
    noise = torch.randn(pi.shape, generator=g, dtype=pi.dtype)
    share = 0.5 * torch.rand(batch, 1, 1, generator=g, dtype=pi.dtype)
    return InertialParameters(pi + share * noise * pi.abs().mean((0, 1)))


# ---- the report's arms ----------------------------------------------------------------------


def test_margins_of_table_3_4_by_hand() -> None:
    """Barycentric tensors with NumPy from the printed J, m and c (-1.58e-2, -6.3e-3, -1e-3)."""
    robot = load_robot("kuka_lwr4")
    found = physics(nominal_set(robot))
    pi = robot.parameters.pi.numpy()
    for link, (m, mx, my, mz, xx, xy, xz, yy, yz, zz) in enumerate(pi):
        c = np.array([mx, my, mz]) / m
        j = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        values = np.linalg.eigvalsh(j - m * (c @ c * np.eye(3) - np.outer(c, c)))
        row = found.margins[0, link]
        assert float(row[MASS]) == m
        assert math.isclose(float(row[EIGENVALUE]), values[0], rel_tol=1e-9, abs_tol=1e-14)
        triangle = values.sum() / 2 - values[2]
        assert math.isclose(float(row[TRIANGLE]), triangle, rel_tol=1e-9, abs_tol=1e-14)
    assert float(found.margins[0, 2, EIGENVALUE]) == pytest.approx(-1.58e-2, rel=5e-3)
    assert float(found.margins[0, 3, EIGENVALUE]) == pytest.approx(-6.3e-3, rel=1e-2)
    assert float(found.margins[0, 6, TRIANGLE]) == pytest.approx(-1.0e-3, rel=5e-2)


# ---- properties -----------------------------------------------------------------------------


@settings(max_examples=40)
@given(seed=st.integers(0, 2**31), n=st.integers(1, 7))
def test_signs_of_margins_are_the_label(seed: int, n: int) -> None:
    g = torch.Generator().manual_seed(seed)
    parameters = random_parameters(seed, 30, n)
    low = -0.3 * torch.rand(n, 3, 1, generator=g, dtype=torch.float64)
    asked = replace(
        physics_only(n),
        com_box=torch.cat([low, -low], -1),
        total_mass=torch.tensor([2.0 * n, 5.0 * n], dtype=torch.float64),
        round_axes=torch.ones(n, 3, dtype=torch.float64),
        round_radius=torch.full((n,), 0.3, dtype=torch.float64),
    )
    values = torch.randn(30, 2, generator=g, dtype=torch.float64)
    sets = sets_of(parameters, values, (ViscousFriction(0), TorqueOffset(0)))
    found = feasibility(sets, asked)
    every = torch.cat(
        [found.margins.flatten(1), found.total_mass.unsqueeze(-1), found.coefficients], -1
    )
    smallest = every.amin(-1)
    assert bool((smallest.abs() > 1e-12).all())  # none is on the boundary, so signs decide
    assert torch.equal(found.feasible, smallest > 0)
    assert torch.equal(found.degree > 0, found.feasible)
    for k in range(30):
        assert (found.reasons(k) == ()) == bool(found.feasible[k])
    assert torch.equal(found.degree.sign(), smallest.sign())


@settings(max_examples=30)
@given(seed=st.integers(0, 2**31))
def test_margins_agree_with_the_pseudo_inertia(seed: int) -> None:
    """Positive mass and positive second moments, exactly when the pseudo-inertia is positive
    definite (Wensing et al. 2018)."""
    parameters = random_parameters(seed, 100, 3)
    parameters.pi[:10, :, 0] *= -1
    found = physics(sets_of(parameters))
    body = ~found.violated[..., [MASS, EIGENVALUE, TRIANGLE]].any(-1)
    consistency = parameters.consistency_margin()
    clear = consistency.abs() > 1e-12
    assert torch.equal(body[clear], (consistency > 0)[clear])


@settings(max_examples=30)
@given(seed=st.integers(0, 2**31))
def test_triangle_is_the_stronger_condition(seed: int) -> None:
    """The smallest eigenvalue of a tensor is the sum of its two smallest second moments, so it is
    at least twice the triangle's margin."""
    margins = physics(sets_of(random_parameters(seed, 100, 2))).margins
    scale = margins.abs().amax()
    assert bool((margins[..., EIGENVALUE] >= 2 * margins[..., TRIANGLE] - 1e-12 * scale).all())
    violated = physics(sets_of(random_parameters(seed, 100, 2))).violated
    assert not bool((violated[..., EIGENVALUE] & ~violated[..., TRIANGLE]).any())


@settings(max_examples=30)
@given(seed=st.integers(0, 2**31), scale=st.floats(1e-3, 1e3), length=st.floats(0.1, 10.0))
def test_degrees_do_not_depend_on_units(seed: int, scale: float, length: float) -> None:
    parameters = random_parameters(seed, 20, 4)
    powers = torch.tensor([0.0] + [1.0] * 3 + [2.0] * 6, dtype=torch.float64)
    box = torch.tensor([-0.2, 0.2], dtype=torch.float64).repeat(4, 3, 1)
    one = feasibility(sets_of(parameters), replace(physics_only(4), com_box=box))
    other = feasibility(
        sets_of(InertialParameters(scale * parameters.pi * length**powers)),
        replace(physics_only(4), com_box=length * box),
    )
    torch.testing.assert_close(other.degrees, one.degrees, rtol=1e-8, atol=1e-9)
    assert torch.equal(other.violated, one.violated)


@settings(max_examples=30)
@given(seed=st.integers(0, 2**31), angles=st.lists(st.floats(-3, 3), min_size=3, max_size=3))
def test_inertia_margins_do_not_depend_on_the_frame(seed: int, angles: list[float]) -> None:
    """Turned and moved axes: the same body."""
    parameters = random_parameters(seed, 20, 2)
    transform = pose(roll_pitch_yaw(angles), torch.tensor([0.3, -0.2, 0.1], dtype=torch.float64))
    moved = InertialParameters(move(parameters.pi, transform))
    one, other = physics(sets_of(parameters)), physics(sets_of(moved))
    torch.testing.assert_close(other.margins[..., :3], one.margins[..., :3], rtol=1e-8, atol=1e-9)


def test_sets_of_a_batch_do_not_depend_on_each_other() -> None:
    parameters = random_parameters(4, 8, 3)
    together = physics(sets_of(parameters))
    for k in range(8):
        alone = physics(sets_of(InertialParameters(parameters.pi[k : k + 1])))
        torch.testing.assert_close(alone.margins[0], together.margins[k], rtol=1e-12, atol=1e-15)
        assert alone.reasons(0) == together.reasons(k)


# ---- on and around the boundary --------------------------------------------------------------


@pytest.mark.parametrize(
    ("mass", "reasons"), [(1.0, ()), (0.0, ("mass_1",)), (-0.0, ("mass_1",)), (-1.0, ("mass_1",))]
)
def test_masses(mass: float, reasons: tuple[str, ...]) -> None:
    found = physics(one_link(mass))
    assert found.reasons(0) == reasons
    assert float(found.margins[0, 0, MASS]) == mass
    assert float(found.degree.sign()) == (mass > 0) - (mass < 0)


def test_all_zero() -> None:
    found = physics(sets_of(InertialParameters(torch.zeros(1, 2, 10, dtype=torch.float64))))
    assert found.reasons(0) == ("mass_1", "inertia_1", "mass_2", "inertia_2")
    assert float(found.degree) == 0.0


@pytest.mark.parametrize(
    ("inertia", "how"),
    [
        ((1, 0, 0, 1, 0, 1), None),
        ((1, 0, 0, 1, 0, 1.999), None),
        ((1, 0, 0, 1, 0, 2), "triangle"),  # a flat plate: on the boundary
        ((1, 0, 0, 1, 0, 2.5), "triangle"),
        ((0, 0, 0, 1, 0, 1), "eigenvalue"),  # a rod
        ((-1, 0, 0, 1, 0, 1), "eigenvalue"),
        ((1, 1.5, 0, 1, 0, 1), "eigenvalue"),
    ],
)
def test_inertias(inertia: tuple[float, ...], how: str | None) -> None:
    found = physics(one_link(1.0, inertia=inertia))
    assert found.inertia_violation(0, 0) == how
    assert found.reasons(0) == (() if how is None else ("inertia_1",))


def box_only(low: float, high: float) -> Conditions:
    return replace(
        physics_only(1), com_box=torch.tensor([low, high], dtype=torch.float64).repeat(1, 3, 1)
    )


def test_centre_on_a_face_is_inside_and_beyond_it_is_named() -> None:
    asked = box_only(-0.1, 0.3)
    on = feasibility(one_link(0.7, (0.3, -0.1, 0.1)), asked)
    assert on.reasons(0) == ()
    assert abs(float(on.degree)) < 1e-9
    out = feasibility(one_link(0.7, (0.31, -0.1, -0.12)), asked)
    assert out.reasons(0) == ("com_1x", "com_1z")
    assert float(out.margins[0, 0, COM_X]) == pytest.approx(-0.01)
    assert float(out.degrees[0, 0, COM_Z]) == pytest.approx(-0.1)


def test_cylinder_counts_two_axes_and_sphere_three() -> None:
    cylinder = replace(
        physics_only(1),
        round_axes=torch.tensor([[1.0, 0.0, 1.0]], dtype=torch.float64),
        round_radius=torch.tensor([0.1], dtype=torch.float64),
    )
    for com, margin in (((0.06, 5.0, 0.0), 0.04), ((0.06, 0.0, 0.08), 0.0), ((0.3, 0, 0.4), -0.4)):
        found = feasibility(one_link(2.0, com), cylinder)
        assert float(found.margins[0, 0, SHAPE]) == pytest.approx(margin, abs=1e-12)
        assert float(found.degrees[0, 0, SHAPE]) == pytest.approx(10 * margin, abs=1e-11)
        assert found.reasons(0) == (("shape_1",) if margin < 0 else ())
    sphere = replace(
        physics_only(1),
        round_centre=torch.tensor([[0.0, 5.0, 0.0]], dtype=torch.float64),
        round_axes=torch.ones(1, 3, dtype=torch.float64),
        round_radius=torch.tensor([0.1], dtype=torch.float64),
    )
    inside, outside = (feasibility(one_link(2.0, (0, y, 0)), sphere) for y in (5.05, 5.2))
    assert float(inside.margins[0, 0, SHAPE]) == pytest.approx(0.05)
    assert outside.reasons(0) == ("shape_1",)


@pytest.mark.parametrize(
    ("interval", "margin", "degree"),
    [
        ((1.0, 4.0), 1.0, 2 / 3),
        ((2.0, 4.0), 0.0, 0.0),
        ((3.0, 4.0), -1.0, -2.0),
        ((0.0, 1.0), -1.0, -2.0),
        ((1.0, math.inf), 1.0, 1.0),
        ((4.0, math.inf), -2.0, -0.5),
        ((-math.inf, 1.0), -1.0, -1.0),
        ((0.0, math.inf), 2.0, math.inf),
    ],
)
def test_total_mass(interval: tuple[float, float], margin: float, degree: float) -> None:
    found = feasibility(one_link(2.0), conditions_of_total(interval))
    assert float(found.total_mass) == pytest.approx(margin)
    assert float(found.total_mass_degree) == pytest.approx(degree)
    assert found.reasons(0) == (("total_mass",) if margin < 0 else ())


def conditions_of_total(interval: tuple[float, float]) -> Conditions:
    return replace(physics_only(1), total_mass=torch.tensor(interval, dtype=torch.float64))


def test_box_open_to_one_side() -> None:
    asked = box_only(0.1, math.inf)
    assert feasibility(one_link(1.0, (0.2, 0.2, 0.2)), asked).reasons(0) == ()
    out = feasibility(one_link(1.0, (0.2, 0.0, 0.2)), asked)
    assert out.reasons(0) == ("com_1y",)
    assert float(out.degree) == pytest.approx(-1.0)


def test_what_is_not_asked_for_is_infinite() -> None:
    found = physics(one_link(2.0))
    assert bool(found.margins[0, 0, [COM_X, COM_Y, COM_Z, SHAPE]].isinf().all())
    assert float(found.total_mass) == float(found.total_mass_degree) == math.inf
    assert len(LINK_CONDITIONS) == found.margins.shape[-1]


# ---- coefficients ---------------------------------------------------------------------------


def with_coefficients(values: list[float]) -> Feasibility:
    """Fv of joints 1 and 12, F0 of joint 1 on a set that is feasible otherwise."""
    effects = (ViscousFriction(0), ViscousFriction(11), TorqueOffset(0))
    sets = one_link(1.0)
    return physics(sets_of(sets.parameters, torch.tensor([values], dtype=torch.float64), effects))


@pytest.mark.parametrize(
    ("values", "reasons"),
    [
        ([0.1, 0.3, -5.0], ()),
        ([0.0, 0.3, 0.0], ()),
        ([0.1, -0.3, 0.0], ("Fv_12",)),
        ([-0.1, -0.3, 0.0], ("Fv_1", "Fv_12")),
        ([math.nan, 0.3, 0.0], ("Fv_1",)),
        ([math.inf, 0.3, 0.0], ("Fv_1",)),
        ([0.1, 0.3, math.nan], ("F0_1",)),
        ([0.1, 0.3, -math.inf], ("F0_1",)),
    ],
)
def test_coefficients(values: list[float], reasons: tuple[str, ...]) -> None:
    found = with_coefficients(values)
    assert found.reasons(0) == reasons
    assert bool(found.feasible) == (reasons == ())


def test_degree_of_a_coefficient_is_its_share_of_its_kind() -> None:
    found = with_coefficients([0.1, -0.3, 7.0])
    torch.testing.assert_close(
        found.coefficient_degrees[0, :2], torch.tensor([0.5, -1.5], dtype=torch.float64)
    )
    assert float(found.coefficient_degrees[0, 2]) == math.inf
    assert found.coefficient_names == ("Fv1", "Fv12", "F01")


# ---- numbers that are none ------------------------------------------------------------------


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("column", range(10))
def test_sets_that_are_not_finite_are_infeasible_and_alone(bad: float, column: int) -> None:
    parameters = consistent_parameters(3, 1, (3,))
    expected = physics(sets_of(parameters))
    pi = parameters.pi.clone()
    pi[1, 2, column] = bad
    found = physics(sets_of(InertialParameters(pi)))
    assert found.feasible.tolist() == [True, False, True]
    assert not bool(found.degree[1] > 0)
    assert any(reason.endswith("_3") or "_3" in reason for reason in found.reasons(1))
    for k in (0, 2):
        torch.testing.assert_close(found.margins[k], expected.margins[k], rtol=1e-12, atol=1e-12)
        torch.testing.assert_close(found.degrees[k], expected.degrees[k], rtol=1e-12, atol=1e-12)
    # The other links of the bad set keep their margins and are not blamed.
    torch.testing.assert_close(
        found.margins[1, :2], expected.margins[1, :2], rtol=1e-12, atol=1e-12
    )
    assert not bool(found.violated[1, :2].any())


def test_eigenvalues_of_what_is_not_finite() -> None:
    pi = consistent_parameters(2, 1).pi
    pi[0, 4] = math.nan
    values = inertia_eigenvalues(InertialParameters(pi))
    assert bool(values[0].isnan().all())
    assert bool(values[1].isfinite().all())


def test_kinds() -> None:
    assert kinds(("inertia_3", "com_7z", "total_mass", "Fv_6")) == {
        "inertia", "com", "total_mass", "Fv",
    }  # fmt: skip
    assert kinds(()) == frozenset()
