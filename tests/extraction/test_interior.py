"""The region of a search: a point strictly inside it, or the names of what excludes what."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.extraction.setups import GROUPS, asking, bounded, problem_of
from torchid.extraction.penalty import gamma
from torchid.extraction.polish.region import Region, region, second_moments
from torchid.extraction.problem import Problem
from torchid.feasibility.bounds import Bounds
from torchid.feasibility.margins import feasibility
from torchid.robot.inertia import symmetric

EXCLUDED = {("kuka_lwr4", "loose"), ("kuka_lwr4", "tight"), ("kuka_lwr4", "tight_corrected")}


def excluded(name: str, group: str) -> bool:
    """Groups whose c7z box does not meet the geometry's, [0.1, 0.2]."""
    return (name.removesuffix("_friction"), group) in EXCLUDED


def assert_inside(p: Problem, found: Region) -> None:
    """Strictly within the region's box, the bounds and every condition asked for."""
    point = found.inside
    assert bool((point > found.box[:, 0]).all())
    assert bool((point < found.box[:, 1]).all())
    assert bool((found.box[:, 0] >= p.box[:, 0]).all())
    assert bool((found.box[:, 1] <= p.box[:, 1]).all())
    if found.physical and not found.contradictions:
        checked = feasibility(p.sets(point.unsqueeze(0), ["x"]), p.conditions)
        assert bool(checked.feasible[0]), checked.reasons(0)
        assert float(checked.degree[0]) > 1e-6
        assert float(gamma(p, point)) == 0.0


@pytest.mark.parametrize(("name", "group"), GROUPS)
def test_built_in_groups(name: str, group: str) -> None:
    p = problem_of(name, group)
    found = region(p, conditions=True)
    assert found.contradictions == (("com_7z",) if excluded(name, group) else ())
    assert found.physical
    assert_inside(p, found)
    if found.contradictions:
        checked = feasibility(p.sets(found.inside.unsqueeze(0), ["x"]), p.conditions)
        assert checked.reasons(0) == ("com_7z",)


@pytest.mark.parametrize(("name", "group"), GROUPS)
def test_partial_loss_has_the_bounds_alone(name: str, group: str) -> None:
    p = problem_of(name, group)
    found = region(p, conditions=False)
    assert torch.equal(found.box, p.box)
    assert not found.physical
    assert found.contradictions == ()
    assert_inside(p, found)


@pytest.mark.parametrize("name", ["3r", "3r_friction"])
@pytest.mark.parametrize("group", ["loose", "normal", "tight"])
def test_with_cylinders_and_total_mass(name: str, group: str) -> None:
    for total in ((5.0, 5.6), (5.0, torch.inf), (-torch.inf, 5.0)):
        p = asking(
            problem_of(name, group, True), total_mass=torch.tensor(total, dtype=torch.float64)
        )
        found = region(p, conditions=True)
        assert found.contradictions == ()
        assert bool(found.round_links.all())
        assert bool(found.total_mass.isfinite().all())
        assert_inside(p, found)


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
    found = region(p, conditions=True)
    assert found.contradictions == ("total_mass",)
    assert bool(found.total_mass.isinf().all())  # left out, so that the rest can be searched
    assert found.physical


def test_negative_masses_only() -> None:
    p = bounded(problem_of("3r"), set_mass(-2.0, -1.0, slice(1, 2)))
    found = region(p, conditions=True)
    assert found.contradictions == ("mass_2",)
    assert bool((found.inside > found.box[:, 0]).all())
    assert bool((found.inside < found.box[:, 1]).all())


def test_masses_that_may_be_negative_are_cut_at_zero() -> None:
    p = bounded(problem_of("3r"), set_mass(-2.0, 1.0))
    found = region(p, conditions=True)
    assert found.contradictions == ()
    assert found.box[:3].tolist() == [[0.0, 1.0]] * 3
    assert_inside(p, found)


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
    assert region(p, conditions=True).contradictions == ("inertia_2",)


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
    found = region(p, conditions=True)
    assert found.contradictions == ()
    assert_inside(p, found)


@settings(max_examples=40, deadline=None)
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
    found = region(p, conditions=True)
    assert (found.contradictions == ()) == (min(margins) > 0)
    if min(margins) > 0:
        assert_inside(p, found)


def with_sphere(radius: float, centre: list[float], link: int = 1) -> Problem:
    p = problem_of("3r")
    c = p.conditions
    r, axes, at = c.round_radius.clone(), c.round_axes.clone(), c.round_centre.clone()
    r[link], axes[link], at[link] = radius, 1.0, torch.tensor(centre, dtype=torch.float64)
    return asking(p, round_radius=r, round_axes=axes, round_centre=at)


def test_impossible_shape() -> None:
    """Link 2's box ends at c2z = 0.035."""
    p = with_sphere(0.05, [-0.1, 0.0, 0.2])
    found = region(p, conditions=True)
    assert found.contradictions == ("shape_2",)
    assert not bool(found.round_links.any())
    assert bool((found.inside < found.box[:, 1]).all())


@pytest.mark.parametrize("radius", [0.17, 0.166, 0.1652, 0.165001])
def test_shape_that_just_reaches_into_the_box(radius: float) -> None:
    p = with_sphere(radius, [-0.1, 0.0, 0.2])
    found = region(p, conditions=True)
    if found.contradictions:
        assert found.contradictions == ("shape_2",)  # too little to search in
        assert radius < 0.1651
    else:
        assert found.round_links.tolist() == [False, True, False]
        assert_inside(p, found)


def test_links_without_a_shape_stay_in_the_middle() -> None:
    """However far another link must move to get into its own."""
    p = with_sphere(0.166, [-0.1, 0.0, 0.2])
    middle = region(problem_of("3r"), conditions=True).inside
    found = region(p, conditions=True).inside
    others = [k for k in range(p.size) if k not in (6, 7, 8)]
    assert torch.equal(found[others], middle[others])


def test_several_contradictions_are_all_named() -> None:
    p = bounded(problem_of("3r"), set_mass(-2.0, -1.0))
    p = asking(
        p,
        total_mass=torch.tensor([1.0, 2.0], dtype=torch.float64),
        com_box=torch.tensor([5.0, 6.0], dtype=torch.float64).repeat(3, 3, 1),
    )
    masses = tuple(f"mass_{i}" for i in (1, 2, 3))
    boxes = tuple(f"com_{i}{a}" for i in (1, 2, 3) for a in "xyz")
    assert region(p, conditions=True).contradictions == (*masses, *boxes, "total_mass")


def test_excluded_box_leaves_the_nearest_face() -> None:
    p = problem_of("kuka_lwr4", "loose")
    found = region(p, conditions=True)
    low, high = found.box[7 + 6 * 3 + 2].tolist()
    assert low == 0.4
    assert 0.4 < high < 0.4001


def test_second_moments() -> None:
    inertia = torch.rand(5, 6, dtype=torch.float64) - 0.5
    values = torch.linalg.eigvalsh(symmetric(inertia))
    expected = (values.sum(-1, keepdim=True) / 2 - values).flip(-1)
    torch.testing.assert_close(second_moments(inertia), expected, rtol=1e-10, atol=1e-13)


def test_conditions_that_are_not_asked_change_nothing() -> None:
    p = problem_of("3r")
    free = torch.tensor([-torch.inf, torch.inf], dtype=torch.float64).repeat(3, 3, 1)
    found = region(replace(p, conditions=replace(p.conditions, com_box=free)), conditions=True)
    assert torch.equal(found.box, p.box)
    assert bool(found.total_mass.isinf().all())
