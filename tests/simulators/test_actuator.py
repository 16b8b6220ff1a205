"""Effects as an explicit actuator's torque, to 1e-9, and in files for Isaac Lab and mjlab."""

import math
import runpy
import sys
import types
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
import torch

from tests.arms import arm
from tests.simulators.test_mujoco import BESIDE, FIELDS
from torchid.effects.base import Motion
from torchid.effects.registry import nominal_effects
from torchid.errors import TorchidError
from torchid.export.dynamics import records
from torchid.simulators.actuator import EffectTorque
from torchid.simulators.actuator_files import write_actuator

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
    with pytest.raises(TorchidError, match="no effect that an actuator adds"):
        write_actuator(robot, "mjlab", Path(), "arm")


class _Base:
    """What both packages' ideal PD actuators do, and no more."""

    _num_envs, _device = 2, "cpu"

    def __init__(self, cfg: object, *args: object, joint_names: list[str] | None = None) -> None:
        self.cfg, self.joint_names = cfg, joint_names

    def initialize(self, *args: object) -> None: ...

    def reset(self, env_ids: object = None) -> None: ...

    def compute(self, command: types.SimpleNamespace, *state: torch.Tensor) -> object:
        if state:
            command.joint_efforts = torch.full_like(state[0], 3.0)
            return command
        return torch.full_like(command.pos, 3.0)


@dataclass(kw_only=True)
class _Cfg:
    target_names_expr: tuple[str, ...] = ()
    joint_names_expr: tuple[str, ...] = ()
    stiffness: float = 0.0
    damping: float = 0.0
    effort_limit: float = 0.0


@pytest.mark.parametrize("package", ["isaaclab", "mjlab"])
def test_files_run_where_the_package_is(
    package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With classes that stand in for the package's own, of the interface that was read."""
    stand_ins = {
        "isaaclab": {}, "isaaclab.utils": {"configclass": dataclass(kw_only=True)},
        "isaaclab.actuators": {"IdealPDActuator": _Base, "IdealPDActuatorCfg": _Cfg},
        "mjlab": {}, "mjlab.actuator": {"IdealPdActuator": _Base, "IdealPdActuatorCfg": _Cfg},
    }  # fmt: skip
    for name, content in stand_ins.items():
        module = types.ModuleType(name)
        module.__dict__.update(content)
        monkeypatch.setitem(sys.modules, name, module)
    robot = replace(arm("3r"), effects=(*FIELDS, *records([BESIDE["load"], BESIDE["presliding"]])))
    files = write_actuator(robot, package, tmp_path, "arm")  # type: ignore[arg-type]
    made = runpy.run_path(str(files[0]))
    x = torch.ones(2, 3)
    if package == "isaaclab":
        cfg = made["actuators"](10.0, 1.0, 50.0, DT)["arm"]
        actuator = made["EffectActuator"](cfg, joint_names=list(robot.joint_names))
        out = actuator.compute(types.SimpleNamespace(), x, x).joint_efforts
    else:
        (cfg,) = made["actuators"](10.0, 1.0, 50.0)
        actuator = cfg.build(None, [0, 1, 2], list(robot.joint_names))
        model = types.SimpleNamespace(opt=types.SimpleNamespace(timestep=DT))
        actuator.initialize(model, None, types.SimpleNamespace(nworld=2), "cpu")
        out = actuator.compute(types.SimpleNamespace(pos=x, vel=x))
    actuator.reset(torch.tensor([0]))
    core = EffectTorque(robot, environments=2)
    torch.testing.assert_close(out, 3.0 - core.torque(x, x, DT, torch.full_like(x, 3.0)))
    assert float((out - 3.0).abs().max()) > 0.05
