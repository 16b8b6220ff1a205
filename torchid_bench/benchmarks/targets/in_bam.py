"""An exported arm, played by better-actuator-models' own controller in MuJoCo:
`python in_bam.py FOLDER`.

FOLDER has arm.xml and arm_bam.json of `torchid export`, and a motion. The file's actuators become
motors; dry friction is made so stiff that a joint at rest stays there.
"""

import sys
from pathlib import Path

import mujoco
import numpy as np
from bam.mujoco import load_config

from torchid_bench.benchmarks.targets.motion import Played, answer


def play(folder: Path) -> np.ndarray:
    """Positions (W, K, n) of a motion."""
    motion = Played.read(folder)
    spec = mujoco.MjSpec.from_file(str(folder / "arm.xml"))
    for actuator in spec.actuators:
        actuator.set_to_motor()
        actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE
    model = spec.compile()
    model.opt.timestep = motion.step
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    model.dof_solimp[:, :2], model.dof_solref[:] = 0.9999, [2.1 * motion.step, 1.0]
    joints = [model.joint(name) for name in motion.joints]
    rows, places = ([int(getattr(j, at)[0]) for j in joints] for at in ("dofadr", "qposadr"))
    out = np.full(motion.control.shape, np.nan)
    for w in range(len(out)):
        data = mujoco.MjData(model)
        controllers, _ = load_config(str(folder / "arm_bam.json"), model, data, kp=1.0, vin=1.0)
        # Its controllers begin where the model is at zero.
        data.qpos[places], data.qvel[rows] = motion.q[w], motion.dq[w]
        mujoco.mj_forward(model, data)
        for k, control in enumerate(motion.control[w]):
            out[w, k] = data.qpos[places]
            for name, goal in zip(motion.joints, control, strict=True):
                controllers[name].set_q_target(name, goal)
            for _ in range(motion.steps):
                for controller in controllers.values():
                    controller.update()
                mujoco.mj_step(model, data)
    return out


if __name__ == "__main__":
    answer(Path(sys.argv[1]), play(Path(sys.argv[1])))
