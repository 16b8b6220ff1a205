"""Ranges over feasible sets of equal torque: closed forms, and sets that must lie in them."""

from collections import Counter
from dataclasses import replace
from functools import lru_cache

import pytest
import torch
from scipy import stats
from torch import Tensor

from tests.arms import arm
from torchid.errors import TorchidError
from torchid.extraction.convex.atlas import Atlas, atlas
from torchid.extraction.convex.certificate import certificate
from torchid.extraction.problem import Problem, Target, extraction_problem, two_step
from torchid.feasibility.bounds import Bounds, read_bounds
from torchid.feasibility.conditions import conditions, physics_only
from torchid.feasibility.margins import feasibility
from torchid.feasibility.sets import ParameterSets, nominal_set
from torchid.identification.base_parameters import base_parameters
from torchid.identification.values import BaseValues
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import JointType, Robot


@lru_cache
def problem(name: str, group: str = "normal") -> Problem:
    robot = arm(name)
    sets = nominal_set(robot)
    base = base_parameters(robot, sets.effects)
    target = two_step(base, sets.effects, base.project(sets.vector[0]))
    return extraction_problem(robot, target, read_bounds(robot, group), conditions(robot))


@lru_cache
def atlas_of(name: str) -> Atlas:
    return atlas(problem(name))


def quantities(given: Problem, x: Tensor) -> Tensor:
    """(K, Q) what the atlas ranges over, of vectors (K, P)."""
    n = given.n
    com = InertialParameters.from_paper_order(x[:, : 10 * n]).com.flatten(-2)
    return torch.cat([x[:, :n], com, x[:, 4 * n :]], -1)


def sets_of(given: Problem, x: Tensor) -> ParameterSets:
    n = given.n
    return ParameterSets(
        tuple(str(k) for k in range(len(x))),
        InertialParameters.from_paper_order(x[:, : 10 * n]),
        given.target.effects,
        x[:, 10 * n :],
    )


def allowed(given: Problem, x: Tensor) -> Tensor:
    """(K,) whether vectors are feasible and within the bounds."""
    sets = sets_of(given, x)
    p = sets.search_vector
    low, high = given.box.unbind(-1)
    return feasibility(sets, given.conditions).feasible & ((p >= low) & (p <= high)).all(-1)


def null_space(matrix: Tensor) -> Tensor:
    return torch.linalg.svd(matrix).Vh[torch.linalg.matrix_rank(matrix) :]


def pendulum(mass: tuple[float, float], side: float) -> Problem:
    """One link that turns about a horizontal axis: mcx, mcy and Jzz are known, no more."""
    robot = Robot(
        name="pendulum",
        joint_names=("joint",),
        link_names=("link",),
        joint_types=(JointType.REVOLUTE,),
        before=torch.eye(4, dtype=torch.float64).unsqueeze(0),
        after=torch.eye(4, dtype=torch.float64).unsqueeze(0),
        gravity=torch.tensor([0.0, -9.81, 0.0], dtype=torch.float64),
        tool=torch.eye(4, dtype=torch.float64),
    )
    box = torch.tensor([-side, side], dtype=torch.float64).repeat(1, 3, 1)
    far = torch.tensor([-10.0, 10.0], dtype=torch.float64).repeat(1, 6, 1)
    bounds = Bounds("own", torch.tensor([mass], dtype=torch.float64), box, far, {})
    base = base_parameters(robot)
    x = torch.tensor([2.0, 0.3, -0.4, 0.1, 0.5, 0.01, 0.02, 0.45, 0.03, 0.25], dtype=torch.float64)
    target = two_step(base, (), base.project(x))
    return extraction_problem(robot, target, bounds, physics_only(1))


def test_a_pendulum_in_closed_form() -> None:
    """With a, b = mcx, mcy and j = Jzz known, S = [[Sxx, Sxy], [Sxy, Syy]] >= hh'/m and
    Sxx + Syy = j: so m >= (a^2 + b^2) / j, and J_xx = Syy + Szz >= b^2 / m."""
    a, b, j, top = 0.3, -0.4, 0.25, 5.0
    found = atlas(pendulum((0.0, top), 10.0), com_bounds=False, inertia_bounds=False)
    assert found.kind == "exact"
    low, high = (dict(zip(found.names, v.tolist(), strict=True)) for v in (found.low, found.high))
    least = (a * a + b * b) / j
    expected = {
        "m1": (least, top),
        "c1x": (a / top, a / least),
        "c1y": (b / least, b / top),
        "J1zz": (j, j),
        "J1xx": (b * b / top, torch.inf),
        "J1yy": (a * a / top, torch.inf),
        # |Sxy - ab/m|^2 <= (Sxx - a^2/m)(Syy - b^2/m), widest at the largest mass: r is the
        # largest root of the product with Sxx + Syy = j.
        "J1xy": tuple(-a * b / top + s * (j - (a * a + b * b) / top) / 2 for s in (-1, 1)),
        "c1z": (-torch.inf, torch.inf),
    }
    for name, (lo, hi) in expected.items():
        assert low[name] == pytest.approx(lo, abs=1e-6), name
        assert high[name] == pytest.approx(hi, abs=1e-6), name
    status = dict(zip(found.names, found.status, strict=True))
    assert status["J1xx"][1] == "unbounded"
    assert status["m1"] == ("solved", "solved")
    known = dict(zip(found.names, found.narrowed.tolist(), strict=True))
    assert known["J1zz"] == pytest.approx(0.0, abs=1e-6)
    assert known["m1"] == pytest.approx((top - least) / top, abs=1e-6)


def test_a_pendulum_with_bounds() -> None:
    found = atlas(pendulum((0.5, 3.0), 0.2))
    ends = torch.stack([found.low, found.high], -1).tolist()
    at = {name: tuple(end) for name, end in zip(found.names, ends, strict=True)}
    # |c_y| <= 0.2 with mcy = -0.4 asks for 2 kg.
    assert at["m1"] == pytest.approx((2.0, 3.0), abs=1e-6)
    assert at["c1x"] == pytest.approx((0.1, 0.15), abs=1e-6)
    assert at["c1y"] == pytest.approx((-0.2, -0.4 / 3), abs=1e-6)
    assert at["c1z"] == pytest.approx((-0.2, 0.2), abs=1e-6)
    assert found.bounds_low[0] == pytest.approx(0.5, abs=1e-6)
    assert bool(torch.isfinite(found.low).all() & torch.isfinite(found.high).all())


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["3r", "3r_friction"])
def test_the_ends_are_reached(name: str) -> None:
    """Sets at the ends reproduce the base parameters, are feasible to the solver's tolerance, and
    have the values that the ranges say."""
    given, found = problem(name), atlas_of(name)
    assert found.kind == "exact"
    assert len(found.names) == len(given.target.base.parameter_names)
    assert {s for pair in found.status for s in pair} <= {"solved", "inexact"}
    beta = given.target.values
    k = torch.arange(len(found.names))
    for end, value in ((0, found.low), (1, found.high)):
        x = found.extremes[:, end]
        error = (given.target.base.project(x) - beta).norm(dim=-1) / beta.norm()
        assert float(error.max()) < 1e-12
        sets = sets_of(given, x)
        assert float(sets.parameters.consistency_margin().min()) > -1e-7
        # A centre of mass is badly known for a link that the end makes all but massless.
        heavy = sets.parameters.mass.amin(-1) > 1e-3
        reached = quantities(given, x)[k, k]
        scale = 1e-5 * (1 + value.abs())
        assert bool(((reached - value).abs() <= scale)[heavy].all())
    assert bool((found.low <= found.high + 1e-9).all())
    assert bool((found.low >= found.bounds_low - 1e-5).all())
    assert bool((found.high <= found.bounds_high + 1e-5).all())
    assert bool(((found.narrowed >= 0) & (found.narrowed <= 1)).all())


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["3r", "3r_friction"])
def test_sets_of_equal_torque_lie_in_the_ranges(name: str) -> None:
    """Feasible sets, as far out in the null space as they stay feasible, in random directions."""
    given, found = problem(name), atlas_of(name)
    inner = certificate(given, explain=False).sets
    assert inner is not None
    null = null_space(given.target.base.grouping)
    generator = torch.Generator().manual_seed(1)
    start = inner.vector
    for _ in range(4):
        step = torch.randn(300, len(null), generator=generator, dtype=torch.float64) @ null
        low, high = (
            torch.zeros(300, 1, dtype=torch.float64),
            torch.full((300, 1), 10.0, dtype=torch.float64),
        )
        for _ in range(40):
            middle = (low + high) / 2
            good = allowed(given, start + middle * step).unsqueeze(-1)
            low, high = torch.where(good, middle, low), torch.where(good, high, middle)
        x = start + low * step
        x = x[allowed(given, x)]
        assert len(x) > 250
        assert float((given.target.base.project(x) - given.target.values).abs().max()) < 1e-10
        values = quantities(given, x)
        tolerance = 1e-6 * (1 + values.abs())
        assert bool((values >= found.low - tolerance).all())
        assert bool((values <= found.high + tolerance).all())
        start = x[:1]


def test_the_one_step_loss_has_the_same_ranges() -> None:
    """An invertible weight changes the loss, not what reproduces the target exactly."""
    given = problem("3r")
    t = given.target
    weight = torch.randn(
        len(t.base), len(t.base), generator=torch.Generator().manual_seed(0), dtype=torch.float64
    )
    target = Target(t.base, t.effects, t.values, weight, weight @ t.values, "one-step")
    only = ["m2", "c2x", "J3yy"]
    a = atlas(given, only=only)
    b = atlas(replace(given, target=target), only=only)
    assert b.names == tuple(only)
    torch.testing.assert_close(a.low, b.low, rtol=1e-5, atol=1e-7)
    torch.testing.assert_close(a.high, b.high, rtol=1e-5, atol=1e-7)


@pytest.mark.nightly
def test_the_confidence_ellipsoid() -> None:
    """Wider than the exact ranges, wider with more noise, and it holds a truth that is within the
    quantile of chi squared."""
    given = problem("3r_friction")
    base = given.target.base
    truth = nominal_set(given.robot).vector
    b = len(base)
    generator = torch.Generator().manual_seed(3)
    root = torch.randn(b, b, generator=generator, dtype=torch.float64) * base.project(truth)[
        0
    ].abs().clamp(min=1e-3)
    noise = 1e-2 * torch.randn(b, generator=generator, dtype=torch.float64) @ root
    assert float((1e2 * torch.linalg.solve(root.T, noise)).square().sum()) < stats.chi2.ppf(0.95, b)
    target = two_step(base, given.target.effects, base.project(truth)[0] + noise)
    noisy = replace(given, target=target)
    only = ["m1", "m3", "c2x", "c3y", "J2xx", "J3xy", "Fv2", "F03"]
    found = atlas(noisy, covariance=1e-4 * root.T @ root, only=only)
    assert (found.kind, found.widened) == ("confidence", False)
    assert found.radius == pytest.approx(stats.chi2.ppf(0.95, b) ** 0.5)
    value = quantities(given, truth)[0][[atlas_of("3r_friction").names.index(k) for k in only]]
    assert bool(((value >= found.low - 1e-9) & (value <= found.high + 1e-9)).all())
    wider = atlas(noisy, covariance=1e-3 * root.T @ root, only=only)
    assert bool((wider.high - wider.low >= found.high - found.low - 1e-6).all())
    assert float((found.high - found.low).min()) > 0
    exact = atlas(given, only=only)
    none = atlas(given, covariance=torch.zeros(b, b, dtype=torch.float64), only=only)
    torch.testing.assert_close(none.low, exact.low, rtol=1e-5, atol=1e-7)
    free = atlas(
        given, covariance=torch.diag(torch.full((b,), torch.inf, dtype=torch.float64)), only=only
    )
    torch.testing.assert_close(free.high, free.bounds_high, rtol=1e-5, atol=1e-7)


@pytest.mark.nightly
def test_the_reports_arm_of_least_loss() -> None:
    """No feasible set has exactly the base parameters: ranges are those of the least loss."""
    given = problem("kuka_lwr4")
    steps: list[tuple[int, int]] = []
    found = atlas(given, slack=0.01, progress=lambda done, total: steps.append((done, total)))
    assert steps == [(k, 280) for k in range(1, 281)]
    assert found.kind == "least loss"
    least = certificate(given, explain=False)
    assert found.radius**2 == pytest.approx(1.01 * least.phi_min, rel=1e-6)
    counts = Counter(s for pair in found.status for s in pair)
    assert counts["solved"] + counts["inexact"] == 140
    x = found.extremes.flatten(0, 1)
    phi = given.residual_of_vector(x).square().sum(-1)
    assert float(phi.max()) <= 1.01 * least.phi_min * (1 + 1e-4)
    assert least.sets is not None
    inside = quantities(given, least.sets.vector)[0]
    assert bool(((inside >= found.low - 1e-6) & (inside <= found.high + 1e-6)).all())


def test_a_set_of_conditions_that_cannot_be_met_is_a_status() -> None:
    asked = conditions(arm("3r"), total_mass=(50.0, 60.0))
    found = atlas(replace(problem("3r"), conditions=asked), only=["m1", "c1x"])
    assert found.status == (("infeasible",) * 2,) * 2
    assert bool(torch.isnan(found.low).all())
    assert bool(torch.isnan(found.extremes).all())


def test_bad_input() -> None:
    given = problem("3r")
    with pytest.raises(TorchidError, match="no such parameters"):
        atlas(given, only=["m9"])
    with pytest.raises(TorchidError, match="level"):
        atlas(given, level=1.5)
    with pytest.raises(TorchidError, match="covariance"):
        atlas(given, covariance=torch.eye(3, dtype=torch.float64))


def test_an_ellipsoid_without_a_feasible_set_is_widened() -> None:
    """The report's arm is infeasible by ||1e-2||: a small covariance has no feasible set in it."""
    given = problem("kuka_lwr4")
    found = atlas(given, covariance=1e-10 * torch.eye(43, dtype=torch.float64), only=["m6"])
    assert (found.kind, found.widened) == ("confidence", True)
    same = atlas(given, only=["m6"])
    assert found.radius * 1e-5 == pytest.approx(same.radius, rel=1e-5)
    torch.testing.assert_close(found.high, same.high, rtol=1e-4, atol=1e-6)


def test_a_covariance_is_a_tensor_an_array_or_an_identification() -> None:
    """Of an identification what the log did not determine is free."""
    given = problem("3r")
    base, free = given.target.base, 2
    size = len(base)
    covariance = 1e-6 * torch.eye(size, dtype=torch.float64)
    known = torch.arange(size) != free
    values = BaseValues(base, (), given.target.values, known, covariance, None)
    unsure = covariance.clone()
    unsure[free, free] = float("inf")
    only = ["m2", "m3"]
    wanted = atlas(given, covariance=unsure, only=only)
    for form in (values, unsure.numpy(), unsure.tolist()):
        found = atlas(given, covariance=form, only=only)
        assert torch.equal(found.low, wanted.low)
        assert torch.equal(found.high, wanted.high)
    assert values.held == ()
    assert replace(values, covariance=0 * covariance).held == tuple(
        name for k, name in enumerate(base.names) if k != free
    )
    with pytest.raises(TorchidError, match="does not belong"):
        atlas(given, covariance=covariance[1:, 1:].numpy(), only=only)
