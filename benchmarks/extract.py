# ruff: noqa: E402 (threads are set before numpy and torch are imported)
"""What blocks of runs cost an extraction here, and what two workers gain.

    python benchmarks/extract.py blocks [--rounds 4] [--json FILE]
    python benchmarks/extract.py workers [--runs 400] [--stages 3] [--rounds 3] [--json FILE]

`blocks`: a stage of 60 generations, runs in blocks of several sizes, in turns; printed are medians
of CPU time a generation, and over that of all runs in one block. `workers`: whole searches by one
worker and by two, in turns: wall time, CPU time of all processes, and their medians' ratios.
"""

import os

for _name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[_name] = "1"

import argparse
import json
import statistics
import sys
import time
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from cpu_time import processor_time

from torchid.extraction import extract as room
from torchid.extraction.cma.search import default_population
from torchid.extraction.from_identification import problem_of
from torchid.extraction.problem import Problem
from torchid.extraction.settings import SearchSettings
from torchid.identification.values import nominal_base
from torchid.robot.library import load_robot

SEARCHES = (("3r", 30, (10, 15, 30)), ("kuka_lwr4", 50, (10, 17, 25, 50)),
            ("kuka_lwr4", 200, (25, 50, 100, 200)))  # fmt: skip
"""Robot, runs, and runs of a block."""
GENERATIONS = 60


def problem(name: str) -> Problem:
    robot = load_robot(name)
    return problem_of(robot, nominal_base(robot), bounds="normal")[0]


def blocks(rounds: int) -> dict:
    # The generations alone are timed, not what ends each run.
    room.finished = lambda problem, p, conditions: p
    out: dict = {}
    for name, runs, sizes in SEARCHES:
        asked = problem(name)
        numbers = asked.size * default_population(asked.size)
        settings = SearchSettings(runs=runs, stages=1, generations=GENERATIONS, seed=1)
        taken: dict[int, list[float]] = {size: [] for size in sizes}
        for turn in range(rounds + 1):
            for size in sizes[:: 1 if turn % 2 else -1]:
                room.BLOCK = size * numbers
                begin = time.process_time()
                room.extract(asked, settings)
                taken[size].append((time.process_time() - begin) / GENERATIONS * 1e3)
        medians = {size: statistics.median(times[1:]) for size, times in taken.items()}
        ratios = {size: m / medians[runs] for size, m in medians.items()}
        out[f"{name}, {runs} runs"] = {"cpu_ms_a_generation": medians, "ratio": ratios}
        print(name, runs, medians, ratios, flush=True)
    return out


def workers(name: str, runs: int, stages: int, rounds: int) -> dict:
    asked = problem(name)
    settings = SearchSettings(runs=runs, stages=stages, seed=1)
    wall: dict[int, list[float]] = {1: [], 2: []}
    cpu: dict[int, list[float]] = {1: [], 2: []}
    found = {}
    for _ in range(rounds):
        for crew in wall:
            begin, used = time.perf_counter(), processor_time()
            found[crew] = room.extract(asked, settings, workers=crew)
            wall[crew].append(time.perf_counter() - begin)
            cpu[crew].append(processor_time() - used)
            print(crew, wall[crew][-1], cpu[crew][-1], os.getloadavg()[0], flush=True)
    same = torch.equal(found[1].sets.vector, found[2].sets.vector)
    medians = {k: statistics.median(v) for k, v in wall.items()}
    return {
        "robot": name, "runs": runs, "stages": stages, "same_bits": same, "wall_s": wall,
        "cpu_s": cpu, "gain": medians[1] / medians[2],
        "cpu_ratio": statistics.median(cpu[2]) / statistics.median(cpu[1]),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("blocks", "workers"))
    parser.add_argument("--robot", default="kuka_lwr4")
    parser.add_argument("--runs", type=int, default=400)
    parser.add_argument("--stages", type=int, default=3)
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    torch.set_num_threads(1)
    found = (
        blocks(args.rounds)
        if args.what == "blocks"
        else workers(args.robot, args.runs, args.stages, args.rounds)
    )
    print(json.dumps(found, indent=1))
    if args.json is not None:
        args.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
