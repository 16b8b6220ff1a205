"""The gap diagnosis on real logs: what the library buys on held-out data; docs/gap-results.md.

    python benchmarks/gap_real.py DATA [--lines panda,ptp,...] [--start rigid|friction|both]

DATA is the folder of benchmarks/real_logs.py. Base parameters are fitted first (no robot here has
any that are trusted), alone or with viscous and Coulomb friction and an offset on every joint. The
search runs at 8 Hz (the drive: 60 Hz); errors are 100 ||tau - model|| / ||tau|| per joint, on torque
filtered as in docs/results.md section 3, on data that took part in no choice.
"""

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import torch
from real_logs import UR10E_GAINS

from torchid.gap.diagnosis import Diagnosis
from torchid.gap.settings import GapSettings
from torchid.gap.torque import diagnose_torque
from torchid.log.filtering import ZeroPhaseFilter
from torchid.log.model import Log
from torchid.log.readers import read_log
from torchid.robot.library import load_robot
from torchid.robot.model import Robot

FRICTION = ("viscous_friction", "coulomb_friction", "torque_offset")
MOVING = 0.02


@dataclass(frozen=True)
class Line:
    label: str
    robot: str
    logs: tuple[str, ...]
    held_out: str | float
    judged: float
    rows: str
    searched: float = 8.0
    reference: str = ""


UR10E = ("ur10e/log_est_30s_12harm.parquet", "ur10e/log_exc_40s_12harm.parquet")
LINES = {
    "panda": Line(
        "Franka Panda, first 60 % -> last 40 %",
        "panda_gaz/robot.yaml",
        ("panda_gaz/log_exciting_traj1.parquet",),
        0.4,
        8.0,
        "all",
        reference="5.9 0.8 1.1 0.7 5.7 2.0 6.1",
    ),
    "ptp": Line(
        "UR10e, est_30s + exc_40s -> val_ptp10",
        "ur10e/robot.urdf",
        UR10E,
        "ur10e/log_val_ptp10.parquet",
        20.0,
        "moving",
        reference="6.9 2.4 2.6 4.4 7.3 6.4",
    ),
    "exc": Line(
        "UR10e, est_30s + exc_40s -> exc_20s",
        "ur10e/robot.urdf",
        UR10E,
        "ur10e/log_exc_20s_8harm.parquet",
        20.0,
        "moving",
        reference="6.4 4.0 3.4 5.4 8.1 6.9",
    ),
    "ur10": Line(
        "UR10, first 60 % -> last 40 %",
        "ur10_unisa/robot.yaml",
        ("ur10_unisa/log_exciting.parquet",),
        0.4,
        2.0,
        "all",
        reference="4.3 2.2 2.0 3.1 7.1 23.7",
    ),
    "xmate": Line(
        "xMate7 Pro, traj1 -> traj2",
        "xmate7p/robot.urdf",
        ("xmate7p/log_traj1.parquet",),
        "xmate7p/log_traj2.parquet",
        8.0,
        "all",
    ),
    "emps": Line(
        "EMPS drive, train -> test",
        "emps/robot.yaml",
        ("emps/log_train.parquet",),
        "emps/log_test_pulses.parquet",
        60.0,
        "all",
        60.0,
        "6.7",
    ),
}


def logs(data: Path, names: tuple[str, ...]) -> Log:
    read = [read_log(data / name) for name in names]
    gains = torch.tensor(UR10E_GAINS, dtype=torch.float64)
    with_torque = [log if log.tau is not None else log.with_torque(gains) for log in read]
    return with_torque[0] if len(read) == 1 else Log.concatenate(with_torque)


def run(line: Line, data: Path, background: tuple[str, ...]) -> Diagnosis:
    whole = isinstance(line.held_out, str)
    settings = GapSettings(
        cutoff=line.searched,
        background=background,
        held_out_fraction=0.0 if whole else line.held_out,  # type: ignore[arg-type]
        report_band=max(20.0, line.judged),
    )
    kept = logs(data, (line.held_out,)) if isinstance(line.held_out, str) else None
    robot: Robot = load_robot(str(data / line.robot)).with_parameters(None)
    return diagnose_torque(robot, logs(data, line.logs), held_out=kept, settings=settings)


def errors(found: Diagnosis, line: Line, which: str) -> str:
    """100 ||e|| / ||tau|| per joint."""
    error, torque = torch.zeros(found.robot.n), torch.zeros(found.robot.n)
    for trace in found.traces:
        low = ZeroPhaseFilter(trace.rate, line.judged) if line.judged < 0.45 * trace.rate else None
        measured, predicted = (
            x if low is None else low.apply(x.T).T for x in (trace.measured, getattr(trace, which))
        )
        rows = trace.valid.unsqueeze(1) & torch.ones_like(measured, dtype=torch.bool)
        if line.rows == "moving":
            rows = rows & (trace.motion.dq.abs() > MOVING)
        error = error + ((measured - predicted).square() * rows).sum(0)
        torque = torque + (measured.square() * rows).sum(0)
    return " ".join(f"{100 * float(x):.1f}" for x in (error / torque).sqrt())


def show(line: Line, found: Diagnosis, start: str, seconds: float) -> None:
    print(f"\n## {line.label}, from {start} ({found.status}, {seconds:.0f} s)\n")
    print("| before | after | to reach |\n|---|---|---|")
    print(
        f"| {errors(found, line, 'before')} | {errors(found, line, 'after')} | {line.reference} |\n"
    )
    print("| effect | joints | cannot be told from | coefficients | share |\n|---|---|---|---|--:|")
    for f in found.findings:
        pairs = zip(f.effect.coefficients, f.values, f.std, strict=True)
        values = ", ".join(f"{c.name} {v:.3g} ± {s:.1g}" for c, v, s in pairs)
        joints = " ".join(str(j + 1) for j in f.joints)
        others = ", ".join(f.ambiguous_with)
        print(f"| {f.effect.name} | {joints} | {others} | {values} | {100 * f.share:.1f} % |")
    for p in found.parametric:
        print(f"| inertial parameters | {[k + 1 for k in p.links]} | | | {100 * p.share:.1f} % |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--lines", default=",".join(LINES))
    parser.add_argument("--start", choices=("rigid", "friction", "both"), default="both")
    given = parser.parse_args()
    torch.set_num_threads(1)
    starts = {"rigid parameters": (), "rigid parameters and friction": FRICTION}
    if given.start != "both":
        starts = dict([list(starts.items())[given.start == "friction"]])
    for name in given.lines.split(","):
        for start, background in starts.items():
            begin = time.perf_counter()
            found = run(LINES[name], given.data, background)
            show(LINES[name], found, start, time.perf_counter() - begin)


if __name__ == "__main__":
    main()
