"""Servos as better-actuator-models has them: the JSON of `bam.mujoco.load_config`.

Read of version 1.0.2 (Duclusaud, Passault, Padois, Ly 2025). A motor's torque there is

    kt / R V - kt^2 / R dq,   V = vin clip(kp error_gain (q_target - q), +-max_pwm)

With kp = vin = 1 and kt = R a volt is a newton metre: error_gain is the servo's gain, max_pwm its
limit of torque, before what kt takes off: the damping that is the motor's own.
"""

import json
from collections.abc import Mapping
from pathlib import Path

from torchid.effects.servo import NAMES
from torchid.errors import TorchidError
from torchid.export.checks import Draft, missing, staged_files
from torchid.export.write_plain import Written
from torchid.position.model import ServoArm

SAID = (
    "kp", "clip", "damping", "damping_share", "armature", "coulomb", "stiction", "stiction_share",
    "stribeck_speed", "stribeck_exponent", "motor_share", "load_share",
)  # fmt: skip
"""Parameters of servos that its models hold."""
_READER = "better-actuator-models"
_VOLTS = "mx64"
"""Of its actuators one that is a voltage, a resistance and a rotor, and all of whose numbers stand
in the file."""
_NO_LIMIT, _NO_TORQUE = 1e9, 1e-9
"""N m, and N m s/rad: JSON has no infinity, and a motor there is divided by its kt."""


def bam_model(p: Mapping[str, float]) -> dict[str, object]:
    """A servo's friction as the smallest of the models M1 to M5 that holds it; none needs M6, whose
    squares of torques no servo here has.

    Args:
        p: by name of `torchid.effects.servo.PARAMETERS`.
    """
    fades = p["stiction"] > 0 or p["stiction_share"] > 0
    loaded = max(p["motor_share"], p["load_share"], p["stiction_share"]) > 0
    directed = p["motor_share"] != p["load_share"]
    inside = p["kd"] + p["damping_share"] * p["damping"]
    kt = max(inside, _NO_TORQUE)
    out = {"kt": kt, "R": kt, "armature": p["armature"], "friction_base": p["coulomb"]}
    if directed:
        out |= {f"load_friction_{x}": p[f"{y}_share"] for x, y in _SIDES.items()}
        out |= dict.fromkeys((f"load_friction_{x}_stribeck" for x in _SIDES), p["stiction_share"])
    elif loaded:
        out["load_friction_base"] = p["load_share"]
        out |= {"load_friction_stribeck": p["stiction_share"]} if fades else {}
    if fades or directed:
        out |= {"friction_stribeck": p["stiction"], "dtheta_stribeck": p["stribeck_speed"]}
        out["alpha"] = p["stribeck_exponent"]
    number = 5 if directed else 1 + fades + 2 * loaded
    out["friction_viscous"] = p["damping"] * (1 - p["damping_share"])
    return {**out, "model": f"m{number}", "actuator": _VOLTS}


_SIDES = {"motor": "motor", "external": "load"}


def write_bam(arm: ServoArm | None, folder: Path, name: str) -> Written:
    """Write NAME_bam.json: of each joint, whose MuJoCo actuator is a motor of the same name, its
    model, gain and limit.

    Raises:
        TorchidError: no servos are known, or the file cannot be written.
    """
    if arm is None:
        raise TorchidError(
            "better-actuator-models has models of servos, and none are known.",
            got="a robot without servos",
            expected="a .yaml that `torchid gap --save-model` wrote of commands and positions",
        )
    joints = {}
    for joint, row in zip(arm.robot.joint_names, arm.servos.joint.tolist(), strict=True):
        p = dict(zip(NAMES, row, strict=True))
        limit = min(p["clip"], _NO_LIMIT)
        own = {"model": bam_model(p), "error_gain": p["kp"], "max_pwm": limit}
        joints[joint] = {"dofs": [joint], **own}
    draft = Draft(
        {f"{name}_bam.json": json.dumps(joints, indent=2).encode()},
        notes=("bam.mujoco.load_config reads it with kp=1, vin=1; its actuators are motors",),
    )
    why = "it needs a Python of its own (3.12)"
    with staged_files(folder, draft.files):
        return draft, (missing(_READER, "friction", why),)
