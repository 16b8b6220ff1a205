"""Columns are what a model's torque changes by, through the filter that the torque passes."""

from dataclasses import replace

import pytest
import torch

from tests.gap.motions import ROBOT
from tests.gap.problems import data_of, measured, motions
from tests.marks import quick_first
from torchid.design.columns import Columns, Model, on_joint, only
from torchid.design.segments import Samples
from torchid.effects.base import Effect, JointEffect
from torchid.effects.friction import CoulombFriction, TorqueOffset, ViscousFriction
from torchid.effects.friction_laws import LoadDependentFriction
from torchid.effects.gravity import BaseTilt, EncoderOffset, TorqueGain
from torchid.effects.registry import KINDS
from torchid.typing import Tensor

FRICTION = ((ViscousFriction(0), [2.0]), (CoulombFriction(1), [1.5]))
SHAPED = [n for n, k in KINDS.items() if issubclass(k, JointEffect) and k.shapes]


@pytest.fixture(scope="module")
def samples() -> Samples:
    """Two runs of the 3R with all that effects may need: a measured torque, and its age."""
    out = []
    for s in measured(FRICTION).segments:
        age = 0.004 * (s.motion.t[:, None] % 0.1 > 0.05).double().expand(-1, 3)
        out.append(replace(s, motion=s.motion._replace(age=age)))
    return data_of(out).samples


@pytest.fixture(scope="module")
def columns(samples: Samples) -> Columns:
    return Columns(Model(ROBOT, FRICTION), samples)


def torque(model: Model, samples: Samples) -> Tensor:
    return samples.of([model.torque(s, samples).T for s in samples.segments])


def exemplar(name: str) -> Effect:
    """The effect of the library's example, on an arm of three joints."""
    effect = KINDS[name].exemplar(1)
    if hasattr(effect, "source_joint"):
        return KINDS[name](1, 2)  # type: ignore[call-arg]
    return effect


@pytest.mark.parametrize("name", KINDS)
def test_columns_are_what_the_torque_changes_by(name: str, columns: Columns) -> None:
    """Of a model that has friction: an effect sees the load, which this changes."""
    effect = exemplar(name)
    values = torch.tensor(effect.example.values, dtype=torch.float64)
    found = torch.tensordot(values, columns.on_all_joints(effect), 1)
    more = Model(ROBOT, (*FRICTION, (effect, values.tolist())))
    change = torque(more, columns.samples) - torque(columns.model, columns.samples)
    size = float(change.abs().max())
    # The limit of the examples is far above this arm's torque.
    assert size > 0 or name in ("saturation", "drive_saturation")
    assert torch.allclose(found, change, atol=1e-8 * max(size, 1.0))


@pytest.mark.parametrize("name", SHAPED)
def test_many_shapes_at_once_are_those_one_by_one(name: str, columns: Columns) -> None:
    kind = KINDS[name]
    assert issubclass(kind, JointEffect)
    shapes = kind.grid(columns.motions, 1, columns.samples.cutoff)
    some = shapes[:: max(1, len(shapes) // 3)]
    found = columns.of_shapes(kind, 1, some)
    assert len(found) == len(some) > 0
    names = [s.name for s in kind.shapes]
    for own, values in zip(found, some.tolist(), strict=True):
        place, alone = columns.of(kind(1, **dict(zip(names, values, strict=True))))
        assert place == 1
        assert torch.allclose(own, alone, atol=1e-9)


@pytest.mark.parametrize(
    "name", quick_first(["base_tilt", "joint_elasticity", "contact", "backlash"], 3)
)
def test_however_many_fit_into_memory_the_columns_are_the_same(
    name: str, samples: Samples, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Effects one by one and segment by segment, or all of them at once. Of gears every second is
    looked at: those of one stiffness, for the stiffest that is there says how fine steps are."""
    step = 2 if name == "backlash" else 1
    monkeypatch.setattr("torchid.design.columns.KEPT", 0)
    effects = list(KINDS[name].starts(ROBOT))[:40:step]  # type: ignore[attr-defined]
    found = []
    for values in (1, 10**9):
        monkeypatch.setattr("torchid.design.columns.AT_ONCE", values)
        columns = Columns(Model.of(ROBOT), samples)
        found.append(list(columns.of_several(effects)))
    for (place, x), (other, y) in zip(*found, strict=True):
        assert place == other
        assert torch.allclose(x, y, rtol=1e-9, atol=1e-12)


def test_an_effect_without_a_shape_has_one() -> None:
    columns = Columns(Model(ROBOT, ()), measured([]).samples)
    kind = ViscousFriction
    shapes = kind.grid(columns.motions, 2, 8.0)
    found = columns.of_shapes(kind, 2, shapes)
    assert torch.allclose(found[0], columns.of(ViscousFriction(2))[1])


def test_the_place_is_the_joint_that_alone_feels_it(columns: Columns) -> None:
    assert columns.of(TorqueOffset(2))[0] == 2
    assert columns.of(TorqueGain(1))[0] == 1
    assert columns.of(TorqueGain(1))[1].ndim == 2
    place, tilt = columns.of(BaseTilt())
    assert place is None
    assert tilt.shape == (2, 3, len(columns.samples))
    alone = columns.on_all_joints(TorqueGain(1))
    assert float(alone[:, [0, 2]].abs().max()) == 0
    torch.testing.assert_close(alone[:, 1], columns.of(TorqueGain(1))[1], rtol=1e-12, atol=1e-12)


def test_rounding_is_no_column(columns: Columns) -> None:
    """An offset of the last encoder changes nothing on joint 1 that gravity or inertia make of it,
    or more than rounding: never in between."""
    _, found = columns.of(EncoderOffset(2))
    peak = found.abs().amax(-1)
    assert bool(((peak == 0) | (peak > 1e-11 * peak.max())).all())


def test_the_regressor_times_parameters_is_the_rigid_torque(samples: Samples) -> None:
    columns = Columns(Model(ROBOT, ()), samples)
    pi = ROBOT.require_parameters("a test").pi
    rigid = torch.einsum("lp,lpjn->jn", pi, columns.regressor)
    assert torch.allclose(rigid, torque(columns.model, samples), atol=1e-8)
    # A link's body is felt by the joints before it alone.
    assert float(columns.regressor[0, :, 1:].abs().max()) == 0


def test_the_gap_is_what_the_model_lacks() -> None:
    made = measured(FRICTION, noise=0.0)
    gap = Columns(Model(ROBOT, FRICTION[:1]), made.samples).gap
    friction = Columns(Model(ROBOT, ()), made.samples).of(CoulombFriction(1))[1][0]
    assert torch.allclose(gap[1], 1.5 * friction, atol=1e-8)
    assert float(gap[[0, 2]].abs().max()) < 1e-8


def test_columns_are_kept_and_those_of_another_model_are_others(
    columns: Columns, monkeypatch: pytest.MonkeyPatch
) -> None:
    effect = LoadDependentFriction(1)
    assert columns.of(effect)[1] is columns.of(effect)[1]
    monkeypatch.setattr("torchid.design.columns.KEPT", columns._held)
    assert columns.of(effect)[1] is columns.of(effect)[1]
    more = LoadDependentFriction(2)  # for which there is no room
    assert columns.of(more)[1].equal(columns.of(more)[1])
    assert columns.of(more)[1] is not columns.of(more)[1]
    other = Columns(Model(ROBOT, ((TorqueOffset(1), [50.0]),)), columns.samples)
    assert not torch.allclose(other.of(effect)[1], columns.of(effect)[1], atol=1.0)


def test_a_model_s_description_is_the_model(columns: Columns) -> None:
    robot = columns.model.described()
    assert [r["effect"] for r in robot.effects] == ["viscous_friction", "coulomb_friction"]


def test_one_joint_s_motion() -> None:
    motion = motions()[0]
    own = only(motion, 1)
    assert torch.equal(own.dq, motion.dq[:, 1:2])
    assert torch.equal(own.t, motion.t)
    assert own.torque is None
    wide = on_joint(torch.ones(2, 5), 1, 3)
    assert wide.sum((0, 2)).tolist() == [0.0, 10.0, 0.0]
