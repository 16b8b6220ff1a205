"""gamma: zero exactly where the margins say so, continuous, and fast without being wrong."""

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.arms import arm
from tests.extraction.setups import (
    BUILT_IN,
    asking,
    bounded,
    nothing_asked,
    problem_of,
    random_vectors,
)
from torchid.extraction.convex.finish import attainable
from torchid.extraction.penalty import extreme_eigenvalues, gamma
from torchid.extraction.problem import Problem, extraction_problem, two_step
from torchid.feasibility.bounds import read_bounds
from torchid.feasibility.conditions import conditions
from torchid.feasibility.margins import feasibility
from torchid.feasibility.sets import nominal_set
from torchid.identification.values import nominal_base
from torchid.robot.inertia import six, symmetric
from torchid.robot.library import load_robot

NEAR = 1e-7
"""What the closed form may be off, as a share of the largest eigenvalue's size: where two are
equal, its arc cosine has the square root of the rounding."""


# ---- eigenvalues in closed form -------------------------------------------------------------


def assert_as_lapack(inertia: torch.Tensor) -> None:
    smallest, largest = extreme_eigenvalues(inertia)
    expected = torch.linalg.eigvalsh(symmetric(inertia))
    # Cubes of what is smaller than 1e-100 are no numbers any more.
    size = expected.abs().amax(-1) + 1e-90
    assert float(((smallest - expected[..., 0]).abs() / size).max()) < NEAR
    assert float(((largest - expected[..., 2]).abs() / size).max()) < NEAR


@settings(max_examples=100)
@given(
    values=st.lists(st.floats(-10, 10), min_size=3, max_size=3),
    seed=st.integers(0, 2**31),
    exponent=st.integers(-8, 8),
)
def test_eigenvalues_of_any_tensor(values: list[float], seed: int, exponent: int) -> None:
    g = torch.Generator().manual_seed(seed)
    q = torch.linalg.qr(torch.randn(3, 3, generator=g, dtype=torch.float64)).Q
    tensor = q @ torch.diag(10.0**exponent * torch.tensor(values, dtype=torch.float64)) @ q.T
    assert_as_lapack(six((tensor + tensor.T) / 2))


@settings(max_examples=100)
@given(
    first=st.floats(0.1, 10),
    gap=st.floats(-16, -1),
    pattern=st.sampled_from([(0, 0, 1), (0, 1, 1), (0, 1, 2), (0, 0, 0), (1, 0, -1)]),
    seed=st.integers(0, 2**31),
)
def test_eigenvalues_nearly_equal(
    first: float, gap: float, pattern: tuple[int, ...], seed: int
) -> None:
    """Two or three eigenvalues 10^gap apart, where acos has no slope."""
    g = torch.Generator().manual_seed(seed)
    q = torch.linalg.qr(torch.randn(3, 3, generator=g, dtype=torch.float64)).Q
    values = first + 10.0**gap * torch.tensor(pattern, dtype=torch.float64)
    tensor = q @ torch.diag(values) @ q.T
    assert_as_lapack(six((tensor + tensor.T) / 2))


def test_eigenvalues_of_special_tensors() -> None:
    rows = [
        [0.0, 0, 0, 0, 0, 0],
        [1.0, 0, 0, 1, 0, 1],
        [2.0, 0, 0, 1, 0, 1],
        [0.0, 1, 0, 0, 0, 0],
        [1.0, 1, 1, 1, 1, 1],
        [-3.0, 0, 0, 0, 0, 0],
        [1e-80, 0, 0, 2e-80, 0, 3e-80],
    ]
    assert_as_lapack(torch.tensor(rows, dtype=torch.float64))


# ---- gamma ----------------------------------------------------------------------------------


def whole(name: str, group: str = "normal") -> Problem:
    """All conditions at once: boxes, cylinders or spheres, total mass."""
    p = problem_of(name, group)
    n = p.n
    axes = torch.tensor([[1.0, 0.0, 1.0], [1.0, 1.0, 1.0]], dtype=torch.float64).repeat(n, 1)[:n]
    total = p.bounds.mass.sum(0) * torch.tensor([1.0, 0.6], dtype=torch.float64) + torch.tensor(
        [1.0, 0.0], dtype=torch.float64
    )
    return asking(
        p,
        round_axes=axes,
        round_radius=torch.full((n,), 0.35, dtype=torch.float64),
        total_mass=total,
    )


def solid(p: Problem) -> torch.Tensor:
    """A set well inside: masses, centres and coefficients in the middle, inertias of balls."""
    n, inside = p.n, p.box.mean(-1)
    box = p.conditions.com_box.reshape(-1, 2)
    low, high = torch.maximum(p.box[n : 4 * n, 0], box[:, 0]), p.box[n : 4 * n, 1]
    inside[n : 4 * n] = (low + torch.minimum(high, box[:, 1])) / 2
    entries, most = inside[4 * n : 10 * n].view(n, 6), p.box[4 * n : 10 * n, 1].view(n, 6)
    entries[:, [1, 2, 4]] = 0.0
    entries[:, [0, 3, 5]] = 0.5 * most[:, [0, 3, 5]].amin(-1, keepdim=True)
    return inside


@pytest.mark.parametrize("name", BUILT_IN)
def test_zero_exactly_where_no_margin_is_negative(name: str) -> None:
    """On random sets, moved towards the interior until some are feasible, and beyond."""
    p = whole(name)
    assert attainable(p)[1] == ()
    inside = solid(p)
    share = torch.linspace(0, 1, 400, dtype=torch.float64).unsqueeze(-1) ** 0.3
    q = random_vectors(p, 400)
    q = q + share * (inside - q)
    # Physics and geometry, not the coefficients, which gamma leaves to their bounds.
    found = feasibility(p.sets(q, [str(k) for k in range(400)]), p.conditions)
    fulfilled = ~(found.violated.flatten(1).any(-1) | found.violated_total)
    assert 20 < int(fulfilled.sum()) < 390
    for exact in (True, False):
        assert torch.equal(gamma(p, q, exact=exact) == 0, fulfilled)


@pytest.mark.parametrize("name", BUILT_IN)
def test_fast_is_exact_enough(name: str) -> None:
    p = whole(name)
    q = random_vectors(p, 500)
    torch.testing.assert_close(gamma(p, q, exact=False), gamma(p, q), rtol=0, atol=1e-7)


@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize("name", ["3r_friction", "kuka_lwr4"])
def test_continuous(name: str, exact: bool) -> None:
    """Along lines through the bounds, in steps that halve: so do the largest changes."""
    p = whole(name)
    a, b = random_vectors(p, 2, seed=3)
    changes = []
    for steps in (1000, 2000, 4000):
        t = torch.linspace(0, 1, steps + 1, dtype=torch.float64).unsqueeze(-1)
        changes.append(float(gamma(p, a + t * (b - a), exact=exact).diff().abs().max()))
    assert changes[1] < 0.6 * changes[0]
    assert changes[2] < 0.6 * changes[1]


def feasible_3r() -> tuple[Problem, torch.Tensor]:
    p = problem_of("3r")
    return p, nominal_set(arm("3r")).search_vector[0]


def test_scaled_violations_by_hand() -> None:
    """Each condition alone, violated by a known amount, counts what the table says."""
    p, good = feasible_3r()
    assert float(gamma(p, good)) == 0.0
    n = p.n

    def at(index: int, value: float) -> float:
        q = good.clone()
        q[index] = value
        return float(gamma(p, q))

    assert at(1, -0.5) == pytest.approx(0.5 / 2.0)  # mass of link 2, of at most 2 kg
    assert at(n + 3 * 2, 0.03) == pytest.approx(0.03 / 0.15)  # c3x in [-0.15, 0]
    q = good.clone()
    q[4 * n : 4 * n + 6] = torch.tensor([0.1, 0.0, 0.0, 0.1, 0.0, 0.3], dtype=torch.float64)
    assert float(gamma(p, q)) == pytest.approx(0.05 / 0.5)  # tr/2 - 0.3 = -0.05
    q[4 * n : 4 * n + 6] = torch.tensor([-0.1, 0.0, 0.0, 0.2, 0.0, 0.2], dtype=torch.float64)
    assert float(gamma(p, q)) == pytest.approx((0.1 + 0.05) / 0.5)
    total = asking(p, total_mass=torch.tensor([6.0, 7.0], dtype=torch.float64))
    assert float(gamma(total, good)) == pytest.approx(0.5)  # 5.5 kg


@pytest.mark.parametrize(
    ("interval", "expected"),
    [
        ((6.0, math.inf), 0.5 / 6.0),
        ((-math.inf, 5.0), 0.5 / 5.0),
        ((5.0, math.inf), 0.0),
        ((-math.inf, 0.0), 5.5),
        ((-math.inf, math.inf), 0.0),
        ((0.0, math.inf), 0.0),
    ],
)
def test_total_mass_open_to_one_side(interval: tuple[float, float], expected: float) -> None:
    p, good = feasible_3r()
    asked = asking(p, total_mass=torch.tensor(interval, dtype=torch.float64))
    assert float(gamma(asked, good)) == pytest.approx(expected)


def test_shape_by_hand() -> None:
    p = problem_of("3r", shapes=True)
    good = nominal_set(arm("3r")).search_vector[0]
    assert float(gamma(p, good)) == 0.0
    q = good.clone()
    q[p.n + 1 * 3 + 1] = 0.03
    q[p.n + 1 * 3 + 2] = 0.03  # c2y, c2z: within the box of +-0.035, outside the circle
    assert float(gamma(p, q)) == pytest.approx((math.hypot(0.03, 0.03) - 0.035) / 0.035)


def test_never_negative_whatever_the_bounds() -> None:
    """Also where they allow nothing but negative masses and inertias."""

    def negative(b):  # type: ignore[no-untyped-def]
        mass, inertia = b.mass, b.inertia
        mass[0] = torch.tensor([-2.0, -1.0], dtype=torch.float64)
        mass[1] = torch.tensor([-2.0, 0.0], dtype=torch.float64)
        inertia[2] = torch.tensor([-1.0, -0.5], dtype=torch.float64)
        inertia[1] = torch.tensor([-1.0, 0.0], dtype=torch.float64)
        return b

    p = bounded(problem_of("3r"), negative)
    q = random_vectors(p, 200)
    for exact in (True, False):
        value = gamma(p, q, exact=exact)
        assert bool(value.isfinite().all())
        assert bool((value > 1.0).all())
    high = p.box[:, 1]
    assert math.isfinite(float(gamma(p, high)))


def test_batches_and_devices(device: torch.device) -> None:
    p = whole("3r")
    q = random_vectors(p, 6)
    expected = gamma(p, q)
    found = gamma(p, q.reshape(2, 3, -1).to(device))
    assert found.shape == (2, 3)
    torch.testing.assert_close(found.cpu().flatten(), expected, rtol=1e-12, atol=1e-15)


def test_without_boxes_only_physics_counts() -> None:
    p = problem_of("3r")
    free = replace(p, conditions=nothing_asked(p.conditions))
    q = nominal_set(arm("3r")).search_vector[0]
    q[p.n : 4 * p.n] = 100.0
    assert float(gamma(p, q)) > 100
    assert float(gamma(free, q)) == 0.0


def test_coefficients_with_a_sign_count_when_the_bounds_let_them_be_negative():
    """Of the friction coefficients, Fv and Fc are asked for to be positive, F0 is not."""
    robot = load_robot("3r_friction")
    found = nominal_base(robot)
    bounds = read_bounds(robot, "normal")
    wide = {
        name: torch.tensor([[-50.0, 50.0]] * 3, dtype=torch.float64) for name in ("Fv", "Fc", "F0")
    }
    target = two_step(found.base, found.effects, found.values)
    open_bounds = replace(bounds, coefficients=wide)
    asked = extraction_problem(robot, target, open_bounds, conditions(robot))
    p = nominal_set(robot).search_vector
    for k, expected in ((30, 0.1), (33, 0.1), (36, 0.0)):
        worse = p.clone()
        worse[:, k] = -5.0
        assert float(gamma(asked, worse) - gamma(asked, p)) == pytest.approx(expected)
    assert attainable(asked)[1] == ()
    impossible = {**wide, "Fc": torch.tensor([[-2.0, -1.0]] * 3, dtype=torch.float64)}
    none = replace(bounds, coefficients=impossible)
    _, against = attainable(extraction_problem(robot, target, none, conditions(robot)))
    assert against == ("Fc_1", "Fc_2", "Fc_3")
