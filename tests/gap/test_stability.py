"""Which findings the folds confirm, under which name."""

from dataclasses import replace

import pytest

from tests.gap.problems import Case
from torchid.effects.friction import CoulombFriction, TorqueOffset, ViscousFriction
from torchid.effects.friction_laws import AsymmetricFriction
from torchid.gap.case import FoldModels
from torchid.gap.findings import findings
from torchid.gap.problem import Term
from torchid.gap.solve import solve
from torchid.gap.stability import stable

pytestmark = pytest.mark.usefixtures("types_unchecked")


class _Plain:
    """What `stable` needs of a case."""

    def __init__(self, case: Case):
        self.plain, self.task = case.evaluator, case.task


@pytest.fixture(scope="module")
def found():
    """Friction on joint 1, on all data."""
    case = Case([(CoulombFriction(0), [1.0])], ("coulomb_friction", "viscous_friction"))
    return case, solve(case.evaluator, case.evaluator, case.keep, case.task, case.banks)


def judged(found, *folds: tuple[Term, ...]):
    case, whole = found
    models = FoldModels([], [], [], list(folds))
    return stable(_Plain(case), whole, findings(whole), models)


def like(term: Term, effect) -> Term:
    place = effect.joint
    return replace(term, name=effect.name, place=place, effects=(effect,))


def test_what_most_folds_find_stays(found):
    (term,) = found[1].terms
    assert term.name == "coulomb_friction"
    whole, kept, doubts = judged(found, (term,), (term,), ())
    assert whole.terms == (term,)
    assert not doubts
    assert kept.effects[0].ambiguous_with == ()


def test_what_few_folds_find_leaves_and_that_is_said(found):
    (term,) = found[1].terms
    other = like(term, CoulombFriction(1))
    whole, kept, doubts = judged(found, (term,), (other,), ())
    assert not whole.terms
    assert not kept.effects
    assert "coulomb_friction of joint 1" in doubts[0]
    assert "1 of 3" in doubts[0]


def test_where_folds_give_another_name_of_the_family_both_are_told(found):
    """Not `no gap` because the folds disagree about its name."""
    case, whole = found
    (term,) = whole.terms
    mine = like(term, AsymmetricFriction(0))
    renamed = replace(whole, terms=(mine,))
    entries = findings(whole)
    entries = replace(entries, terms=(mine,))
    rival = like(term, TorqueOffset(0))
    models = FoldModels([], [], [], [(mine,), (rival,), (rival,), (rival,)])
    _, kept, doubts = stable(_Plain(case), renamed, entries, models)
    assert not doubts
    assert kept.effects[0].ambiguous_with == ("torque_offset",)
    stranger = like(term, ViscousFriction(0))
    models = FoldModels([], [], [], [(mine,), (stranger,), (stranger,), (stranger,)])
    _, _, doubts = stable(_Plain(case), whole, findings(whole), models)
    assert len(doubts) == 1
