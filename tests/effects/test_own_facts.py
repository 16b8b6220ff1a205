"""What a class tells of its effect, beside its columns: flags, linearisation, identity, grids."""

from dataclasses import fields

import pytest
import torch

from tests.effects.cases import JOINT, on_joint, trajectory
from torchid.effects.backlash import Backlash
from torchid.effects.base import Effect, JointEffect, ModelEffect
from torchid.effects.file_mistakes import InertiaReferencePoint, InertiaScale, MirroredLink
from torchid.effects.friction import CoulombFriction, ViscousFriction
from torchid.effects.friction_laws import StribeckFriction
from torchid.effects.gravity import EncoderOffset, TorqueCrosstalk
from torchid.effects.inertia import RotorInertia
from torchid.effects.phase import JointElasticity, TimeDelay
from torchid.effects.registry import EVENTS, KINDS, experiment
from torchid.effects.spring import JointSpring
from torchid.effects.transient import Contact, Saturation

every_kind = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)


@every_kind
def test_it_is_told_in_words(kind: type[Effect]) -> None:
    for text in (kind.signature, kind.experiment):
        assert len(text) > 10
        assert text[0].islower()
        assert not text.endswith(".")
    assert kind.beyond is None or kind.beyond[0].islower()
    assert (
        experiment(kind.name, kind.name) == kind.experiment[0].upper() + kind.experiment[1:] + "."
    )


def test_two_experiments_are_one_sentence() -> None:
    text = experiment("viscous_friction", "base_tilt")
    assert text.startswith("Run one joint")
    assert "; and repeat the motion" in text
    assert experiment("base_tilt", "all_base") == experiment("base_tilt", "base_tilt")


@every_kind
def test_friction_says_which_detail_of_a_law_it_is(kind: type[Effect]) -> None:
    assert bool(kind.detail) == (kind.branch == "friction")


@every_kind
def test_its_example_can_be_made(kind: type[Effect]) -> None:
    effect = kind.exemplar(1)
    assert len(kind.example.values) == len(kind.coefficients)
    assert effect.joints[:1] in ((), (1,))
    for c, value in zip(kind.coefficients, kind.example.values, strict=True):
        assert abs(value) <= c.largest
        assert value >= 0 or not c.non_negative


MISTAKES = (InertiaReferencePoint, InertiaScale, MirroredLink)


@pytest.mark.parametrize(
    ("flag", "names"),
    [
        ("event", {"contact", "dropped_samples"}),
        ("shared", {"time_delay", "torque_gain", *(kind.name for kind in MISTAKES[:2])}),
        (
            "inertial",
            {
                "payload",
                "link_inertia",
                "inertia_reference_point",
                "inertia_scale",
                "mirrored_link",
            },
        ),
        ("smooth", {"time_delay", "filter_lag", "joint_elasticity"}),
    ],
)
def test_flags(flag: str, names: set[str]) -> None:
    assert {name for name, kind in KINDS.items() if getattr(kind, flag)} == names


@every_kind
def test_flags_agree_with_each_other(kind: type[Effect]) -> None:
    """What happened once is brought about by no motion; what is smooth differentiates in time."""
    assert kind.by_motion or not kind.inertial
    assert not (kind.event and kind.by_motion)
    assert (kind.name in EVENTS) == kind.event
    differentiates = kind.family in ("phase", "hysteresis") and "t" in kind.needs
    impacts = kind is Backlash
    assert (kind.smooth or impacts) == (differentiates and issubclass(kind, ModelEffect))
    secant = any(f.name == "at" for f in fields(kind))
    assert kind.linearised == (secant and not impacts)


def test_a_secant_is_taken_at_the_estimate_and_nowhere_else() -> None:
    assert EncoderOffset(2).at_estimate([0.07]) == EncoderOffset(2, at=0.07)
    assert Backlash(1, at=2e-3).at_estimate([3e-3]) == Backlash(1, at=2e-3)
    assert TimeDelay(0, at=0.01).at_estimate([0.0]) == TimeDelay(0, at=0.01)
    assert ViscousFriction(0).at_estimate([0.3]) == ViscousFriction(0)
    # A joint that stiffens under load swings ever more.
    assert JointElasticity(0, at=1e-4).at_estimate([-1e-5]) == JointElasticity(0, at=1e-4)


def test_identity_is_kind_and_place_whatever_the_shape() -> None:
    assert StribeckFriction(2, vs=0.1).identity == StribeckFriction(2, vs=0.3).identity
    assert CoulombFriction(1, smoothing=0.1).identity == ("coulomb_friction", (1,))
    assert TorqueCrosstalk(1, 3).identity == ("torque_crosstalk", (1, 3))
    assert TorqueCrosstalk(1, 3).identity != TorqueCrosstalk(3, 1).identity
    assert Contact(3.96, 5.0).identity == Contact(4.2, 6.0).identity
    assert Contact(4.0, 5.0).identity != Contact(9.0, 10.0).identity
    assert Contact().identity == ("contact", ())


@pytest.mark.parametrize("kind", [k for k in KINDS.values() if issubclass(k, JointEffect)])
def test_grid_and_finer_hold_their_own_shape(kind: type[JointEffect]) -> None:
    """Rows are combinations; closer levels are within the wider ones, around the same shape."""
    grid = kind.grid([trajectory()], JOINT, 8.0)
    assert grid.shape[1:] == (len(kind.shapes),)
    assert len(grid) > 0
    effect = on_joint(kind)
    levels = [effect.finer([trajectory()], level, 8.0) for level in (0, 1, 4)]
    if not kind.shapes:
        assert grid.shape == (1, 0)
        assert levels == [None] * 3
        return
    own = torch.tensor(effect.shape_values, dtype=torch.float64)
    widths = []
    for shapes in levels:
        assert float((shapes - own).abs().amin(0).max()) < 1e-9
        widths.append(float((shapes.amax(0) - shapes.amin(0)).max()))
    assert widths[0] > widths[1] > 9 * widths[2] > 0


def test_contacts_around_one() -> None:
    near = Contact(4.0, 5.0).around(0, 0.05)
    assert Contact(4.0, 5.0) in near
    assert len(near) == 9
    assert {c.start for c in near} == {3.8, 4.0, 4.2}
    assert max(abs(c.start - 4.0) for c in Contact(4.0, 5.0).around(3, 0.05)) == pytest.approx(
        0.025
    )
    assert all(c.stop > c.start for c in Contact(4.0, 4.1).around(0, 0.5))
    assert Contact().around(0, 0.05) == []


def test_attributes_of_a_joint_in_either_format() -> None:
    assert ViscousFriction(0).attributes([0.2]) == {"damping": 0.2}
    assert ViscousFriction(0).attributes([-0.2]) is None
    assert CoulombFriction(0, smoothing=0.1).attributes([0.2]) is None
    assert RotorInertia(0).attributes([0.2]) == {"armature": 0.2}
    spring = {"stiffness": 2.0, "offset": -0.5}
    assert JointSpring(0).attributes([2.0, -0.5]) == spring
    assert JointSpring(0, curvature=1.0).attributes([2.0, -0.5]) is None
    assert StribeckFriction(0).attributes([0.2]) is None


def test_a_size_that_is_zero_but_for_rounding_can_be_read_back() -> None:
    """What is fitted at its bound may lie below it by rounding, which no reader takes."""
    record = Saturation(0, limit=160.0).record([-1.8e-15])
    assert record["clip"] == 0.0
    assert Saturation(0, limit=160.0).record([-0.5])["clip"] == -0.5
    assert ViscousFriction(0).record([-0.5])["Fv"] == -0.5
