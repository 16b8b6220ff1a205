"""What joins once others have left, and shapes that the grid does not hold."""

from dataclasses import replace

import pytest
import torch

from tests.gap.motions import ROBOT
from tests.gap.problems import (
    SIMPLE,
    measured,
    named,
    problem_of,
    question_of,
    term,
    two_folds,
    wanted_of,
)
from tests.gap.search.beside import offers
from torchid.design.columns import Columns, Model
from torchid.effects.friction import CoulombFriction, TorqueOffset, ViscousFriction
from torchid.effects.friction_laws import PowerLawFriction
from torchid.effects.periodic import Cogging
from torchid.effects.transient import Saturation
from torchid.gap.search import explain
from torchid.gap.search.climb import candidate_moves, climb_from, drop_worthless, fit_anew
from torchid.gap.search.evidence import comparable
from torchid.gap.search.explain import (
    Explanation,
    beside_small,
    improve_by_swaps,
    refine_shapes,
    search_again_without,
    search_without_small,
    settle,
    solve,
    terms_without_torque,
)
from torchid.gap.search.solve import solve_terms
from torchid.gap.search.terms import Term


def test_what_is_barred_is_not_offered() -> None:
    question = question_of(measured([(CoulombFriction(1), [0.6])]))
    dry = term(question, "coulomb_friction", 1)
    barred = replace(question, barred=frozenset([dry.key]))
    empty = fit_anew(question)
    assert any(o.term.key == dry.key for o in offers(question, empty))
    assert not any(o.term.key == dry.key for o in offers(barred, empty))
    assert ("coulomb_friction", 1) not in named(climb_from(barred, ()).terms)


def test_the_search_goes_on_without_what_has_left() -> None:
    """Viscous friction has left, which the search may not take again; dry friction, which it stood
    for, joins in its place."""
    data = measured([(CoulombFriction(1), [0.6]), (ViscousFriction(0), [0.8])])
    question = question_of(data, parts=two_folds(data))
    folds = question.candidates.gram.folds()
    left = [term(question, "viscous_friction", 1)]
    start, _ = drop_worthless(
        question, folds, fit_anew(question, [term(question, "viscous_friction", 0)])
    )
    fit, gone = search_without_small(question, folds, start, left)
    assert named(fit.terms) == {("coulomb_friction", 1), ("viscous_friction", 0)}
    assert gone == left
    # Where nothing has left nothing is looked for.
    same, none = search_without_small(question, folds, start, [])
    assert same is start
    assert none == []


@pytest.mark.parametrize("small", [True, False])
def test_a_cause_does_not_give_way_to_one_that_holds_what_is_too_small(small: bool) -> None:
    """Viscous friction, beside a steep power law that has no name: a flat one holds most of both,
    and takes the place of viscous friction where the steep one is forgotten."""
    steep = PowerLawFriction(1, 2.5)
    names = (*SIMPLE, "power_law_friction")
    data = measured([(steep, [0.3]), (ViscousFriction(1), [0.8])], noise=0.01)
    question = question_of(data, names, parts=two_folds(data))
    folds = question.candidates.gram.folds()
    viscous = fit_anew(question, [term(question, "viscous_friction", 1)])
    left = [t for t in question.candidates.terms if t.effects == (steep,) and small]
    fit, _ = improve_by_swaps(question, folds, viscous, left)
    assert (named(fit.terms) == {("viscous_friction", 1)}) is small


def test_only_what_the_evidence_has_is_beside_an_explanation() -> None:
    data = measured([(CoulombFriction(1), [0.1]), (ViscousFriction(1), [0.8])], noise=0.01)
    question = question_of(data)
    fit = fit_anew(question, [term(question, "viscous_friction", 1)])
    others = [("coulomb_friction", 1), ("torque_offset", 2), ("viscous_friction", 1)]
    whole = beside_small(question, fit, [term(question, *one) for one in others])
    assert named(whole.terms) == {("viscous_friction", 1), ("coulomb_friction", 1)}
    assert beside_small(question, fit, []) is fit


def test_another_cause_may_follow_one_that_was_refused() -> None:
    """Dry friction, which has been refused a name, does not come back; what says most of it in its
    place does."""
    data = measured([(CoulombFriction(1), [0.6]), (ViscousFriction(0), [0.8])])
    question = question_of(data, parts=two_folds(data))
    dry, viscous = term(question, "coulomb_friction", 1), term(question, "viscous_friction", 0)
    empty = fit_anew(question)
    problem = problem_of(data, wanted_of(SIMPLE))
    fit = fit_anew(question, [viscous])
    solution = solve(problem, fit)
    without = Explanation(question, empty, fit, (dry,), solution)
    more = search_again_without(without, [dry], problem)
    assert ("coulomb_friction", 1) not in named(more.terms)
    assert named(more.terms) > {("viscous_friction", 0)}
    assert dry.key in more.question.barred
    second = [t for t in more.terms if t.place == 1]
    again = search_again_without(more, second, problem)
    assert again.question.barred >= more.question.barred
    # Where nothing more is barred nothing is looked for again.
    complete = replace(more, unworthy=())
    assert search_again_without(complete, [dry], problem) is complete


@pytest.mark.parametrize("between", [0.35, 0.5])
def test_a_shape_between_those_of_the_grid_is_found_before_its_cause_is(between: float) -> None:
    """Cogging whose period lies between two of the grid's has its shape refined although it is no
    term yet, and more evidence with the shape that is found."""
    names = (*SIMPLE, "cogging")
    data = measured([], noise=0.0)
    grid = sorted(
        {t.effects[0].k for t in question_of(data, names).candidates.terms if t.name == "cogging"}
    )
    k = grid[3] + between * (grid[4] - grid[3])
    data = measured([(Cogging(1, k=k), [0.2, 0.1])])
    question = question_of(data, names)
    empty = fit_anew(question)
    (best, *_) = (m for _, m in candidate_moves(question, empty) if m[0].name == "cogging")
    (finer,) = (e for e in refine_shapes(question, empty) if e.name == "cogging" and e.joint == 1)
    assert abs(finer.k - k) < 0.2 * abs(best[0].effects[0].k - k)
    again = question_of(data, names, extra=[finer])
    (own,) = (t for t in again.candidates.terms if t.effects == (finer,))
    (near,) = (t for t in again.candidates.terms if t.effects == best[0].effects)
    with_it, without = comparable(again, fit_anew(again, [own]), fit_anew(again, [near]))
    assert with_it.evidence > without.evidence
    assert torch.isfinite(torch.tensor(with_it.evidence))


def test_what_makes_no_torque_at_the_corrected_model_vanishes() -> None:
    """A clip that the torque of the model as given would meet, and that of the corrected one, whose
    offset takes it away from there, does not."""
    quiet = measured([(TorqueOffset(1), [-60.0])])
    reached = max(float(s.tau[:, 1].abs().max()) for s in quiet.segments)
    clip, offset = Saturation(1, limit=1.02 * reached), TorqueOffset(1)
    data = measured([(offset, [-60.0]), (CoulombFriction(0), [0.8])])
    names = ("torque_offset", "coulomb_friction", "saturation")
    question = question_of(data, names, extra=[clip])
    blocks = torch.arange(len(data.samples)) // 100

    def told(*terms: Term) -> list[tuple[str, int | None]]:
        fit = fit_anew(question, terms)
        columns = Columns(Model(ROBOT, ()), data.samples)
        solution = solve_terms(columns, fit.terms, fit.values(), data, wanted_of(names), blocks)
        return [(t.name, t.place) for t in terms_without_torque(question, solution)]

    friction = term(question, "coulomb_friction", 0)
    clipped = next(t for t in question.candidates.terms if t.effects == (clip,))
    assert bool(clipped.at.numel())  # the model as given would meet it
    assert told(term(question, "torque_offset", 1), friction, clipped) == [("saturation", 1)]
    assert told(term(question, "torque_offset", 1), friction) == []


def test_swaps_and_the_search_without_small_causes_end_where_neither_helps() -> None:
    data = measured([(CoulombFriction(1), [0.6]), (ViscousFriction(0), [0.8])])
    question = question_of(data, parts=two_folds(data))
    folds = question.candidates.gram.folds()
    start = fit_anew(question, [term(question, "viscous_friction", 1)])
    small = [term(question, "rotor_inertia", 1)]
    fit, left = settle(question, folds, start, small)
    assert named(fit.terms) == {("coulomb_friction", 1), ("viscous_friction", 0)}
    same, _ = settle(question, folds, fit, left)
    assert same is fit


def test_swaps_that_go_round_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two fits each may be better than the other: samples count as what the pair leaves."""
    data = measured([(CoulombFriction(1), [0.6])])
    question = question_of(data, parts=two_folds(data))
    terms = (term(question, name, 1) for name in ("viscous_friction", "coulomb_friction"))
    one, two = (fit_anew(question, [t]) for t in terms)
    monkeypatch.setattr(explain, "swap_term", lambda _, fit, every: two if fit is one else one)
    monkeypatch.setattr(explain, "drop_worthless", lambda _, __, fit: (fit, []))
    monkeypatch.setattr(explain, "most_evident", lambda _, fits: fits[-1])
    fit, _ = improve_by_swaps(question, question.candidates.gram.folds(), one, [])
    assert fit in (one, two)
