"""The polish: down to the proven minimum, never up, never out, and every run on its own."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from tests.extraction.setups import GROUPS, asking, bounded, problem_of, random_vectors
from tests.marks import quick_first
from torchid.extraction.penalty import gamma
from torchid.extraction.polish.barrier import Barrier
from torchid.extraction.polish.polish import polish
from torchid.extraction.polish.region import Region, region
from torchid.extraction.problem import Problem
from torchid.feasibility.margins import feasibility

LWR_NORMAL_PHI_MIN = 1.032e-4
"""Of the report's LWR within the boxes `normal`, by a semidefinite program written elsewhere."""
THREE_R = [(name, group) for name, group in GROUPS if name.startswith("3r")]


def entered(p: Problem, r: Region, q: Tensor) -> Tensor:
    """Where the polish begins: one per cent further in than the region's edge."""
    barrier = Barrier(p, r)
    return barrier.search_vector(barrier.entered(q, 0.01))


def assert_strictly_within(box: Tensor, q: Tensor) -> None:
    assert bool(((q > box[:, 0]) & (q < box[:, 1])).all())


@pytest.mark.parametrize("conditions", [True, False])
@pytest.mark.parametrize(("name", "group"), quick_first(THREE_R, 2, several=True))
def test_3r_ends_at_zero(name: str, group: str, conditions: bool) -> None:
    p = problem_of(name, group)
    r = region(p, conditions=conditions)
    q = polish(p, r, random_vectors(p, 6))
    assert float(p.phi(q).max()) <= 1e-18
    assert_strictly_within(r.box, q)
    if conditions:
        found = feasibility(p.sets(q, list("abcdef")), p.conditions)
        assert bool(found.feasible.all())
        assert bool((found.degree > 0).all())
        assert float(gamma(p, q).max()) == 0.0


@pytest.mark.nightly
@pytest.mark.parametrize("conditions", [True, False])
@pytest.mark.parametrize(("name", "group"), [("3r", "loose"), ("kuka_lwr4", "normal")])
def test_never_up_and_never_out(name: str, group: str, conditions: bool) -> None:
    """Also after few steps: whatever it is stopped at is inside and no worse."""
    p = problem_of(name, group)
    r = region(p, conditions=conditions)
    corners = torch.where(
        torch.rand(4, p.size, dtype=torch.float64) < 0.5, p.box[:, 0], p.box[:, 1]
    )
    starts = torch.cat([random_vectors(p, 4), corners])
    first = p.phi(entered(p, r, starts))
    before = first
    for steps in (0, 1, 3, 10, 40):
        q = polish(p, r, starts, steps=steps)
        assert_strictly_within(r.box, q)
        now = p.phi(q)
        assert bool((now <= first * (1 + 1e-9)).all())
        before = torch.minimum(before, now)
        if conditions:
            assert float(gamma(p, q).max()) == 0.0
    assert bool((before < 0.5 * first).all())


def test_lwr_reaches_the_certificate() -> None:
    p = problem_of("kuka_lwr4")
    r = region(p, conditions=True)
    phi = p.phi(polish(p, r, random_vectors(p, 4)))
    assert float(phi.max()) < 1.02 * LWR_NORMAL_PHI_MIN
    assert float(phi.min()) > 0.99 * LWR_NORMAL_PHI_MIN


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["kuka_lwr4", "kuka_lwr4_friction"])
@pytest.mark.parametrize("group", ["normal", "normal_corrected", "loose_corrected"])
def test_reaches_the_certificate_from_anywhere(name: str, group: str) -> None:
    """Not below the dual's proven bound, and within two per cent of it."""
    pytest.importorskip("cvxpy")
    from torchid.extraction.convex.certificate import certificate

    p = problem_of(name, group)
    proven = certificate(p)
    phi = p.phi(polish(p, region(p, conditions=True), random_vectors(p, 6)))
    assert float(phi.max()) <= 1.02 * proven.phi_min
    assert float(phi.min()) >= proven.phi_min * (1 - 1e-9)


def test_with_shapes_and_total_mass() -> None:
    p = asking(
        problem_of("3r", shapes=True),
        total_mass=torch.tensor([5.4, torch.inf], dtype=torch.float64),
    )
    r = region(p, conditions=True)
    q = polish(p, r, random_vectors(p, 5))
    found = feasibility(p.sets(q, list("abcde")), p.conditions)
    assert bool(found.feasible.all())
    assert float(p.split(q)[0].sum(-1).min()) > 5.4
    assert float(p.phi(q).max()) <= 1e-18


# ---- runs on their own ----------------------------------------------------------------------


@pytest.mark.nightly
@pytest.mark.parametrize("bad", [torch.nan, torch.inf])
@pytest.mark.parametrize("conditions", [True, False])
@pytest.mark.parametrize(("name", "group"), [("3r", "loose"), ("kuka_lwr4", "tight")])
def test_a_run_that_is_no_number_is_left_alone(
    name: str, group: str, conditions: bool, bad: float
) -> None:
    p = problem_of(name, group)
    r = region(p, conditions=conditions)
    starts = random_vectors(p, 5)
    broken = starts.clone()
    broken[2, 4] = bad
    expected, found = polish(p, r, starts, steps=60), polish(p, r, broken, steps=60)
    others = [0, 1, 3, 4]
    assert torch.equal(found[others], expected[others])
    assert torch.equal(found[2].isfinite(), broken[2].isfinite())
    assert torch.equal(found[2, 5:], broken[2, 5:])


@pytest.mark.nightly
def test_no_run_depends_on_how_long_another_takes() -> None:
    p = problem_of("kuka_lwr4", "loose")
    r = region(p, conditions=False)
    starts = random_vectors(p, 4)
    other = starts.clone()
    other[3] = r.inside
    a, b = polish(p, r, starts, steps=60), polish(p, r, other, steps=60)
    assert torch.equal(a[:3], b[:3])
    assert not torch.equal(a[3], b[3])


@pytest.mark.nightly
@pytest.mark.parametrize("conditions", [True, False])
def test_runs_stay_different(conditions: bool) -> None:
    """The 3R's loss leaves 15 directions free; each run keeps what it had in them."""
    p = problem_of("3r", "loose")
    r = region(p, conditions=conditions)
    starts = random_vectors(p, 8)
    begun, ended = p.unit(entered(p, r, starts)), p.unit(polish(p, r, starts))
    # Half of the 30 directions are the loss's, in which all runs agree in the end.
    before, after = torch.pdist(begun), torch.pdist(ended)
    assert float(after.median()) > 0.3 * float(before.median())
    assert float(after.min()) > 0.05 * float(before.min())
    assert torch.linalg.matrix_rank(ended - ended.mean(0), rtol=1e-3) == 7
    # Where a run lies among the others is where it began among the others, mostly; by chance
    # it would be for one of eight.
    place, origin = (torch.nn.functional.normalize(x - x.mean(0)) for x in (ended, begun))
    assert int(((place @ origin.T).argmax(-1) == torch.arange(8)).sum()) >= 5


def test_same_start_same_end() -> None:
    p = problem_of("3r")
    r = region(p, conditions=True)
    q = random_vectors(p, 3)
    assert torch.equal(polish(p, r, q), polish(p, r, q))


# ---- regions with something impossible in them ----------------------------------------------


def test_excluded_box_is_kept_to_its_nearest_face() -> None:
    p = problem_of("kuka_lwr4", "loose")
    r = region(p, conditions=True)
    q = polish(p, r, random_vectors(p, 3))
    found = feasibility(p.sets(q, list("abc")), p.conditions)
    assert [found.reasons(k) for k in range(3)] == [("com_7z",)] * 3
    assert float((p.split(q)[1][:, 6, 2] - 0.4).abs().max()) < 1e-6


@pytest.mark.parametrize("conditions", [True, False])
def test_a_region_without_interior_changes_nothing(conditions: bool) -> None:
    def negative(b):  # type: ignore[no-untyped-def]
        b.mass[1] = torch.tensor([-2.0, -1.0], dtype=torch.float64)
        return b

    p = bounded(problem_of("3r"), negative)
    q = random_vectors(p, 3)
    assert torch.equal(polish(p, region(p, conditions=conditions), q), q)


def test_an_impossible_inertia_leaves_the_bounds() -> None:
    def flat(b):  # type: ignore[no-untyped-def]
        b.inertia[1, [0, 3, 5]] = torch.tensor(
            [[0.4, 0.5], [0.0, 0.1], [0.0, 0.1]], dtype=torch.float64
        )
        return b

    p = bounded(problem_of("3r"), flat)
    r = region(p, conditions=True)
    starts = random_vectors(p, 3)
    q = polish(p, r, starts)
    assert_strictly_within(r.box, q)
    assert bool((p.phi(q) < p.phi(entered(p, r, starts))).all())


@pytest.mark.nightly
def test_one_step_weights_reach_zero_too() -> None:
    """Any weight, also an ill-conditioned one: the target is exact, so the loss ends at zero."""
    p = problem_of("3r", "loose")
    g = torch.Generator().manual_seed(1)
    size = len(p.target.base)
    weight = torch.randn(size, size, generator=g, dtype=torch.float64).triu()
    weight = weight * torch.logspace(2, -2, size, dtype=torch.float64).unsqueeze(-1)
    target = replace(p.target, weight=weight, offset=weight @ p.target.values)
    p = replace(p, target=target)
    q = polish(p, region(p, conditions=True), random_vectors(p, 4))
    assert float(p.phi(q).max()) <= 1e-16
