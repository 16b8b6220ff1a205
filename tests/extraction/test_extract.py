"""Algorithm 1 as a whole, on budgets of a second."""

import math

import pytest
import torch

from tests.extraction.setups import asking, bounded, problem_of
from torchid.errors import TorchidError
from torchid.extraction import extract as room
from torchid.extraction.cma.search import default_population
from torchid.extraction.extract import Extraction, SearchSettings, extract, require_possible
from torchid.extraction.penalty import gamma
from torchid.extraction.problem import Problem
from torchid.feasibility.margins import feasibility

SMALL = SearchSettings(runs=4, stages=4, generations=25, seed=1)


def with_settings(**changes: object) -> SearchSettings:
    return SearchSettings(**{"runs": 4, "stages": 4, "generations": 25, "seed": 1} | changes)


def assert_same(a: Extraction, b: Extraction) -> None:
    """To the last bit."""
    for name in ("phi", "gamma", "history_phi", "history_gamma"):
        assert torch.equal(getattr(a, name), getattr(b, name)), name
    assert torch.equal(a.sets.vector, b.sets.vector)


# ---- settings -------------------------------------------------------------------------------


def test_weights_of_the_two_schedules() -> None:
    """Algorithm 1 prints xi_1 = 0 and xi_{k+1} = 10 k; the text, ten times more at every stage."""
    linear, geometric = with_settings(), with_settings(schedule="geometric")
    assert [linear.weight(k) for k in range(5)] == [0, 10, 20, 30, 40]
    assert [geometric.weight(k) for k in range(5)] == [0, 10, 100, 1000, 10000]
    partial = with_settings(penalty="partial", schedule="geometric")
    assert [partial.weight(k) for k in range(5)] == [0.0] * 5


def test_every_stage_of_the_geometric_schedule_has_a_weight() -> None:
    most = SearchSettings(schedule="geometric", stages=300)
    assert math.isfinite(1e3 * most.weight(300))
    with pytest.raises(TorchidError, match="too many stages"):
        SearchSettings(schedule="geometric", stages=301)


@pytest.mark.parametrize("name", ["runs", "stages", "generations"])
@pytest.mark.parametrize("value", [0, -3])
def test_counts_below_one_are_refused(name: str, value: int) -> None:
    with pytest.raises(TorchidError, match=name) as caught:
        with_settings(**{name: value})
    assert str(value) in str(caught.value)


@pytest.mark.usefixtures("types_unchecked")
@pytest.mark.parametrize(
    ("name", "known"),
    [("penalty", "partial"), ("schedule", "geometric")],
)
def test_unknown_names_are_refused(name: str, known: str) -> None:
    with pytest.raises(TorchidError, match=f"unknown {name}") as caught:
        with_settings(**{name: "other"})
    assert caught.value.got == "other"
    assert known in (caught.value.available or [])


# ---- what comes out -------------------------------------------------------------------------


def assert_consistent(p: Problem, found: Extraction, settings: SearchSettings) -> None:
    """The figures are those of the sets, and the history's last column is what was searched."""
    q = found.sets.search_vector
    torch.testing.assert_close(p.phi(q), found.phi, rtol=1e-6, atol=1e-20)
    torch.testing.assert_close(gamma(p, q), found.gamma, rtol=1e-6, atol=1e-12)
    shape = (settings.runs, settings.stages)
    assert found.history_phi.shape == found.history_gamma.shape == shape
    low, high = p.box.unbind(-1)
    slack = 1e-9 * (high - low)
    assert bool(((q >= low - slack) & (q <= high + slack)).all())
    weight = settings.weight(settings.stages)
    assert found.best == int((found.phi + weight * found.gamma).argmin())


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"penalty": "partial"},
        {"schedule": "geometric"},
        {"stages": 1, "runs": 1, "population": 6},
    ],
)
def test_figures_are_those_of_the_sets(changes: dict[str, object]) -> None:
    p, settings = problem_of("3r_friction"), with_settings(**changes)
    assert_consistent(p, extract(p, settings), settings)


def test_partial_loss_ignores_gamma() -> None:
    """It descends further, ends outside physics, and says so in gamma."""
    p = problem_of("3r", "loose")
    partial = extract(p, with_settings(penalty="partial"))
    full = extract(p, SMALL)
    assert float(partial.phi.max()) < 1e-18
    assert float(partial.gamma.min()) > 0.0
    assert partial.best == int(partial.phi.argmin())
    assert not bool(feasibility(partial.sets, p.conditions).feasible.any())
    assert float(full.gamma.max()) == 0.0
    # The first stage is the same for both: xi_1 = 0.
    assert torch.equal(partial.history_phi[:, 0], full.history_phi[:, 0])
    assert not torch.equal(partial.history_phi[:, 1], full.history_phi[:, 1])


def test_partial_loss_does_not_read_the_conditions() -> None:
    p = problem_of("3r")
    other = asking(p, total_mass=torch.tensor([100.0, 200.0], dtype=torch.float64))
    settings = with_settings(penalty="partial")
    a, b = extract(p, settings), extract(other, settings)
    assert torch.equal(a.sets.vector, b.sets.vector)
    assert b.contradictions == ("total_mass",)


def assert_descends(found: Extraction) -> None:
    """No stage ends above where it began, in its own loss phi + xi gamma: the best is kept."""
    phi, violated, settings = found.history_phi, found.history_gamma, found.settings
    for k in range(1, settings.stages):
        xi = settings.weight(k)
        began = phi[:, k - 1] + xi * violated[:, k - 1]
        ended = phi[:, k] + xi * violated[:, k]
        # The search's gamma is in closed form, the history's from LAPACK.
        assert bool((ended <= began + 1e-6 * (1 + xi)).all())
    last = settings.weight(settings.stages - 1)
    final = phi[:, -1] + last * violated[:, -1]
    assert bool((final < phi[:, 0] + last * violated[:, 0]).all())


@pytest.mark.parametrize("changes", [{}, {"penalty": "partial"}, {"schedule": "geometric"}])
def test_search_alone_descends(changes: dict[str, object]) -> None:
    settings = with_settings(stages=6, **changes)
    found = extract(problem_of("3r"), settings)
    assert_descends(found)


def test_global_random_state_is_neither_read_nor_changed() -> None:
    p = problem_of("3r")
    torch.manual_seed(5)
    before = torch.get_rng_state()
    a = extract(p, SMALL)
    assert torch.equal(before, torch.get_rng_state())
    torch.manual_seed(6)
    assert_same(a, extract(p, SMALL))


@pytest.fixture
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three runs of the 3R and more."""
    monkeypatch.setattr(room, "BLOCK", 3 * 30 * default_population(30))


@pytest.mark.nightly
@pytest.mark.usefixtures("small_blocks")
def test_the_bits_do_not_depend_on_the_number_of_processes() -> None:
    p, settings = problem_of("3r"), with_settings(runs=10)
    found = extract(p, settings)
    for workers in (2, 8):
        assert_same(extract(p, settings, workers=workers), found)


@pytest.mark.usefixtures("small_blocks")
def test_blocks_search_elsewhere() -> None:
    p = problem_of("3r")
    few, many = (extract(p, with_settings(runs=k, stages=2)) for k in (4, 8))
    assert torch.equal(few.sets.vector, many.sets.vector[:4])
    assert not torch.equal(many.sets.vector[4:], many.sets.vector[:4])


def test_progress_is_reported() -> None:
    seen: list[tuple[int, int]] = []
    extract(problem_of("3r"), SMALL, report=lambda done, of: seen.append((done, of)))
    assert seen == [(1, 4), (2, 4), (3, 4), (4, 4)]


def test_on_a_device(device: torch.device) -> None:
    found = extract(problem_of("3r"), SMALL, device=device)
    assert found.phi.device.type == "cpu"
    assert float(found.phi.max()) < 1e-18


# ---- what cannot be --------------------------------------------------------------------------


def test_impossible_problems_are_named_before_the_search() -> None:
    with pytest.raises(TorchidError, match="'loose'") as caught:
        require_possible(problem_of("kuka_lwr4", "loose"))
    assert caught.value.got == "com_7z"
    heavy = asking(problem_of("3r"), total_mass=torch.tensor([100.0, 200.0], dtype=torch.float64))
    with pytest.raises(TorchidError, match="no feasible set") as caught:
        require_possible(heavy)
    assert caught.value.got == "total_mass"


@pytest.mark.slow
def test_impossible_problems_can_be_searched_all_the_same() -> None:
    """The report's loose sets: all violate com_7z, and only that."""
    p = problem_of("kuka_lwr4", "loose")
    found = extract(p, SMALL)
    assert found.contradictions == ("com_7z",)
    reasons = [feasibility(found.sets, p.conditions).reasons(k) for k in range(4)]
    assert reasons == [("com_7z",)] * 4
    torch.testing.assert_close(
        found.gamma, torch.full((4,), 1.0, dtype=torch.float64), rtol=0, atol=1e-4
    )


def test_bounds_of_negative_masses_end_in_numbers() -> None:
    def negative(b):  # type: ignore[no-untyped-def]
        b.mass[1] = torch.tensor([-2.0, -1.0], dtype=torch.float64)
        return b

    p = bounded(problem_of("3r"), negative)
    found = extract(p, SMALL)
    assert found.contradictions == ("mass_2",)
    assert bool(found.phi.isfinite().all())
    assert bool((found.gamma >= 0.5).all())  # a mass of -1 kg at best, of 2
