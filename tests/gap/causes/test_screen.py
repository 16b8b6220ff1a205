from collections import Counter

import numpy as np
import pytest

from tests.gap.causes.problems import search
from torchid.gap.causes.candidates import Term
from torchid.gap.causes.screen import OF_A_PLACE
from torchid.gap.causes.search import Search


def evidence_of(of: Search, terms: tuple[Term, ...], weight: np.ndarray) -> float:
    """Marginal likelihood of Gaussian noise of known size, from the covariance of the samples."""
    total, y = 0.0, of.library.gap
    columns = of.evidence.columns(terms)
    flat = (columns * np.sqrt(weight)[:, None, None]).transpose(1, 0, 2)
    flat = flat.reshape(len(columns[0]), y.size)
    target = (y * np.sqrt(weight)[:, None]).ravel()
    spread = np.zeros((len(flat), len(flat)))
    k = 0
    for t in terms:
        spread[k : k + t.count, k : k + t.count] = t.spread
        k += t.count
    inner = np.eye(len(flat)) + spread.T @ (flat @ flat.T) @ spread
    right = spread.T @ (flat @ target)
    total -= 0.5 * float(target @ target - right @ np.linalg.solve(inner, right))
    return total - 0.5 * float(np.linalg.slogdet(inner)[1])


@pytest.mark.parametrize("beside", [(), (("torque_offset", 2), ("coulomb_friction", 0))])
def test_what_a_candidate_promises_is_its_rise_in_known_noise(
    beside: tuple[tuple[str, int], ...],
) -> None:
    of = search("viscous_friction")
    terms = tuple(
        next(t for t in of.library.terms if (t.name, t.joints) == (n, (j,))) for n, j in beside
    )
    fit = of.evidence.fit(terms, of.library.rows)
    # The fit's coefficients are those of this noise once it has settled.
    weight = of.library.rows / fit.losses
    before = evidence_of(of, terms, weight)
    for gain, term in of.screen.best(fit, of.library.rows, 6):
        rise = evidence_of(of, (*terms, term), weight) - before
        paid = np.log(term.shapes * of.evidence.forms[term.cause])
        assert gain + paid == pytest.approx(rise, rel=1e-2, abs=0.05)


def test_the_planted_effect_promises_most() -> None:
    of = search("viscous_friction")
    (_, first), *_ = of.screen.best(of.empty(), of.library.rows, 3)
    assert (first.name, first.joints) == ("viscous_friction", (1,))


@pytest.mark.parametrize("count", [6, 1000])
def test_one_joint_leaves_room_for_the_others(count: int) -> None:
    """And takes what is left."""
    of = search("viscous_friction")
    every = [t for _, t in of.screen.ranked(of.empty(), of.library.rows)]
    some = [t for _, t in of.screen.best(of.empty(), of.library.rows, count)]
    place = Counter(t.place if t.place is not None else t.name for t in some)
    assert max(Counter(t.place for t in every[:count]).values()) > OF_A_PLACE
    if count == 6:
        assert max(place.values()) <= OF_A_PLACE
    assert len(some) == min(count, len(every))
    assert {t.serial for t in some} <= {t.serial for t in every}
