"""The search on small problems: what is planted is found, as few causes as it is."""

import pytest
import torch

from tests.gap.problems import (
    SETTINGS,
    SIMPLE,
    measured,
    named,
    question_of,
    term,
    two_folds,
)
from torchid.effects.friction import CoulombFriction, TorqueOffset, ViscousFriction
from torchid.gap.folds import make_folds
from torchid.gap.search.climb import (
    candidate_moves,
    climb_from,
    drop_worthless,
    fit_anew,
    held_out_losses,
)
from torchid.gap.search.evidence import cause_groups, fit_terms, subset_of
from torchid.gap.settings import GapSettings

PLANTED = {
    "viscous": (ViscousFriction(1), [1.0]),
    "coulomb": (CoulombFriction(0), [0.6]),
    "offset": (TorqueOffset(2), [0.3]),
}
ONE = GapSettings(max_effects=1)


@pytest.mark.parametrize("names", [(), ("viscous",), ("coulomb", "offset"), tuple(PLANTED)])
def test_what_is_planted_is_found_and_nothing_else(names):
    effects = [PLANTED[n] for n in names]
    question = question_of(measured(effects, seed=1))
    fit = climb_from(question, ())
    assert named(fit.terms) == {(e.name, e.joint) for e, _ in effects}
    found = dict(zip((t.effects[0] for t in fit.terms), fit.values(), strict=True))
    for effect, values in effects:
        assert found[effect].tolist() == pytest.approx(values, rel=0.05)
    assert (fit.evidence > 0) == bool(names)


def test_a_wrong_start_is_left():
    question = question_of(measured([PLANTED["coulomb"]]))
    start = [term(question, "rotor_inertia", 0), term(question, "viscous_friction", 2)]
    fit = climb_from(question, start)
    assert named(fit.terms) == {("coulomb_friction", 0)}


def test_no_more_causes_than_wanted():
    question = question_of(measured([PLANTED["coulomb"], PLANTED["offset"]]), settings=ONE)
    fit = climb_from(question, ())
    assert len(cause_groups(fit.terms, 3)) == 1


COMMON = [(CoulombFriction(j), [f]) for j, f in enumerate((0.3, 0.5, 0.2))]


def test_what_all_joints_have_is_one_cause():
    """Found on all three, also by a search that may name one cause only."""
    question = question_of(measured(COMMON), settings=ONE)
    fit = climb_from(question, ())
    assert named(fit.terms) == {("coulomb_friction", j) for j in range(3)}
    assert len(cause_groups(fit.terms, 3)) == 1
    assert [sorted(t.place for t in g) for g in cause_groups(fit.terms, 3)] == [[0, 1, 2]]
    together = [m for _, m in candidate_moves(question, fit_anew(question)) if len(m) == 3]
    assert any(named(m) == named(fit.terms) for m in together)


def test_causes_are_grouped_by_effect():
    question = question_of(measured([]), (*SIMPLE, "joint_spring"))
    dry = [term(question, "coulomb_friction", j) for j in range(2)]
    viscous = term(question, "viscous_friction", 0)
    springs = [term(question, "joint_spring", j) for j in range(3)]
    groups = cause_groups([*dry, viscous, *springs], 3)
    assert sorted(len(g) for g in groups) == [1, 1, 1, 1, 2]


def test_the_fitted_is_the_model_as_given():
    question = question_of(measured([]))
    fit = fit_anew(question)
    assert fit.terms == ()
    assert fit.evidence == 0.0
    assert bool((fit.effective <= question.normal.rows).all())


def test_losses_on_held_out_data_are_those_of_fits_without_them():
    """Of one term on one joint: two halves, each judged by the other's coefficient."""
    data = measured([PLANTED["viscous"]])
    parts = two_folds(data)
    question = question_of(data, parts=parts)
    viscous = term(question, "viscous_friction", 1)
    fit = fit_terms(question, [viscous], question.normal.rows)
    found = held_out_losses(question, question.candidates.gram.folds(), fit, [viscous])
    x = question.candidates.columns.of(viscous.effects[0])[1][0]
    y, keep = question.candidates.gap[1], question.candidates.keep[1]
    expected = 0.0
    for k in (1, 2):
        test, train = keep & (parts == k), keep & (parts == 3 - k)
        value = float(x[train] @ y[train] / x[train].square().sum())
        expected += float((y[test] - value * x[test]).square().sum())
    assert float(found[1]) == pytest.approx(expected)


def worthy_terms(effects, *names, settings=SETTINGS):
    data = measured(effects, noise=0.002)
    question = question_of(data, parts=two_folds(data), settings=settings)
    terms = [term(question, *n) for n in names]
    fit = fit_terms(question, terms, question.normal.rows)
    return drop_worthless(question, question.candidates.gram.folds(), fit)


def test_what_is_small_leaves_and_what_is_large_stays():
    """Both have all the evidence that one could wish."""
    effects = [(CoulombFriction(1), [0.6]), (ViscousFriction(1), [0.005])]
    both = ("coulomb_friction", 1), ("viscous_friction", 1)
    fit, left = worthy_terms(effects, *both)
    assert named(fit.terms) == {("coulomb_friction", 1)}
    assert named(left) == {("viscous_friction", 1)}
    fit, left = worthy_terms(
        effects, *both, settings=GapSettings(worthwhile=0.0, worthwhile_torque=0.0)
    )
    assert named(fit.terms) == set(both)
    assert left == []


def test_the_joints_that_hardly_bear_a_common_cause_leave_it():
    effects = [(CoulombFriction(j), [f]) for j, f in enumerate((0.6, 0.8, 0.003))]
    every = [("coulomb_friction", j) for j in range(3)]
    fit, left = worthy_terms(effects, *every)
    assert named(fit.terms) >= set(every[:2])
    assert named(left) <= {every[2]}


def test_every_fold_is_judged_by_the_others():
    """Whole runs, between which no sample lies: each is judged once, and fitted otherwise."""
    data = measured([], count=3, duration=6.0)
    folds = make_folds(data.samples, 3, (0, 1, 2))
    question = question_of(data, parts=folds.parts)
    counts = question.normal.rows
    found = question.candidates.gram.folds()
    assert len(found) == 3
    assert torch.equal(found.rows.sum(0), counts)
    fitted_on, judged_on = found.of(subset_of(question.normal, ()))
    assert torch.allclose(judged_on.squares.sum(0), question.squares)
    assert torch.allclose(fitted_on.squares.sum(0), 2 * question.squares)
