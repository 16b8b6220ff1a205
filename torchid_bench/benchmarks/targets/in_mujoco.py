"""An exported arm, played by MuJoCo: `python in_mujoco.py FOLDER`. The reference of all targets.

FOLDER has arm.xml of `torchid export`, and a motion. Commands go to the file's own actuators;
where there is arm_servos.yaml or arm_effects.yaml, these do the work of servos or of effects at run
time, as in torchid.simulators.
"""

import sys
from pathlib import Path

import mujoco
import numpy as np
import torch

from torchid_bench.benchmarks.targets.motion import Played, answer


def play(folder: Path) -> np.ndarray:
    """Positions (W, K, n) of a motion."""
    motion = Played.read(folder)
    model = mujoco.MjModel.from_xml_path(str(folder / "arm.xml"))
    model.opt.timestep = motion.step
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    joints = [model.joint(name) for name in motion.joints]
    rows = [int(j.dofadr[0]) for j in joints]
    places = [int(j.qposadr[0]) for j in joints]
    servos, effects = folder / "arm_servos.yaml", folder / "arm_effects.yaml"
    if servos.exists() or motion.kind == "torque":
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    out = np.full(motion.control.shape, np.nan)
    for w in range(len(out)):
        torque = _drive(servos, effects, motion)
        data = mujoco.MjData(model)
        data.qpos[places], data.qvel[rows] = motion.q[w], motion.dq[w]
        if torque is None:
            _stand(model, data, motion.control[w, 0])
        for k, control in enumerate(motion.control[w]):
            out[w, k] = data.qpos[places]
            for _ in range(motion.steps):
                if torque is None:
                    data.ctrl[:] = control
                else:
                    now = control, data.qpos[places], data.qvel[rows]
                    data.qfrc_applied[rows] = torque(*(torch.from_numpy(x)[None] for x in now))[0]
                mujoco.mj_step(model, data)
    return out


def _drive(servos: Path, effects: Path, motion: Played):  # type: ignore[no-untyped-def]
    """Torque of a control at q, dq; None where the file's own actuators follow it."""
    if servos.exists():
        from torchid import ServoArm
        from torchid.simulators.servo import ServoTorque

        arm = ServoArm.read(servos)
        step = {"dt": motion.step, "steps": motion.steps}
        return ServoTorque(arm.robot, arm.servos, motion.joints, dtype=torch.float64, **step).torque
    if not effects.exists():
        return None if motion.kind == "position" else lambda control, q, dq: control
    from torchid import load_robot
    from torchid.simulators.actuator import EffectTorque

    resisting = EffectTorque(load_robot(effects), motion.joints, dtype=torch.float64)
    return lambda control, q, dq: control - resisting.torque(q, dq, motion.step, control)


def _stand(model: mujoco.MjModel, data: mujoco.MjData, control: np.ndarray) -> None:
    """As if a command had stood for long: in delays and filters."""
    data.ctrl[:] = control
    for k, value in enumerate(control):
        held = int(model.actuator_history[k, 0])
        if held:
            past = model.opt.timestep * (np.arange(held) - held)
            mujoco.mj_initCtrlHistory(model, data, k, past, np.full((held, 1), value))
        if model.actuator_actnum[k]:
            data.act[model.actuator_actadr[k]] = value


if __name__ == "__main__":
    answer(Path(sys.argv[1]), play(Path(sys.argv[1])))
