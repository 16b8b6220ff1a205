"""What a candidate would add, against fits of all rows; what it costs; and what is refused."""

import math
from dataclasses import replace

import pytest
import torch

from tests.gap.motions import ROBOT
from tests.gap.problems import SIMPLE, measured, motions, question_of, term
from tests.gap.search.beside import offers
from torchid.effects.base import Effect
from torchid.effects.friction import CoulombFriction, TorqueOffset, ViscousFriction
from torchid.effects.friction_laws import StribeckFriction
from torchid.effects.gravity import EncoderOffset, TorqueGain
from torchid.effects.surroundings import EndStop, PlaneContact
from torchid.gap.search.evidence import (
    Question,
    active_share,
    best_fits,
    cause_groups,
    common_names,
    comparable,
    cost,
    directions,
    effective_samples,
    fit_terms,
    prior_of,
    refit_each,
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


def rows(question: Question, joint: int, terms: list) -> tuple[Tensor, Tensor]:
    """Columns (R, K) of terms and the gap (R,) in the samples of a joint that count."""
    keep = question.candidates.keep[joint]
    parts = [rows_of(question, t) for t in terms]
    own = [p[:, 0 if t.place is not None else joint] for t, p in zip(terms, parts, strict=True)]
    return torch.cat(own)[:, keep].T, question.candidates.gap[joint, keep]


def loss(a: Tensor, y: Tensor) -> float:
    # gelsd: the driver that knows about rank
    x = torch.linalg.lstsq(a, y.unsqueeze(1), driver="gelsd").solution[:, 0]
    return float((y - a @ x).square().sum())


def test_gains_are_the_fall_of_the_log_likelihood(question: Question) -> None:
    """Of every candidate on one joint: n log of how the sum of squares falls, two fits by hand."""
    held = [term(question, "viscous_friction", 1)]
    beside = fit_terms(question, held, question.normal.rows)
    found = [o for o in offers(question, beside) if o.term.place is not None]
    # A coefficient that physics bounds is fitted beside what is known of it beforehand.
    free = [o for o in found if not o.term.ridge.any()]
    assert len(found) > len(free) > 10
    for offer in free:
        place = offer.term.place
        own = [t for t in held if t.place == place]
        before, after = (
            loss(*rows(question, place, terms)) if terms else float(beside.losses[place])
            for terms in (own, [*own, offer.term])
        )
        fall = float(question.normal.rows[place]) * math.log(before / after)
        assert offer.gain == pytest.approx(fall, rel=1e-5, abs=1e-6)


def test_gains_on_all_joints_are_so_to_first_order(question: Question) -> None:
    """With the joints' weights as they are, an effect of the arm lowers the weighted squares by
    what is offered; the likelihood, whose weights follow, by a little more."""
    rows, planted = question.normal.rows, [t for t in question.candidates.terms if _planted(t)]
    start = fit_terms(question, planted, rows)
    beside = fit_terms(question, planted, rows, start.weight)
    offered = [o for o in offers(question, beside) if o.term.place is None and not o.term.bodies]
    assert {o.term.name for o in offered} >= {"base_tilt"}
    for offer in offered:
        more = fit_terms(question, [*planted, offer.term], rows, beside.weight)
        fall = float((rows * (beside.losses / more.losses).log()).sum())
        assert offer.gain == pytest.approx(fall, rel=0.1, abs=0.1)


def _planted(t) -> bool:
    return len(t.effects) == 1 and t.effects[0] in [e for e, _ in FRICTION]


def test_what_is_planted_is_offered_first(question: Question) -> None:
    empty = fit_terms(question, (), question.normal.rows)
    best = next(o.term for o in offers(question, empty) if o.term.place == 1)
    assert best.name in ("viscous_friction", "power_law_friction")
    held = fit_terms(question, [term(question, "viscous_friction", 1)], question.normal.rows)
    assert all(o.term.key != ("viscous_friction", (1,)) for o in offers(question, held))


def offered(effects: tuple, names: tuple[str, ...]) -> dict[tuple[str, int], float]:
    """Gains by name and joint."""
    question = question_of(measured(effects), names)
    empty = fit_terms(question, (), question.normal.rows)
    found = offers(question, empty)
    return {(o.term.name, o.term.effects[0].joints[0]): o.gain for o in found if o.term.effects}


def test_a_sign_that_physics_forbids_is_refused() -> None:
    """Friction that drives is none; an offset has either sign."""
    found = offered(((ViscousFriction(1), [-1.0]), (TorqueOffset(2), [-1.0])), SIMPLE)
    assert ("viscous_friction", 1) not in found
    assert found["torque_offset", 2] > 100
    assert ("viscous_friction", 1) in offered(FRICTION, SIMPLE)


def test_a_negative_correction_of_the_model_s_own_is_no_negative_friction() -> None:
    """The model has more viscous friction than the arm; what is left stays positive."""
    given = ((ViscousFriction(1), [1.5]),)
    question = question_of(measured(FRICTION[:1]), SIMPLE, given=given)
    empty = fit_terms(question, (), question.normal.rows)
    found = {(o.term.name, o.term.place): o for o in offers(question, empty)}
    best = found["viscous_friction", 1]
    assert best.term.known == (1.5,)
    fit = fit_terms(question, [best.term], question.normal.rows)
    assert float(fit.x[0]) == pytest.approx(-0.5, abs=0.02)


def test_a_size_that_no_arm_has_is_refused() -> None:
    """No encoder is 2 rad off: whatever looks like it is something else."""
    largest = EncoderOffset.coefficients[0].largest
    usual = EncoderOffset(1)
    for size, there in ((0.5 * largest, True), (6.0 * largest, False)):
        found = offered(((usual, [size]),), ("encoder_offset",))
        assert (("encoder_offset", 1) in found) == there


def plane_offered(question: Question) -> list[Term]:
    empty = fit_terms(question, (), question.normal.rows)
    return [o.term for o in offers(question, empty) if o.term.name == "plane_contact"]


def test_a_damping_that_drives_is_left_out_and_the_plane_stays() -> None:
    """A plane whose force grows faster than with depth looks as if it drove: the plane is offered
    and fitted with its stiffness alone, and a plane that pulls is refused."""
    height = float(torch.cat([tool_pose(ROBOT, m.q)[:, 2, 3] for m in motions()]).quantile(0.1))
    plane = PlaneContact(height)

    def asked(*values: float) -> Question:
        data = measured(((plane, [*values]),), noise=0.01)
        return question_of(data, ("plane_contact",), extra=[plane])

    question = asked(2000.0, -300.0)
    (there,) = plane_offered(question)
    fit = fit_terms(question, [there], question.normal.rows, torch.ones(3).double(), 1)
    keep, column = question.candidates.keep, rows_of(question, there)[0]
    stiffness = (column * question.candidates.gap)[keep].sum() / column[keep].square().sum()
    # Joints are weighed by what they leave; of unequal joints not quite as one.
    assert fit.x.tolist() == pytest.approx([float(stiffness), 0.0], rel=2e-3)
    assert math.isfinite(fit.evidence)
    assert not plane_offered(asked(-2000.0, 300.0))


@pytest.mark.parametrize("count", [1, 3])
def test_the_leading_explanations_are_those_of_all_fits(count: int) -> None:
    """Bodies whose free fits are none among them: the same fits in the same order as if all conic
    programs had been solved."""
    question = question_of(measured(FRICTION), ("link_inertia", "payload", *SIMPLE), inertial=True)
    n = question.normal.rows
    weight = n / question.squares
    tried = [[t] for t in question.candidates.terms if t.name != BASE]
    start = replace(fit_terms(question, [], n), losses=question.squares)
    every = refit_each(question, start, tried)
    free = [fit_terms(question, t, n, weight, conic=False) for t in tried]
    bound = [not torch.allclose(a.x, b.x) for a, b in zip(every, free, strict=True)]
    assert any(bound)
    assert all(b.evidence >= a.evidence - 1e-6 for a, b in zip(every, free, strict=True))
    best = sorted(range(len(tried)), key=lambda k: -every[k].evidence)[:count]
    found = best_fits(question, start, tried, count)
    assert [k for k, _ in found] == best
    assert [f.evidence for _, f in found] == pytest.approx([every[k].evidence for k in best])


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
    """Its gain is that of a fit to the gap with the model's own effect taken out."""
    question = stribeck()
    empty = fit_terms(question, (), question.normal.rows)
    columns = question.candidates.columns
    keep = question.candidates.keep[1]
    freed = question.candidates.gap[1] + 0.8 * columns.of(OWN)[1][0]
    shapes = [o for o in offers(question, empty) if o.term.instead]
    assert shapes
    for offer in shapes:
        own = rows_of(question, offer.term)[:, 0][:, keep].T
        left = loss(own, freed[keep])
        before = float(question.candidates.gap[1, keep].square().sum())
        fall = float(question.normal.rows[1]) * math.log(before / left)
        assert offer.gain == pytest.approx(fall, rel=1e-5, abs=1e-6)
        fit = fit_terms(question, [offer.term], question.normal.rows)
        assert float(fit.losses[1]) == pytest.approx(left, rel=1e-6)
        after = residual(question, fit.terms, fit.x)
        assert float(after[1].square().sum()) == pytest.approx(left, rel=1e-6)


def test_the_model_s_own_shape_stands_beside_itself() -> None:
    question = stribeck()
    own = [t for t in question.candidates.terms if t.effects == (OWN,)]
    assert len(own) == 1
    assert own[0].instead == ()
    assert own[0].known == (0.8,)


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


def test_causes_are_terms_but_what_most_joints_have_is_one(question: Question) -> None:
    dry = [term(question, "coulomb_friction", j) for j in range(3)]
    inertia = term(question, "rotor_inertia", 1)
    assert len(cause_groups([], 3)) == 0
    assert len(cause_groups(dry[:1], 3)) == 1
    assert len(cause_groups(dry[:2], 3)) == len(cause_groups(dry, 3)) == 1
    assert len(cause_groups([*dry, inertia], 3)) == 2
    springs = [term(question, "joint_spring", j) for j in range(3)]
    assert len(cause_groups(springs, 3)) == 3  # an arm that has one has no reason to have others
    assert common_names(dry[:2], 3) == {"coulomb_friction"}
    assert not common_names(dry[:1], 3)
    assert not common_names(dry, 6)  # half of them are not most
    assert not common_names(springs, 3)


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
