from dataclasses import replace

import numpy as np
import pytest

from tests.gap.causes.problems import candidate, search


def test_a_fit_leaves_the_gap_less_its_terms() -> None:
    of = search("viscous_friction")
    terms = candidate(of, "viscous_friction", 1), candidate(of, "torque_offset", 0)
    fit = of.evidence.fit(terms, of.library.rows)
    columns = of.evidence.columns(terms)
    left = of.library.gap - np.einsum("k,nkN->nN", fit.x, columns)
    np.testing.assert_allclose(of.evidence.left(fit), left, atol=1e-12)
    np.testing.assert_allclose(fit.losses, (left**2).sum(1), rtol=1e-9)


def test_terms_that_are_appended_have_the_normal_equations_of_all() -> None:
    of = search("viscous_friction")
    terms = [candidate(of, n, j) for n, j in (("viscous_friction", 1), ("joint_spring", 0))]
    slabs = of.evidence.slabs(terms)
    columns = slabs.spread.T @ of.evidence.columns(terms)
    full = np.concatenate([columns, of.library.gap[:, None]], 1)
    np.testing.assert_allclose(slabs.normal, full @ full.transpose(0, 2, 1), atol=1e-9)


@pytest.mark.parametrize("joint", [0, 1, 2])
@pytest.mark.parametrize("planted", [None, "coulomb_friction"])
def test_a_term_without_torque_nets_minus_its_price(planted: str | None, joint: int) -> None:
    """Beside anything: two explanations are compared with the same samples."""
    of = search(planted)
    term = candidate(of, "torque_offset", joint)
    nothing = replace(term, columns=0.0 * term.columns)
    there = (candidate(of, "torque_offset", (joint + 1) % 3), candidate(of, "torque_gain", joint))
    for beside in ((), there):
        fit = of.evidence.fit(beside, of.library.rows / 3)
        more = of.evidence.fit((*beside, nothing), of.library.rows / 3)
        paid = of.evidence.price((*beside, nothing)) - of.evidence.price(beside)
        assert of.evidence.over(more, fit) == pytest.approx(-paid, abs=1e-6)


@pytest.mark.parametrize("hz", [None, 2.0])
def test_evidence_is_as_much_for_one_as_against_the_other(hz: float | None) -> None:
    of = search("viscous_friction", hz)
    one, other = (
        of.evidence.fit((candidate(of, name, 1),), of.library.rows)
        for name in ("viscous_friction", "coulomb_friction")
    )
    assert of.evidence.over(one, other) == pytest.approx(-of.evidence.over(other, one))
    assert of.evidence.over(one, other) > 5


def test_slow_noise_hides_slow_torque() -> None:
    """As many samples tell an offset in slow noise as it has correlation times, and more tell what
    changes faster."""
    white, slow = (search("torque_offset", hz) for hz in (None, 1.0))
    telling = []
    for of in (white, slow):
        fit = of.evidence.fit((candidate(of, "torque_offset", 2),), of.library.rows)
        telling.append(of.evidence.telling(fit, of.empty())[2])
    assert telling[1] < 0.7 * telling[0]


def test_what_physics_forbids_is_at_its_bound_and_refused_alone() -> None:
    of = search("viscous_friction")
    term = candidate(of, "viscous_friction", 1)
    against = replace(term, columns=-term.columns)
    fit = of.evidence.fit((against,), of.library.rows)
    assert fit.x.tolist() == [0.0]
    assert not fit.allowed
    assert of.evidence.over(fit, of.empty()) == -np.inf


def test_forms_of_a_law_on_a_joint_are_one_cause() -> None:
    of = search("viscous_friction")
    one, two, far = (
        candidate(of, name, joint)
        for name, joint in (
            ("viscous_friction", 1),
            ("coulomb_friction", 1),
            ("coulomb_friction", 0),
        )
    )
    price = of.evidence.price
    beside = price((one, two)) - price((one,))
    assert beside < price((one, far)) - price((one,))
