# ruff: noqa: E402 (threads are set before numpy and torch are imported)
"""Internal wrenches of many sets against Pinocchio's rnea (KUKA LWR, one thread).

    python -m torchid_bench.benchmarks.wrenches [--sets K] [--instants T] [--eigen DIR] [--json FILE]

A set-sample is one parameter set at one instant: all the joint wrenches. `internal_wrenches` stores
them, `wrench_errors` reduces them to errors against a reference, `wrench_norms` stores the norms.
Pinocchio's rnea computes the same wrenches (data.f) for one set at one instant; it is timed from
C++ (-O3 -march=native, nothing stored, no reduction) when a compiler and the headers of Pinocchio and
Eigen are there (--eigen: the folder that has Eigen/Core), and from a Python loop, which includes Python's own time. Peers and torchid run in turn;
printed are medians over the rounds and the median of the rounds' ratios. Times are of this
process's processor, which other programs on the machine disturb less than the wall clock; both are
given. `gemm` is the speed of a matrix product of a tile's size, for comparing machines.
"""

import os

for _name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[_name] = "1"

import argparse
import json
import platform
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.arms import consistent_parameters, states
from tests.oracles import PinocchioOracle
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot
from torchid.wrenches import regressor as tiles
from torchid.wrenches.deviation import wrench_errors
from torchid.wrenches.regressor import internal_wrenches, wrench_norms
from torchid_bench.benchmarks.cpu_time import machine

TARGET_NS = 65
TARGET_RATIO = 10
TILES = ((64, 125), (64, 200), (128, 200), (64, 334), (32, 500), (16, 1000), (32, 1000), (64, 1000))
LOOP_SAMPLES = 2000
CPP_SAMPLES = 50_000

Clocks = tuple[float, float]
"""Nanoseconds of the processor and of the wall clock."""

DEFINITIONS = (
    "-DBOOST_MPL_LIMIT_LIST_SIZE=30",
    "-DBOOST_MPL_LIMIT_VECTOR_SIZE=30",
    "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS",
    "-DBOOST_FUSION_INVOKE_MAX_ARITY=12",
)
"""As Pinocchio's CMake target asks. Its library is not linked: that is built for older processors,
and vectors of another alignment."""

CPP = r"""
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <vector>
#include <Eigen/Core>
#include <pinocchio/multibody.hpp>
#include <pinocchio/algorithm/rnea.hpp>

// argv: file of doubles, samples. File: n, then per joint placement R (row-major), p, and mass,
// com, inertia about the com (6); gravity; then q, dq, ddq of every sample.
int main(int, char **argv) {
  std::ifstream in(argv[1], std::ios::binary);
  auto next = [&] { double x; in.read(reinterpret_cast<char *>(&x), sizeof x); return x; };
  pinocchio::Model model;
  const int n = int(next());
  pinocchio::JointIndex parent = 0;
  for (int i = 0; i < n; ++i) {
    Eigen::Matrix3d R; Eigen::Vector3d p, c; Eigen::Matrix3d I;
    for (int r = 0; r < 3; ++r) for (int k = 0; k < 3; ++k) R(r, k) = next();
    for (int k = 0; k < 3; ++k) p(k) = next();
    const double m = next();
    for (int k = 0; k < 3; ++k) c(k) = next();
    for (int r = 0; r < 3; ++r) for (int k = 0; k < 3; ++k) I(r, k) = next();
    parent = model.addJoint(parent, pinocchio::JointModelRZ(), pinocchio::SE3(R, p), "j" + std::to_string(i));
    model.appendBodyToJoint(parent, pinocchio::Inertia(m, c, I));
  }
  Eigen::Vector3d g; for (int k = 0; k < 3; ++k) g(k) = next();
  model.gravity.linear() = g;
  const long samples = std::atol(argv[2]);
  Eigen::MatrixXd q(n, samples), v(n, samples), a(n, samples);
  for (auto *x : {&q, &v, &a})
    in.read(reinterpret_cast<char *>(x->data()), sizeof(double) * n * samples);
  pinocchio::Data data(model);
  double sum = 0;
  auto run = [&] {
    for (long s = 0; s < samples; ++s) {
      pinocchio::rnea(model, data, q.col(s), v.col(s), a.col(s));
      sum += data.f[1].linear()[0];
    }
  };
  std::printf("ready\n"); std::fflush(stdout);
  while (std::getchar() == 'r') {
    const auto wall = std::chrono::steady_clock::now();
    const auto cpu = std::clock();
    run();
    const double c = double(std::clock() - cpu) / CLOCKS_PER_SEC;
    const double w = std::chrono::duration<double>(std::chrono::steady_clock::now() - wall).count();
    std::printf("%.17g %.17g %.17g\n", c / samples * 1e9, w / samples * 1e9, data.f[1].linear()[0]);
    std::fflush(stdout);
  }
  return sum == 12345.6789;
}
"""


class CppRnea:
    """Pinocchio's rnea in a C++ loop, in a process that waits for its turns."""

    def __init__(self, oracle: PinocchioOracle, folder: Path, eigen: Path | None):
        self.why_not = ""
        self.process: subprocess.Popen[str] | None = None
        prefix = Path(oracle.pin.__file__).resolve().parents[4]
        compiler = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
        places = (eigen, prefix / "include/eigen3", Path("/usr/include/eigen3"))
        eigen = next((p for p in places if p and (p / "Eigen/Core").exists()), None)
        if compiler is None or eigen is None or not (prefix / "include/pinocchio").exists():
            self.why_not = (
                f"not measured: compiler {compiler}, Eigen's headers {eigen}, "
                f"Pinocchio's headers {(prefix / 'include/pinocchio').exists()}"
            )
            return
        source, program, data = (folder / x for x in ("rnea.cpp", "rnea", "data.bin"))
        source.write_text(CPP)
        command = [
            compiler, "-O3", "-march=native", "-DNDEBUG", "-std=c++17", str(source), "-o", str(program),
            *DEFINITIONS, f"-I{prefix / 'include'}", f"-I{eigen}",
        ]  # fmt: skip
        built = subprocess.run(command, check=False, capture_output=True, text=True)
        if built.returncode:
            lines = [line for line in built.stderr.splitlines() if "error" in line] or ["?"]
            self.why_not = f"not measured: the C++ loop did not build ({lines[0]})"
            return
        data.write_bytes(_model_numbers(oracle))
        self.process = subprocess.Popen(
            [str(program), str(data), str(CPP_SAMPLES)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert self.process.stdout is not None
        self.process.stdout.readline()

    def turn(self) -> tuple[float, float, float]:
        """Nanoseconds a sample (processor, wall) and the last sample's base force along x."""
        assert self.process is not None
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write("r")
        self.process.stdin.flush()
        cpu, wall, force = map(float, self.process.stdout.readline().split())
        return cpu, wall, force

    def close(self) -> None:
        if self.process is not None:
            assert self.process.stdin is not None
            self.process.stdin.close()
            self.process.wait()


def _model_numbers(oracle: PinocchioOracle) -> bytes:
    model = oracle.model
    numbers: list[float] = [model.nq]
    for i in range(1, model.njoints):
        placement, body = model.jointPlacements[i], model.inertias[i]
        numbers += [*placement.rotation.ravel(), *placement.translation, body.mass]
        numbers += [*body.lever, *body.inertia.ravel()]
    numbers += [*model.gravity.linear]
    motion = states(oracle.robot, CPP_SAMPLES)
    return np.asarray(numbers, dtype=float).tobytes() + b"".join(
        x.numpy().tobytes() for x in motion
    )


def check_cpp(cpp: CppRnea, oracle: PinocchioOracle) -> None:
    """The C++ loop computes what the Python binding does."""
    motion = [x[-1:] for x in states(oracle.robot, CPP_SAMPLES)]
    expected = float(oracle.wrenches(*motion)[0, 0, 0])
    found = cpp.turn()[2]
    assert abs(found - expected) < 1e-9 * max(1.0, abs(expected)), (found, expected)


def clocks(call: Callable[[], object], units: int) -> Clocks:
    """Nanoseconds a unit of one call."""
    wall, cpu = time.perf_counter(), time.process_time()
    call()
    return (
        (time.process_time() - cpu) / units * 1e9,
        (time.perf_counter() - wall) / units * 1e9,
    )


def gemm_speed() -> float:
    """Gflop a second of one product of a tile's size."""
    a, b = torch.randn(64, 31, dtype=torch.float64), torch.randn(31, 600, dtype=torch.float64)
    out = torch.empty(64, 600, dtype=torch.float64)
    start = time.process_time()
    for _ in range(200):
        torch.mm(a, b, out=out)
    return 2 * 64 * 31 * 600 * 200 / (time.process_time() - start) / 1e9


def measure(
    ours: dict[str, Callable[[], object]],
    peers: dict[str, Callable[[], Clocks]],
    units: int,
    rounds: int,
) -> tuple[dict[str, list[Clocks]], list[float]]:
    """Everything in turn, so many rounds."""
    for call in ours.values():
        call()
    found: dict[str, list[Clocks]] = {name: [] for name in (*ours, *peers)}
    speeds = []
    for _ in range(rounds):
        for name, peer in peers.items():
            found[name].append(peer())
        for name, call in ours.items():
            found[name].append(clocks(call, units))
        speeds.append(gemm_speed())
    return found, speeds


def tile_table(call: Callable[[], object], units: int) -> list[dict[str, float]]:
    """Processor nanoseconds of wrench_errors for several tile sizes."""
    chosen = tiles.SETS, tiles.INSTANTS
    rows = []
    for sets, instants in TILES:
        tiles.SETS, tiles.INSTANTS = sets, instants
        call()
        ns = statistics.median(clocks(call, units)[0] for _ in range(7))
        rows.append({"sets": sets, "instants": instants, "ns": ns})
    tiles.SETS, tiles.INSTANTS = chosen
    return rows


def median(values: list[Clocks], clock: int) -> float:
    return statistics.median(v[clock] for v in values)


def print_table(found: dict[str, list[Clocks]], peers: list[str], ours: list[str]) -> None:
    heads = "".join(f"{'x ' + p:>20}" for p in peers)
    print(f"{'ns a set-sample':26}{'processor':>10}{'wall':>8}{heads}")
    for name in (*peers, *ours):
        row = f"{name:26}{median(found[name], 0):10.1f}{median(found[name], 1):8.1f}"
        if name in ours:
            for peer in peers:
                ratio = statistics.median(
                    p[0] / o[0] for p, o in zip(found[peer], found[name], strict=True)
                )
                row += f"{ratio:20.1f}"
        print(row)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=1000)
    parser.add_argument("--instants", type=int, default=1000)
    parser.add_argument("--rounds", type=int, default=11)
    parser.add_argument("--eigen", type=Path, help="folder of Eigen's headers, for the C++ peer")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    args = parser.parse_args()
    torch.set_num_threads(1)
    robot = load_robot("kuka_lwr4")
    # Pinocchio's model takes one set of parameters: any will do, the arithmetic is the same.
    oracle = PinocchioOracle(robot.with_parameters(consistent_parameters(robot.n, 1)))
    motion = states(robot, args.instants)
    sets = consistent_parameters(robot.n, 2, (args.sets,))
    reference = InertialParameters(sets.pi[0].clone())
    units = args.sets * args.instants
    ours: dict[str, Callable[[], object]] = {
        "internal_wrenches": lambda: internal_wrenches(robot, *motion, sets),
        "wrench_norms": lambda: wrench_norms(robot, *motion, sets),
        "wrench_errors": lambda: wrench_errors(robot, *motion, sets, reference),
    }
    q, dq, ddq = (x.numpy() for x in states(robot, LOOP_SAMPLES))

    def python_loop() -> None:
        for i in range(LOOP_SAMPLES):
            oracle.pin.rnea(oracle.model, oracle.data, q[i], dq[i], ddq[i])

    with tempfile.TemporaryDirectory() as folder:
        cpp = CppRnea(oracle, Path(folder), args.eigen)
        peers: dict[str, Callable[[], Clocks]] = {
            "rnea in Python": lambda: clocks(python_loop, LOOP_SAMPLES)
        }
        if cpp.process is not None:
            check_cpp(cpp, oracle)
            peers["rnea in C++"] = lambda: cpp.turn()[:2]
        found, speeds = measure(ours, peers, units, args.rounds)
        cpp.close()
    print(machine())
    print(
        f"{robot.name}, {args.sets} sets x {args.instants} instants, {args.rounds} rounds in turn"
    )
    print_table(found, list(peers), list(ours))
    if cpp.why_not:
        print(f"rnea in C++: {cpp.why_not}")
    print("rnea in Python includes the loop's and the binding's own time.")
    print(f"target: {TARGET_NS} ns, {TARGET_RATIO} x rnea in C++")
    print(
        f"gemm of a tile's size: {statistics.median(speeds):.0f} Gflop/s ({min(speeds):.0f} to {max(speeds):.0f})"
    )
    table = tile_table(ours["wrench_errors"], units)
    print("\nwrench_errors by tile, ns of the processor a set-sample")
    for row in table:
        print(f"  {row['sets']:4} sets x {row['instants']:4} instants {row['ns']:8.1f}")
    if args.json:
        content = {
            "machine": machine(),
            "python": platform.python_version(),
            "sets": args.sets,
            "instants": args.instants,
            "nanoseconds_processor_wall": found,
            "gemm_gflops": speeds,
            "cpp": cpp.why_not or "measured",
            "tiles": table,
        }
        args.json.write_text(json.dumps(content, indent=1))


if __name__ == "__main__":
    main()
