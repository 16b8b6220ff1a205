"""What has a name, what stays in the model without one, and what the two add up to."""

from types import SimpleNamespace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.gap.small_logs import ROBOT, Recording, arm, friction, logged, true_motion
from torchid.gap.search.findings import with_a_name
from torchid.gap.search.odds import Odds
from torchid.gap.torque import diagnose_torque
from torchid.log.model import Log
from torchid.results.words import percent

pytestmark = pytest.mark.usefixtures("types_unchecked")


def term(place, sure, law_sure=0.0):
    """A judged term of a joint; of the joint's law of several where that is likely."""
    law = f"law of joint {place}" if law_sure else None
    named = sure >= 0.5
    return SimpleNamespace(
        named=named, law=law, law_sure=law_sure, term=SimpleNamespace(place=place)
    )


def test_of_a_law_whose_terms_are_unsure_the_largest_has_the_name():
    law = [term(0, 0.3, 0.99), term(0, 0.4, 0.99), term(1, 0.2)]
    assert with_a_name(law, [0.1, 0.5, 0.4]) == [False, True, False]
    # Where one of its terms is likely, that is its name alone.
    law[0] = term(0, 0.8, 0.99)
    assert with_a_name(law, [0.1, 0.5, 0.4]) == [True, False, False]
    # A law that is not likely names nothing.
    assert with_a_name([term(0, 0.3, 0.4), term(0, 0.4, 0.4)], [0.1, 0.5]) == [False, False]


@given(
    st.lists(st.floats(0.0, 1.0), min_size=3, max_size=6).filter(lambda m: sum(m) > 0),
    st.floats(0.0, 1.0),
)
def test_what_other_data_do_not_confirm_is_nothing(masses, share):
    sure, nothing, unknown, *others = (m / sum(masses) for m in masses)
    odds = Odds(sure, nothing, unknown, tuple(others))
    less = odds.confirmed(share)
    assert less.sure == pytest.approx(share * sure)
    total = less.sure + less.nothing + less.unknown + sum(less.others)
    assert total == pytest.approx(1.0)
    assert less.nothing >= nothing - 1e-12


def strange(log: Log, true: Log, size: float) -> Log:
    """With a torque on joint 2 that no effect of the library has: waves over the joint's speed."""
    torque = size * torch.sin(9 * true.dq[:, 1]) * torch.cos(2 * true.q[:, 0])
    tau = log.tau.clone()
    tau[:, 1] += torque
    return log.replace(tau=tau)


@pytest.mark.slow
def test_shares_of_names_and_of_terms_without_one_add_up():
    """Friction, and beside it something strange, which terms may take and none explains."""
    recording = Recording(runs=(0, 1, 2))
    real = arm(friction(1, Fc=1.5), friction(2, Fv=0.8))
    log = strange(logged(real, recording), true_motion(recording), 0.25)
    found = diagnose_torque(ROBOT, log)
    answer = found.answer
    closes = sum(c.closes for c in answer.causes) + sum(law.unnamed for law in found.friction)
    assert closes + answer.unnamed == pytest.approx(answer.less, abs=1e-6)
    entries = sum(c.closes for c in answer.entries)
    assert entries + answer.unnamed == pytest.approx(answer.less, abs=1e-6)
    held = [s for s in found.suspects if s.share == s.share]
    assert sum(s.share for s in held) == pytest.approx(answer.unnamed)
    assert all(s.how_sure < 0.5 for s in held)
    # The corrected model has all of them, and the headline says how much has no sure name.
    names = {e["effect"] for e in found.corrected.effects}
    assert {s.effect for s in held} <= names | {"link_inertia"}
    if percent(answer.unnamed) != percent(0.0):
        assert f"({percent(answer.unnamed)} without a sure name)" in answer.headline
    assert {(c.effect, c.joints) for c in answer.causes if c.how_sure > 0.9} <= {
        ("coulomb_friction", (0,)), ("viscous_friction", (1,))
    }  # fmt: skip
