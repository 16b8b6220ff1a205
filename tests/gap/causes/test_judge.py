import numpy as np
import pytest
import torch

from tests.gap.causes.problems import NAMES, candidate, problem, search
from torchid.gap.causes.candidates import Library
from torchid.gap.causes.judge import judge, judged, probabilities
from torchid.gap.causes.search import Search
from torchid.statistics.bagging import Draws

NOTHING_LEFT = np.zeros(4)


def test_what_is_there_is_sure_and_what_is_not_is_nothing() -> None:
    of = search("viscous_friction")
    there, extra = candidate(of, "viscous_friction", 1), candidate(of, "torque_offset", 0)
    fit = of.evidence.fit((there, extra), of.library.rows)
    one, other = judge(of, fit, NOTHING_LEFT, problem("viscous_friction").draws)
    assert one.sure > 0.95
    assert one.name is there
    assert other.nothing > 0.5


def test_half_of_the_samples_have_half_of_the_price() -> None:
    """On a log drawn whole and on half of it, a cause of no torque has the odds of its price."""
    of = search(None)
    term = candidate(of, "torque_offset", 0)
    block = problem(None).block
    fit = of.evidence.fit((term,), of.library.rows)
    odds = []
    for times in (1.0, 0.5):
        count = int(block.max()) + 1
        draws = Draws(block, torch.full((1, count), times, dtype=torch.float64))
        sure, nothing = probabilities(of, fit, [of.empty()], draws)
        odds.append(np.log(sure / nothing))
    assert odds[1] == pytest.approx(odds[0] / 2, rel=1e-6)


@pytest.mark.parametrize(("share", "most"), [(0.0, 1.0), (1 / 16, 0.9), (0.25, 0.6923)])
def test_what_is_left_bounds_how_sure_a_cause_is(share: float, most: float) -> None:
    of = search("viscous_friction")
    fit = of.evidence.fit((candidate(of, "viscous_friction", 1),), of.library.rows)
    (one,) = judge(of, fit, np.full(4, share), problem("viscous_friction").draws)
    assert one.sure <= most + 1e-4
    assert one.sure > most - 0.05


def test_what_another_joint_leaves_bounds_a_cause_of_one_joint_as_the_arm_s_alone() -> None:
    of = search("viscous_friction")
    fit = of.evidence.fit((candidate(of, "viscous_friction", 1),), of.library.rows)
    (one,) = judge(of, fit, np.array([1.0, 0.0, 0.0, 0.0]), problem("viscous_friction").draws)
    assert one.sure > 0.95


def test_two_forms_of_a_law_together_are_a_rival_of_another_form() -> None:
    """Dry and viscous friction were planted, and a power of the speed stands for them."""
    asked = problem("dry_and_viscous", names=(*NAMES, "power_law_friction"))
    of = Search(Library(asked))
    power = max(
        (t for t in of.library.terms if (t.name, t.joints) == ("power_law_friction", (1,))),
        key=lambda t: of.evidence.value(of.evidence.fit((t,), of.library.rows)),
    )
    fit = of.again(of.evidence.fit((power,), of.library.rows))
    ((forms, pair),) = of.other_forms(fit, (power.law, power.since))
    assert {t.name for t in forms} == {"viscous_friction", "coulomb_friction"}
    assert of.evidence.over(pair, fit) > 0


def test_the_two_forms_that_are_there_are_sure() -> None:
    of = search("dry_and_viscous")
    pair = tuple(candidate(of, name, 1) for name in ("viscous_friction", "coulomb_friction"))
    fit = of.again(of.evidence.fit(pair, of.library.rows))
    for one in judge(of, fit, NOTHING_LEFT, problem("dry_and_viscous").draws):
        assert one.sure > 0.9


def test_rivals_of_one_term_of_a_law_are_none_of_the_next() -> None:
    """Two other forms of the law stand for both terms, what else was tried for one alone."""
    asked = problem("dry_and_viscous", names=(*NAMES, "power_law_friction"))
    of = Search(Library(asked))
    names = ("viscous_friction", "coulomb_friction")
    terms = tuple(candidate(of, name, 1) for name in names)
    fit = of.again(of.evidence.fit(terms, of.library.rows))
    law = terms[0].law, terms[0].since
    forms = [[t.name for t in some] for some, _ in of.other_forms(fit, law)]
    assert judged(of, fit, terms[0], NOTHING_LEFT, asked.draws).own > 0.5
    assert [[t.name for t in some] for some, _ in of.other_forms(fit, law)] == forms
