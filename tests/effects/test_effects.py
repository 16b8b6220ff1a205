"""One battery for every effect in the registry: a new one is covered by its registry line."""

from dataclasses import replace
from types import MappingProxyType

import pytest
import torch
from torch import Tensor

from tests.arms import arm, states
from torchid.effects.base import Effect, Motion
from torchid.effects.friction import CoulombFriction, TorqueOffset, ViscousFriction
from torchid.effects.registry import (
    KINDS,
    effect_kind,
    nominal_effect_torque,
    nominal_effects,
    on_every_joint,
)
from torchid.errors import RobotError, TorchidError

JOINT = 1
UNITS = {"N m", "N m s/rad", "kg m^2"}
"""Units in use, so that a new one gets a line in Coefficient.unit_for and here."""
ON_A_SLIDER = {"N m": "N", "N m s/rad": "N s/m", "kg m^2": "kg"}

every_kind = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
dissipative = pytest.mark.parametrize("kind", [ViscousFriction, CoulombFriction])


def motion(*batch: int) -> Motion:
    return Motion(*states(arm("3r"), *batch))


@every_kind
def test_registered_under_its_name(kind: type[Effect]) -> None:
    assert effect_kind(kind.name) is kind
    assert kind.family
    assert kind.coefficients
    assert all(c.name and c.meaning for c in kind.coefficients)
    assert kind.__doc__


@every_kind
@pytest.mark.parametrize("batch", [(), (1,), (5, 3), (0,)])
def test_columns_times_coefficients_is_the_torque(kind: type[Effect], batch: tuple) -> None:
    effect, state = kind(JOINT), motion(*batch)
    columns = effect.columns(state)
    assert columns.shape == (*batch, len(effect.coefficients))
    values = [0.7 - 0.3 * k for k in range(len(effect.coefficients))]
    torch.testing.assert_close(effect.torque(state, values), columns @ torch.tensor(values))


@every_kind
def test_units_of_both_joint_types(kind: type[Effect]) -> None:
    for coefficient in kind.coefficients:
        assert coefficient.unit_for(prismatic=False) in UNITS
        assert coefficient.unit_for(prismatic=True) == ON_A_SLIDER[coefficient.unit]


@every_kind
def test_coefficients_carry_the_joint_number_from_one(kind: type[Effect]) -> None:
    names = kind(JOINT).coefficient_names()
    assert names == [f"{c.name}2" for c in kind.coefficients]


@every_kind
def test_acts_on_its_own_joint_only(kind: type[Effect]) -> None:
    """Motion of the other joints does not enter these effects."""
    state = motion(20)
    others = [x.clone() for x in state[:3]]
    for x in others:
        x[..., [0, 2]] += 1.0
    assert torch.equal(kind(JOINT).columns(state), kind(JOINT).columns(Motion(*others)))


@every_kind
def test_dtype_and_device_follow_the_motion(kind: type[Effect], device: torch.device) -> None:
    state = Motion(*(x.to(device, torch.float32) for x in motion(4)[:3]))
    torque = kind(JOINT).torque(state, [1.0] * len(kind.coefficients))
    assert torque.dtype is torch.float32
    assert torque.device.type == device.type


@every_kind
def test_planted_value_is_recovered(kind: type[Effect]) -> None:
    effect, state = kind(JOINT), motion(100)
    planted = torch.tensor([0.37 + 0.2 * k for k in range(len(effect.coefficients))])
    tau = effect.torque(state, planted.tolist())
    found = torch.linalg.lstsq(effect.columns(state), tau.unsqueeze(-1)).solution.squeeze(-1)
    torch.testing.assert_close(found, planted, rtol=1e-12, atol=1e-12)


def test_planted_values_of_all_effects_together() -> None:
    effects = on_every_joint(KINDS, 3)
    assert [e.joint for e in effects] == [0, 1, 2] * len(KINDS)
    state = motion(200)
    own = [e for e in effects if e.joint == JOINT]
    a = torch.cat([e.columns(state) for e in own], -1)
    planted = torch.rand(a.shape[1])
    found = torch.linalg.lstsq(a, (a @ planted).unsqueeze(-1)).solution.squeeze(-1)
    torch.testing.assert_close(found, planted, rtol=1e-11, atol=1e-11)


@dissipative
def test_friction_takes_energy(kind: type[Effect]) -> None:
    """The drive's torque against friction has the sign of the speed: dq tau >= 0."""
    state = motion(500)
    power = state.dq[:, JOINT] * kind(JOINT).torque(state, [0.5])
    assert float(power.min()) > 0
    assert all(c.non_negative for c in kind.coefficients)


def test_signs_by_hand() -> None:
    dq = torch.tensor([[0.0, 2.0, 0.0], [0.0, -2.0, 0.0], [0.0, 0.0, 0.0]])
    state = Motion(torch.zeros(3, 3), dq, 3 * dq)

    def torque(kind: type[Effect]) -> list[float]:
        return kind(JOINT).torque(state, [0.5]).tolist()

    assert torque(ViscousFriction) == [1.0, -1.0, 0.0]
    assert torque(CoulombFriction) == [0.5, -0.5, 0.0]
    assert torque(TorqueOffset) == [0.5, 0.5, 0.5]
    assert torque(effect_kind("rotor_inertia")) == [3.0, -3.0, 0.0]


def test_smooth_sign_tends_to_the_sharp_one() -> None:
    state = motion(200)
    sharp = CoulombFriction(JOINT).columns(state)
    slow = float(state.dq[:, JOINT].abs().min())
    gaps = [
        float((CoulombFriction(JOINT, smoothing=s * slow).columns(state) - sharp).abs().max())
        for s in (1.0, 0.3, 0.1, 0.03)
    ]
    assert gaps == sorted(gaps, reverse=True)
    assert gaps[0] > 0.1
    assert gaps[-1] < 1e-12


def test_smooth_sign_has_a_gradient_at_rest() -> None:
    dq = torch.zeros(3, requires_grad=True)
    column = CoulombFriction(JOINT, smoothing=0.1).columns(Motion(dq, dq, dq))
    (slope,) = torch.autograd.grad(column.sum(), dq)
    assert slope.tolist() == [0.0, 10.0, 0.0]


def test_unknown_effect_lists_the_available_ones() -> None:
    with pytest.raises(TorchidError, match="unknown effect 'stiction'") as error:
        on_every_joint(["viscous_friction", "stiction"], 3)
    assert error.value.available == list(KINDS)
    assert all(name in str(error.value) for name in KINDS)


@pytest.mark.parametrize("name", ["3r_friction", "kuka_lwr4_friction"])
def test_nominal_effects_of_built_in_robots(name: str) -> None:
    robot = arm(name)
    found = nominal_effects(robot)
    assert len(found) == len(robot.effects) == 3 * robot.n
    assert {e.name for e, _ in found} == {"viscous_friction", "coulomb_friction", "torque_offset"}
    state = Motion(*states(robot, 6))
    expected = torch.zeros(6, robot.n)
    for record in robot.effects:
        expected[:, record["joint"] - 1] += by_hand(record, state.dq[:, record["joint"] - 1])
    torch.testing.assert_close(nominal_effect_torque(robot, state), expected)


def by_hand(record: MappingProxyType, dq: Tensor) -> Tensor:
    """Equation (2.16), term by term."""
    return (
        record.get("Fv", 0.0) * dq
        + record.get("Fc", 0.0) * torch.sign(dq)
        + record.get("F0", 0.0) * torch.ones_like(dq)
    )


def test_a_robot_without_effects_has_no_effect_torque() -> None:
    robot = arm("3r")
    state = motion(4)
    assert nominal_effects(robot) == []
    assert torch.equal(nominal_effect_torque(robot, state), torch.zeros(4, 3))


@pytest.mark.parametrize(
    ("record", "error", "text"),
    [
        ({"effect": "stiction", "joint": 1}, TorchidError, "unknown effect"),
        ({"effect": "viscous_friction", "joint": 1}, RobotError, "wrong entries"),
        ({"effect": "viscous_friction", "Fv": 1.0}, RobotError, "wrong entries"),
        ({"effect": "viscous_friction", "joint": 1, "Fc": 1.0}, RobotError, "wrong entries"),
        ({"effect": "torque_offset", "joint": 1, "F0": 1, "x": 2}, RobotError, "wrong entries"),
    ],
)
def test_bad_records_raise(record: dict, error: type[TorchidError], text: str) -> None:
    robot = replace(arm("3r"), effects=(record,))
    with pytest.raises(error, match=text):
        nominal_effects(robot)


@pytest.mark.parametrize(
    ("record", "text"),
    [
        ({"effect": "torque_offset", "joint": 1, "F0": "much"}, "number"),
        ({"effect": "torque_offset", "joint": 1, "F0": float("nan")}, "number"),
        ({"effect": "torque_offset", "joint": 1, "F0": None}, "number"),
        ({"effect": "torque_offset", "joint": 9, "F0": 1.0}, "joint"),
        ({"effect": "torque_offset", "joint": 0, "F0": 1.0}, "joint"),
        ({"effect": "torque_offset", "joint": "two", "F0": 1.0}, "joint"),
        ({"joint": 1, "F0": 1.0}, "'effect'"),
    ],
)
def test_bad_values_raise(record: dict, text: str) -> None:
    robot = replace(arm("3r"), effects=(record,))
    with pytest.raises(RobotError, match=text):
        nominal_effects(robot)
