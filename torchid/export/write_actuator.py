"""Actuator classes with a robot's effects, or with its servos, for Isaac Lab and mjlab, as files.

Read of the two packages: Isaac Lab 2.x (`isaaclab.actuators.IdealPDActuator`), and mjlab's main
branch after v1.2 (`mjlab.actuator.IdealPdActuator`, whose commands hold `pos` and `vel`, and
`joint_pos` and `joint_vel` before).
"""

from dataclasses import replace
from pathlib import Path
from pprint import pformat
from typing import Literal

import torch

from torchid import __version__
from torchid.effects.base import Motion
from torchid.effects.registry import Valued, nominal_effects
from torchid.errors import TorchidError
from torchid.export.checks import EXACT, Comparison, compared, relative_difference
from torchid.export.dynamics import Dynamics, robot_torque
from torchid.export.keeping import Draft, kept, staged
from torchid.export.servo_mjcf import STEP
from torchid.export.write_plain import READER, Written
from torchid.position.model import ServoArm
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.robot.writer import robot_yaml
from torchid.simulators.actuator import EffectTorque
from torchid.simulators.servo import FIELDS, ServoTorque
from torchid.typing import Joints

Package = Literal["isaaclab", "mjlab"]

_HEAD = '''"""An ideal PD actuator whose joints have the effects of '{robot}'.

Written by torchid {version}, which it needs beside {package}. Armature, damping and frictionloss
of the joints are the simulator's own; these effects are added to the effort:
{effects}
"""
'''

_ISAACLAB = '''
from pathlib import Path

from isaaclab.actuators import IdealPDActuator, IdealPDActuatorCfg
from isaaclab.utils import configclass
from torchid import load_robot
from torchid.simulators.actuator import EffectTorque

ROBOT = Path(__file__).with_name("{yaml}")


class EffectActuator(IdealPDActuator):
    """The PD law's effort, less what the effects resist it with."""

    def __init__(self, cfg, *args, **kwargs):
        super().__init__(cfg, *args, **kwargs)
        names, count, device = self.joint_names, self._num_envs, self._device
        self.effects = EffectTorque(load_robot(ROBOT), names, count, device)

    def reset(self, env_ids):
        super().reset(env_ids)
        self.effects.reset(env_ids)

    def compute(self, control_action, joint_pos, joint_vel):
        action = super().compute(control_action, joint_pos, joint_vel)
        drive = action.joint_efforts
        resisting = self.effects.torque(joint_pos, joint_vel, self.cfg.physics_dt, drive)
        self.applied_effort = drive - resisting
        action.joint_efforts = self.applied_effort
        return action


@configclass
class EffectActuatorCfg(IdealPDActuatorCfg):
    class_type: type = EffectActuator
    physics_dt: float = 0.005
    """Step of the physics [s], as in SimulationCfg."""


def actuators(stiffness, damping, effort_limit, physics_dt):
    """For ArticulationCfg(actuators=...): one group of all joints."""
    return {{
        "arm": EffectActuatorCfg(
            joint_names_expr={joints},
            stiffness=stiffness,
            damping=damping,
            effort_limit=effort_limit,
            physics_dt=physics_dt,
        )
    }}
'''

_MJLAB = '''
from dataclasses import dataclass
from pathlib import Path

from mjlab.actuator import IdealPdActuator, IdealPdActuatorCfg
from torchid import load_robot
from torchid.simulators.actuator import EffectTorque

ROBOT = Path(__file__).with_name("{yaml}")


class EffectActuator(IdealPdActuator):
    """The PD law's effort, less what the effects resist it with."""

    def __init__(self, cfg, entity, target_ids, target_names):
        super().__init__(cfg, entity, target_ids, target_names)
        self.names = list(target_names)

    def initialize(self, mj_model, model, data, device):
        super().initialize(mj_model, model, data, device)
        self.dt = float(mj_model.opt.timestep)
        self.effects = EffectTorque(load_robot(ROBOT), self.names, data.nworld, device)

    def compute(self, cmd):
        effort = super().compute(cmd)
        pos, vel = (cmd.pos, cmd.vel) if hasattr(cmd, "pos") else (cmd.joint_pos, cmd.joint_vel)
        return effort - self.effects.torque(pos, vel, self.dt, effort)

    def reset(self, env_ids=None):
        super().reset(env_ids)
        self.effects.reset(env_ids)


@dataclass(kw_only=True)
class EffectActuatorCfg(IdealPdActuatorCfg):
    def build(self, entity, target_ids, target_names):
        return EffectActuator(self, entity, target_ids, target_names)


def actuators(stiffness, damping, effort_limit):
    """For EntityArticulationInfoCfg(actuators=...): one group of all joints."""
    return (
        EffectActuatorCfg(
            target_names_expr={joints},
            stiffness=stiffness,
            damping=damping,
            effort_limit=effort_limit,
        ),
    )
'''


_SERVOS = '''"""Actuators that are the position servos of '{robot}'.

Written by torchid {version}, which it needs beside {package}. Targets are joint positions; what
servos make of them is computed at run time, and their damping, dry friction and armature are the
simulator's own. The arm needs no other actuators{not_said}.
Environments have servos of their own where {draws} is beside this file.
"""
'''

_SERVOS_ISAACLAB = '''
from pathlib import Path

from isaaclab.actuators import IdealPDActuator, IdealPDActuatorCfg
from isaaclab.utils import configclass
from torchid import ServoArm
from torchid.simulators.servo import ServoTorque, drawn_servos

ARM = ServoArm.read(Path(__file__).with_name("{yaml}"))
DRAWS = Path(__file__).with_name("{draws}")
SERVOS = drawn_servos(DRAWS, ARM.servos) if DRAWS.is_file() else ARM.servos
JOINTS = {joints}
"""Damping [N m s/rad], dry friction [N m] and armature [kg m^2], as of Isaac Sim 5 (Isaac Lab 2.2);
in 4.5 friction is a coefficient of another meaning."""


class ServoActuator(IdealPDActuator):
    """What the servos of the arm's joints do about a target of their positions."""

    def __init__(self, cfg, *args, **kwargs):
        super().__init__(cfg, *args, **kwargs)
        of = self.joint_names, self._num_envs, self._device
        step = {{"dt": cfg.physics_dt, "steps": cfg.decimation}}
        self.servos = ServoTorque(ARM.robot, SERVOS, *of, **step)

    def reset(self, env_ids):
        super().reset(env_ids)
        self.servos.reset(env_ids)

    def compute(self, control_action, joint_pos, joint_vel):
        effort = self.servos.torque(control_action.joint_positions, joint_pos, joint_vel)
        self.computed_effort = self.applied_effort = effort
        control_action.joint_efforts = effort
        control_action.joint_positions = control_action.joint_velocities = None
        return control_action


@configclass
class ServoActuatorCfg(IdealPDActuatorCfg):
    class_type: type = ServoActuator
    physics_dt: float = 0.005
    """Step of the physics [s], as in SimulationCfg."""
    decimation: int = 4
    """Steps of the physics from one target to the next, as in the environment's Cfg."""


def actuators(physics_dt, decimation):
    """For ArticulationCfg(actuators=...): one group of all joints."""
    damping, friction, armature = (
        {{name: values[k] for name, values in JOINTS.items()}} for k in range(3)
    )
    return {{
        "arm": ServoActuatorCfg(
            joint_names_expr=list(JOINTS),
            stiffness=0.0,
            damping=0.0,
            viscous_friction=damping,
            friction=friction,
            dynamic_friction=friction,
            armature=armature,
            physics_dt=physics_dt,
            decimation=decimation,
        )
    }}
'''

_SERVOS_MJLAB = '''
from dataclasses import dataclass
from pathlib import Path

from mjlab.actuator import IdealPdActuator, IdealPdActuatorCfg
from torchid import ServoArm
from torchid.simulators.servo import ServoTorque, drawn_servos

ARM = ServoArm.read(Path(__file__).with_name("{yaml}"))
DRAWS = Path(__file__).with_name("{draws}")
SERVOS = drawn_servos(DRAWS, ARM.servos) if DRAWS.is_file() else ARM.servos
JOINTS = {joints}
"""Damping [N m s/rad], dry friction [N m] and armature [kg m^2]."""


class ServoActuator(IdealPdActuator):
    """What the servos of the arm's joints do about a target of their positions."""

    def __init__(self, cfg, entity, target_ids, target_names):
        super().__init__(cfg, entity, target_ids, target_names)
        self.names = list(target_names)

    def edit_spec(self, spec, target_names):
        super().edit_spec(spec, target_names)
        for name in target_names:
            joint = spec.joint(name)
            damping, joint.frictionloss, joint.armature = JOINTS[name.rpartition("/")[2]]
            # One number, or a polynomial's three, by the version of MuJoCo.
            single = isinstance(joint.damping, float)
            joint.damping = damping if single else [damping, 0.0, 0.0]

    def initialize(self, mj_model, model, data, device):
        super().initialize(mj_model, model, data, device)
        of = self.names, data.nworld, device
        step = {{"dt": float(mj_model.opt.timestep), "steps": self.cfg.decimation}}
        self.servos = ServoTorque(ARM.robot, SERVOS, *of, **step)

    def compute(self, cmd):
        if hasattr(cmd, "pos"):
            return self.servos.torque(cmd.position_target, cmd.pos, cmd.vel)
        return self.servos.torque(cmd.position_target, cmd.joint_pos, cmd.joint_vel)

    def reset(self, env_ids=None):
        super().reset(env_ids)
        self.servos.reset(env_ids)


@dataclass(kw_only=True)
class ServoActuatorCfg(IdealPdActuatorCfg):
    decimation: int = 4
    """Steps of the physics from one target to the next, as in the environment's Cfg."""

    def build(self, entity, target_ids, target_names):
        return ServoActuator(self, entity, target_ids, target_names)


def actuators(decimation):
    """For EntityArticulationInfoCfg(actuators=...): one group of all joints."""
    return (
        ServoActuatorCfg(
            target_names_expr=tuple(JOINTS),
            stiffness=0.0,
            damping=0.0,
            decimation=decimation,
        ),
    )
'''


def adds_any(robot: Robot) -> bool:
    """Whether an actuator adds any effect of a robot's."""
    return bool(_places(robot)["in_file"])


def _places(robot: Robot) -> dict[str, list[Valued]]:
    """What an actuator adds, what the simulator has fields for, and what nobody does."""
    ignored = EffectTorque(robot).ignored
    places: dict[str, list[Valued]] = {"in_file": [], "beside": [], "left_out": []}
    for effect, values in nominal_effects(robot):
        field = effect.attributes(values) is not None
        place = "beside" if field else "left_out" if effect.name in ignored else "in_file"
        places[place].append((effect, values))
    return places


def write_actuator(
    dynamics: Dynamics, package: Package, folder: Path, name: str, motion: Motion
) -> Written:
    """Write NAME_actuator_PACKAGE.py, and NAME_effects.yaml (of servos NAME_servos.yaml) which it
    reads; the yaml is read back and its torque compared.

    Args:
        dynamics: of which the robot's effects are written, or the servos.
        package: whose actuator.
        folder: exists.
        name: of the files, without suffix.
        motion: states (T, n) of the comparison.

    Returns:
        The draft, in which `beside` are effects that the simulator's own fields say, and the
        comparison.

    Raises:
        TorchidError: a robot of whose effects none can be added, or files that cannot be written.
    """
    if dynamics.arm is not None:
        return _write_servos(dynamics.arm, package, folder, name)
    robot = replace(dynamics.robot, bounds={})
    places = _places(robot)
    if not places["in_file"]:
        raise TorchidError(
            f"'{robot.name}' has no effect that an actuator adds.",
            got=", ".join(e.name for e, _ in nominal_effects(robot)) or "no effects",
            hint="damping, frictionloss and armature are in what `torchid export --to mjcf` writes",
        )
    lines = [f"- {e.name} ({', '.join(e.coefficient_names())})" for e, _ in places["in_file"]]
    ignored = dict.fromkeys(effect.name for effect, _ in places["left_out"])
    lines += [f"and not: {', '.join(ignored)}."] if ignored else []
    source, yaml = f"{name}_actuator_{package}.py", f"{name}_effects.yaml"
    text = (_HEAD + (_ISAACLAB if package == "isaaclab" else _MJLAB)).format(
        robot=robot.name,
        version=__version__,
        package="Isaac Lab" if package == "isaaclab" else "mjlab",
        effects="\n".join(lines),
        yaml=yaml,
        joints=tuple(robot.joint_names) if package == "mjlab" else list(robot.joint_names),
    )
    files = {source: text.encode(), yaml: robot_yaml(robot).encode()}
    in_file, beside, left_out = map(tuple, places.values())
    draft = Draft(files, in_file, beside, left_out)
    with staged(folder, files) as paths:
        torque = robot_torque(load_robot(paths[yaml]), motion)
        what = f"torque with all effects of {yaml}"
        return draft, kept([compared(READER, what, motion, dynamics.torque(motion), torque)])


def _write_servos(arm: ServoArm, package: Package, folder: Path, name: str) -> Written:
    """The same of servos; the yaml is read back and their torque compared."""
    source, yaml = f"{name}_actuator_{package}.py", f"{name}_servos.yaml"
    fields = torch.stack([arm.servos.of(field) for field in FIELDS], 1).tolist()
    ignored = ServoTorque(arm.robot, arm.servos, dt=STEP).ignored
    text = (_SERVOS + (_SERVOS_ISAACLAB if package == "isaaclab" else _SERVOS_MJLAB)).format(
        robot=arm.robot.name,
        version=__version__,
        package="Isaac Lab" if package == "isaaclab" else "mjlab",
        not_said=f"; {', '.join(ignored)} are not made" if ignored else "",
        yaml=yaml,
        draws=f"{name}_servo_draws.npz",
        joints=pformat(dict(zip(arm.robot.joint_names, fields, strict=True)), sort_dicts=False),
    )
    files = {source: text.encode(), yaml: arm.yaml.encode()}
    # At commands, positions and velocities within a servo's reach.
    draw, states = torch.Generator().manual_seed(0), 50
    given = 0.4 * torch.rand(3, states, arm.robot.n, generator=draw, dtype=torch.float64) - 0.2

    def torque(one: ServoArm) -> Joints:
        drives = ServoTorque(one.robot, one.servos, None, states, dtype=torch.float64, dt=STEP)
        return drives.torque(*given)

    with staged(folder, files) as paths:
        apart = relative_difference(torque(ServoArm.read(paths[yaml])), torque(arm))
        what = f"torque of the servos of {yaml}"
        return Draft(files), kept([Comparison(READER, what, states, apart, EXACT)])
