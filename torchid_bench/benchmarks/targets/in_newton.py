"""An exported arm, played by Newton: `python in_newton.py FOLDER`.

FOLDER has arm.xml of `torchid export` and a motion. Newton reads the file and steps it with its
MuJoCo solver on the CPU, one window after the other. Commands go to the file's own actuators.
"""

import sys
from pathlib import Path

import newton
import numpy as np

from torchid_bench.benchmarks.targets.motion import Played, answer


def play(folder: Path) -> np.ndarray:
    """Positions (W, K, n) of a motion."""
    motion = Played.read(folder)
    builder = newton.ModelBuilder()
    builder.add_mjcf(str(folder / "arm.xml"))
    model = builder.finalize(device="cpu")
    labels = [label.rpartition("/")[2] for label in model.joint_label]
    joints = [labels.index(name) for name in motion.joints]
    places, rows = (start.numpy()[joints] for start in (model.joint_q_start, model.joint_qd_start))
    solver = newton.solvers.SolverMuJoCo(model, use_mujoco_cpu=True, disable_contacts=True)
    out = np.full(motion.control.shape, np.nan)
    for w in range(len(out)):
        now, then, control = model.state(), model.state(), model.control()
        # The file's actuators are in the order of its joints, as torchid writes them.
        given = control.mujoco.ctrl if motion.kind == "position" else control.joint_f
        at = np.argsort(np.argsort(places)) if motion.kind == "position" else rows
        _put(now.joint_q, places, motion.q[w])
        _put(now.joint_qd, rows, motion.dq[w])
        # As if the first command had stood for long: a filter begins where it was, or at zero.
        _put(given, at, motion.control[w, 0])
        if motion.kind == "position":
            filtered = solver.mj_model.actuator_actadr >= 0
            solver.mj_data.act[:] = given.numpy()[filtered]
        for k, values in enumerate(motion.control[w]):
            out[w, k] = now.joint_q.numpy()[places]
            _put(given, at, values)
            for _ in range(motion.steps):
                solver.step(now, then, control, None, motion.step)
                now, then = then, now
    return out


def _put(array, at: np.ndarray, values: np.ndarray) -> None:  # type: ignore[no-untyped-def]
    """Values at some places of an array of Warp's."""
    whole = array.numpy()
    whole[at] = values
    array.assign(whole)


if __name__ == "__main__":
    answer(Path(sys.argv[1]), play(Path(sys.argv[1])))
