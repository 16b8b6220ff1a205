"""Causes have the arm's numbers, and beside them what the robot's file has."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.gap.small_logs import ROBOT
from torchid.design.columns import Model
from torchid.effects.friction import CoulombFriction, TorqueOffset, ViscousFriction
from torchid.effects.friction_laws import StribeckFriction
from torchid.effects.inertia import RotorInertia
from torchid.gap.cause_records import body_cause, effect_cause, valued
from torchid.gap.describe.findings import Findings
from torchid.gap.torque import that_help
from torchid.results.cause import remedy_of

KINDS = (ViscousFriction, CoulombFriction, RotorInertia, TorqueOffset)


def model(*effects) -> Model:
    return Model(ROBOT, tuple(effects))


@given(st.sampled_from(KINDS), st.floats(0.0, 100.0), st.floats(-50.0, 50.0), st.integers(0, 2))
def test_the_arm_has_what_the_file_has_and_the_change(kind, file, change, joint) -> None:
    effect = kind(joint)
    signed = effect.coefficients[0].non_negative
    arm = max(file + change, 0.0) if signed else file + change
    given_model = model((effect, [file])) if file else model()
    cause = effect_cause((effect, [change]), [0.1], given_model, model((effect, [arm])), 0)
    (size,) = cause.sizes
    assert size.value == arm
    assert size.was == (file if file else None)
    assert not (signed and size.value < 0)
    assert valued(cause, ROBOT) == (effect, [arm])
    assert "-" not in remedy_of([cause]) or not signed


@pytest.mark.parametrize("beside", [False, True])
def test_another_shape_takes_the_place_of_the_files(beside) -> None:
    """What stands beside the model's own is none of the file's."""
    own, new = (StribeckFriction(1, vs=vs) for vs in (0.1, 0.3))
    corrected = model((own, [2.0]), (new, [0.5])) if beside else model((new, [0.5]))
    cause = effect_cause((new, [0.5]), [0.1], model((own, [2.0])), corrected, 0)
    assert cause.file == ({} if beside else {"Fs": 2.0})
    assert (cause.parameters["Fs"], cause.parameters["vs"]) == (0.5, 0.3)


def test_what_mends_a_file_is_no_effect_of_the_corrected_model() -> None:
    effect = replace(ViscousFriction(0))
    assert effect_cause((effect, [0.4]), [0.1], model(), model(), 0).sizes[0].value == 0.4


def test_bodies_are_links_or_all() -> None:
    link, every = body_cause((1,)), body_cause(())
    assert (link.name, link.at, every.name, every.at) == (
        "inertia of link 2", (1,), "inertial parameters", ()
    )  # fmt: skip


def test_several_links_are_plural() -> None:
    assert body_cause((1, 4)).name == "inertia of links 2 and 5"


def test_what_all_joints_share_and_none_feels_much_can_be_read_back() -> None:
    effect = ViscousFriction(0)
    cause = effect_cause(
        (effect, [0.4]), [0.1], model(), model(), 0, joints=(), located=(), common=True
    )
    assert cause.at == ()
    assert valued(cause, ROBOT) == (effect, [0.4])


@pytest.mark.parametrize(
    ("shares", "kept"),
    [((0.5, -0.1, 0.2), (0, 1, 2)), ((-0.2, 0.1, 0.2), (2,)), ((0.0, 0.0, -0.1), ())],
)
def test_forms_of_a_law_take_of_the_error_together(shares, kept) -> None:
    effects = (ViscousFriction(0), CoulombFriction(0), TorqueOffset(1))
    causes = tuple(
        effect_cause((e, [0.4]), [0.1], model(), model(), 0, share=share)
        for e, share in zip(effects, shares, strict=True)
    )
    helping, others = that_help(Findings(causes, ()), ROBOT)
    assert helping.causes == tuple(causes[k] for k in kept)
    assert others == (len(kept) < 3)
