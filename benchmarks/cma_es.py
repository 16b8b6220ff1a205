# ruff: noqa: E402 (threads are set before numpy and torch are imported)
"""The batched CMA-ES against pycma: time of a generation of all runs, and generations needed.

    python benchmarks/cma_es.py [--rounds N] [--device cuda] [--quality] [--json FILE]

Both minimise the sphere over [0, 1]^n with the default population and one thread. In a round each
does GENERATIONS generations, after a warm-up: pycma as 50 (or 30) strategies that ask, have all
their samples evaluated in one call, and are told; ours continues its state. Printed are medians
over the rounds and the median of the rounds' ratios.

--quality compares the median number of generations until a target, 21 runs each, on the problems
of tests/extraction/problems.py (many minutes, nearly all of them pycma's).
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
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cma
import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.extraction.problems import ENGINES, PROBLEMS, generations_to, problem, values_of
from torchid.extraction.cma.search import default_population, start

VARIABLES = (30, 70, 91)
RUNS = (30, 50)
GENERATIONS = {"pycma": 5, "batched": 50}
TARGET = 5
QUALITY_VARIABLES = (2, 10, 30)
QUALITY_RUNS = 21

Step = Callable[[int], None]


def machine() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    models = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    return (
        f"{models[0] if models else platform.processor()}, {os.cpu_count()} cores, "
        f"load {os.getloadavg()[0]:.1f}, python {platform.python_version()}, "
        f"torch {torch.__version__}, cma {cma.__version__}, {torch.get_num_threads()} thread"
    )


def sphere(x: torch.Tensor) -> torch.Tensor:
    return (x - 0.4).square_().sum(-1)


def pycma_steps(runs: int, n: int) -> Step:
    """Strategies that live from round to round."""
    options = {"bounds": [0, 1], "verbose": -9, "popsize": default_population(n)}
    peers = [
        cma.CMAEvolutionStrategy(n * [0.5], 0.3, options | {"seed": r + 1}) for r in range(runs)
    ]

    def steps(generations: int) -> None:
        for _ in range(generations):
            asked = [peer.ask() for peer in peers]
            values = sphere(torch.as_tensor(np.asarray(asked))).numpy()
            for peer, points, told in zip(peers, asked, values, strict=True):
                peer.tell(points, told)

    return steps


def batched_steps(runs: int, n: int, device: str) -> Step:
    state = start(torch.full((runs, n), 0.5, dtype=torch.float64, device=device), 0.3)

    def steps(generations: int) -> None:
        nonlocal state
        state = ENGINES["batched"](sphere, state, generations=generations, seed=0)
        state.best_value.cpu()

    return steps


def milliseconds(steps: Step, generations: int) -> float:
    """Time of a generation of all runs."""
    begin = time.perf_counter()
    steps(generations)
    return (time.perf_counter() - begin) / generations * 1e3


def speed(runs: int, n: int, rounds: int, device: str) -> dict[str, float]:
    """Medians of both, alternated, and the median ratio."""
    peer, ours = pycma_steps(runs, n), batched_steps(runs, n, device)
    peer(10), ours(50)
    pairs = [
        (milliseconds(peer, GENERATIONS["pycma"]), milliseconds(ours, GENERATIONS["batched"]))
        for _ in range(rounds)
    ]
    return {
        "pycma_ms": statistics.median(p for p, _ in pairs),
        "batched_ms": statistics.median(o for _, o in pairs),
        "ratio": statistics.median(p / o for p, o in pairs),
    }


def quality(name: str, n: int) -> dict[str, float]:
    """Median generations to the target (rastrigin: median value at the end) and the successes."""
    p = problem(name, n)
    generator = torch.Generator().manual_seed(n)
    first = start(torch.rand(QUALITY_RUNS, n, generator=generator, dtype=torch.float64), 0.3)
    found: dict[str, float] = {}
    for kind in ("cma", "batched"):
        if name == "rastrigin":
            endless = replace(p, target=-1.0)
            found[kind] = float(values_of(endless, ENGINES[kind], first)[-1].median())
            continue
        needed = generations_to(p, ENGINES[kind], first)
        found[kind] = float(needed.median())
        found[f"{kind} found"] = int(needed.isfinite().sum())
    return found | {"ratio": found["batched"] / found["cma"]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=11)
    parser.add_argument("--device", default="cpu", help="of the batched engine")
    parser.add_argument("--quality", action="store_true", help="generations to targets as well")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    args = parser.parse_args()
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    content: dict[str, object] = {"machine": machine(), "speed": {}, "quality": {}}
    print(machine())
    print(f"milliseconds a generation of all runs, {args.rounds} alternated rounds, {args.device}")
    print(f"{'n':>4}{'runs':>6}{'L':>4}{'pycma':>10}{'batched':>10}{'ratio':>8}{'target':>8}")
    for n in VARIABLES:
        for runs in RUNS:
            found = speed(runs, n, args.rounds, args.device)
            content["speed"][f"n={n} runs={runs}"] = found  # type: ignore[index]
            print(
                f"{n:4}{runs:6}{default_population(n):4}{found['pycma_ms']:10.2f}"
                f"{found['batched_ms']:10.2f}{found['ratio']:8.1f}{TARGET:8}",
                flush=True,
            )
    if args.quality:
        print(f"\nmedian generations to the target, {QUALITY_RUNS} runs (rastrigin: last value)")
        print(f"{'n':>4}  {'problem':24}{'pycma':>12}{'batched':>12}{'ratio':>8}")
        for n in QUALITY_VARIABLES:
            for name in PROBLEMS:
                found = quality(name, n)
                content["quality"][f"{name} n={n}"] = found  # type: ignore[index]
                both = [
                    f"{found[k]:.4g} ({found[f'{k} found']})"
                    if f"{k} found" in found
                    else f"{found[k]:.4g}"
                    for k in ("cma", "batched")
                ]
                print(
                    f"{n:4}  {name:24}{both[0]:>12}{both[1]:>12}{found['ratio']:8.2f}", flush=True
                )
    if args.json:
        args.json.write_text(json.dumps(content, indent=1))


if __name__ == "__main__":
    main()
