"""The least loss of any feasible set: the report's arms, closed forms, another modelling tool."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
import torch

from tests.arms import arm, consistent_parameters
from torchid.design.bodies import triangle
from torchid.extraction.convex.certificate import (
    _Question,
    certificate,
    certificate_where_possible,
    loss_matrix,
)
from torchid.extraction.convex.conic import Rows, matrix_of, minimise
from torchid.extraction.convex.sets import ConvexSets, convex_sets
from torchid.extraction.problem import Problem, extraction_problem, two_step
from torchid.feasibility.bounds import read_bounds
from torchid.feasibility.conditions import Conditions, conditions, physics_only
from torchid.feasibility.margins import feasibility
from torchid.feasibility.sets import nominal_set
from torchid.identification.base_parameters import base_parameters

NO_BOXES = {"com_bounds": False, "inertia_bounds": False, "with_conditions": False}
BOXES = {"inertia_bounds": False, "with_conditions": False}


@lru_cache
def problem(name: str, group: str = "normal", total_mass: tuple[float, float] | None = None):
    robot = arm(name)
    sets = nominal_set(robot)
    base = base_parameters(robot, sets.effects)
    target = two_step(base, sets.effects, base.project(sets.vector[0]))
    asked = conditions(robot, total_mass=total_mass)
    return extraction_problem(robot, target, read_bounds(robot, group), asked)


def with_conditions(given: Problem, asked: Conditions) -> Problem:
    return replace(given, conditions=asked)


def distance(body: ConvexSets, x: np.ndarray) -> float:
    """The smallest margin of the rows at x: negative outside."""
    margins = []
    for row in body.rows:
        s = row.matrix @ np.linalg.solve(body.basis, x - body.origin) + row.offset
        if row.cone == "nonnegative":
            margins.append(s.min())
        elif row.cone == "second_order":
            margins.append(s[0] - np.linalg.norm(s[1:]))
        else:
            margins.append(np.linalg.eigvalsh(matrix_of(s))[0])
    return float(min(margins))


@pytest.mark.parametrize(
    ("group", "total_mass", "options", "phi"),
    [
        ("normal", None, NO_BOXES, 1.031e-4),
        ("normal", None, BOXES, 1.032e-4),
        ("normal", (13.0, 18.0), {"inertia_bounds": False}, 1.035e-4),
        ("tight", None, BOXES, 1.039e-4),
    ],
)
def test_the_reports_seven_axis_arm_has_no_feasible_set(group, total_mass, options, phi) -> None:
    """Minima that an independent program found, with pseudo-inertias of 1e-6 at least."""
    found = certificate(
        problem("kuka_lwr4", group, total_mass), margin=1e-6, explain=False, **options
    )
    assert found.feasible
    assert found.phi_min == pytest.approx(phi, rel=1e-3)
    assert found.phi_min <= found.phi_strict <= found.phi_min * 1.001


@pytest.mark.parametrize("group", ["loose", "normal", "tight"])
@pytest.mark.parametrize("name", ["3r", "3r_friction"])
def test_the_reports_three_axis_arm_has_one(name: str, group: str) -> None:
    given = problem(name, group)
    found = certificate(given)
    assert found.phi_min == 0
    assert found.phi_strict < 1e-18
    assert found.relaxed_active == ()
    assert (found.forcing, found.released, found.conflict) == ((), {}, ())
    assert found.sets is not None
    assert bool(feasibility(found.sets, given.conditions).feasible.all())
    p = found.sets.search_vector[0]
    low, high = given.box.unbind(-1)
    assert bool(((p >= low - 1e-9) & (p <= high + 1e-9)).all())
    assert float(found.sets.parameters.consistency_margin().min()) >= 0.99 * found.strict


@pytest.mark.nightly
def test_inertia_bounds_that_matter_are_bracketed() -> None:
    """The tight group's barycentric bounds cost something: phi_min counts them by a relaxation,
    the set meets them in full."""
    given = problem("kuka_lwr4", "tight")
    without = certificate(given, inertia_bounds=False, explain=False)
    found = certificate(given, explain=False)
    assert without.phi_min * 1.01 < found.phi_min < found.phi_strict < 1.12e-4
    assert "bound_4yy" in found.relaxed_active
    assert found.sets is not None
    p = found.sets.search_vector[0]
    low, high = given.box.unbind(-1)
    assert bool(((p >= low - 1e-9) & (p <= high + 1e-9)).all())


def test_what_forces_the_loss() -> None:
    """Three links of the ground truth have no body: 3 and 4 share base parameters, so that
    freeing one of them frees both."""
    found = certificate(problem("kuka_lwr4"), **NO_BOXES)
    assert set(found.forcing) in ({"inertia_3", "inertia_7"}, {"inertia_4", "inertia_7"})
    assert found.released["inertia_3"] < 0.05 * found.phi_min
    assert found.released["inertia_7"] < found.phi_min * 0.99
    assert all(v <= found.phi_min * (1 + 1e-5) for v in found.released.values())


@pytest.mark.nightly
def test_a_negative_friction_costs_its_square() -> None:
    """Table 3.4's f_v6 = -0.0132; no other parameter can make up for it."""
    rigid = certificate(problem("kuka_lwr4"), explain=False)
    found = certificate(problem("kuka_lwr4_friction"))
    assert found.phi_min - rigid.phi_min == pytest.approx(0.0132**2, rel=1e-5)
    assert found.forcing[0] == "Fv_6"
    assert found.released["Fv_6"] == pytest.approx(rigid.phi_min, rel=1e-5)


def test_coefficients_on_their_bounds_are_no_failure() -> None:
    """The optimum is at zero friction, and the interval is so short that the solver's rounding is
    more than the distance it keeps."""
    given = problem("3r_friction")
    short = given.bounds.coefficients["Fc"].new_tensor([[0.0, 1e-6]]).repeat(3, 1)
    kinds = {**given.bounds.coefficients, "Fc": short}
    bounds = replace(given.bounds, coefficients=kinds)
    values = given.target.values.clone()
    names = given.target.base.names
    values[[names.index(f"Fc{j}") for j in (1, 2, 3)]] = -0.05
    target = two_step(given.target.base, given.target.effects, values)
    found = certificate(extraction_problem(given.robot, target, bounds, given.conditions))
    assert found.feasible
    assert found.phi_min == pytest.approx(3 * 0.05**2, rel=1e-5)
    assert found.sets is not None
    assert float(found.sets.coefficients[0, 3:6].min()) >= 0


def test_a_failed_solver_is_not_taken_for_infeasible(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_Question, "_best", lambda *_: None)
    found, notes = certificate_where_possible(problem("3r"))
    assert not found.feasible
    assert found.conflict == ()
    assert np.isnan(found.phi_min)
    assert "solver failed" in notes[0]


def test_boxes_that_exclude_each_other_are_named() -> None:
    """Table A.5 as printed: c7z in [0.4, 0.6] loose, the link's geometry in [0.1, 0.2]."""
    found = certificate(problem("kuka_lwr4", "loose"))
    assert not found.feasible
    assert found.conflict == ("com_7z",)
    assert found.phi_min == np.inf
    assert found.sets is None
    assert certificate(problem("kuka_lwr4", "loose"), with_conditions=False, explain=False).feasible


def test_a_total_mass_out_of_reach_is_named() -> None:
    assert certificate(problem("3r", "tight", (7.0, 9.0))).conflict == ("total_mass",)


def test_shapes_that_exclude_a_box_are_named() -> None:
    """A sphere about a far point: no interval says so, the proof of infeasibility does."""
    given = problem("3r", "tight")
    none = physics_only(3)
    centre, axes, radius = none.round_centre, none.round_axes, none.round_radius
    centre[1] = torch.tensor([0.3, 0.3, 0.0], dtype=torch.float64)
    axes[1] = 1.0
    radius[1] = 0.1
    asked = Conditions(none.com_box, centre, axes, radius, none.total_mass)
    found = certificate(with_conditions(given, asked))
    assert not found.feasible
    assert "shape_2" in found.conflict
    assert set(found.conflict) <= {"shape_2", "com_2x", "com_2y", "mass_2"}


def test_shapes_are_met() -> None:
    given = with_conditions(problem("3r"), conditions(arm("3r"), shapes=True))
    found = certificate(given)
    assert found.feasible
    assert found.sets is not None
    assert float(feasibility(found.sets, given.conditions).margins[0, :, 6].min()) >= 0


@pytest.mark.parametrize("name", ["3r", "kuka_lwr4"])
@pytest.mark.parametrize("group", ["normal", "tight"])
def test_the_relaxation_leaves_no_set_out(name: str, group: str) -> None:
    """Every row holds at sets within the bounds, whatever the rows are."""
    given = problem(name, group)
    body = convex_sets(given.robot, (), None, given.bounds)
    generator = torch.Generator().manual_seed(5)
    p = given.physical(torch.rand(4000, given.size, generator=generator, dtype=torch.float64))
    # Most random tensors have no body: bring the off-diagonal entries down until some do.
    mass, com, inertia, rest = given.split(p)
    shrink = torch.tensor([1.0, 0.05, 0.05, 1.0, 0.05, 1.0], dtype=torch.float64)
    p = torch.cat([mass, com.flatten(-2), (inertia * shrink).flatten(-2), rest], -1)
    consistent = given.parameters(p).consistency_margin().amin(-1) > 0
    x = given.vector(p[consistent])[:200].numpy()
    assert len(x) > (20 if name == "3r" else 0)
    assert all(distance(body, one) >= -1e-12 for one in x)


@pytest.mark.nightly
def test_the_restriction_lets_no_set_out() -> None:
    """Sets at its edge, in random directions, are within the bounds; the relaxation's are not."""
    given = problem("kuka_lwr4", "tight")
    com = (given.bounds.com.mean(-1)).numpy()
    inside = convex_sets(given.robot, (), None, given.bounds, inside=com)
    relaxed = convex_sets(given.robot, (), None, given.bounds)
    low, high = given.box.unbind(-1)
    left = []
    for seed in range(8):
        row = np.random.default_rng(seed).standard_normal(70)
        row[28:] *= 100
        for body in (inside, relaxed):
            solution, x = body.least(row)
            assert solution.usable
            p = torch.cat(
                [
                    torch.as_tensor(x[:7]),
                    torch.as_tensor((x[7:28].reshape(7, 3) / x[:7, None]).ravel()),
                    _barycentric(x),
                ]
            )
            out = torch.maximum(low - p, p - high)[28:].max()
            if body is inside:
                assert float(out) < 1e-6
            else:
                left.append(float(out))
    assert max(left) > 1e-4


def _barycentric(x: np.ndarray) -> torch.Tensor:
    full = torch.as_tensor(x)
    m, h, j = full[:7], full[7:28].reshape(7, 3), full[28:].reshape(7, 6)
    second = torch.einsum("la,lb->lab", h, h) / m[:, None, None]
    xx, yy, zz = (second[:, k, k] for k in range(3))
    parallel = [yy + zz, -second[:, 0, 1], -second[:, 0, 2], xx + zz, -second[:, 1, 2], xx + yy]
    return (j - torch.stack(parallel, -1)).flatten()


@pytest.mark.parametrize("seed", range(3))
def test_no_set_has_less(seed: int) -> None:
    """Consistent sets around the best one, joined to it by segments that stay feasible."""
    given = problem("kuka_lwr4")
    found = certificate(given, explain=False, **NO_BOXES)
    matrix, offset = loss_matrix(given)
    assert found.sets is not None
    best = found.sets.vector[0].numpy()
    other = consistent_parameters(7, seed).to_paper_order().numpy()
    for share in np.logspace(-6, 0, 13):
        x = (1 - share) * best + share * other
        assert np.sum((matrix @ x + offset) ** 2) >= found.phi_min


def test_another_modelling_tool_agrees() -> None:
    cvxpy = pytest.importorskip("cvxpy")
    given = problem("kuka_lwr4", "normal")
    matrix, offset = loss_matrix(given)
    x = cvxpy.Variable(70)
    asked = []
    for i in range(7):
        xx, xy, xz, yy, yz, zz = (x[28 + 6 * i + k] for k in range(6))
        h, m = x[7 + 3 * i : 10 + 3 * i], x[i]
        asked += [m <= 12]
        for a in range(3):
            low, high = given.bounds.com[i, a].tolist()
            asked += [h[a] >= low * m, h[a] <= high * m]
        s = [[(yy + zz - xx) / 2, -xy, -xz], [-xy, (xx + zz - yy) / 2, -yz]]
        s += [[-xz, -yz, (xx + yy - zz) / 2]]
        rows = [[*s[a], h[a]] for a in range(3)] + [[h[0], h[1], h[2], m]]
        asked += [cvxpy.bmat([[cvxpy.reshape(e, (1, 1), order="C") for e in r] for r in rows]) >> 0]
    other = cvxpy.Problem(cvxpy.Minimize(cvxpy.norm(matrix @ x + offset)), asked)
    value = other.solve(solver="CLARABEL", tol_gap_abs=1e-10, tol_gap_rel=1e-10, tol_feas=1e-10)
    found = certificate(given, explain=False, **BOXES)
    assert found.phi_min == pytest.approx(value**2, rel=1e-5)


def test_a_minimum_in_closed_form_and_its_bound() -> None:
    """The smallest eigenvalue of a matrix is the largest t with M - t E positive semidefinite."""
    m = np.random.default_rng(0).standard_normal((4, 4))
    m = m + m.T
    rows = Rows("psd", "semidefinite", -triangle(np.eye(4))[:, None], triangle(m), np.zeros(10))
    found = minimise(np.array([-1.0]), [rows])
    exact = -np.linalg.eigvalsh(m)[0]
    assert found.status == "solved"
    assert found.bound <= exact + 1e-14
    assert found.bound == pytest.approx(exact, abs=1e-8)
    assert found.value == pytest.approx(exact, abs=1e-8)
