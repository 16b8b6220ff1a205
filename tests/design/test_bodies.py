"""What is known of bodies beside least squares: divergences, their slopes, and the minimum."""

import pytest
import torch

from tests.gap.motions import ROBOT
from torchid.design.bodies import (
    Bodies,
    Prior,
    _by_newton,
    _stay_bodies,
    links_near,
    nearest_to,
    some_body,
    together,
    usual_bodies,
)
from torchid.errors import TorchidError
from torchid.robot.inertia import InertialParameters
from torchid.typing import Tensor

PI = ROBOT.require_parameters("a test").pi.double()
USUAL = usual_bodies(PI)
NOTHING = torch.zeros(10, dtype=torch.float64)
COUNT = PI.numel()


def near(deviation: float = 0.3) -> Bodies:
    """All links of the 3R."""
    links = links_near(PI, USUAL, deviation)
    assert links is not None
    every = together([b.shifted(10 * k) for k, b in enumerate(links)])
    assert every is not None
    return every


def equations(x: Tensor, noise: float = 0.0) -> tuple[Tensor, Tensor]:
    g = torch.Generator().manual_seed(0)
    a = torch.randn(4 * COUNT, COUNT, generator=g, dtype=torch.float64)
    y = a @ x + noise * torch.randn(len(a), generator=g, dtype=torch.float64)
    return a.T @ a * 1e4, a.T @ y * 1e4


def test_a_body_heavier_by_a_share_costs_four_squares_of_it_in_any_frame() -> None:
    """tr((R^-1 e R)^2) = 4 e^2; the small body beside which it counts takes a little."""
    links = links_near(PI, 1e-6 * USUAL, 0.3)
    assert links is not None
    for link, pi in zip(links, PI, strict=True):
        heavier = 0.03 * pi
        assert Prior(torch.zeros(10).double(), link).value(heavier) == pytest.approx(0.04, rel=0.01)


def test_the_metric_is_the_second_order_of_the_divergence() -> None:
    """D(P, R) = tr(R^-1 P) - log det(R^-1 P) - 4 of Lee, Wensing and Park (2020)."""
    links = links_near(PI, USUAL, 1.0)
    assert links is not None

    def divergence(x: Tensor) -> Tensor:
        p, r = (InertialParameters(PI[1] + USUAL[1] + y).pseudo_inertia for y in (x, 0 * x))
        inner = torch.linalg.solve(r, p)
        return inner.trace() - torch.logdet(inner) - 4

    hessian = torch.autograd.functional.hessian(divergence, torch.zeros(10).double())
    assert torch.allclose(links[1].metric[0], hessian, rtol=1e-6, atol=1e-9 * float(hessian.max()))


def test_what_bodies_have_is_found_and_what_no_body_has_is_not() -> None:
    there = 0.3 * PI.flatten()
    found = Prior(torch.zeros(COUNT).double(), near(100.0)).solve(*equations(there))
    assert torch.allclose(found, there, atol=1e-3)
    none = Prior(torch.zeros(COUNT).double(), near()).solve(*equations(-1.5 * PI.flatten()))
    margin = InertialParameters(PI + none.view(-1, 10)).consistency_margin()
    assert bool((margin > 0).all())
    assert float(none.view(-1, 10)[:, 0].max()) < 0  # as light as bodies may be


def test_where_nothing_is_measured_bodies_stay_what_they_were() -> None:
    zero = torch.zeros(COUNT, dtype=torch.float64)
    found = Prior(zero, near()).solve(torch.zeros(COUNT, COUNT).double(), zero)
    assert torch.allclose(PI + found.view(-1, 10), PI, rtol=2e-3, atol=2e-3 * float(PI.abs().max()))


def test_no_body_is_better_than_the_minimum() -> None:
    """Against bodies drawn between the minimum and others: convex, so none has a lower value."""
    matrix, right = equations(-0.9 * PI.flatten(), noise=0.5)
    prior = Prior(torch.zeros(COUNT).double(), near())
    found = prior.solve(matrix, right)

    def objective(x: Tensor) -> float:
        return float(x @ matrix @ x - 2 * right @ x) + prior.value(x)

    g = torch.Generator().manual_seed(3)
    for share in (1e-3, 0.1, 1.0):
        for _ in range(20):
            scale = 1 + 0.3 * torch.rand(len(PI), 1, generator=g, dtype=torch.float64)
            other = found + share * ((scale - 1) * PI - 0.5 * PI).flatten().clamp(min=-1e9)
            mixed = found + share * (other - found)
            if prior.bodies.are(mixed):
                assert objective(mixed) >= objective(found) - 1e-6 * abs(objective(found))


def test_other_coefficients_are_fitted_beside_bodies() -> None:
    """A coefficient that is no body's: the solution meets the normal equations with it."""
    there = torch.cat([torch.tensor([2.0]).double(), 0.2 * PI.flatten()])
    g = torch.Generator().manual_seed(2)
    a = torch.randn(200, COUNT + 1, generator=g, dtype=torch.float64)
    prior = Prior(torch.zeros(COUNT + 1).double(), near(100.0).shifted(1))
    found = prior.solve(1e4 * a.T @ a, 1e4 * a.T @ (a @ there))
    assert float(found[0]) == pytest.approx(2.0, abs=1e-3)


def margin_of(load: torch.Tensor) -> float:
    """Least eigenvalue of the pseudo-inertia of ten parameters."""
    return float(InertialParameters(load.unsqueeze(0)).consistency_margin())


def test_a_load_may_be_any_body() -> None:
    load = torch.tensor([0.5, 0.05, -0.02, 0.1, 0.08, 0.0, 0.0, 0.08, 0.0, 0.08]).double()
    matrix = 1e4 * torch.eye(10, dtype=torch.float64)
    prior = Prior(torch.zeros(10).double(), some_body(USUAL[-1], NOTHING))
    assert torch.allclose(prior.solve(matrix, matrix @ load), load, atol=2e-3)
    negative = prior.solve(matrix, -matrix @ load)
    assert margin_of(negative) > 0
    # What is there already may go, and no more.
    other = Prior(torch.zeros(10).double(), some_body(USUAL[-1], 0.5 * load))
    assert margin_of(0.5 * load + other.solve(matrix, -matrix @ load)) > 0


def test_numbers_that_no_body_has_are_no_links() -> None:
    pi = PI.clone()
    pi[1, 0] = -1.0
    assert links_near(pi, USUAL, 1.0) is None
    assert together([]) is None


def test_newton_and_interior_points_find_the_same_minimum() -> None:
    """Of many least squares at once, some of which no body fits, and with two bodies each."""
    links = near(1.0)
    for bodies in (links_near(PI, USUAL, 1.0)[0], Bodies(*(x[:2] for x in vars(links).values()))):  # type: ignore[index]
        count = bodies.at.numel()
        g = torch.Generator().manual_seed(5)
        a = torch.randn(12, 3 * count, count, generator=g, dtype=torch.float64)
        wanted = torch.randn(12, count, generator=g, dtype=torch.float64)
        matrix = 1e2 * a.mT @ a + bodies.squares(count)
        right = (matrix @ wanted.unsqueeze(-1)).squeeze(-1)
        found, settled = _by_newton([bodies] * 12, matrix.numpy(), right.numpy())
        assert settled.all()
        for m, b, x in zip(matrix, right, torch.from_numpy(found), strict=True):
            slow = torch.from_numpy(nearest_to(bodies, m.numpy(), b.numpy()))
            fast, exact = (float(y @ m @ y - 2 * b @ y) for y in (x, slow))
            assert fast == pytest.approx(exact, rel=1e-6)
            assert torch.allclose(x, slow, atol=1e-3)


def test_a_direction_that_nothing_shows_is_left_to_interior_points() -> None:
    """A load of which one moment is never felt: Newton says so, and the minimum is a body."""
    load = some_body(USUAL[-1], NOTHING)
    matrix = 1e4 * torch.eye(10, dtype=torch.float64)
    matrix[5, 5] = 0.0
    right = -matrix @ torch.ones(10, dtype=torch.float64)
    assert not _by_newton([load], matrix[None].numpy(), right[None].numpy())[1].any()
    found = Prior(torch.zeros(10).double(), load).solve(matrix, right)
    assert margin_of(found) > 0


@pytest.mark.parametrize("value", [0.0, float("nan")])
def test_a_program_without_digits_ends_and_moves_nothing(value: float) -> None:
    """A load whose columns others hold wholly, or equations that have overflown."""
    load = some_body(USUAL[-1], NOTHING)
    matrix, x = torch.full((1, 10, 10), value).double(), -5 * USUAL[-1:].double()
    with pytest.raises(TorchidError, match="no bodies were found that fit"):
        nearest_to(load, matrix[0].numpy(), x[0].numpy())
    before = x.clone()
    _stay_bodies([load], matrix, x, x)
    assert torch.equal(x, before)
