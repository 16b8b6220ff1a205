# ruff: noqa: E402 (threads are set before numpy and torch are imported)
"""Inverse dynamics and regressor against Pinocchio's calls in a Python loop (KUKA LWR, one thread).

    python benchmarks/dynamics.py [--compile] [--json FILE]

Peer and torchid run in turn; printed are medians over the rounds, and the median of the rounds'
ratios. Regressor: torchid's chunks of non-zeros, which is what identification uses; `dense` is the
(M, n, 10 n) matrix, as Pinocchio's call fills one (n, 10 n) matrix again and again.
"""

import os

for _name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[_name] = "1"

import argparse
import json
import platform
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.oracles import PinocchioOracle
from torchid.dynamics import newton_euler
from torchid.dynamics import regressor as regressor_module
from torchid.dynamics.compiled import compiled_dynamics
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.dynamics.regressor import RegressorChunk, regressor, regressor_chunks
from torchid.robot.library import load_robot

SAMPLES = 12327
"""As the report's log of the LWR."""
CHUNKS = (2040, 4088, 8184, 12280, 16376)
TARGETS = {
    "rnea eager": 3,
    "regressor eager": 2,
    "rnea compiled": 20,
    "regressor compiled": 15,
}

Call = Callable[[], object]


def machine() -> str:
    model = next(
        (
            line.split(":")[1].strip()
            for line in Path("/proc/cpuinfo").read_text().splitlines()
            if line.startswith("model name")
        )
        if Path("/proc/cpuinfo").exists()
        else [platform.processor()],
    )
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    return (
        f"{model}, {os.cpu_count()} cores, load {load:.1f}, python {platform.python_version()}, "
        f"torch {torch.__version__}, {torch.get_num_threads()} thread, "
        f"{torch.backends.cpu.get_cpu_capability()}"
    )


def microseconds(call: Call) -> float:
    """Time of one call per sample."""
    start = time.perf_counter()
    call()
    return (time.perf_counter() - start) / SAMPLES * 1e6


def against(peer: Call, ours: Call, rounds: int) -> dict[str, float]:
    """Medians of both, alternated, and the median ratio. Ours runs five times a round, as it is so
    much shorter."""
    peer(), ours()
    pairs = [
        (microseconds(peer), statistics.median(microseconds(ours) for _ in range(5)))
        for _ in range(rounds)
    ]
    return {
        "peer_us": statistics.median(p for p, _ in pairs),
        "ours_us": statistics.median(o for _, o in pairs),
        "ratio": statistics.median(p / o for p, o in pairs),
    }


def drain(chunks: "object") -> None:
    """Take every chunk and keep none."""
    for _chunk in chunks:  # type: ignore[attr-defined]
        assert isinstance(_chunk, RegressorChunk)


def chunk_table(motion: tuple[torch.Tensor, ...], robot: object) -> list[dict[str, float]]:
    """Microseconds a sample for several chunk sizes."""
    rows = []
    chosen = newton_euler.CHUNK, regressor_module.CHUNK
    for size in CHUNKS:
        newton_euler.CHUNK = regressor_module.CHUNK = size
        calls = {
            "rnea": lambda: inverse_dynamics(robot, *motion),
            "regressor": lambda: drain(regressor_chunks(robot, *motion)),
            "autograd": lambda: drain(regressor_chunks(robot, *motion, method="autograd")),
        }
        for call in calls.values():
            call()
        timed = {k: statistics.median(microseconds(c) for _ in range(5)) for k, c in calls.items()}
        rows.append({"chunk": size, **timed})
    newton_euler.CHUNK, regressor_module.CHUNK = chosen
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--compile", action="store_true", help="measure torch.compile too")
    parser.add_argument("--rounds", type=int, default=11)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    args = parser.parse_args()
    torch.set_num_threads(1)
    robot = load_robot("kuka_lwr4")
    generator = torch.Generator().manual_seed(0)
    motion = tuple(
        torch.randn(SAMPLES, robot.n, generator=generator, dtype=torch.float64) for _ in range(3)
    )
    oracle = PinocchioOracle(robot)
    pin, model, data = oracle.pin, oracle.model, oracle.data
    q, dq, ddq = (x.numpy() for x in motion)

    def peer_rnea() -> None:
        for i in range(SAMPLES):
            pin.rnea(model, data, q[i], dq[i], ddq[i])

    def peer_regressor() -> None:
        for i in range(SAMPLES):
            pin.computeJointTorqueRegressor(model, data, q[i], dq[i], ddq[i])

    calls: dict[str, tuple[Call, Call]] = {
        "rnea eager": (peer_rnea, lambda: inverse_dynamics(robot, *motion)),
        "regressor eager": (peer_regressor, lambda: drain(regressor_chunks(robot, *motion))),
        "regressor eager dense": (peer_regressor, lambda: regressor(robot, *motion)),
    }
    if args.compile:
        fast = compiled_dynamics(robot)
        start = time.perf_counter()
        fast.inverse_dynamics(*motion)
        drain(fast.regressor_chunks(*motion))
        print(f"compiled in {time.perf_counter() - start:.1f} s")
        calls["rnea compiled"] = (peer_rnea, lambda: fast.inverse_dynamics(*motion))
        calls["regressor compiled"] = (
            peer_regressor,
            lambda: drain(fast.regressor_chunks(*motion)),
        )

    print(machine())
    print(f"{robot.name}, M = {SAMPLES}, microseconds a sample, {args.rounds} alternated rounds")
    print(f"{'':24}{'Pinocchio':>10}{'torchid':>10}{'ratio':>8}{'target':>8}")
    results = {}
    for name, (peer, ours) in calls.items():
        results[name] = found = against(peer, ours, args.rounds)
        target = f"{TARGETS[name]}" if name in TARGETS else ""
        print(
            f"{name:24}{found['peer_us']:10.3f}{found['ours_us']:10.3f}"
            f"{found['ratio']:8.1f}{target:>8}"
        )
    table = chunk_table(motion, robot)
    print(f"\n{'eager, chunk':>12}{'rnea':>10}{'regressor':>12}{'by autograd':>14}")
    for row in table:
        print(
            f"{row['chunk']:12}{row['rnea']:10.3f}{row['regressor']:12.3f}{row['autograd']:14.3f}"
        )
    if args.json:
        content = {"machine": machine(), "samples": SAMPLES, "results": results, "chunks": table}
        args.json.write_text(json.dumps(content, indent=1))


if __name__ == "__main__":
    main()
