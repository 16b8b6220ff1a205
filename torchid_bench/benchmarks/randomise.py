"""Whether what `torchid export --randomise` draws holds the arm.

    python -m torchid_bench.benchmarks.randomise planted [--runs 100] [--level 0.95] [--first 0]
    python -m torchid_bench.benchmarks.randomise logs DATA [--level 0.95]

`planted`: the 3R arm with dry and viscous friction, rotor inertia and a load drawn by seed, a short
simulated log of each, its diagnosis, and of each planted coefficient whether the range holds it; of
the base parameters of the bodies likewise. A planted effect without a name has no range, and counts
as missed. `logs`: real logs are diagnosed, and on motion that was held out the share of the
measured torque that lies between the quantiles of the draws' torque with the residual of the model.
"""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from torchid.design.columns import Model
from torchid.excitation.synthetic import HonestNoise, synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.export.randomise import Randomisation, randomise
from torchid.gap.data import prepare
from torchid.gap.describe.traces import traces
from torchid.gap.diagnosis import Diagnosis
from torchid.gap.settings import GapSettings
from torchid.gap.torque import diagnose_torque
from torchid.identification.base_parameters import base_parameters
from torchid.log.model import Log
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.simulation.sensors import Sensors, measured_log
from torchid.typing import Tensor
from torchid_bench.benchmarks.real_logs import LINES, read
from torchid_bench.benchmarks.runner import command, results, share

RATE, SECONDS, NOISE = 125.0, 6.0, 0.05
SEARCHED = (
    "viscous_friction", "coulomb_friction", "rotor_inertia", "torque_offset", "payload",
    "link_inertia",
)  # fmt: skip


def drawn(seed: int) -> tuple[Robot, Robot, list[tuple[str, str, float]], Log]:
    """The simulator, the arm, (field, joint, value) of its effects, and a log of it."""
    robot = load_robot("3r")
    g = torch.Generator().manual_seed(seed)

    def draw(low: float, high: float) -> float:
        return float(low + (high - low) * torch.rand((), generator=g, dtype=torch.float64))

    effects: list[dict[str, object]] = []
    truth = []
    for j, name in enumerate(robot.joint_names):
        for field, effect, key, low, high in (
            ("friction", "coulomb_friction", "Fc", 0.5, 2.0),
            ("damping", "viscous_friction", "Fv", 0.3, 1.5),
        ):
            value = draw(low, high)
            effects.append({"effect": effect, "joint": j + 1, key: value})
            truth.append((field, name, value))
    # A load on the last link, of a size that a hand has.
    mass, radius = draw(0.1, 0.5), 0.04
    com = torch.tensor([[draw(-0.1, 0.1) for _ in range(3)]], dtype=torch.float64)
    inertia = torch.tensor([[1, 0, 0, 1, 0, 1]], dtype=torch.float64) * mass * radius**2
    load = InertialParameters.from_com(torch.tensor([mass]).double(), com, inertia)
    pi = robot.require_parameters("a load").pi.clone()
    pi[-1] += load.pi[0]
    arm = replace(robot.with_parameters(InertialParameters(pi)), effects=tuple(effects))
    motion = Log.concatenate(
        [
            trajectory_log(
                random_trajectory(robot, run, duration=SECONDS, fill=True), RATE, (f"run{run}",)
            )
            for run in (3 * seed, 3 * seed + 1, 3 * seed + 2)
        ]
    )
    sensors = Sensors(HonestNoise(), torque_std=NOISE)
    return robot, arm, truth, measured_log(robot, synthetic_log(arm, motion), [], sensors, seed)


def covered(seed: int, level: float) -> tuple[list[bool], list[bool], float]:
    """Whether the ranges hold each planted coefficient, and each base parameter; and seconds."""
    robot, arm, truth, log = drawn(seed)
    settings = GapSettings(effects=SEARCHED, seed=seed)
    started = time.perf_counter()
    wide = randomise(diagnose_torque(robot, log, settings=settings).record, level, seed=seed)
    seconds = time.perf_counter() - started
    ranges = {(r.field, r.name): (r.low, r.high) for r in wide.ranges}
    held = []
    for field, name, value in truth:
        low, high = ranges.get((field, name), (torch.nan, torch.nan))
        held.append(low <= value <= high)
    base = base_parameters(robot)
    ranged = base.project(InertialParameters(wide.draws.pi).to_paper_order())
    true = base.project(arm.require_parameters("the truth").to_paper_order())
    tails = torch.tensor([(1 - level) / 2, (1 + level) / 2], dtype=torch.float64)
    low_, high_ = ranged.quantile(tails, 0)
    # Only those that a load on the last link changes are asked for.
    asked = (high_ - low_) > 1e-9 * ranged.abs().amax(0)
    return held, ((low_ <= true) & (true <= high_))[asked].tolist(), seconds


def band(wide: Randomisation, diagnosis: Diagnosis, log: Log, models: int = 64) -> Tensor:
    """(n,) share [%] of a held-out log's torque between the quantiles of the draws' torque with
    what the model left of the log that was fitted, while the joint moves."""
    judged = prepare(wide.robot, log, diagnosis.cutoff, diagnosis.band, diagnosis.band)
    every = [
        traces(judged.samples, None, [model], [model], diagnosis.band)
        for k in range(0, len(wide), max(1, len(wide) // models))
        for model in [Model.of(wide.one(k))]
    ]
    g = torch.Generator().manual_seed(0)
    inside, whole = torch.zeros(2, wide.robot.n, dtype=torch.float64)
    tails = torch.tensor([(1 - wide.level) / 2, (1 + wide.level) / 2], dtype=torch.float64)
    for parts in zip(*every, strict=True):
        torque = torch.stack([t.after for t in parts])
        for one in diagnosis.residual:
            # What was left, of either sign, by its own quantiles.
            part = 2 * torch.rand(torque.shape[:2], generator=g, dtype=torch.float64) - 1
            levels = np.array([0.0, *one.levels])
            left = np.interp(part.abs().numpy(), levels, np.array([0.0, *one.sizes]))
            torque[..., one.joint] += part.sign() * torch.from_numpy(left)
        low, high = torque.quantile(tails, 0)
        measured, counts = parts[0].measured, parts[0].counting
        inside += ((low <= measured) & (measured <= high) & counts).sum(0)
        whole += counts.sum(0)
    return 100 * inside / whole


def logs(data: Path, *, level: float = 0.95) -> None:
    """Print the coverage of held-out torque on real logs."""
    for line in (LINES["panda"], LINES["ptp"]):
        arm, log = load_robot(str(data / line.robot)), read(data, line.logs)
        if isinstance(line.held_out, float):
            log, apart = log.split(1 - line.held_out)
        else:
            apart = read(data, (line.held_out,))
        started = time.perf_counter()
        diagnosis = diagnose_torque(arm, log)
        wide = randomise(diagnosis.record, level)
        shares = band(wide, diagnosis, apart)
        each = " ".join(f"{x:.1f}" for x in shares.tolist())
        took = time.perf_counter() - started
        print(
            f"{line.label}: {each} %, mean {float(shares.mean()):.1f} %, {took:.0f} s", flush=True
        )
        print("".join(f"  ! {sentence}\n" for sentence in wide.warnings), end="", flush=True)


def planted(
    *, runs: int = 100, first: int = 0, level: float = 0.95, out: Path | None = None, jobs: int = 1
) -> None:
    """Print how many planted coefficients are held; answers are kept in the folder `out`."""
    every: tuple[list[bool], list[bool]] = [], []
    cases = {f"{seed}-{level:g}": (seed, level) for seed in range(first, first + runs)}
    for name, (*held, seconds) in results(covered, cases, out, jobs=jobs):
        counts = ", ".join(f"{sum(own)}/{len(own)}" for own in held)
        print(f"{name}: {counts}, {seconds:.1f} s", flush=True)
        for sofar, more in zip(every, held, strict=True):
            sofar.extend(more)
    for name, own in zip(("coefficients", "base parameters"), every, strict=True):
        print(f"{name}: {100 * sum(own) / max(1, len(own)):.1f} %: {share(sum(own), len(own))}")


if __name__ == "__main__":
    command(planted, logs)
