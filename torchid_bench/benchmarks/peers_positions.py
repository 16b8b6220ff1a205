"""mujoco.sysid itself, fitted to some motions and judged on others.

    python -m torchid_bench.benchmarks.peers_positions ROBOT LOG... --held-out OTHER...
        [--corrected FILE] [--windows 60]

MuJoCo's own toolbox (`pip install "mujoco[sysid]"`) fits, to windows of 2 s from their measured
start, of each joint

- `plain`: kp, damping, armature and dry friction, and one delay (25 numbers of six joints),
- `offset`: an offset of the command, too (31),
- `all`: what a servo of torchid's has and an MJCF can say: a velocity gain and a largest torque,
  and of the command a scale, a delay and a filter of first order (60); begun where `offset` ended,
  if that was fitted: from the maker's numbers it ends far away.

`default` has MuJoCo's dry friction, which creeps; `firm` has solimpfriction .9999, with which a
joint that is stuck stays there. Masses are the file's, and the simulator, its derivatives and its
optimiser MuJoCo's own. Each residual is the difference of positions in radians: its own default
divides by each window's size. FILE is torchid's, of `torchid gap ROBOT LOG... --save-model FILE`: it
is judged on the same motions, by its own replay, and as MuJoCo moves what `torchid correct` makes of
it (the seconds are that refit's): `servos and table`, and, as mujoco.sysid knows nothing of a table,
`servos` alone. Windows of 10 s are those of `torchid correct`.
"""

import io
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch
from scipy.signal import lfilter
from torch import Tensor

from torchid.export.correct import correct
from torchid.export.correct_positions import WINDOW_S as PROMISED_S
from torchid.export.export import export_dynamics
from torchid.export.servo_mjcf import ServosInMujoco
from torchid.log.model import Log
from torchid.log.readers import read_log
from torchid.position.data import WINDOW_S, PositionData, prepare
from torchid.position.model import ServoArm
from torchid.position.problem import some_of
from torchid.position.replay import replay
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.simulation.servo_loop import windows_of
from torchid_bench.benchmarks.runner import command, table
from torchid_bench.benchmarks.sysid_toolbox import sysid_toolbox

START = {
    "kp": 17.8, "damping": 0.6, "armature": 0.028, "frictionloss": 0.052, "kv": 0.06, "clip": 5.0,
}  # fmt: skip
"""Of the SO-101's STS3215 in TheRobotStudio's `joints_properties.xml`; kv and the largest torque so
that they do little."""
RANGE = {"kp": 30.0, "damping": 30.0, "armature": 30.0, "frictionloss": 100.0} | dict.fromkeys(
    ("kv", "clip"), 100.0
)
"""Factors by which a fit may leave these."""
PLAIN = ("kp", "damping", "armature", "frictionloss")
FITTED = {
    "plain": PLAIN,
    "offset": (*PLAIN, "offset"),
    "all": (*START, "offset", "delay", "lag", "scale"),
}
"""Of each joint; where the delay is not among them, all joints have one."""
STEPS = 4
"""Of the simulator, from one row of a log to the next."""
DELAY_S, LATEST_S = 0.04, 0.15
SCALES = (0.8, 1.2)
JUDGED = (None, WINDOW_S, PROMISED_S)
"""Whole motions, and windows [s]."""
HEADS = ("model", "windows", "all rows, joint by joint [mrad]", "mean", "each", "mean of each",
         "median of each", "CPU s")  # fmt: skip
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


def parameters(names: Sequence[str], fitted: Sequence[str]) -> Any:
    """Logarithms of each joint's `START`, its offset in radians, its delay and lag in tenths of a
    second, and the scale of its commands: those that are fitted."""
    sysid = sysid_toolbox()
    out, late = sysid.ParameterDict(), (10 * DELAY_S, 0.0, 10 * LATEST_S)
    if "delay" not in fitted:
        out.add(sysid.Parameter("delay", *late))
    # Offset of a command that a fit may have [rad]
    farthest = 0.3
    for joint in names:
        for what, start in START.items():
            if what not in fitted:
                continue

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

        # 0.2: time constant of the slowest filter [s]
        others: dict[str, tuple[tuple[float, float, float], Any]] = {
            "offset": ((0.0, -farthest, farthest), shift),
            "delay": (late, None),
            "lag": ((0.1, 0.0, 10 * 0.2), None),
            "scale": ((1.0, *SCALES), None),
        }
        for what, (bounds, modifier) in others.items():
            if what in fitted:
                out.add(sysid.Parameter(f"{joint} {what}", *bounds, modifier=modifier))
    return out


def value(params: Any, joint: str, what: str, without: float) -> float:
    """Value of a joint's parameter, else of all joints', else what stands for one that is not
    fitted."""
    for name in (f"{joint} {what}", what):
        if name in params:
            return float(params[name].value[0])
    return without


def residual(spec: mujoco.MjSpec, data: PositionData, chunks: Iterable[tuple[int, int]]) -> Any:
    """sysid's residual [rad] of chunks of the motions, each of so many rows from a first one; chunks
    of one length are rolled out together, so that their model is made once."""
    sysid, model, n = sysid_toolbox(), spec.compile(), data.robot.n
    q, dq, u = (x.numpy() for x in (data.q, data.dq, data.tracks.u))
    dt, firsts = data.tracks.dt, data.tracks.first.numpy()

    @lru_cache(maxsize=100_000)
    def late(row: int, times: int, j: int, delay: float, lag: float, scale: float) -> np.ndarray:
        """Commands of joint j at so many times from a row on."""
        first = firsts[np.searchsorted(firsts, row, side="right") - 1]
        # 2.0: of commands before a window, which a delay and a filter know [s]
        first = max(first, row - round(2.0 / dt))
        known = np.arange(first, row + times // STEPS + 1)
        fine = dt * first + dt / STEPS * np.arange(STEPS * (row - first) + times)
        x = scale * np.interp(fine - delay, dt * known, u[known, j])
        share = 1 - np.exp(-dt / STEPS / max(lag, 1e-9))
        x, _ = lfilter([share], [1, share - 1], x, zi=[(1 - share) * x[0]])
        return x[-times:]

    def rolled(*, control_signal: Any, param_dicts: Any, **rest: Any) -> Any:
        moved, each = [], len(control_signal) // len(param_dicts)
        for k, control in enumerate(control_signal):
            p, times = param_dicts[k // each], control.times
            at = round(times[0] / dt), len(times)
            joints = [
                late(
                    *at, j, value(p, joint, "delay", 0.0) / 10, value(p, joint, "lag", 0.0) / 10,
                    value(p, joint, "scale", 1.0),
                )
                for j, joint in enumerate(data.robot.joint_names)
            ]  # fmt: skip
            moved.append(sysid.TimeSeries(times, np.stack(joints, 1), control.signal_mapping))
        return sysid.sysid_rollout(control_signal=moved, **rest)

    def differences(
        params: Any, predicted: Any, measured: Any, model: Any, every: bool, *, state: Any, **_: Any
    ) -> Any:
        # Sensors are one step older than states, which are those after each step.
        found = state[STEPS - 1 :: STEPS, 1 : 1 + n]
        own = sysid.TimeSeries(measured.times[1:], found, measured.signal_mapping)
        seen = sysid.TimeSeries(measured.times[1:], measured.data[1:], measured.signal_mapping)
        return seen.data - found, own, seen

    measured: dict[int, list[Any]] = {}
    for a, rows in chunks:
        fine = a * dt + dt / STEPS * np.arange(STEPS * (rows - 1) + 1)
        start = sysid.create_initial_state(model, q[a], dq[a], np.zeros(0))
        control = sysid.TimeSeries(fine, np.zeros((len(fine), n)))
        seen = sysid.TimeSeries.from_names(dt * np.arange(a, a + rows), q[a : a + rows], model)
        one = sysid.ModelSequences("arm", spec, str(a), start, control, seen)
        measured.setdefault(rows, []).extend(one.measured_rollout)

    def of(x: np.ndarray, params: Any) -> Any:
        residuals = []
        for alike in measured.values():
            found, _, _ = sysid.model_residual(
                x, params, lambda p: sysid.apply_param_modifiers(p, spec), alike, differences,
                rolled, n_threads=1, resample_true=False,
            )  # fmt: skip
            # One column for each x, chunk after chunk.
            found = found.T.reshape(x.shape[1], -1).T if x.ndim > 1 else found
            residuals.append(found)
        return residuals, [], []

    return of


def chunks_of(data: PositionData, seconds: float | None, most: int | None = None) -> list[Any]:
    """Whole motions, or windows: all, or some evenly taken ones."""
    windows = windows_of(data.tracks, seconds)
    windows = windows if most is None else some_of(windows, most)
    return list(zip(windows.start.tolist(), windows.length.tolist(), strict=True))


def fit(
    robot: Robot,
    training: PositionData,
    fitted: Sequence[str],
    windows: int,
    *,
    firm: bool,
    start: Any = None,
) -> tuple[mujoco.MjSpec, Any]:
    """The arm and the numbers that sysid finds; prints how far it came.

    Args:
        robot, training, fitted: whose joints, on which motions, and what of each joint.
        windows: that the fit looks at.
        firm: whether a joint that is stuck stays there.
        start: numbers that another fit has found.
    """
    with tempfile.TemporaryDirectory() as folder:
        spec = spec_of(training.robot, Path(folder), training.tracks.dt / STEPS, firm=firm)
    function = residual(spec, training, chunks_of(training, WINDOW_S, windows))
    sysid = sysid_toolbox()
    begun, sums = parameters(robot.joint_names, fitted), []
    for name, p in begun.items():
        joint, _, what = name.rpartition(" ")
        p.value = np.array([value(start or {}, joint, what, float(p.value[0]))])
    with redirect_stdout(io.StringIO()):
        # 15: at most
        found, _ = sysid.optimize(
            begun, function, verbose=False, max_iters=15, eps=1e-4, xtol=1e-3,
            iter_callback=lambda trace: sums.append(trace[-1].objective),
        )  # fmt: skip
    print(f"  {begun.size} numbers, iterations: " + " ".join(f"{x:.4g}" for x in sums))
    values = {name: float(p.value[0]) for name, p in found.items()}
    for what in fitted:
        row = [values[f"{joint} {what}"] for joint in robot.joint_names]
        row = np.exp(row).tolist() if what in START else row
        print(f"  {what:13s}" + " ".join(f"{x:8.3g}" for x in row), flush=True)
    return spec, found


def main(
    robot: str,
    logs: Sequence[Path],
    *,
    held_out: Sequence[Path],
    windows: int = 60,
    fitted: tuple[str, ...] = tuple(FITTED),
    friction: tuple[str, ...] = ("default", "firm"),
    corrected: str | None = None,
) -> None:
    """Fit logs, judge by others, and torchid's model of the logs, too."""
    arm, log = load_robot(robot), read_log(list(logs))
    others = list(read_log(list(held_out)).trajectories())
    training, kept = prepare(arm, log), prepare(arm, Log.concatenate(others))
    with_offset, rows = dict[str, Any](), []
    for hold, which in product(friction, fitted):
        begun, start = time.process_time(), with_offset.get(hold) if which == "all" else None
        spec, best = fit(arm, training, FITTED[which], windows, firm=hold == "firm", start=start)
        busy, squares = time.process_time() - begun, {x: list[Tensor]() for x in JUDGED}
        if which == "offset":
            with_offset[hold] = best
        for seconds, own in squares.items():
            for chunk in chunks_of(kept, seconds):
                error = residual(spec, kept, [chunk])(best.as_vector(), best)[0][0]
                radians = torch.from_numpy(error.reshape(-1, arm.n)) / kept.scale
                own.append(torch.cat([torch.zeros(1, arm.n), radians]).square())
        rows += rows_of(f"{hold} {which}", squares, busy)
    if corrected:
        rows += ours(corrected, log, others)
    table(HEADS, rows)


def ours(corrected: str, log: Log, others: Sequence[Log]) -> list[tuple[str, ...]]:
    """Errors on other motions of torchid's own replay, and of MuJoCo's of the refitted file: with
    what the arm touches, that file with its contact off, and refitted as servos alone."""
    whole = ServoArm.read(corrected)
    data = prepare(whole.robot, Log.concatenate(others), whole.scale)
    measured = data.q / data.scale

    def judged(name: str, busy: float, positions: Callable[[float | None], Tensor]) -> None:
        squares = dict[float | None, list[Tensor]]()
        for seconds in JUDGED:
            square = (positions(seconds) - measured).square()
            squares[seconds] = [square[a : a + rows] for a, rows in chunks_of(data, seconds)]
        out.extend(rows_of(name, squares, busy))

    def in_mujoco(seconds: float | None) -> Tensor:
        windows = windows_of(data.tracks, seconds)
        start = (x.numpy() for x in data.start(windows))
        return engine.moved(servos, data.tracks, windows, *start) / data.scale

    out = list[tuple[str, ...]]()
    judged(
        "torchid's replay", 0.0,
        lambda t: torch.cat([log.q for log in replay(whole, others, windows=t).simulated]),
    )  # fmt: skip
    alone = replace(whole, servos=replace(whole.servos, plane=0 * whole.servos.plane))
    for name, arm in (("servos and table", whole), ("servos", alone)):
        begun = time.process_time()
        with tempfile.TemporaryDirectory() as folder:
            done = correct(arm.robot, arm, log, "mjcf", folder)
            engine = ServosInMujoco(done.files[0], arm.robot)
        assert done.servos is not None
        servos = done.servos.servos
        judged(name, time.process_time() - begun, in_mujoco)
        if arm is whole:
            engine.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
            judged(f"{name}, contact off", 0.0, in_mujoco)
    return out


def row(
    name: str, seconds: float | None, squares: Sequence[Tensor], busy: float, each: str = "motions"
) -> tuple[str, ...]:
    """A row of the table: RMS of all rows, joint by joint, and over motions.

    Args:
        name: of what is judged.
        seconds: of windows; None: whole motions.
        squares: errors (T, n) of each motion or window [rad^2].
        busy: CPU time [s].
        each: what `squares` are of.
    """
    together = 1e3 * torch.cat(list(squares)).mean(0).sqrt()
    rms = 1e3 * torch.stack([s.mean(0).sqrt() for s in squares]).mean(1)
    numbers = together.mean(), rms.mean(), rms.median()
    mean, own, middle = (f"{float(x):.2f}" for x in numbers)
    joints = " ".join(f"{v:.1f}" for v in together.tolist())
    window = "whole" if seconds is None else f"{seconds:g} s"
    return name, window, joints, mean, each, own, middle, f"{busy:.0f}"


def rows_of(
    name: str, squares: Mapping[float | None, Sequence[Tensor]], busy: float
) -> list[tuple[str, ...]]:
    """A row of each kind of window."""
    kinds = {None: "motions"}
    rows = [row(name, t, own, busy, kinds.get(t, "windows")) for t, own in squares.items()]
    print(*(" ".join(one) for one in rows), sep="\n", flush=True)
    return rows


if __name__ == "__main__":
    command(main)
