"""What a log could not show, and why."""

from dataclasses import replace

import pytest
import torch

from tests.gap.motions import ROBOT
from tests.gap.problems import SIMPLE, explanation_of, measured, search_of, term
from torchid.design.deflection import Compliance
from torchid.effects.friction import CoulombFriction, TorqueOffset
from torchid.gap.describe.unseen import next_experiment, not_testable
from torchid.robot.inertia import InertialParameters


@pytest.mark.parametrize("bodies", [True, False])
def test_what_needs_bodies_is_not_testable_without_them(bodies: bool) -> None:
    """Base parameters have no moment on a bearing: the answer says so where links are no bodies."""
    pi = ROBOT.require_parameters("a test").pi.clone()
    if not bodies:
        pi[1, 4:] = -pi[1, 4:]
    robot = ROBOT.with_parameters(InertialParameters(pi))
    names = ("coulomb_friction", "bearing_moment_friction")
    found = explanation_of(search_of(measured([], real=robot), names, robot=robot), [])
    reasons = {x.effect: x.reason for x in not_testable(found)}
    assert ("no bodies" in reasons.get("bearing_moment_friction", "")) is not bodies


def test_nothing_is_seen_on_a_joint_without_a_signal_or_that_rests() -> None:
    data = measured([])
    keep = data.keep.clone()
    keep[0] = False
    slides = torch.tensor([True, False, True])
    found = explanation_of(search_of(replace(data, keep=keep, silent=(0,), slides=slides)), [])
    told = {(x.effect, x.joints): x.reason for x in not_testable(found)}
    assert {j for _, j in told} == {(0,), (1,)}
    assert all("no signal" in why for (_, j), why in told.items() if j == (0,))
    assert "does not excite" in told["coulomb_friction", (1,)]


def test_noise_hides_what_is_smaller_than_it() -> None:
    """As large as half of the joint's torque it could not be told."""
    quiet, loud = (
        explanation_of(search_of(measured([], noise=noise, hz=hz)), [])
        for noise, hz in ((0.05, None), (20.0, 0.3))
    )
    assert not_testable(quiet) == []
    told = not_testable(loud)
    assert {x.reason for x in told} == {"noise hides it up to half of the joint's torque"}
    assert all(x.smallest_detectable is not None and x.smallest_detectable > 0 for x in told)


def test_what_another_sensor_tells_of_is_not_hidden_by_the_torque_s_noise() -> None:
    """Its evidence may be positive at any size."""
    search = search_of(measured([], noise=20.0, hz=0.3))
    assert "torque_offset" in {x.effect for x in not_testable(explanation_of(search, []))}
    seen = Compliance(0.0, 1e-4, 1e-3, 0.5)
    search.screen.stacks = [
        replace(
            stack,
            terms=tuple(
                replace(t, seen=seen, extra=1e3) if t.name == "torque_offset" else t
                for t in stack.terms
            ),
        )
        for stack in search.screen.stacks
    ]
    assert "torque_offset" not in {x.effect for x in not_testable(explanation_of(search, []))}


def test_the_experiment_says_where_two_causes_differ_most() -> None:
    search = search_of(measured([(CoulombFriction(1), [0.5])]), SIMPLE)
    terms = term(search, CoulombFriction(1)), term(search, TorqueOffset(1))
    found = explanation_of(search, terms[:1])
    told = next_experiment(found, [terms])
    assert told is not None
    assert told.separates == ("coulomb_friction", "torque_offset")
    assert told.joint == 1
    where = told.most_informative
    assert 0 < where.share <= 1
    assert where.from_s < where.to_s
    assert next_experiment(found, []) is None
