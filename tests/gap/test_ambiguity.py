"""What cannot be told apart is said, and where it could be."""

from dataclasses import replace

import pytest
import torch

from tests.gap.problems import ar_noise, problem, random
from tests.gap.test_select import named
from torchid.effects.gravity import BaseTilt, KinematicError
from torchid.effects.hysteresis import PreslidingHysteresis
from torchid.effects.inertia import LinkInertia, Payload
from torchid.gap.ambiguity import aliases, alternatives, separation
from torchid.gap.problem import Term, term_of
from torchid.gap.select import Search

N, ROWS = 3, 1000


def accepted(x, y, *others, place=1) -> tuple[Search, Term]:
    bank = named(x, place, "viscous_friction")
    search = Search(problem(y, (bank, *others)))
    search.terms = [term_of(bank)]
    return search, search.terms[0]


def planted(seed: int = 0, size: float = 1.0):
    x = ar_noise(1, 1, ROWS, pole=0.9, seed=50 + seed)
    y = random(N, ROWS, seed=seed)
    y[1] += size * x[0, 0]
    return x, y


@pytest.mark.parametrize("factor", [1.0, -3.0])
def test_identical_columns_are_in_the_set(factor):
    x, y = planted()
    search, term = accepted(x, y, named(factor * x, 1, "torque_offset"))
    found = alternatives(search, term)
    assert [a.name for a in found] == ["torque_offset"]
    assert found[0].loses == pytest.approx(0.0, abs=1e-9)
    assert float(separation(search, term, found[0].term).sum()) == pytest.approx(0.0, abs=1e-12)


def test_columns_as_like_as_noise_allows_are_in_the_set():
    """Correlated to 0.999 at a size at which a hundredth of the gain is less than noise."""
    x, y = planted(size=0.5)
    near = x + 0.03 * ar_noise(1, 1, ROWS, pole=0.9, seed=77)
    search, term = accepted(x, y, named(near, 1, "torque_offset"))
    found = alternatives(search, term)
    assert [a.name for a in found] == ["torque_offset"]
    assert float(separation(search, term, found[0].term).sum()) > 0


@pytest.mark.parametrize("place", [1, 2])
def test_columns_that_differ_are_not(place):
    """Half of its square in common on the same joint; all of it, but on another joint."""
    x, y = planted(size=2.0)
    other = x + ar_noise(1, 1, ROWS, pole=0.9, seed=77) if place == 1 else x
    search, term = accepted(x, y, named(other, place, "torque_offset"))
    assert alternatives(search, term) == []


def test_the_set_does_not_change_the_search():
    x, y = planted()
    search, term = accepted(x, y, named(x, 1, "torque_offset"))
    before = list(search.terms)
    alternatives(search, term)
    assert search.terms == before


def test_an_alternative_must_not_need_many_more_columns():
    x, y = planted()
    wide = torch.cat([x, *(random(1, 1, ROWS, seed=200 + k) for k in range(4))], 1)
    search, term = accepted(x, y, named(wide, 1, "torque_offset"))
    assert alternatives(search, term) == []


def test_separation_shows_where_they_differ():
    """Equal but in one twentieth of the time, which is the motion to repeat."""
    x, y = planted(size=2.0)
    other = x.clone()
    other[..., 450:500] = 0
    search, term = accepted(x, y, named(other, 1, "torque_offset"))
    left = separation(search, term, term_of(search.problem.banks[1]))
    assert bool((left >= 0).all())
    best = int(left.argmax())
    rows = (search.problem.block == best).nonzero().flatten()
    assert int(rows[0]) < 500
    assert int(rows[-1]) >= 450
    inside = search.problem.block[450:500].unique()
    assert float(left[inside].sum()) > 0.9 * float(left.sum())


def test_what_is_the_same_by_physics():
    def term(effect) -> Term:
        return Term(effect.name, None, (effect,), torch.zeros(1, 3), effect.coefficients)

    assert aliases(term(Payload()), N) == ("link_inertia",)
    assert aliases(term(LinkInertia(N - 1)), N) == ("payload",)
    assert aliases(term(LinkInertia(0)), N) == ()
    assert aliases(term(BaseTilt()), N) == ("kinematic_error",)
    first = [e for e in KinematicError.candidates(_robot()) if e.joints == (0,)]
    assert all(aliases(term(e), N) == ("base_tilt",) for e in first)
    own = replace(term(BaseTilt()), name="torque_offset")
    assert aliases(own, N) == ()
    assert aliases(term(PreslidingHysteresis(1, 0.002)), N) == ("coulomb_friction",)
    assert aliases(term(PreslidingHysteresis(1, 0.02)), N) == ()


def _robot():
    from tests.gap.motions import ROBOT

    return ROBOT
