"""Actuator classes with a robot's effects for Isaac Lab and mjlab, as files.

Read of the two packages: Isaac Lab 2.x (`isaaclab.actuators.IdealPDActuator`), and mjlab's main
branch after v1.2 (`mjlab.actuator.IdealPdActuator`, whose commands hold `pos` and `vel`, and
`joint_pos` and `joint_vel` before).
"""

from dataclasses import replace
from pathlib import Path
from typing import Literal

from torchid import __version__
from torchid.effects.base import Motion
from torchid.effects.registry import Valued, nominal_effects
from torchid.errors import TorchidError
from torchid.export.checks import compared
from torchid.export.dynamics import Dynamics, robot_torque
from torchid.export.keeping import Draft, kept, staged
from torchid.export.write_plain import READER, Written
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.robot.writer import robot_yaml
from torchid.simulators.actuator import EffectTorque

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
    """Write NAME_actuator_PACKAGE.py, and NAME_effects.yaml which it reads; the yaml is read back
    and its effects' torque compared.

    Args:
        dynamics: of which the robot's effects are written.
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
