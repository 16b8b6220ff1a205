"""A log's torque replayed in MuJoCo for half a second from many of its instants: by the corrected
file alone, and by the file whose other effects are added at run time.

    torchid correct my_arm.xml run1.csv run2.csv --to mjcf --with-effects --out corrected
    python docs/examples/effects_in_mujoco.py corrected/my_arm_corrected.xml run3.csv
"""

import argparse
import copy
import math
from pathlib import Path

import mujoco
import torch

import torchid
from torchid.export.engines import InMujoco
from torchid.gap.data import prepare
from torchid.simulation.shooting import Windows, starts_of, windows_of
from torchid.simulators.mujoco import Effects


def with_effects(path: Path, windows: Windows) -> torch.Tensor:
    """Positions (B, n) at the end of all windows, simulated together."""
    robot = torchid.load_robot(path)
    model = mujoco.MjModel.from_xml_path(str(path))
    steps = math.ceil(windows.dt / model.opt.timestep - 1e-9)
    model.opt.timestep = windows.dt / steps
    # Every simulation has a model of its own, whose friction the effects change.
    models = [copy.copy(model) for _ in windows.q]
    effects = Effects(robot, [(one, mujoco.MjData(one)) for one in models])
    if effects.ignored:
        print(f"not run: {', '.join(effects.ignored)}")
    for b in range(len(models)):
        effects.place(b, windows.q[b, 0], windows.dq[b, 0])
    effects.restart()
    for k in range(windows.q.shape[1] - 1):
        for i in range(steps):
            share = (i + 0.5) / steps
            effects.step(torch.lerp(windows.tau[:, k], windows.tau[:, k + 1], share))
    return effects.motion().q


def main() -> None:
    """Print how far each joint is off."""
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    asked.add_argument(
        "file", type=Path, help="the corrected file; NAME_effects.xml lies beside it"
    )
    asked.add_argument("logs", type=Path, nargs="+")
    asked.add_argument("--gain", help="drive gains K1,K2,.. of logs of currents")
    asked.add_argument("--seconds", type=float, default=0.5)
    asked.add_argument("--starts", type=int, default=64)
    given = asked.parse_args()
    robot = torchid.load_robot(given.file)
    log = torchid.read_log(given.logs)
    if given.gain:
        log = log.with_torque(torch.tensor([float(k) for k in given.gain.split(",")]).double())
    segments = prepare(robot, log, None).segments
    windows = windows_of(
        segments, starts_of(segments, given.seconds, given.starts, 0), given.seconds
    )
    beside = given.file.with_stem(f"{given.file.stem}_effects")
    ends = {
        "file alone": InMujoco(given.file, robot).positions(windows)[:, -1],
        "with effects": with_effects(beside, windows),
    }
    print(
        f"RMS error after {given.seconds:g} s from {len(windows.q)} starts [rad; m], joint by joint"
    )
    for name, q in ends.items():
        error = (q - windows.q[:, -1]).square().mean(0).sqrt()
        print(f"{name:>12}: {' '.join(f'{x:.5f}' for x in error.tolist())}")


if __name__ == "__main__":
    main()
