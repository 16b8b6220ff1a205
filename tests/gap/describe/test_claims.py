"""What has a name, what stays in the model without one, and what the two add up to."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.gap.problems import measured, on_joint, search_of, term
from tests.gap.small_logs import ROBOT, Recording, arm, friction, logged, true_motion
from torchid.effects.friction_laws import PowerLawFriction
from torchid.gap.causes.judge import Judged
from torchid.gap.describe.claims import Claim, at_an_end, with_a_name
from torchid.gap.torque import diagnose_torque
from torchid.log.model import Log
from torchid.results.words import percent

pytestmark = pytest.mark.usefixtures("types_unchecked")


def some_term(name: str, joint: int | None = 0, law: object = None) -> Any:
    joints = () if joint is None else (joint,)
    return SimpleNamespace(
        name=name,
        joints=joints,
        place=joint,
        law=law,
        cause=law or name,
        effect=None,
        shown=False,
        rare=False,
    )


def claim(sure: float, law: float = 0.0, rivals: tuple[float, ...] = (), **more: Any) -> Claim:
    """Of a joint's friction, with other laws in its place; of a law where that is likely."""
    one = some_term("viscous_friction", law=("friction", 0) if law else None)
    names = ["coulomb_friction", "torque_offset", "joint_spring", "cogging", "rotor_inertia"]
    members = [((some_term(n),), p) for n, p in zip(names, rivals, strict=False)]
    members.append(((one,), sure))
    nothing = max(0.0, 1 - sure - sum(rivals))
    return Claim(Judged(one, one, sure, sure, nothing, tuple(members), law), torch.ones(3), **more)


@pytest.mark.parametrize(
    ("rare", "force", "std", "named"),
    [(True, 89.0, 219.0, False), (True, -89.0, 20.0, True), (False, 0.1, 0.2, True)],
)
def test_a_push_that_may_as_well_not_be_has_no_name(rare, force, std, named):
    one = claim(0.99)
    one.judged.term.rare = rare
    assert one.as_known(force, std).named == named


def test_another_push_in_the_same_window_is_a_push() -> None:
    """One name has one probability, and is no rival of itself."""
    one, other, gain = (some_term(n, None) for n in ("contact", "contact", "torque_gain"))
    members = (((one,), 0.4), ((other,), 0.3), ((gain,), 0.2))
    of = Claim(Judged(one, one, 0.4, 0.4, 0.1, members, 0.4), torch.ones(3))
    assert of.probabilities == pytest.approx({"contact": 0.7, "torque_gain": 0.2})
    assert of.ambiguous_with == ("torque_gain",)


def test_of_a_law_whose_terms_are_unsure_the_largest_has_the_name():
    law = [claim(0.3, 0.99), claim(0.4, 0.99), claim(0.2)]
    assert with_a_name(law, [0.1, 0.5, 0.4]) == [False, True, False]
    # Where one of its terms is likely, that is its name alone.
    law[0] = claim(0.8, 0.99)
    assert with_a_name(law, [0.1, 0.5, 0.4]) == [True, False, False]
    # A law that is not likely names nothing.
    assert with_a_name([claim(0.3, 0.4), claim(0.4, 0.4)], [0.1, 0.5]) == [False, False]


@given(
    st.lists(st.floats(0.0, 1.0), min_size=2, max_size=6).filter(lambda m: sum(m) > 0),
    st.floats(0.0, 1.0),
)
def test_what_other_data_do_not_confirm_is_nothing(masses, share):
    sure, *others = (m / sum(masses) for m in masses)
    one = claim(sure, rivals=tuple(others))
    less = one.beside(torch.tensor([share, 0.0, 0.0]).double())
    assert less.alone_sure == pytest.approx(share * one.alone_sure)
    assert less.set_sure == pytest.approx(share * one.set_sure)
    assert less.law_sure <= one.law_sure


@given(st.lists(st.floats(0.0, 1.0), min_size=2, max_size=6))
def test_a_set_is_the_smallest_that_holds_nine_tenths_of_its_place(masses):
    sure, *others = (m / (sum(masses) or 1.0) for m in masses)
    one = claim(sure, rivals=tuple(others))
    of = {id(t): p for t, p in one.others}
    held = [of[id(t)] for t in one.in_set]
    assert held == sorted(held, reverse=True)
    assert sure + sum(held) >= 0.9 * one.set_sure - 1e-12
    if held:
        assert sure + sum(held[:-1]) < 0.9 * one.set_sure


def test_a_law_that_is_one_curve_names_no_part_of_it():
    one = claim(0.9, 0.9, curve=True)
    assert one.alone_sure == 0.0
    assert one.law_sure == 0.9
    assert not one.named
    assert not one.unnamed


@pytest.mark.parametrize(("a", "others"), [(2.5, ()), (3.0, ("coulomb_friction",))])
def test_a_shape_at_the_end_of_its_range_is_never_told_alone(a, others):
    """However clearly it explains more: what lies beyond its range nobody has looked at."""
    planted = PowerLawFriction(1, a)
    search = search_of(measured([(planted, [3.0])], noise=0.01), (planted.name,))
    ended = at_an_end(search.library, term(search, planted))
    assert ended == (("a",) if others else ())
    # However sure, the other one is in its set.
    assert claim(1.0, rivals=(0.0,), at_an_end=bool(ended)).ambiguous_with == others


def test_of_the_same_effect_elsewhere_the_set_says_where():
    search = search_of(measured([]), ("link_inertia",), inertial=True)
    own, other = (on_joint(search, "link_inertia", j) for j in (2, 1))
    judged = Judged(own, own, 0.5, 0.5, 0.0, (((own,), 0.5), ((other,), 0.5)), 0.5)
    one = Claim(judged, torch.ones(3))
    assert one.ambiguous_with == ("link_inertia 2",)
    assert one.branch_sure == 0.5
    assert replace(one, judged=replace(judged, members=(((own,), 1.0),))).ambiguous_with == ()


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
    closes = sum(c.share for c in answer.causes) + sum(law.unnamed for law in found.friction)
    assert closes + answer.unnamed == pytest.approx(answer.less, abs=1e-6)
    entries = sum(c.share for c in answer.entries)
    assert entries + answer.unnamed == pytest.approx(answer.less, abs=1e-6)
    held = [s for s in found.suspects if s.share == s.share]
    assert sum(s.share for s in held) == pytest.approx(answer.unnamed)
    assert all(s.how_sure < 0.5 for s in held)
    # The corrected model has all of them, and the headline says how much has no sure name.
    names = {e["effect"] for e in found.corrected.effects}
    assert {s.effect for s in held} <= names | {"link_inertia"}
    if percent(answer.unnamed) != percent(0.0):
        assert f", {percent(answer.unnamed)} unnamed" in answer.headline
    assert {(c.effect, c.joints) for c in answer.causes if c.how_sure > 0.9} <= {
        ("coulomb_friction", (0,)), ("viscous_friction", (1,))
    }  # fmt: skip
