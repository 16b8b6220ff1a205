# ruff: noqa: E402 (threads are set before numpy and torch are imported)
"""A long log reduced to its R factor, and the report's own job: 12327 x 70 and base parameters.

    python benchmarks/streaming.py [--samples N] [--compile] [--json FILE]

Targets: 1e6 instants x 7 joints in under 3 s eagerly on one core, in memory that does not depend on
the length of the log; the 12327 x 70 regressor and the LWR's base parameters in under 0.1 s.
"""

import os

for _name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[_name] = "1"

import argparse
import json
import platform
import resource
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

from torchid.dynamics.compiled import compiled_dynamics
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.dynamics.regressor import regressor
from torchid.identification.base_parameters import BaseParameters, base_parameters
from torchid.identification.streaming import reduce_to_factor
from torchid.robot.library import load_robot
from torchid.robot.model import Robot

ROWS = 12327
COMPARED = 20_000


def peak_megabytes() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def median_seconds(call: Callable[[], object], rounds: int) -> float:
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def log(robot: Robot, samples: int) -> tuple[Tensor, ...]:
    """A synthetic log: q, dq, ddq, tau (samples, n), torque with noise of 0.1 N m."""
    generator = torch.Generator().manual_seed(0)

    def normal() -> Tensor:
        return torch.randn(samples, robot.n, generator=generator, dtype=torch.float64)

    motion = normal(), normal(), normal()
    return (*motion, inverse_dynamics(robot, *motion).add_(normal(), alpha=0.1))


def disagreement(robot: Robot, base: BaseParameters, signals: tuple[Tensor, ...]) -> float:
    """Largest difference from the R of a dense Householder QR, relative to R."""
    short = [x[:COMPARED] for x in signals]
    streamed = reduce_to_factor(robot, base, *short)
    y = regressor(robot, *short[:3])[..., list(base.independent)]
    dense = torch.linalg.qr(torch.cat([y, short[3].unsqueeze(-1)], -1).flatten(0, 1), mode="r").R
    dense = dense * torch.where(dense.diagonal() < 0, -1.0, 1.0).unsqueeze(-1)
    return float((streamed - dense).abs().max() / dense.abs().max())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--compile", action="store_true", help="measure torch.compile too")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    args = parser.parse_args()
    torch.set_num_threads(1)
    robot = load_robot("kuka_lwr4")
    base = base_parameters(robot)
    print(f"{platform.platform()}, load {os.getloadavg()[0]:.1f}, torch {torch.__version__}")
    figures: dict[str, float] = {"samples": args.samples}

    short = [x[: ROWS // robot.n] for x in log(robot, ROWS)[:3]]

    def report_job() -> None:
        regressor(robot, *short).flatten(0, 1)
        base_parameters(robot)

    report_job()
    figures["regressor_and_base_s"] = median_seconds(report_job, 7)
    print(
        f"{len(short[0]) * robot.n} x {10 * robot.n} regressor and {len(base)} base parameters: "
        f"{figures['regressor_and_base_s']:.3f} s (target 0.1)"
    )

    signals = log(robot, args.samples)
    reduce_to_factor(robot, base, *(x[:COMPARED] for x in signals))
    before = peak_megabytes()
    figures["log_mb"] = sum(x.nbytes for x in signals) / 2**20
    figures["eager_s"] = median_seconds(
        lambda: reduce_to_factor(robot, base, *signals), args.rounds
    )
    figures["peak_mb"] = peak_megabytes()
    figures["peak_growth_mb"] = figures["peak_mb"] - before
    print(
        f"{args.samples} instants x {robot.n} joints to R ({len(base) + 1} columns), eager: "
        f"{figures['eager_s']:.2f} s (target 3 for 1e6)"
    )
    print(
        f"peak memory {figures['peak_mb']:.0f} MB, of which the log {figures['log_mb']:.0f} MB; "
        f"reducing all of it took {figures['peak_growth_mb']:.0f} MB more than {COMPARED} instants"
    )
    if args.compile:
        chunks = compiled_dynamics(robot).regressor_chunks
        reduce_to_factor(robot, base, *(x[:COMPARED] for x in signals), chunks=chunks)
        figures["compiled_s"] = median_seconds(
            lambda: reduce_to_factor(robot, base, *signals, chunks=chunks), args.rounds
        )
        print(f"the same, compiled: {figures['compiled_s']:.2f} s")
    figures["disagreement"] = disagreement(robot, base, signals)
    print(f"R against dense Householder QR of {COMPARED} instants: {figures['disagreement']:.1e}")
    if args.json:
        args.json.write_text(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
