"""The table of docs/export.md: what each target does with the exports of two arms on their logs.

    python -m torchid_bench.benchmarks.targets.table --servos so101.yaml LOG [--torque ur10e.yaml LOG [--gain K1,K2,..]]
        [--page docs/export.md]

The yaml files are of `torchid gap --save-model`, the logs took no part in them. TORCHID_TARGET_MJLAB
and so on name the interpreters of the targets' environments; targets without one are left out.
Promised is what MuJoCo does with the same file, and with what torchid adds at run time, in this
process' environment.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch

from torchid import ServoArm, load_robot, read_log
from torchid.export.dynamics import Dynamics
from torchid.export.export import export_dynamics
from torchid.export.results import robot_dynamics, servo_dynamics
from torchid.gap.data import prepare as prepare_torque
from torchid.log.model import Log
from torchid.position.data import prepare
from torchid.report.table import pipe_table
from torchid.simulation.servo_loop import windows_of
from torchid.simulation.shooting import starts_of
from torchid.simulation.shooting import windows_of as torque_windows
from torchid_bench.benchmarks.runner import command, replace_table
from torchid_bench.benchmarks.targets.motion import Played
from torchid_bench.benchmarks.targets.play import play, python_of

WINDOW_S, WINDOWS, STEPS = 5.0, 8, 4
"""Of positions: how long a window is, how many there are, and steps of the physics a command."""
HORIZON_S, STARTS, STEP_S = 0.5, 16, 0.002
"""Of torques."""
RUNS = (("newton", ()), ("mjlab", ("mjlab",)))
"""Targets, and what they get beside the MJCF."""


def by_position(path: Path, log: Log) -> tuple[Dynamics, Played, np.ndarray]:
    """Servos, windows of commands, and the measured positions (W, K, n)."""
    arm = ServoArm.read(path)
    data = prepare(arm.robot, log, arm.scale)
    windows = windows_of(data.tracks, WINDOW_S)
    q, dq = data.start(windows)
    rows = int(windows.length.max())
    whole = (windows.length == rows).nonzero().flatten()[:WINDOWS]
    at = windows.start[whole, None] + torch.arange(rows)
    names, dt = arm.robot.joint_names, data.tracks.dt
    control, q, dq = (x.numpy() for x in (data.tracks.u[at], q[whole], dq[whole]))
    motion = Played("position", control, q, dq, dt, STEPS, names)
    return servo_dynamics(arm), motion, data.q[at].numpy()


def by_torque(path: Path, log: Log) -> tuple[Dynamics, Played, np.ndarray]:
    """Effects, half seconds of torques, and the measured positions at their ends (W, 1, n)."""
    robot = load_robot(path)
    segments = prepare_torque(robot, log, None).segments
    starts = starts_of(segments, HORIZON_S, STARTS, 0)
    windows = torque_windows(segments, starts, HORIZON_S)
    steps = math.ceil(windows.dt / STEP_S - 1e-9)
    share = (torch.arange(steps, dtype=windows.tau.dtype) + 0.5) / steps
    torque = torch.lerp(windows.tau[:, :-1, None], windows.tau[:, 1:, None], share[:, None])
    # The end of the last torque is the beginning of one more.
    torque = torque.flatten(1, 2)
    torque = torch.cat([torque, torque[:, -1:]], 1).numpy()
    q, dq = windows.q[:, 0].numpy(), windows.dq[:, 0].numpy()
    motion = Played("torque", torque, q, dq, windows.dt / steps, 1, robot.joint_names)
    return robot_dynamics(robot), motion, windows.q[:, -1:].numpy()


def rows(what: Dynamics, motion: Played, measured: np.ndarray) -> Iterator[str]:
    """A line of the table for each target that there is."""
    last = measured.shape[1]
    unit, size = ("mrad", 1e3) if motion.kind == "position" else ("deg", 180 / math.pi)
    with TemporaryDirectory() as name:
        folder = Path(name)
        motion.write(folder)

        def played(target: str) -> tuple[str, np.ndarray]:
            moved = play(target, folder)[:, -last:]
            error = size * np.sqrt(((moved - measured) ** 2).mean((0, 1)))
            return f"{error.mean():.2f} {unit}", moved

        for target, beside in RUNS:
            if python_of(target) is None:
                continue
            for to in ("mjcf", *beside):
                export_dynamics(
                    what, to, folder, "arm", nominal=what.robot, geometry="none", plain=True
                )  # type: ignore[arg-type]
            promised, expected = played("mujoco")
            torque, moved = played(target)
            apart = size * np.abs(moved - expected).max()
            run = "its fields alone" if not beside else "all of it at run time"
            yield f"| {what.robot.name} | {target} | {run} | {promised} | {torque} | {apart:.2g} {unit} |"


def main(
    *,
    servos: tuple[Path, Path] | None = None,
    torque: tuple[Path, Path] | None = None,
    gain: tuple[float, ...] = (),
    page: Path | None = None,
) -> None:
    """Print the table of YAML and LOG of positions, of torques (or of currents with the drives' gains),
    and put it into a page."""
    heads = "arm", "target", "what runs", "promised", "measured", "largest difference"
    cases, lines = [], pipe_table(heads, ()).splitlines()
    if servos:
        cases.append(by_position(servos[0], read_log([servos[1]])))
    if torque:
        log = read_log([torque[1]])
        cases.append(
            by_torque(torque[0], log.with_torque(torch.tensor(gain).double()) if gain else log)
        )
    for case in cases:
        for line in rows(*case):
            print(line, flush=True)
            lines.append(line)
    if page:
        replace_table(page, lines)


if __name__ == "__main__":
    command(main)
