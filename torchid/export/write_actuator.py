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
from torchid.export.checks import (
    EXACT,
    Comparison,
    Draft,
    relative_difference,
    require_agreement,
    staged_files,
)
from torchid.export.dynamics import Dynamics
from torchid.export.servo_mjcf import STEP
from torchid.export.write_plain import READER, Written, read_back
from torchid.position.model import ServoArm
from torchid.robot.config_files import filled_template
from torchid.robot.model import Robot
from torchid.robot.writer import robot_yaml
from torchid.simulators.actuator import EffectTorque
from torchid.simulators.servo import FIELDS, ServoTorque
from torchid.typing import Joints

Package = Literal["isaaclab", "mjlab"]


def _filled(template: str, robot: Robot, package: Package, **words: object) -> bytes:
    """A template of configs/templates with its words."""
    name = "Isaac Lab" if package == "isaaclab" else "mjlab"
    given = {"robot": robot.name, "version": __version__, "package": name, **words}
    return filled_template(f"{template}_{package}.txt", **given).encode()


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
    joints: object = tuple(robot.joint_names) if package == "mjlab" else list(robot.joint_names)
    text = _filled("effects", robot, package, effects="\n".join(lines), yaml=yaml, joints=joints)
    files = {source: text, yaml: robot_yaml(robot).encode()}
    in_file, beside, left_out = map(tuple, places.values())
    draft = Draft(files, in_file, beside, left_out)
    with staged_files(folder, files) as paths:
        what = f"torque with all effects of {yaml}"
        return draft, read_back(dynamics, paths[yaml], motion, what)


def _write_servos(arm: ServoArm, package: Package, folder: Path, name: str) -> Written:
    """The same of servos; the yaml is read back and their torque compared."""
    source, yaml = f"{name}_actuator_{package}.py", f"{name}_servos.yaml"
    fields = torch.stack([arm.servos.of(field) for field in FIELDS], 1).tolist()
    ignored = ServoTorque(arm.robot, arm.servos, dt=STEP).ignored
    text = _filled(
        "servos", arm.robot, package,
        not_said=f"; {', '.join(ignored)} are not made" if ignored else "",
        yaml=yaml,
        draws=f"{name}_servo_draws.npz",
        joints=pformat(dict(zip(arm.robot.joint_names, fields, strict=True)), sort_dicts=False),
    )  # fmt: skip
    files = {source: text, yaml: arm.yaml.encode()}
    # At commands, positions and velocities within a servo's reach.
    draw, states = torch.Generator().manual_seed(0), 50
    given = 0.4 * torch.rand(3, states, arm.robot.n, generator=draw, dtype=torch.float64) - 0.2

    def torque(one: ServoArm) -> Joints:
        drives = ServoTorque(one.robot, one.servos, None, states, dtype=torch.float64, dt=STEP)
        return drives.torque(*given)

    with staged_files(folder, files) as paths:
        apart = relative_difference(torque(ServoArm.read(paths[yaml])), torque(arm))
        what = f"torque of the servos of {yaml}"
        return Draft(files), require_agreement([Comparison(READER, what, states, apart, EXACT)])
