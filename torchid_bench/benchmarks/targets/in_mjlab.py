"""An exported arm and its exported actuators, played by mjlab: `python in_mjlab.py FOLDER`.

FOLDER has arm.xml and arm_actuator_mjlab.py of `torchid export`, and a motion.
"""

import runpy
import sys
from pathlib import Path

import mujoco
import numpy as np
import torch
from mjlab.entity import EntityArticulationInfoCfg, EntityCfg
from mjlab.scene import Scene, SceneCfg
from mjlab.sim import MujocoCfg, Simulation, SimulationCfg

from torchid_bench.benchmarks.targets.motion import Played, answer


def play(folder: Path, device: str = "cpu") -> np.ndarray:
    """Positions (W, K, n) of a motion."""
    motion, made = Played.read(folder), runpy.run_path(str(folder / "arm_actuator_mjlab.py"))
    by_position = motion.kind == "position"
    drives = made["actuators"](motion.steps) if by_position else made["actuators"](0.0, 0.0, 1e9)
    arm = EntityCfg(
        spec_fn=lambda: mujoco.MjSpec.from_file(str(folder / "arm.xml")),
        articulation=EntityArticulationInfoCfg(actuators=drives),
    )
    count = len(motion.q)
    scene = Scene(SceneCfg(num_envs=count, entities={"robot": arm}), device)
    physics = MujocoCfg(timestep=motion.step, disableflags=("contact",))
    simulation = Simulation(count, SimulationCfg(mujoco=physics), scene.compile(), device)
    scene.initialize(simulation.mj_model, simulation.model, simulation.data)
    robot = scene["robot"]
    ids = torch.tensor([robot.joint_names.index(name) for name in motion.joints])

    def tensor(x: np.ndarray) -> torch.Tensor:
        return torch.tensor(x, dtype=torch.float32, device=device)

    scene.reset()
    robot.write_joint_state_to_sim(tensor(motion.q), tensor(motion.dq), joint_ids=ids)
    simulation.forward()
    scene.update(0.0)
    out = np.full(motion.control.shape, np.nan)
    for k in range(motion.control.shape[1]):
        out[:, k] = robot.data.joint_pos[:, ids].numpy(force=True)
        target = tensor(motion.control[:, k])
        if by_position:
            robot.set_joint_position_target(target, joint_ids=ids)
        else:
            robot.set_joint_effort_target(target, joint_ids=ids)
        for _ in range(motion.steps):
            scene.write_data_to_sim()
            simulation.step()
            scene.update(motion.step)
    return out


if __name__ == "__main__":
    answer(Path(sys.argv[1]), play(Path(sys.argv[1])))
