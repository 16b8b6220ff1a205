"""The registry: names, and records of a robot's yaml."""

from dataclasses import replace
from types import MappingProxyType

import pytest
import torch
from torch import Tensor

from tests.arms import arm, states
from torchid.effects.base import Motion
from torchid.effects.names import NAMES
from torchid.effects.registry import (
    _NAMED,
    KINDS,
    effect_torque,
    nominal_effects,
    on_every_joint,
)
from torchid.errors import RobotError, TorchidError


def test_unknown_effect_lists_the_available_ones() -> None:
    with pytest.raises(TorchidError, match="unknown effect 'stiction'") as error:
        on_every_joint(["viscous_friction", "stiction"], 3)
    assert error.value.available == list(KINDS)
    assert all(name in str(error.value) for name in KINDS)


def test_names_are_known_without_the_classes() -> None:
    assert tuple(KINDS) == NAMES
    assert set(_NAMED) == set(NAMES)


@pytest.mark.parametrize("name", ["3r_friction", "kuka_lwr4_friction"])
def test_nominal_effects_of_built_in_robots(name: str) -> None:
    robot = arm(name)
    found = nominal_effects(robot)
    assert len(found) == len(robot.effects) == 3 * robot.n
    assert {e.name for e, _ in found} == {"viscous_friction", "coulomb_friction", "torque_offset"}
    state = Motion(*states(robot, 6))
    expected = torch.zeros(6, robot.n, dtype=torch.float64)
    for record in robot.effects:
        expected[:, record["joint"] - 1] += by_hand(record, state.dq[:, record["joint"] - 1])
    torch.testing.assert_close(effect_torque(robot, found, state), expected)


def by_hand(record: MappingProxyType, dq: Tensor) -> Tensor:
    """Equation (2.16), term by term."""
    return (
        record.get("Fv", 0.0) * dq
        + record.get("Fc", 0.0) * torch.sign(dq)
        + record.get("F0", 0.0) * torch.ones_like(dq)
    )


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
        ({"effect": "stribeck_friction", "joint": 1, "Fs": 1.0, "vs": 0.0}, "positive"),
        ({"effect": "stribeck_friction", "joint": 1, "Fs": 1.0, "d": "two"}, "cannot be made"),
        ({"effect": "presliding_hysteresis", "joint": 1, "Fh": 1.0, "length": -1.0}, "positive"),
        ({"effect": "power_law_friction", "joint": 1, "F2": 1.0, "a": "two"}, "number"),
    ],
)
def test_bad_values_raise(record: dict, text: str) -> None:
    robot = replace(arm("3r"), effects=(record,))
    with pytest.raises(RobotError, match=text):
        nominal_effects(robot)
