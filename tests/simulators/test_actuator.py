"""Effects as an explicit actuator's torque, to 1e-9."""

import math
from dataclasses import replace

import pytest
import torch

from tests.arms import arm
from tests.simulators.test_mujoco import BESIDE, FIELDS
from torchid.effects.base import Motion
from torchid.effects.registry import nominal_effects
from torchid.errors import TorchidError
from torchid.export.dynamics import records
from torchid.simulators.actuator import EffectTorque

DT = 0.01


def bristled() -> torch.Tensor:
    """Speeds (T, B, n) of two environments, and nothing at rest."""
    t = torch.arange(200, dtype=torch.float64)[:, None, None] * DT
    phase = torch.tensor([[0.1, 0.9, 1.7], [2.0, 0.4, 1.1]], dtype=torch.float64)
    return torch.cos(5 * t + phase)


@pytest.mark.parametrize("name", BESIDE)
def test_torque_is_that_of_the_effect(name: str) -> None:
    """Along a motion, with states, for each environment its own."""
    robot = replace(arm("3r"), effects=(*FIELDS, *records([BESIDE[name]])))
    core = EffectTorque(robot, environments=2, dtype=torch.float64, resting=0.0)
    assert not core.ignored
    dq = bristled()
    # Positions that a step of the states takes: the displacement is dq dt.
    q = torch.cumsum(dq * DT, 0)
    drive = 5 * torch.sin(3 * q)
    found = torch.stack([core.torque(*x, DT, tau) for *x, tau in zip(q, dq, drive, strict=True)])
    effect, values = BESIDE[name]
    for b in range(2):
        t = torch.arange(len(q), dtype=torch.float64) * DT
        motion = Motion(q[:, b], dq[:, b], torch.zeros_like(q[:, b]), t=t, torque=drive[:, b])
        expected = effect.all_torques(motion, values, robot)
        if name == "presliding":
            # A log's first sample has no displacement before it; a step of the states has.
            expected = (
                values[0] * stepped(q[:, b, 2], dq[:, b, 2])[:, None] * torch.tensor([0, 0, 1])
            )
        assert float((found[:, b] - expected).abs().max()) < 1e-9


def stepped(q: torch.Tensor, dq: torch.Tensor) -> torch.Tensor:
    """Dahl's bristle by its own equation, displacement by displacement."""
    z, out = 0.0, []
    for step in (dq * DT).tolist():
        sign = (step > 0) - (step < 0)
        z = sign + (z - sign) * math.exp(-abs(step) / 0.1)
        out.append(z)
    return torch.tensor(out, dtype=torch.float64)


def test_reset_begins_anew_where_it_is_asked() -> None:
    robot = replace(arm("3r"), effects=records([BESIDE["presliding"]]))
    core = EffectTorque(robot, environments=2, dtype=torch.float64)
    dq = bristled()
    first = core.torque(dq[0], dq[0], DT)
    for x in dq[1:20]:
        core.torque(x, x, DT)
    core.reset(torch.tensor([1]))
    again = core.torque(dq[0], dq[0], DT)
    torch.testing.assert_close(again[1], first[1])
    assert float((again[0] - first[0]).abs().max()) > 1e-3


def test_joints_are_taken_by_name_and_fields_are_the_simulators() -> None:
    robot = replace(arm("3r"), effects=(*FIELDS, *records([BESIDE["stribeck"], BESIDE["offset"]])))
    names = [f"left/{robot.joint_names[j]}" for j in (1, 0)]
    core = EffectTorque(robot, names, 4, dtype=torch.float64)
    x = torch.ones(4, 2, dtype=torch.float64)
    found = core.torque(x, x, DT)
    both = EffectTorque(robot, names, 4, dtype=torch.float64, fields=True).torque(x, x, DT)
    motion = Motion(*(torch.ones(1, 3, dtype=torch.float64),) * 2, torch.zeros(1, 3).double())
    beside = [
        p for p in nominal_effects(robot) if p[0].name in ("stribeck_friction", "torque_offset")
    ]
    expected = sum(e.all_torques(motion, v) for e, v in beside)[0]
    torch.testing.assert_close(found, expected[[1, 0]].expand(4, 2))
    rotors = [p for p in nominal_effects(robot) if p[0].name != "rotor_inertia"]
    whole = sum(e.all_torques(motion, v) for e, v in rotors)[0]
    torch.testing.assert_close(both, whole[[1, 0]].expand(4, 2))
    with pytest.raises(TorchidError, match="no such joint"):
        EffectTorque(robot, ["elbow"])


def test_what_an_actuator_cannot_add_is_named() -> None:
    late = {"effect": "time_delay", "joint": 1, "delay": 0.004}
    robot = replace(arm("3r"), effects=(*FIELDS, late))
    assert EffectTorque(robot).ignored == ("time_delay",)
