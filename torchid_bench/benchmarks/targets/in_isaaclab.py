"""Exported actuators asked by Isaac Lab's own classes: `python in_isaaclab.py FOLDER`.

Isaac Sim is not in the package index, so that no physics runs: FOLDER has arm_actuator_isaaclab.py
of `torchid export` and a motion whose q and dq are (W, K, n), at which the efforts (W, K, n) are
answered. Of Isaac Sim, `carb` and `omni.client` are empty modules: what the actuators' package
imports of them is for files on servers.
"""

import runpy
import sys
import types
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import torch

from torchid_bench.benchmarks.targets.motion import Played, answer

spec = find_spec("isaaclab")
assert spec is not None
assert spec.origin is not None
sys.path.insert(0, str(Path(spec.origin).parent / "source/isaaclab"))
for absent in ("carb", "omni", "omni.client"):
    sys.modules[absent] = types.ModuleType(absent)
sys.modules["omni"].client = sys.modules["omni.client"]  # type: ignore[attr-defined]
no_setting = types.SimpleNamespace(get=lambda key: "")
settings = types.SimpleNamespace(get_settings=lambda: no_setting)
sys.modules["carb"].settings = settings  # type: ignore[attr-defined]

from isaaclab.utils.types import ArticulationActions  # noqa: E402


def play(folder: Path) -> np.ndarray:
    """Efforts (W, K, n) along a motion."""
    motion = Played.read(folder)
    made = runpy.run_path(str(folder / "arm_actuator_isaaclab.py"))
    by_position = motion.kind == "position"
    step, names, count = motion.step, list(motion.joints), len(motion.q)
    cfg = made["actuators"](step, 1) if by_position else made["actuators"](0.0, 0.0, 1e9, step)
    (cfg,) = cfg.values()
    actuator = cfg.class_type(cfg, names, slice(None), count, "cpu")
    actuator.reset(list(range(count)))
    control, q, dq = (
        torch.tensor(x, dtype=torch.float32) for x in (motion.control, motion.q, motion.dq)
    )
    efforts = []
    for k in range(control.shape[1]):
        none = torch.zeros_like(q[:, k])
        position, effort = (control[:, k], none) if by_position else (none, control[:, k])
        action = ArticulationActions(position, none, effort)
        efforts.append(actuator.compute(action, q[:, k], dq[:, k]).joint_efforts)
    return torch.stack(efforts, 1).numpy()


if __name__ == "__main__":
    answer(Path(sys.argv[1]), play(Path(sys.argv[1])))
