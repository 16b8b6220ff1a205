"""Fits against those of all rows; what terms cost; and what is refused."""

import math
from dataclasses import replace

import pytest
import torch

from tests.gap.motions import ROBOT
from tests.gap.problems import SIMPLE, measured, motions, question_of, term
from torchid.effects.base import Effect
from torchid.effects.friction import CoulombFriction, TorqueOffset, ViscousFriction
from torchid.effects.friction_laws import StribeckFriction
from torchid.effects.gravity import EncoderOffset, TorqueGain
from torchid.effects.surroundings import EndStop, PlaneContact
from torchid.gap.search.evidence import (
    Fitted,
    Question,
    active_share,
    common_names,
    comparable,
    cost,
    directions,
    effective_samples,
    fit_terms,
    prior_of,
    residual,
    rows_of,
    subset_of,
)
from torchid.gap.search.findings import p_value
from torchid.gap.search.terms import BASE, Term
from torchid.robot.model import tool_pose
from torchid.typing import Tensor

FRICTION = ((ViscousFriction(1), [1.0]), (CoulombFriction(0), [0.5]))
NAMES = (
    *SIMPLE,
    "joint_spring",
    "asymmetric_friction",
    "power_law_friction",
    "torque_gain",
    "base_tilt",
)


@pytest.fixture(scope="module")
def question() -> Question:
    """Viscous friction of joint 2 and Coulomb friction of joint 1, in white noise."""
    return question_of(measured(FRICTION), NAMES)


def loss(a: Tensor, y: Tensor) -> float:
    # gelsd: the driver that knows about rank
    x = torch.linalg.lstsq(a, y.unsqueeze(1), driver="gelsd").solution[:, 0]
    return float((y - a @ x).square().sum())


def is_allowed(effects: tuple, names: tuple[str, ...], name: str, place: int) -> bool:
    """Whether a term may be alone in an explanation."""
    question = question_of(measured(effects), names)
    fit = fit_terms(question, [term(question, name, place)], question.normal.rows)
    return math.isfinite(fit.evidence)


def test_a_sign_that_physics_forbids_is_refused() -> None:
    """Friction that drives is none; an offset has either sign."""
    effects = ((ViscousFriction(1), [-1.0]), (TorqueOffset(2), [-1.0]))
    assert not is_allowed(effects, SIMPLE, "viscous_friction", 1)
    assert is_allowed(effects, SIMPLE, "torque_offset", 2)
    assert is_allowed(FRICTION, SIMPLE, "viscous_friction", 1)


def test_a_negative_correction_of_the_model_s_own_is_no_negative_friction() -> None:
    """The model has more viscous friction than the arm; what is left stays positive."""
    given = ((ViscousFriction(1), [1.5]),)
    question = question_of(measured(FRICTION[:1]), SIMPLE, given=given)
    own = term(question, "viscous_friction", 1)
    assert own.known == (1.5,)
    fit = fit_terms(question, [own], question.normal.rows)
    assert math.isfinite(fit.evidence)
    assert float(fit.x[0]) == pytest.approx(-0.5, abs=0.02)


def test_a_size_that_no_arm_has_is_refused() -> None:
    """No encoder is 2 rad off: whatever looks like it is something else."""
    largest = EncoderOffset.coefficients[0].largest
    usual = EncoderOffset(1)
    for size, there in ((0.5 * largest, True), (6.0 * largest, False)):
        question = question_of(measured(((usual, [size]),)), ("encoder_offset",))
        own = next(t for t in question.candidates.terms if t.joints == (1,))
        fit = fit_terms(question, [own], question.normal.rows)
        assert math.isfinite(fit.evidence) == there


def test_a_damping_that_drives_is_left_out_and_the_plane_stays() -> None:
    """A plane whose force grows faster than with depth looks as if it drove: the plane is fitted
    with its stiffness alone, and a plane that pulls is refused."""
    height = float(torch.cat([tool_pose(ROBOT, m.q)[:, 2, 3] for m in motions()]).quantile(0.1))
    plane = PlaneContact(height)

    def asked(*values: float) -> tuple[Question, Term, Fitted]:
        data = measured(((plane, [*values]),), noise=0.01)
        question = question_of(data, ("plane_contact",), extra=[plane])
        own = next(t for t in question.candidates.terms if t.effects == (plane,))
        one = torch.ones(3).double()
        return question, own, fit_terms(question, [own], question.normal.rows, one, 1)

    question, there, fit = asked(2000.0, -300.0)
    keep, column = question.candidates.keep, rows_of(question, there)[0]
    stiffness = (column * question.candidates.gap)[keep].sum() / column[keep].square().sum()
    # Joints are weighed by what they leave; of unequal joints not quite as one.
    assert fit.x.tolist() == pytest.approx([float(stiffness), 0.0], rel=2e-3)
    assert math.isfinite(fit.evidence)
    assert asked(-2000.0, 300.0)[2].evidence == -math.inf


def test_what_acts_beyond_a_limit_acts_there_alone() -> None:
    q = torch.cat([m.q[:, 1] for m in motions()])
    stop = EndStop(1, limit=float(q.quantile(0.9)))
    question = question_of(measured([]), (*SIMPLE, "end_stop"), extra=[stop])
    (own,) = (t for t in question.candidates.terms if t.effects == (stop,))
    # The filter's tails, and what is hardly beyond the limit.
    assert active_share(question, [own]) == pytest.approx(0.1, abs=0.03)
    assert active_share(question, [term(question, "coulomb_friction", 1)]) == 1.0
    assert active_share(question, [own, term(question, "coulomb_friction", 1)]) == 1.0


OWN = StribeckFriction(1, vs=0.3)


def stribeck() -> Question:
    """The arm's friction has another shape than the model's."""
    truth = ((StribeckFriction(1, vs=0.05), [1.0]),)
    return question_of(measured(truth), ("stribeck_friction",), given=((OWN, [0.8]),))


def test_another_shape_stands_in_the_place_of_the_model_s_own() -> None:
    """It is fitted to the gap with the model's own effect taken out."""
    question = stribeck()
    columns = question.candidates.columns
    keep = question.candidates.keep[1]
    freed = question.candidates.gap[1] + 0.8 * columns.of(OWN)[1][0]
    shapes = [t for t in question.candidates.terms if t.instead]
    assert shapes
    for shape in shapes:
        left = loss(rows_of(question, shape)[:, 0][:, keep].T, freed[keep])
        fit = fit_terms(question, [shape], question.normal.rows)
        assert float(fit.losses[1]) == pytest.approx(left, rel=1e-6)
        after = residual(question, fit.terms, fit.x)
        assert float(after[1].square().sum()) == pytest.approx(left, rel=1e-6)


def test_the_model_s_own_shape_stands_beside_itself() -> None:
    question = stribeck()
    own = [t for t in question.candidates.terms if t.effects == (OWN,)]
    assert len(own) == 1
    assert own[0].instead == ()
    assert own[0].known == (0.8,)


def test_what_most_joints_have_is_one_cause(question: Question) -> None:
    dry = [term(question, "coulomb_friction", j) for j in range(3)]
    springs = [term(question, "joint_spring", j) for j in range(3)]
    assert common_names(dry[:2], 3) == {"coulomb_friction"}
    assert not common_names(dry[:1], 3)
    assert not common_names(dry, 6)  # half of them are not most
    assert not common_names(springs, 3)  # an arm that has one has no reason to have others


def test_evidence_is_made_of_likelihood_and_cost(question: Question) -> None:
    n = torch.tensor([100.0, 50.0, 20.0], dtype=torch.float64)
    # Friction that differs by direction resists beside dry friction.
    names = (("viscous_friction", 1), ("asymmetric_friction", 0), ("coulomb_friction", 0))
    terms = [term(question, *name) for name in names]
    fit = fit_terms(question, terms, n)
    nothing = torch.stack([g[-1, -1] for g in question.normal.g])
    likelihood = float((n * (nothing / fit.losses).log()).sum())
    two = directions(question, terms[1])
    causes = {t.key for t in question.candidates.terms}
    price = 2 * math.log(len(causes) / question.settings.alpha)
    paid = math.log(50.0) + (two + 1) * math.log(100.0) + 3 * price
    assert cost(question, terms, n) == pytest.approx(paid)
    assert fit.evidence == pytest.approx(likelihood - paid)
    assert fit_terms(question, (), n).evidence == pytest.approx(0.0)


def test_every_joint_is_weighed_by_what_it_leaves(question: Question) -> None:
    fit = fit_terms(question, [term(question, "viscous_friction", 1)], question.normal.rows)
    assert torch.allclose(fit.weight * fit.losses, question.normal.rows)
    assert [len(v) for v in fit.values()] == [1]


def test_weights_settle_where_columns_are_shared() -> None:
    """All base parameters pull on every joint: the same maximum from any start."""
    data = measured([(ViscousFriction(1), [2.0])], noise=0.01)
    question = question_of(data, inertial=True)
    base = next(t for t in question.candidates.terms if t.name == BASE)
    effective = torch.full((3,), 200.0, dtype=torch.float64)
    few, many = (fit_terms(question, [base], effective, None, k).evidence for k in (1, 10))
    assert many >= few
    starts = torch.eye(3, dtype=torch.float64) * 1e4 + 1.0
    ends = [fit_terms(question, [base], effective, start, 30).evidence for start in starts]
    assert max(ends) - min(ends) < 1e-3 * abs(max(ends))


def test_a_prior_holds_bodies_back() -> None:
    """Of noise alone bodies with a prior are fitted smaller than without."""
    question = question_of(measured([]), ("link_inertia",), inertial=True)
    link = [t for t in question.candidates.terms if t.name == "link_inertia"][1]
    one = fit_terms(question, [link], question.normal.rows)
    free = fit_terms(question, [replace(link, sigma=None, bodies=None)], question.normal.rows)
    assert prior_of([link]).value(one.x) < prior_of([link]).value(free.x)
    assert float(one.losses.sum()) >= float(free.losses.sum()) - 1e-9


def test_directions_that_the_samples_do_not_tell_apart_cost_nothing(question: Question) -> None:
    doubled = term(question, "viscous_friction", 1)
    twice = replace(
        doubled, at=doubled.at.repeat(2), coefficients=doubled.coefficients * 2, sigma=None
    )
    assert directions(question, twice) == directions(question, doubled) == 1


def test_effective_samples_are_fewer_where_what_is_left_is_slow() -> None:
    """White noise: nearly as many as there are samples; below the cut-off: much fewer."""
    white, slow = (question_of(measured([], hz=hz), ("torque_offset",)) for hz in (None, 0.5))
    ones = torch.ones(3, dtype=torch.float64)
    counts = [effective_samples(q, fit_terms(q, (), ones)) for q in (white, slow)]
    assert bool((counts[0] > 0.3 * white.normal.rows).all())
    assert bool((counts[1] < 0.3 * counts[0]).all())


def test_slow_noise_hides_a_slow_torque_and_not_a_fast_one() -> None:
    """Of a constant torque slow noise tells as little as of itself; of a ripple much more."""
    question = question_of(measured([], hz=0.5), ("torque_offset", "cogging"))
    empty = fit_terms(question, (), question.normal.rows)
    ripples = [t for t in question.candidates.terms if t.name == "cogging" and t.place == 1]
    fastest = max(ripples, key=lambda t: t.effects[0].k)
    one, two = (
        effective_samples(question, empty, fit_terms(question, [t], question.normal.rows))[1]
        for t in (term(question, "torque_offset", 1), fastest)
    )
    assert float(one) == pytest.approx(float(effective_samples(question, empty)[1]), rel=0.1)
    assert float(two) > 3 * float(one)


def test_two_fits_are_compared_with_the_same_samples_whichever_comes_first() -> None:
    question = question_of(measured([(TorqueOffset(1), [0.5])], hz=0.5), ("torque_offset",))
    empty = fit_terms(question, (), question.normal.rows)
    more = fit_terms(question, [term(question, "torque_offset", 1)], question.normal.rows)
    (a, b), (d, c) = comparable(question, empty, more), comparable(question, more, empty)
    torch.testing.assert_close(a.effective, b.effective, rtol=1e-12, atol=1e-12)
    assert a.evidence - b.evidence == pytest.approx(c.evidence - d.evidence, rel=1e-6)


def test_p_values_tell_what_is_there_from_what_is_not(question: Question) -> None:
    n = question.normal.rows / 4
    viscous, inertia = term(question, "viscous_friction", 1), term(question, "rotor_inertia", 2)
    both = fit_terms(question, [viscous, inertia], n)
    found = []
    for left, tested in ((inertia, viscous), (viscous, inertia)):
        found.append(p_value(question, both, fit_terms(question, [left], n), tested))
    assert found[0] < 1e-20
    assert found[1] > 0.05
    assert found[1] <= 1.0


def test_where_terms_are_in_the_matrices(question: Question) -> None:
    gain = next(t for t in question.candidates.terms if t.effects == (TorqueGain(1),))
    tilt = next(t for t in question.candidates.terms if t.name == "base_tilt")
    subset = subset_of(question.normal, [gain, tilt])
    count = len(tilt.at)
    assert subset.count == 1 + count
    common = tilt.at.tolist()
    assert subset.at.tolist() == [[-1, *common], [*gain.at.tolist(), *common], [-1, *common]]
    effect: Effect = gain.effects[0]
    _, column = question.candidates.columns.of(effect)
    keep = question.candidates.keep[1]
    row = int(gain.at[0])
    assert float(question.normal.g[1][row, row]) == pytest.approx(
        float(column[0, keep].square().sum())
    )
