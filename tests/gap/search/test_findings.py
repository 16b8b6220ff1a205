"""What is told: of a load beside corrected base parameters, which do whatever it does; of
alternatives."""

import pytest
import torch

from tests.gap.motions import ROBOT
from tests.gap.problems import measured, question_of, term, wanted_of
from torchid.design.columns import Columns, Model
from torchid.effects.friction_laws import PowerLawFriction
from torchid.effects.inertia import Payload
from torchid.effects.spring import JointSpring
from torchid.gap.search.evidence import fit_terms
from torchid.gap.search.explain import Explanation, fit_anew
from torchid.gap.search.findings import Judged, at_an_end, not_testable
from torchid.gap.search.odds import Odds, Place
from torchid.gap.search.solve import Solution, solve_terms
from torchid.gap.search.terms import BASE, LINK, PAYLOAD
from torchid.robot.inertia import InertialParameters
from torchid.statistics.blocks import block_numbers

LOAD = [0.5, 0.05, -0.02, 0.1, 0.08, 0.0, 0.0, 0.08, 0.0, 0.08]


@pytest.fixture(scope="module")
def solution() -> Solution:
    """A load, explained by itself and all links at once."""
    data = measured([(Payload(), LOAD)], noise=0.01)
    question = question_of(data, (PAYLOAD,), inertial=True)
    terms = {t.name: t for t in question.candidates.terms}
    rows = question.normal.rows
    fit = fit_terms(question, [terms[BASE], terms[PAYLOAD]], rows, None, 10)
    block = block_numbers(data.samples.bounds, len(data.samples) // 40)
    wanted = wanted_of((PAYLOAD,), inertial=True)
    columns = question.candidates.columns
    return solve_terms(columns, fit.terms, fit.values(), data, wanted, block, rows)


def test_a_load_is_the_load_and_not_the_links(solution: Solution) -> None:
    """What is known of the links beforehand decides, not how a fit divides the sum."""
    base, load = solution.values
    count = len(base)
    torque = torch.tensor(LOAD, dtype=torch.float64) @ solution.a[count:].flatten(1)
    found = load @ solution.a[count:].flatten(1)
    assert float((found - torque).norm()) < 0.05 * float(torque.norm())
    assert float((base @ solution.a[:count].flatten(1)).norm()) < 0.1 * float(torque.norm())


def test_a_load_is_known_no_better_than_the_body_that_carries_it(solution: Solution) -> None:
    """Its moments, beside those of a last link that may be off by 30 %."""
    std = solution.std[1]
    moments = ROBOT.require_parameters("a test").pi[-1, 1:4].abs().max()
    assert float(std[1:4].max()) > 0.1 * float(moments)


def test_links_stay_bodies(solution: Solution) -> None:
    margin = solution.model.robot.require_parameters("a test").consistency_margin()
    assert bool((margin > 0).all())


@pytest.mark.parametrize(("k", "c0", "main"), [(-0.8, 8.9, 1), (8.9, -0.8, 0)])
def test_the_number_shown_first_makes_most_of_the_torque(k: float, c0: float, main: int) -> None:
    planted = JointSpring(1, 1.0)
    data = measured([(planted, [k, c0])], noise=0.01)
    question = question_of(data, (planted.name,), extra=[planted])
    own = next(t for t in question.candidates.terms if t.effects == (planted,))
    fit = fit_terms(question, [own], question.normal.rows)
    block = block_numbers(data.samples.bounds, len(data.samples) // 40)
    wanted = wanted_of((planted.name,))
    columns = question.candidates.columns
    solution = solve_terms(columns, fit.terms, fit.values(), data, wanted, block)
    assert solution.main(0) == main


@pytest.mark.parametrize(("a", "others"), [(2.5, set()), (3.0, {"viscous_friction"})])
def test_a_shape_at_the_end_of_its_range_is_never_told_alone(a: float, others: set[str]) -> None:
    """However clearly it explains more: what lies beyond its range nobody has looked at."""
    planted = PowerLawFriction(1, a)
    data = measured([(planted, [3.0])], noise=0.01)
    question = question_of(data, ("viscous_friction", "power_law_friction"), extra=[planted])
    own = next(t for t in question.candidates.terms if t.effects == (planted,))
    rows = question.normal.rows
    fit, without = (fit_terms(question, terms, rows) for terms in ([own], []))
    ended = at_an_end(question, own)
    assert ended == (("a",) if others else ())
    # However sure, the other one is in its set.
    place = Place(question, (fit, without), own, None)  # type: ignore[arg-type]
    rival = term(question, "viscous_friction", 1)
    judged = Judged(place, (rival,), Odds(1.0, 0.0, 0.0, (0.0,)), bool(ended))
    assert set(judged.ambiguous_with) == others


def test_of_the_same_effect_elsewhere_the_set_says_where() -> None:
    question = question_of(measured([]), (LINK,), inertial=True)
    own, other = (next(t for t in question.candidates.terms if t.joints == (j,)) for j in (2, 1))
    fit, without = (fit_terms(question, terms, question.normal.rows) for terms in ([own], []))
    place = Place(question, (fit, without), own, None)  # type: ignore[arg-type]
    judged = Judged(place, (other,), Odds(0.5, 0.0, 0.0, (0.5,)))
    assert judged.ambiguous_with == ("link_inertia 2",)


@pytest.mark.parametrize("bodies", [True, False])
def test_what_needs_bodies_is_not_testable_without_them(bodies: bool) -> None:
    """Base parameters have no moment on a bearing: the answer says so where links are no bodies."""
    pi = ROBOT.parameters.pi.clone()
    if not bodies:
        pi[1, 4:] = -pi[1, 4:]
    robot = ROBOT.with_parameters(InertialParameters(pi))
    data, names = measured([], real=robot), ("coulomb_friction", "bearing_moment_friction")
    columns = Columns(Model(robot, ()), data.samples)
    question = question_of(data, names, columns=columns)
    empty = fit_anew(question)
    block = block_numbers(data.samples.bounds, 50)
    wanted = wanted_of(names)
    solution = solve_terms(
        columns, empty.terms, empty.values(), data, wanted, block, empty.effective
    )
    found = Explanation(question, empty, empty, (), solution)
    reasons = {x.effect: x.reason for x in not_testable(found, data)}
    assert ("no bodies" in reasons.get("bearing_moment_friction", "")) is not bodies
