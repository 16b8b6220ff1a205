"""Ends of runs: at the proven minimum, within the bounds, near their starts, each on its own; and
what conditions the bounds exclude."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from tests.extraction.setups import GROUPS, asking, bounded, problem_of, random_vectors
from tests.marks import quick_first
from torchid.extraction.convex.finish import attainable, finished
from torchid.extraction.penalty import gamma
from torchid.extraction.problem import Problem
from torchid.feasibility.bounds import Bounds
from torchid.feasibility.margins import feasibility

LWR_NORMAL_PHI_MIN = 1.032e-4
"""Of the report's LWR within the boxes `normal`, by a semidefinite program written elsewhere."""
THREE_R = [(name, group) for name, group in GROUPS if name.startswith("3r")]


def assert_within(p: Problem, q: Tensor) -> None:
    assert bool(((q >= p.box[:, 0]) & (q <= p.box[:, 1])).all())


@pytest.mark.parametrize("conditions", [True, False])
@pytest.mark.parametrize(("name", "group"), quick_first(THREE_R, 2, several=True))
def test_3r_ends_at_zero(name: str, group: str, conditions: bool) -> None:
    p = problem_of(name, group)
    q = finished(p, random_vectors(p, 6), conditions=conditions)
    assert float(p.phi(q).max()) <= 1e-18
    assert_within(p, q)
    if conditions:
        found = feasibility(p.sets(q, list("abcdef")), p.conditions)
        assert bool(found.feasible.all())
        assert float(gamma(p, q).max()) == 0.0


def test_lwr_reaches_the_certificate() -> None:
    p = problem_of("kuka_lwr4")
    phi = p.phi(finished(p, random_vectors(p, 2)))
    assert float(phi.max()) < 1.02 * LWR_NORMAL_PHI_MIN
    assert float(phi.min()) > 0.99 * LWR_NORMAL_PHI_MIN


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["kuka_lwr4", "kuka_lwr4_friction"])
@pytest.mark.parametrize("group", ["normal", "normal_corrected", "loose_corrected"])
def test_reaches_the_certificate_from_anywhere(name: str, group: str) -> None:
    """Not below the dual's proven bound, and within two per cent of it."""
    from torchid.extraction.convex.certificate import certificate

    p = problem_of(name, group)
    proven = certificate(p)
    phi = p.phi(finished(p, random_vectors(p, 6)))
    assert float(phi.max()) <= 1.02 * proven.phi_min
    assert float(phi.min()) >= proven.phi_min * (1 - 1e-9)


def test_with_shapes_and_total_mass() -> None:
    p = asking(
        problem_of("3r", shapes=True),
        total_mass=torch.tensor([5.4, torch.inf], dtype=torch.float64),
    )
    q = finished(p, random_vectors(p, 5))
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
    starts = random_vectors(p, 5)
    broken = starts.clone()
    broken[2, 4] = bad
    expected, found = (finished(p, q, conditions=conditions) for q in (starts, broken))
    others = [0, 1, 3, 4]
    assert torch.equal(found[others], expected[others])
    assert torch.equal(found[2].isfinite(), broken[2].isfinite())
    assert torch.equal(found[2, 5:], broken[2, 5:])


@pytest.mark.nightly
def test_no_run_depends_on_how_long_another_takes() -> None:
    p = problem_of("kuka_lwr4", "loose")
    starts = random_vectors(p, 4)
    other = starts.clone()
    other[3] = p.box.mean(-1)
    a, b = (finished(p, q, conditions=False) for q in (starts, other))
    assert torch.equal(a[:3], b[:3])
    assert not torch.equal(a[3], b[3])


@pytest.mark.nightly
@pytest.mark.parametrize("conditions", [True, False])
def test_runs_stay_different(conditions: bool) -> None:
    """The 3R's loss leaves 15 directions free; each run keeps what it had in them."""
    p = problem_of("3r", "loose")
    starts = random_vectors(p, 8)
    begun, ended = p.unit(starts), p.unit(finished(p, starts, conditions=conditions))
    # Half of the 30 directions are the loss's, in which all runs agree in the end.
    before, after = torch.pdist(begun), torch.pdist(ended)
    assert float(after.median()) > 0.3 * float(before.median())
    assert float(after.min()) > 0.05 * float(before.min())
    assert torch.linalg.matrix_rank(ended - ended.mean(0), rtol=1e-3) == 7
    if conditions:
        return  # far from where they began: none of these is feasible
    # Where a run lies among the others is where it began among the others, mostly; by chance
    # it would be for one of eight.
    place, origin = (torch.nn.functional.normalize(x - x.mean(0)) for x in (ended, begun))
    assert int(((place @ origin.T).argmax(-1) == torch.arange(8)).sum()) >= 5


# ---- regions with something impossible in them ----------------------------------------------


def test_excluded_box_is_kept_to_its_nearest_face() -> None:
    p = problem_of("kuka_lwr4", "loose")
    q = finished(p, random_vectors(p, 3))
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
    assert torch.equal(finished(p, q, conditions=conditions), q)


def test_an_impossible_inertia_leaves_the_bounds() -> None:
    def flat(b):  # type: ignore[no-untyped-def]
        b.inertia[1, [0, 3, 5]] = torch.tensor(
            [[0.4, 0.5], [0.0, 0.1], [0.0, 0.1]], dtype=torch.float64
        )
        return b

    p = bounded(problem_of("3r"), flat)
    starts = random_vectors(p, 3)
    q = finished(p, starts)
    assert_within(p, q)
    assert float(p.phi(q).max()) < 1e-2 * float(p.phi(starts).min())


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
    q = finished(p, random_vectors(p, 4))
    assert float(p.phi(q).max()) <= 1e-16


# ---- what is excluded ------------------------------------------------------------------------

EXCLUDED = {("kuka_lwr4", "loose"), ("kuka_lwr4", "tight"), ("kuka_lwr4", "tight_corrected")}


def excluded(name: str, group: str) -> bool:
    """Groups whose c7z box does not meet the geometry's, [0.1, 0.2]."""
    return (name.removesuffix("_friction"), group) in EXCLUDED


def assert_attained(p: Problem) -> Tensor:
    """Some set within the bounds meets every condition asked for."""
    q = finished(p, random_vectors(p, 1))
    assert_within(p, q)
    checked = feasibility(p.sets(q, ["x"]), p.conditions)
    assert bool(checked.feasible[0]), checked.reasons(0)
    return q


@pytest.mark.parametrize(("name", "group"), GROUPS)
def test_built_in_groups(name: str, group: str) -> None:
    p = problem_of(name, group)
    _, against = attainable(p)
    assert against == (("com_7z",) if excluded(name, group) else ())
    if not against and name.startswith("3r"):
        assert_attained(p)


@pytest.mark.parametrize("name", ["3r", "3r_friction"])
@pytest.mark.parametrize("group", ["loose", "normal", "tight"])
def test_with_cylinders_and_total_mass(name: str, group: str) -> None:
    for total in ((5.0, 5.6), (5.0, torch.inf), (-torch.inf, 5.0)):
        p = asking(
            problem_of(name, group, True), total_mass=torch.tensor(total, dtype=torch.float64)
        )
        _, against = attainable(p)
        assert against == ()
        assert_attained(p)


# ---- contradictions -------------------------------------------------------------------------


def set_mass(low: float, high: float, links: slice = slice(None)) -> Callable[[Bounds], Bounds]:
    def change(b: Bounds) -> Bounds:
        b.mass[links] = torch.tensor([low, high], dtype=torch.float64)
        return b

    return change


def set_inertia(link: int, *rows: tuple[float, float]) -> Callable[[Bounds], Bounds]:
    def change(b: Bounds) -> Bounds:
        b.inertia[link] = torch.tensor(rows, dtype=torch.float64)
        return b

    return change


ANY, DIAGONAL = (-0.5, 0.5), (0.0, 0.5)


@pytest.mark.parametrize("total", [(100.0, 120.0), (-5.0, -1.0), (10.0, torch.inf)])
def test_impossible_total_mass(total: tuple[float, float]) -> None:
    """The bounds of the 3R allow 0 to 10 kg."""
    p = asking(problem_of("3r"), total_mass=torch.tensor(total, dtype=torch.float64))
    within, against = attainable(p)
    assert against == ("total_mass",)
    # Left out, so that the rest can be searched.
    assert bool(within.conditions.total_mass.isinf().all())


def test_masses_that_may_be_negative_are_cut_at_zero() -> None:
    p = bounded(problem_of("3r"), set_mass(-2.0, 1.0))
    _, against = attainable(p)
    assert against == ()
    assert float(p.split(assert_attained(p))[0].min()) > 0


@pytest.mark.parametrize(
    "rows",
    [
        ((0.4, 0.5), ANY, ANY, (0.0, 0.1), ANY, (0.0, 0.1)),  # xx > yy + zz
        ((0.0, 0.1), (0.3, 0.5), ANY, (0.0, 0.1), ANY, (0.0, 0.1)),  # xy^2 > xx yy
        ((-0.5, -0.1), ANY, ANY, DIAGONAL, ANY, DIAGONAL),
    ],
)
def test_impossible_inertias(rows: tuple[tuple[float, float], ...]) -> None:
    p = bounded(problem_of("3r"), set_inertia(1, *rows))
    assert attainable(p)[1] == ("inertia_2",)


@pytest.mark.parametrize(
    "rows",
    [
        ((0.4, 0.5), ANY, ANY, (0.0, 0.26), ANY, (0.0, 0.16)),  # xx < yy + zz in a corner
        (DIAGONAL, (0.0, 0.5), (0.0, 0.5), DIAGONAL, (0.0, 0.5), DIAGONAL),  # from 0 exactly
        (DIAGONAL, (0.1, 0.5), ANY, DIAGONAL, ANY, DIAGONAL),  # not zero
        (DIAGONAL, (0.05, 0.5), (-0.5, -0.05), DIAGONAL, (0.05, 0.5), DIAGONAL),
        ((0.19, 0.21), (0.09, 0.11), ANY, (0.19, 0.21), ANY, (0.05, 0.5)),
    ],
)
def test_inertias_that_are_just_possible(rows: tuple[tuple[float, float], ...]) -> None:
    p = bounded(problem_of("3r"), set_inertia(1, *rows))
    _, against = attainable(p)
    assert against == ()
    assert_attained(p)


@settings(max_examples=40)
@given(
    low=st.lists(st.floats(0.0, 0.4), min_size=3, max_size=3),
    span=st.lists(st.floats(0.02, 0.3), min_size=3, max_size=3),
)
def test_diagonal_boxes_are_judged_by_their_best_corner(
    low: list[float], span: list[float]
) -> None:
    """With off-diagonal entries free about 0 the closed form is: some diagonal within the box has
    every entry below the sum of the others. The best one lowers an entry at a time."""
    high = [a + b for a, b in zip(low, span, strict=True)]
    margins = [sum(high) - high[k] - low[k] for k in range(3)]
    if min(abs(m) for m in margins) < 0.02:
        return  # nearly on the boundary: either answer will do
    (a, b), (c, d), (e, f) = zip(low, high, strict=True)
    p = bounded(problem_of("3r"), set_inertia(0, (a, b), ANY, ANY, (c, d), ANY, (e, f)))
    _, against = attainable(p)
    assert (against == ()) == (min(margins) > 0)


def with_sphere(radius: float, centre: list[float], link: int = 1) -> Problem:
    p = problem_of("3r")
    c = p.conditions
    r, axes, at = c.round_radius.clone(), c.round_axes.clone(), c.round_centre.clone()
    r[link], axes[link], at[link] = radius, 1.0, torch.tensor(centre, dtype=torch.float64)
    return asking(p, round_radius=r, round_axes=axes, round_centre=at)


def test_impossible_shape() -> None:
    """Link 2's box ends at c2z = 0.035."""
    p = with_sphere(0.05, [-0.1, 0.0, 0.2])
    within, against = attainable(p)
    assert against == ("shape_2",)
    assert bool(within.conditions.round_radius.isinf().all())


@pytest.mark.parametrize("radius", [0.17, 0.166, 0.1652, 0.165001])
def test_shape_that_just_reaches_into_the_box(radius: float) -> None:
    p = with_sphere(radius, [-0.1, 0.0, 0.2])
    _, against = attainable(p)
    if against:
        assert against == ("shape_2",)  # too little to search in
        assert radius < 0.1651
    else:
        assert_attained(p)


def test_several_contradictions_are_all_named() -> None:
    p = bounded(problem_of("3r"), set_mass(-2.0, -1.0))
    p = asking(
        p,
        total_mass=torch.tensor([1.0, 2.0], dtype=torch.float64),
        com_box=torch.tensor([5.0, 6.0], dtype=torch.float64).repeat(3, 3, 1),
    )
    masses = tuple(f"mass_{i}" for i in (1, 2, 3))
    boxes = tuple(f"com_{i}{a}" for i in (1, 2, 3) for a in "xyz")
    assert attainable(p)[1] == (*masses, *boxes, "total_mass")
