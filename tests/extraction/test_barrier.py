"""The barrier's derivatives against autograd, and the steps it allows against where it ends."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from tests.extraction.setups import asking, problem_of, random_vectors
from torchid.extraction.polish.barrier import Barrier
from torchid.extraction.polish.region import Region, region
from torchid.extraction.problem import Problem
from torchid.robot.inertia import InertialParameters


def whole(name: str) -> Problem:
    """All conditions at once: boxes, round shapes on some links, total mass."""
    p = problem_of(name)
    n = p.n
    axes = torch.tensor([[1.0, 0.0, 1.0], [1.0, 1.0, 1.0]], dtype=torch.float64).repeat(n, 1)[:n]
    radius = torch.full((n,), 0.4, dtype=torch.float64)
    radius[0] = torch.inf
    total = p.bounds.mass.sum(0) * torch.tensor([0.0, 0.8], dtype=torch.float64) + torch.tensor(
        [1.0, 0.0], dtype=torch.float64
    )
    return asking(p, round_axes=axes, round_radius=radius, total_mass=total)


def inside_points(p: Problem, r: Region, barrier: Barrier, count: int = 6) -> Tensor:
    """(count, P) strictly inside, of all distances from the boundary."""
    q = random_vectors(p, count, seed=5)
    share = torch.linspace(0.1, 1.0, count, dtype=torch.float64).unsqueeze(-1)
    x = barrier.entered(r.inside + share * (q - r.inside), 0.02)
    assert bool(barrier.value(x).isfinite().all())
    return x


def own_value(p: Problem, r: Region, x: Tensor) -> Tensor:
    """The sum of logarithms written out for one point, for autograd."""
    n = p.n
    links = x[: 10 * n].reshape(n, 10)
    own = InertialParameters(links)
    mass, moment = links[:, 0], links[:, 1:4]
    box = r.box
    com = box[n : 4 * n].reshape(n, 3, 2)
    inertia = box[4 * n : 10 * n].reshape(n, 6, 2)
    m = mass.unsqueeze(-1)
    slacks = [
        mass - box[:n, 0], box[:n, 1] - mass,
        moment - m * com[..., 0], m * com[..., 1] - moment,
        own.inertia_about_com - inertia[..., 0], inertia[..., 1] - own.inertia_about_com,
        x[10 * n :] - box[10 * n :, 0], box[10 * n :, 1] - x[10 * n :],
    ]  # fmt: skip
    value = -sum(s.log().sum() for s in slacks)
    if not r.physical:
        return value
    value = value - torch.logdet(own.pseudo_inertia).sum()
    c = p.conditions
    for i in r.round_links.nonzero().flatten().tolist():
        away = (moment[i] - mass[i] * c.round_centre[i]) * c.round_axes[i]
        value = value - ((c.round_radius[i] * mass[i]) ** 2 - away @ away).log()
    if bool(r.total_mass.isfinite().all()):
        total = mass.sum()
        value = value - (total - r.total_mass[0]).log() - (r.total_mass[1] - total).log()
    return value


CASES = [
    (name, physical) for name in ("3r", "3r_friction", "kuka_lwr4") for physical in (True, False)
]


@pytest.mark.parametrize(("name", "physical"), CASES)
def test_value_and_gradient(name: str, physical: bool) -> None:
    p = whole(name)
    r = region(p, conditions=physical)
    barrier = Barrier(p, r)
    x = inside_points(p, r, barrier)
    gradient, _ = barrier.derivatives(x)
    for k, row in enumerate(x):
        at = row.clone().requires_grad_()
        value = own_value(p, r, at)
        torch.testing.assert_close(barrier.value(x)[k], value.detach(), rtol=1e-11, atol=1e-9)
        (expected,) = torch.autograd.grad(value, at)
        size = expected.abs().max()
        torch.testing.assert_close(gradient[k] / size, expected / size, rtol=1e-7, atol=1e-11)


def true_hessian(p: Problem, r: Region, x: Tensor) -> Tensor:
    return torch.autograd.functional.hessian(lambda at: own_value(p, r, at), x)  # type: ignore[no-any-return]


def scaled_difference(a: Tensor, b: Tensor) -> float:
    """Largest difference, with b scaled to a unit diagonal."""
    scale = b.diagonal().abs().rsqrt()
    return float(((a - b) * scale * scale.unsqueeze(-1)).abs().max())


@pytest.mark.parametrize(("name", "physical"), CASES)
def test_hessian_is_positive_semidefinite(name: str, physical: bool) -> None:
    p = whole(name)
    r = region(p, conditions=physical)
    barrier = Barrier(p, r)
    hessian = barrier.derivatives(inside_points(p, r, barrier))[1]
    torch.testing.assert_close(hessian, hessian.mT, rtol=1e-9, atol=1e-9)
    scale = hessian.diagonal(dim1=-2, dim2=-1).rsqrt()
    values = torch.linalg.eigvalsh(hessian * scale.unsqueeze(-1) * scale.unsqueeze(-2))
    assert float(values.min()) > -1e-10


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["3r", "3r_friction", "kuka_lwr4"])
def test_hessian_is_the_true_one_where_inertias_are_free(name: str) -> None:
    """Bounds on barycentric inertias a thousand times wider than the inertias: all that is not
    convex is gone, and the rest must be exact."""
    p = whole(name)
    n = p.n
    box = p.box.clone()
    box[4 * n : 10 * n] = torch.tensor([-1e5, 1e5], dtype=torch.float64)
    p = replace(p, box=box)
    r = region(p, conditions=True)
    inside = r.inside.clone()
    inside[4 * n : 10 * n] = torch.tensor([0.1, 0, 0, 0.1, 0, 0.1], dtype=torch.float64).repeat(n)
    r = replace(r, inside=inside)
    barrier = Barrier(p, r)
    shares = torch.tensor([0.0, 0.3, 0.6], dtype=torch.float64).unsqueeze(-1)
    q = random_vectors(problem_of(name), 3)
    x = barrier.entered(inside + shares * (q - inside), 0.02)
    hessian = barrier.derivatives(x)[1]
    for k in range(3):
        assert scaled_difference(hessian[k], true_hessian(p, r, x[k])) < 1e-8


@pytest.mark.parametrize("name", ["3r", "kuka_lwr4_friction"])
def test_infinite_outside(name: str) -> None:
    """Every slack in turn made negative, all others left positive as far as may be."""
    p = whole(name)
    r = region(p, conditions=True)
    barrier = Barrier(p, r)
    low, high = r.box.unbind(-1)
    for k in range(p.size):
        for value in (low[k] - 1e-6, high[k] + 1e-6):
            q = r.inside.clone()
            q[k] = value
            assert float(barrier.value(barrier.point(q.unsqueeze(0)))) == torch.inf
    n = p.n
    for mixed in (1, 2, 4):  # within the bounds, but no body's
        q = r.inside.clone()
        q[4 * n + mixed] = 0.999 * high[4 * n + mixed]
        q[[4 * n, 4 * n + 3, 4 * n + 5]] = 0.01
        assert float(barrier.value(barrier.point(q.unsqueeze(0)))) == torch.inf
    heavy = r.inside.clone()
    heavy[:n] = 0.99 * high[:n]
    assert float(barrier.value(barrier.point(heavy.unsqueeze(0)))) == torch.inf
    none = torch.full((1, p.size), torch.nan, dtype=torch.float64)
    assert float(barrier.value(barrier.point(none))) == torch.inf


def test_infinite_outside_a_shape() -> None:
    p = asking(
        problem_of("3r", "loose"),
        com_box=torch.tensor([-0.4, 0.4], dtype=torch.float64).repeat(3, 3, 1),
    )
    p = asking(
        p,
        round_axes=torch.ones(3, 3, dtype=torch.float64),
        round_radius=torch.full((3,), 0.15, dtype=torch.float64),
    )
    r = region(p, conditions=True)
    barrier = Barrier(p, r)
    q = r.inside.clone()
    assert float(barrier.value(barrier.point(q.unsqueeze(0)))) < torch.inf
    q[3:6] = torch.tensor([0.1, 0.0, 0.12], dtype=torch.float64)
    assert float(barrier.value(barrier.point(q.unsqueeze(0)))) == torch.inf


@pytest.mark.parametrize(("name", "physical"), CASES)
def test_entered_points_are_inside(name: str, physical: bool) -> None:
    """From anywhere in the bounds, their corners and beyond."""
    p = whole(name)
    r = region(p, conditions=physical)
    barrier = Barrier(p, r)
    corners = torch.where(
        torch.rand(20, p.size, dtype=torch.float64) < 0.5, p.box[:, 0], p.box[:, 1]
    )
    starts = torch.cat([random_vectors(p, 20), corners, 3 * corners, r.inside.unsqueeze(0)])
    for inward in (0.0, 0.01):
        x = barrier.entered(starts, inward)
        assert bool(barrier.value(x).isfinite().all())
        q = barrier.search_vector(x)
        assert bool(((q > r.box[:, 0]) & (q < r.box[:, 1])).all())
    # A point that is well inside stays where it is.
    torch.testing.assert_close(
        barrier.search_vector(barrier.entered(r.inside.unsqueeze(0)))[0],
        r.inside, rtol=1e-9, atol=1e-12,
    )  # fmt: skip


def test_points_and_search_vectors_are_two_forms_of_one() -> None:
    for name in ("3r_friction", "kuka_lwr4"):
        p = problem_of(name)
        r = region(p, conditions=False)
        barrier = Barrier(p, r)
        q = random_vectors(p, 5)
        again = barrier.search_vector(barrier.point(q))
        torch.testing.assert_close(again, q, rtol=1e-9, atol=1e-12)


def test_loss_in_the_barriers_layout() -> None:
    for name in ("3r_friction", "kuka_lwr4"):
        p = problem_of(name)
        barrier = Barrier(p, region(p, conditions=True))
        q = random_vectors(p, 5)
        residual = barrier.point(q) @ barrier.weight.T - p.target.offset
        torch.testing.assert_close(residual, p.residual(q), rtol=1e-10, atol=1e-11)


def convex_slacks(p: Problem, r: Region, x: Tensor) -> float:
    """Smallest of what `reach` promises: linear slacks and pseudo-inertias, each by its size."""
    n = p.n
    links = x[: 10 * n].reshape(n, 10)
    own = InertialParameters(links)
    mass, moment = links[:, 0], links[:, 1:4]
    com = r.box[n : 4 * n].reshape(n, 3, 2)
    m, rest = mass.unsqueeze(-1), r.box[10 * n :]
    slacks = [
        mass - r.box[:n, 0], r.box[:n, 1] - mass,
        (moment - m * com[..., 0]).flatten(), (m * com[..., 1] - moment).flatten(),
        x[10 * n :] - rest[:, 0], rest[:, 1] - x[10 * n :],
    ]  # fmt: skip
    if r.physical:
        slacks.append(torch.linalg.eigvalsh(own.pseudo_inertia).flatten())
    return float(torch.cat(slacks).min())


@pytest.mark.parametrize(("name", "physical"), CASES)
def test_reach_is_where_the_first_convex_slack_ends(name: str, physical: bool) -> None:
    p = whole(name)
    r = region(p, conditions=physical)
    barrier = Barrier(p, r)
    x = inside_points(p, r, barrier, 8)
    step = torch.randn_like(x) * x.abs().mean(-1, keepdim=True)
    reach = barrier.reach(x, step)
    assert bool((reach > 0).all())
    assert bool(reach.isfinite().all())
    for k in range(len(x)):
        assert convex_slacks(p, r, x[k] + (1 - 1e-6) * reach[k] * step[k]) > 0
        assert convex_slacks(p, r, x[k] + (1 + 1e-6) * reach[k] * step[k]) < 0


def test_reach_of_no_step_has_no_end() -> None:
    p = problem_of("3r_friction")
    r = region(p, conditions=True)
    barrier = Barrier(p, r)
    x = inside_points(p, r, barrier, 3)
    assert barrier.reach(x, torch.zeros_like(x)).tolist() == [torch.inf] * 3


def test_count_is_the_barriers_parameter() -> None:
    """B(t x) falls by count log t along a ray of a cone: a 4 x 4 determinant counts four."""
    p = problem_of("3r")
    bounds_only = Barrier(p, region(p, conditions=False))
    assert bounds_only.count == 2 * 30
    assert Barrier(p, region(p, conditions=True)).count == 2 * 30 + 4 * 3
    both = whole("3r")
    assert Barrier(both, region(both, conditions=True)).count == 2 * 30 + 4 * 3 + 2 * 2 + 2


def test_reach_of_coefficients_by_hand() -> None:
    """A step in one coefficient ends at its upper or its lower bound."""
    p = problem_of("3r_friction")
    r = region(p, conditions=True)
    barrier = Barrier(p, r)
    x = inside_points(p, r, barrier, 2)
    for k in range(10 * p.n, p.size):
        low, high = r.box[k].tolist()
        step = torch.zeros_like(x)
        step[0, k], step[1, k] = 0.1, -0.1
        up, down = (high - float(x[0, k])) / 0.1, (float(x[1, k]) - low) / 0.1
        torch.testing.assert_close(
            barrier.reach(x, step), torch.tensor([up, down], dtype=torch.float64)
        )
