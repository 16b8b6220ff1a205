"""mujoco.sysid itself, on the folds of `position_folds.py` and by its measures.

    python -m torchid_bench.benchmarks.peers_positions ROBOT LOG... [--folds 5] [--windows 60]
    python -m torchid_bench.benchmarks.peers_positions ROBOT LOG... --held-out OTHER...

MuJoCo's own toolbox (`pip install "mujoco[sysid]"`) fits what a servo of torchid's has and an MJCF
can say: kp, kv within a largest torque, damping, armature, dry friction, and of the command an
offset, a scale, a delay and a filter of first order, of each joint (60 of six joints), to windows
of 2 s from their measured start. Windows of 10 s are those of `torchid correct`. `default` has MuJoCo's dry friction, which
creeps; `firm` has solimpfriction .9999, with which a joint that is stuck stays there. Masses are
the file's, and the simulator, its derivatives and its optimiser MuJoCo's own. Each residual is the
difference of positions in radians: its own default divides by each window's size.
"""

import io
import os
import tempfile
import time
from collections.abc import Iterable, Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import mujoco
import numpy as np
import torch
from mujoco import sysid
from scipy.signal import lfilter

from torchid.export.correct_positions import WINDOW_S as PROMISED_S
from torchid.export.export import export_dynamics
from torchid.log.model import Log
from torchid.log.readers import read_log
from torchid.position.data import WINDOW_S, PositionData, prepare
from torchid.position.problem import some_of
from torchid.simulation.servo_loop import windows_of
from torchid_bench.benchmarks.position_errors import fold_parser, print_errors, read_folds

START = {
    "kp": 17.8, "damping": 0.6, "armature": 0.028, "frictionloss": 0.052, "kv": 0.06, "clip": 5.0,
}  # fmt: skip
"""Of the SO-101's STS3215 in TheRobotStudio's `joints_properties.xml`; kv and the largest torque so
that they do little."""
RANGE = {"kp": 30.0, "damping": 30.0, "armature": 30.0, "frictionloss": 100.0} | dict.fromkeys(
    ("kv", "clip"), 100.0
)
"""Factors by which a fit may leave these."""
STEPS = 4
"""Of the simulator, from one row of a log to the next."""
DELAY_S, LATEST_S = 0.04, 0.15
LONGEST_LAG_S = 0.2
SCALES = (0.8, 1.2)
PAST_S = 2.0
"""Of commands before a window, which a delay and a filter know [s]."""
FARTHEST = 0.3
"""Offset of a command that a fit may have [rad]."""
FIRM = [0.9999, 0.9999, 0.001, 0.5, 2]
"""`solimpfriction` with which a joint that is stuck stays there."""


def spec_of(robot: Any, folder: Path, step: float, *, firm: bool) -> mujoco.MjSpec:
    """The arm of the file with a position servo and a position sensor on every joint."""
    file = export_dynamics(robot, "mjcf", folder, nominal=robot, geometry="none").files[0]
    spec = mujoco.MjSpec.from_file(str(file))
    spec.option.timestep = step
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for name in robot.joint_names:
        joint = spec.joint(name)
        joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
        if firm:
            joint.solimp_friction = FIRM
        servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=START["kp"])
        spec.add_sensor(
            name=f"{name}_q", type=mujoco.mjtSensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=name,
        )  # fmt: skip
    return spec


def parameters(names: Sequence[str]) -> Any:
    """Logarithms of each joint's `START`, its offset in radians, its delay and lag in tenths of a
    second, and the scale of its commands."""
    out = sysid.ParameterDict()
    for joint in names:
        for what, start in START.items():

            def change(s: Any, p: Any, joint: str = joint, what: str = what) -> None:
                value = float(np.exp(p.value[0]))
                if what == "kp":
                    s.actuator(joint).set_to_position(kp=value)
                elif what == "kv":
                    s.actuator(joint).biasprm[2] = -value
                elif what == "clip":
                    s.actuator(joint).forcerange = np.array([-value, value])
                    s.actuator(joint).forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
                elif what == "damping":
                    s.joint(joint).damping = np.array([value, 0.0, 0.0])
                else:
                    setattr(s.joint(joint), what, value)

            middle, width = np.log(start), np.log(RANGE[what])
            bounds = middle - width, middle + width
            out.add(sysid.Parameter(f"{joint} {what}", middle, *bounds, modifier=change))

        # After kp, which makes the actuator anew.
        def shift(s: Any, p: Any, joint: str = joint) -> None:
            servo = s.actuator(joint)
            servo.biasprm[0] = servo.gainprm[0] * p.value[0]

        out.add(sysid.Parameter(f"{joint} offset", 0.0, -FARTHEST, FARTHEST, modifier=shift))
        out.add(sysid.Parameter(f"{joint} delay", 10 * DELAY_S, 0.0, 10 * LATEST_S))
        out.add(sysid.Parameter(f"{joint} lag", 0.1, 0.0, 10 * LONGEST_LAG_S))
        out.add(sysid.Parameter(f"{joint} scale", 1.0, *SCALES))
    return out


def residual(spec: mujoco.MjSpec, data: PositionData, chunks: Iterable[tuple[int, int]]) -> Any:
    """sysid's residual [rad] of chunks of the motions, each of so many rows from a first one."""
    model, n = spec.compile(), data.robot.n
    q, dq, u = (x.numpy() for x in (data.q, data.dq, data.tracks.u))
    dt, firsts = data.tracks.dt, data.tracks.first.numpy()

    def rolled(*, control_signal: Any, param_dicts: Any, **rest: Any) -> Any:
        times = control_signal[0].times
        row = round(times[0] / dt)
        first = firsts[np.searchsorted(firsts, row, side="right") - 1]
        first = max(first, row - round(PAST_S / dt))
        known = np.arange(first, row + len(times) // STEPS + 1)
        before = times[0] - dt / STEPS * np.arange(STEPS * (row - first), 0, -1)
        fine = np.concatenate([before, times])
        moved = []
        for p in param_dicts:
            late = np.empty((len(fine), n))
            for j, joint in enumerate(data.robot.joint_names):
                delay, lag, scale = (
                    p[f"{joint} {what}"].value[0] for what in ("delay", "lag", "scale")
                )
                x = scale * np.interp(fine - delay / 10, dt * known, u[known, j])
                share = 1 - np.exp(-dt / STEPS / max(lag / 10, 1e-9))
                late[:, j], _ = lfilter([share], [1, share - 1], x, zi=[(1 - share) * x[0]])
            late = late[len(before) :]
            moved.append(sysid.TimeSeries(times, late, control_signal[0].signal_mapping))
        return sysid.sysid_rollout(control_signal=moved, **rest)

    def differences(
        params: Any, predicted: Any, measured: Any, model: Any, every: bool, *, state: Any, **_: Any
    ) -> Any:
        # Sensors are one step older than states, which are those after each step.
        found = state[STEPS - 1 :: STEPS, 1 : 1 + n]
        own = sysid.TimeSeries(measured.times[1:], found, measured.signal_mapping)
        seen = sysid.TimeSeries(measured.times[1:], measured.data[1:], measured.signal_mapping)
        return seen.data - found, own, seen

    starts, controls, seen = [], [], []
    for a, rows in chunks:
        fine = a * dt + dt / STEPS * np.arange(STEPS * (rows - 1) + 1)
        starts.append(sysid.create_initial_state(model, q[a], dq[a], np.zeros(0)))
        controls.append(sysid.TimeSeries(fine, np.zeros((len(fine), n))))
        at = dt * np.arange(a, a + rows)
        seen.append(sysid.TimeSeries.from_names(at, q[a : a + rows], model))
    names = [str(k) for k in range(len(starts))]
    return sysid.build_residual_fn(
        models_sequences=[sysid.ModelSequences("arm", spec, names, starts, controls, seen)],
        modify_residual=differences,
        custom_rollout=rolled,
        resample_true=False,
        n_threads=1,
    )


def chunks_of(data: PositionData, seconds: float | None, most: int | None = None) -> list[Any]:
    """Whole motions, or windows: all, or some evenly taken ones."""
    windows = windows_of(data.tracks, seconds)
    windows = windows if most is None else some_of(windows, most)
    return list(zip(windows.start.tolist(), windows.length.tolist(), strict=True))


def main() -> None:
    parser = fold_parser(__doc__)
    parser.add_argument("--only", type=int, nargs="*", help="these folds alone")
    parser.add_argument("--held-out", type=Path, nargs="*", help="judge by these, fit to all LOG")
    parser.add_argument("--windows", type=int, default=60, help="that a fit looks at")
    parser.add_argument("--friction", default="default,firm")
    given = parser.parse_args()
    robot, parts, folds = read_folds(given)
    if given.held_out:
        others = list(read_log(given.held_out).trajectories())
        folds, parts, given.only = [1] * len(parts) + [0] * len(others), parts + others, [0]
    for friction in given.friction.split(","):
        squares: dict[float | None, list[torch.Tensor]] = {None: [], WINDOW_S: [], PROMISED_S: []}
        busy, taken = 0.0, given.only or range(given.folds)
        for fold in taken:
            begun = time.process_time()
            sides = [
                [p for p, f in zip(parts, folds, strict=True) if (f == fold) == k] for k in (0, 1)
            ]
            training, kept = (prepare(robot, Log.concatenate(some)) for some in sides)
            with tempfile.TemporaryDirectory() as folder:
                step, firm = training.tracks.dt / STEPS, friction == "firm"
                spec = spec_of(training.robot, Path(folder), step, firm=firm)
            function = residual(spec, training, chunks_of(training, WINDOW_S, given.windows))
            with redirect_stdout(io.StringIO()):
                fitted, _ = sysid.optimize(
                    parameters(robot.joint_names), function, verbose=False, max_iters=15, eps=1e-4,
                    xtol=1e-3,
                )  # fmt: skip
            busy += time.process_time() - begun
            values = {name: float(p.value[0]) for name, p in fitted.items()}
            for what in START:
                row = (np.exp(values[f"{joint} {what}"]) for joint in robot.joint_names)
                print(f"  fold {fold}  {what:13s}" + " ".join(f"{x:8.3g}" for x in row), flush=True)
            for seconds, rows in squares.items():
                for chunk in chunks_of(kept, seconds):
                    error = residual(spec, kept, [chunk])(fitted.as_vector(), fitted)[0][0]
                    radians = torch.from_numpy(error.reshape(-1, robot.n)) / kept.scale
                    rows.append(torch.cat([torch.zeros(1, robot.n), radians]).square())
        for seconds, rows in squares.items():
            each = "motions" if seconds is None else "windows"
            print_errors(friction, seconds, rows, busy / len(taken), each=each)


if __name__ == "__main__":
    main()
