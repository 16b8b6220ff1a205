"""Actuator classes for Isaac Lab and mjlab: files that run where the package is."""

import runpy
import sys
import types
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.arms import arm
from tests.simulators.test_actuator import DT
from tests.simulators.test_mujoco import BESIDE, FIELDS
from torchid.effects.servo import NAMES
from torchid.errors import TorchidError
from torchid.export.dynamics import records
from torchid.export.export import export_dynamics
from torchid.export.results import servo_dynamics
from torchid.position.model import ServoArm
from torchid.simulators.actuator import EffectTorque


def test_a_robot_without_such_effects_is_refused(tmp_path: Path) -> None:
    late = {"effect": "time_delay", "joint": 1, "delay": 0.004}
    robot = replace(arm("3r"), effects=(*FIELDS, late))
    with pytest.raises(TorchidError, match="no effect that an actuator adds"):
        export_dynamics(robot, "mjlab", tmp_path, "arm", nominal=robot)
    assert not list(tmp_path.iterdir())


class _Base:
    """What both packages' ideal PD actuators do, and no more."""

    _num_envs, _device = 2, "cpu"

    def __init__(self, cfg: object, *args: object, joint_names: list[str] | None = None) -> None:
        self.cfg, self.joint_names = cfg, joint_names

    def initialize(self, *args: object) -> None: ...

    def edit_spec(self, spec: object, names: list[str]) -> None: ...

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
    viscous_friction: dict[str, float] | None = None
    friction: dict[str, float] | None = None
    dynamic_friction: dict[str, float] | None = None
    armature: dict[str, float] | None = None


@pytest.fixture
def packages(monkeypatch: pytest.MonkeyPatch) -> None:
    """Classes that stand in for the packages' own, of the interfaces that were read."""
    stand_ins = {
        "isaaclab": {}, "isaaclab.utils": {"configclass": dataclass(kw_only=True)},
        "isaaclab.actuators": {"IdealPDActuator": _Base, "IdealPDActuatorCfg": _Cfg},
        "mjlab": {}, "mjlab.actuator": {"IdealPdActuator": _Base, "IdealPdActuatorCfg": _Cfg},
    }  # fmt: skip
    for name, content in stand_ins.items():
        module = types.ModuleType(name)
        module.__dict__.update(content)
        monkeypatch.setitem(sys.modules, name, module)


@pytest.mark.usefixtures("packages")
@pytest.mark.parametrize("package", ["isaaclab", "mjlab"])
def test_files_run_where_the_package_is(package: str, tmp_path: Path) -> None:
    robot = replace(arm("3r"), effects=(*FIELDS, *records([BESIDE["load"], BESIDE["presliding"]])))
    done = export_dynamics(robot, package, tmp_path, "arm", nominal=robot)  # type: ignore[arg-type]
    made = runpy.run_path(str(done.files[0]))
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


@pytest.mark.usefixtures("packages")
@pytest.mark.parametrize("package", ["isaaclab", "mjlab"])
def test_servos_run_where_the_package_is(package: str, tmp_path: Path) -> None:
    robot = arm("3r")
    servos = {"kp": 40.0, "kd": 1.5, "damping": [1.0, 2.0, 3.0], "armature": 0.2, "coulomb": 0.3}
    servo = ServoArm.of(robot, **servos, delay=0.01, clip=3.0, stop_high=2.0)
    done = export_dynamics(servo_dynamics(servo), package, tmp_path, "arm", nominal=robot)  # type: ignore[arg-type]
    assert [f.name for f in done.files] == [f"arm_actuator_{package}.py", "arm_servos.yaml"]
    assert done.notes == ("of the servos stop_high are not in it",)
    assert "; stop_high are not made" in done.files[0].read_text()
    made = runpy.run_path(str(done.files[0]))
    names, x = list(robot.joint_names), torch.linspace(-0.2, 0.2, 6).view(2, 3)
    if package == "isaaclab":
        cfg = made["actuators"](DT, 2)["arm"]
        assert cfg.viscous_friction == dict(zip(names, [1.0, 2.0, 3.0], strict=True))
        assert cfg.armature[names[0]] == 0.2
        assert cfg.dynamic_friction[names[2]] == 0.3
        actuator = made["ServoActuator"](cfg, joint_names=names)
        action = types.SimpleNamespace(joint_positions=x)
        out = actuator.compute(action, 0 * x, x).joint_efforts
        assert action.joint_positions is None
    else:
        import mujoco

        (cfg,) = made["actuators"](2)
        actuator = cfg.build(None, [0, 1, 2], names)
        spec = mujoco.MjSpec()
        body = spec.worldbody
        for name in names:
            body = body.add_body(mass=1.0, inertia=[1.0, 1.0, 1.0])
            body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
        actuator.edit_spec(spec, names)
        model = spec.compile()
        assert model.dof_damping.tolist() == [1.0, 2.0, 3.0]
        assert model.dof_frictionloss.tolist() == [0.3] * 3
        assert model.dof_armature.tolist() == [0.2] * 3
        model.opt.timestep = DT
        actuator.initialize(model, None, types.SimpleNamespace(nworld=2), "cpu")
        out = actuator.compute(types.SimpleNamespace(position_target=x, pos=0 * x, vel=x))
    torch.testing.assert_close(out, (40 * x - 1.5 * x).clamp(-3, 3))
    assert made["SERVOS"] is made["ARM"].servos
    # Draws that lie beside the file are its servos.
    values = servo.servos.joint.repeat(5, 1, 1)
    np.savez(tmp_path / "arm_servo_draws.npz", parameters=np.array(NAMES), values=values)
    assert runpy.run_path(str(done.files[0]))["SERVOS"].joint.shape == (5, 3, len(NAMES))
    actuator.reset(torch.tensor([0]))
