"""The gap diagnosis on real logs: what the library buys on held-out data; docs/gap-results.md.

    python -m torchid_bench.benchmarks.gap_real DATA [--lines panda,ptp,...] [--start rigid|friction|both]

DATA is the folder of torchid_bench/benchmarks/real_logs.py. Base parameters are fitted first (no robot here has
any that are trusted), alone or with viscous and Coulomb friction and an offset on every joint. The
search runs at 8 Hz (the drive: 60 Hz); errors are 100 ||tau - model|| / ||tau|| per joint, on torque
filtered as in docs/results.md section 3, on data that took part in no choice.
"""

import time
from pathlib import Path
from typing import Literal

import torch

from torchid.gap.diagnosis import Diagnosis
from torchid.gap.settings import GapSettings
from torchid.gap.torque import diagnose_torque
from torchid.log.filtering import ZeroPhaseFilter
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid_bench.benchmarks.real_logs import LINES, Line, read
from torchid_bench.benchmarks.runner import command, table

FRICTION = ("viscous_friction", "coulomb_friction", "torque_offset")


def run(line: Line, data: Path, background: tuple[str, ...]) -> Diagnosis:
    whole = isinstance(line.held_out, str)
    settings = GapSettings(
        cutoff=line.searched,
        background=background,
        held_out_fraction=0.0 if whole else line.held_out,  # type: ignore[arg-type]
        report_band=max(20.0, line.cutoff),
    )
    kept = read(data, (line.held_out,)) if isinstance(line.held_out, str) else None
    robot: Robot = load_robot(str(data / line.robot)).with_parameters(None)
    return diagnose_torque(robot, read(data, line.logs), held_out=kept, settings=settings)


def errors(diagnosis: Diagnosis, line: Line, which: str) -> str:
    """100 ||e|| / ||tau|| per joint."""
    error, torque = torch.zeros(diagnosis.robot.n), torch.zeros(diagnosis.robot.n)
    for trace in diagnosis.traces:
        low = ZeroPhaseFilter(trace.rate, line.cutoff) if line.cutoff < 0.45 * trace.rate else None
        measured, predicted = (
            x if low is None else low.apply(x.T).T for x in (trace.measured, getattr(trace, which))
        )
        rows = trace.valid.unsqueeze(1) & torch.ones_like(measured, dtype=torch.bool)
        if line.rows == "moving":
            # 0.02: speed from which a joint moves [rad/s]
            rows = rows & (trace.motion.dq.abs() > 0.02)
        error = error + ((measured - predicted).square() * rows).sum(0)
        torque = torque + (measured.square() * rows).sum(0)
    return " ".join(f"{100 * float(x):.1f}" for x in (error / torque).sqrt())


def show(line: Line, diagnosis: Diagnosis, start: str, seconds: float) -> None:
    """What is left before and after, and the causes."""
    print(f"\n## {line.label}, from {start} ({diagnosis.status}, {seconds:.0f} s)")
    both = errors(diagnosis, line, "before"), errors(diagnosis, line, "after")
    table(("before", "after", "to reach"), [(*both, line.gap)])
    rows = [
        (
            f.name, " ".join(str(j + 1) for j in f.joints), ", ".join(f.ambiguous_with),
            ", ".join(s.named for s in f.sizes), f"{100 * f.share:.1f} %",
        )
        for f in diagnosis.answer.causes
    ]  # fmt: skip
    table(("effect", "joints", "cannot be told from", "coefficients", "share"), rows)


def main(
    data: Path,
    *,
    lines: tuple[str, ...] = tuple(LINES),
    start: Literal["rigid", "friction", "both"] = "both",
) -> None:
    """Diagnose the logs of lines from one start or both."""
    starts = {"rigid parameters": (), "rigid parameters and friction": FRICTION}
    for name in lines:
        for words, background in starts.items():
            if start == "both" or (start == "friction") == bool(background):
                begin = time.perf_counter()
                diagnosis = run(LINES[name], data, background)
                show(LINES[name], diagnosis, words, time.perf_counter() - begin)


if __name__ == "__main__":
    command(main)
