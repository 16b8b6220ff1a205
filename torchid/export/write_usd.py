"""Attributes of joints as a USD layer over a stage that has the arm: drives, friction, armature.

Each joint gets an `over`, with its fields in the schemas of UsdPhysics (drives), PhysX (as of Isaac
Sim 5) and MuJoCo (which Newton reads, too). Of a revolute joint UsdPhysics and PhysX count errors
and rates in degrees, MuJoCo in radians. Bodies are not in it.
"""

import math
import re
from pathlib import Path

from torchid import __version__
from torchid.digits import number
from torchid.effects.registry import nominal_effects
from torchid.export.checks import Draft, missing, staged_files
from torchid.export.dynamics import Dynamics, effect_text
from torchid.export.write_plain import Written
from torchid.robot.model import JointType
from torchid.simulators.joint_dynamics import JointDynamics, split

SAID = ("kp", "kd", "clip", "damping", "coulomb", "armature")
"""Parameters of servos that a layer says."""


def write_usd(dynamics: Dynamics, path: Path) -> Written:
    """Write the layer; nothing of torchid reads it back."""
    robot, arm = dynamics.robot, dynamics.arm
    joints, rest = split(robot, "usd")
    overs = []
    for j, (name, kind) in enumerate(zip(robot.joint_names, robot.joint_types, strict=True)):
        turns = kind is JointType.REVOLUTE
        axis, unit = ("angular", math.pi / 180) if turns else ("linear", 1.0)
        schemas = ["PhysxJointAPI", f"PhysxJointAxisAPI:{axis}", "MjcJointAPI"]
        fields = _passive(joints[j], axis, unit)
        if arm is not None:
            schemas.insert(0, f"PhysicsDriveAPI:{axis}")
            kp, kd, clip = (float(arm.servos.of(key)[j]) for key in ("kp", "kd", "clip"))
            fields |= _drive(kp, kd, clip, axis, unit)
        applied = ", ".join(f'"{schema}"' for schema in schemas)
        overs += [f'over "{_prim(name)}" (', f"    prepend apiSchemas = [{applied}]", ")", "{"]
        overs += [*(f"    {key} = {value}" for key, value in fields.items()), "}"]
    lines = [
        "#usda 1.0",
        f"# Joints of {dynamics.title}; torchid {__version__}.",
        "# A stage with subLayers = [@this file@, @the arm@] has them where the arm's joints are",
        f"# below /{_prim(robot.name)}/joints; elsewhere move the overs.",
        *(f"# Not in it: {effect_text(*pair, robot)}" for pair in rest),
        f'over "{_prim(robot.name)}"',
        "{",
        '    over "joints"',
        "    {",
        *(f"        {line}" for line in overs),
        "    }",
        "}",
        "",
    ]
    known = tuple(pair for pair in nominal_effects(robot) if pair not in rest)
    draft = Draft({path.name: "\n".join(lines).encode()}, known, left_out=rest)
    with staged_files(path.parent, draft.files):
        return draft, (missing("usd-core", "attributes of joints", "not read back"),)


def _prim(name: str) -> str:
    """A name as that of a prim."""
    return re.sub(r"^(?=\d)|\W", "_", name)


def _passive(joint: JointDynamics, axis: str, unit: float) -> dict[str, str]:
    """Friction and armature of a joint."""
    on_axis = f"float physxJointAxis:{axis}"
    damping, friction, armature = map(number, (joint.damping, joint.friction, joint.armature))
    return {
        "float physxJoint:armature": armature,
        f"{on_axis}:armature": armature,
        f"{on_axis}:staticFrictionEffort": friction,
        f"{on_axis}:dynamicFrictionEffort": friction,
        f"{on_axis}:viscousFrictionCoefficient": number(joint.damping * unit),
        "double mjc:armature": armature,
        "double mjc:frictionloss": friction,
        "double mjc:damping": damping,
    }


def _drive(kp: float, kd: float, clip: float, axis: str, unit: float) -> dict[str, str]:
    """A servo as UsdPhysics' drive."""
    drive = f"drive:{axis}:physics"
    limit = {f"float {drive}:maxForce": number(clip)} if math.isfinite(clip) else {}
    return {
        f"uniform token {drive}:type": '"force"',
        f"float {drive}:stiffness": number(kp * unit),
        f"float {drive}:damping": number(kd * unit),
        **limit,
    }
