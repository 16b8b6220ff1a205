"""One document of every schema, made by the commands on small data of the 3R."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import torch
from typer.testing import CliRunner

from tests.gap_files import diagnosis, named
from tests.gap_files import hidden as untested
from tests.torchid_bench.withheld.fakes import answer, entry
from torchid.app.commands import app
from torchid.excitation.synthetic import HonestNoise, synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.feasibility.sets import joined, nominal_set, sets_record
from torchid.identification.payload import with_payload
from torchid.log.model import Log
from torchid.log.readers import write_log
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.robot.writer import write_robot
from torchid.simulation.sensors import Sensors, measured_log

SEARCH = ("--runs", 3, "--stages", 2, "--generations", 4)
FRICTION = {"effect": "coulomb_friction", "joint": 2, "Fc": 0.6}
FEW = ("--effects", "coulomb_friction,viscous_friction,torque_offset")
NEVER = ("--effects", "torque_offset", "--parameters", "trusted")


@dataclass(frozen=True)
class Bench:
    """A folder in which commands are run, and the files that they need."""

    folder: Path

    def run(self, *arguments: object) -> dict[str, Any]:
        """The document that `torchid ARGUMENTS --json` writes."""
        target = self.folder / "document.json"
        target.unlink(missing_ok=True)
        words = [*(str(a) for a in arguments), "--json", str(target), "--quiet"]
        done = CliRunner().invoke(app, words, catch_exceptions=False)
        # The doctor writes what is wrong and ends with 1.
        assert done.exit_code == (words[:2] == ["log", "doctor"]), done.output
        return json.loads(target.read_text())

    def kept(self, name: str, document: dict[str, Any]) -> Path:
        path = self.folder / name
        path.write_text(json.dumps(document))
        return path

    @cache  # noqa: B019 (a bench lives as long as the tests)
    def friction(self, seed: int = 0, count: int = 2) -> Path:
        """A log of the 3R with friction on every joint."""
        robot = load_robot("3r_friction")
        motion = trajectory_log(random_trajectory(robot, seed, count=count, fill=True), 100.0)
        path = self.folder / f"friction_{seed}.parquet"
        write_log(synthetic_log(robot, motion, HonestNoise(), seed), path)
        return path

    @cache  # noqa: B019
    def identified(self, seed: int = 0) -> Path:
        """The result of an identification."""
        found = self.run("identify", "3r_friction", self.friction(seed), "--cutoff", 8)
        return self.kept(f"identified_{seed}.json", found)

    @cached_property
    def sets(self) -> Path:
        """The 3R's own parameters, and some that no body has: inertias of link 2 turned round."""
        robot = load_robot("3r")
        own = nominal_set(robot)
        pi = own.parameters.pi.clone()
        pi[0, 1, 4:] *= -1
        bad = type(own)(("bad",), InertialParameters(pi), (), own.coefficients)
        return self.kept("sets.json", sets_record(joined([own, bad]), robot).plain())

    @cache  # noqa: B019
    def runs(self, which: str) -> tuple[Path, ...]:
        """Logs of an arm for the gap diagnosis: three runs of 8 s, the first one again."""
        paths = []
        for k, seed in enumerate((0,) if which == "short" else (0, 1, 2, 0)):
            paths.append(self.folder / f"gap_{which}_{k}.parquet")
            write_log(gap_log(arm(which), seed, k, 4.0 if which == "short" else 8.0), paths[-1])
        return tuple(paths)

    def gap(self, which: str, *options: object) -> dict[str, Any]:
        return self.run("gap", "3r", *self.runs(which), *options)


def arm(which: str) -> Robot:
    robot = load_robot("3r")
    if which == "friction":
        return replace(robot, effects=(FRICTION,))
    if which == "heavy":
        pi = robot.require_parameters("a test").pi.clone()
        return robot.with_parameters(InertialParameters(1.2 * pi))
    return robot


def gap_log(robot: Robot, seed: int, noise_seed: int, duration: float) -> Log:
    motion = trajectory_log(random_trajectory(robot, seed, duration=duration, fill=True), 200.0)
    return measured_log(
        robot, synthetic_log(robot, motion), [], Sensors(torque_std=0.05), noise_seed
    )


def _payload(bench: Bench) -> dict[str, Any]:
    robot = load_robot("3r_friction")
    box = InertialParameters.from_com(
        torch.tensor([1.2], dtype=torch.float64),
        torch.tensor([[0.03, -0.02, 0.08]], dtype=torch.float64),
        torch.tensor([[0.005, 0, 0, 0.004, 0, 0.002]], dtype=torch.float64),
    ).pi[0]
    motion = trajectory_log(random_trajectory(robot, 0, count=2, fill=True), 100.0)
    full = bench.folder / "full.parquet"
    write_log(synthetic_log(with_payload(robot, box), motion, HonestNoise(), 1), full)
    return bench.run("payload", robot.name, bench.friction(), "--loaded", full, "--cutoff", 5)


def _diagnoses(bench: Bench) -> dict[str, Any]:
    """Two diagnoses by hand: one cause in both, one in one of them, one not testable."""
    hidden = [untested("contact", 1)]
    one = diagnosis(bench.folder / "one.json", named(Fc=0.5), named("torque_offset", 1, F0=1.0))
    two = diagnosis(bench.folder / "two.json", named(Fc=0.8), hidden=hidden)
    return bench.run("compare", one, two)


def _doctor(bench: Bench) -> dict[str, Any]:
    log = bench.folder / "degrees.parquet"
    own = gap_log(load_robot("3r"), 0, 0, 8.0)
    write_log(own.replace(q=own.q * 180 / torch.pi), log)
    return bench.run("log", "doctor", "3r", log)


def _fleet_gap(bench: Bench) -> dict[str, Any]:
    """One log, in the folder of its unit."""
    log = bench.folder / "unit-1" / "day-1.parquet"
    log.parent.mkdir(exist_ok=True)
    log.write_bytes(bench.friction().read_bytes())
    few = ("--effects", "coulomb_friction,viscous_friction", "--parameters", "trusted")
    return bench.run("fleet", "gap", "3r", log, *few)


def _score(bench: Bench) -> dict[str, Any]:
    """With answers by hand: what is scored is no diagnosis of today's."""
    cases = bench.folder / "cases"
    bench.run("withheld", "make", "--out", cases, "--cases", 3, "--seed", 7, "--jobs", 1)
    said = {
        "case-0001": answer("explained", entry("coulomb_friction", "sign", 2)),
        "case-0002": answer("detected_unexplained"),
        "case-0003": answer("no_gap"),
    }
    from torchid_bench.withheld import run as running

    before, running._answer = running._answer, lambda job: dict(said[job.case])
    try:
        bench.run("withheld", "run", cases, "--jobs", 1)
    finally:
        running._answer = before
    return bench.run("withheld", "score", cases)


def _simulate(bench: Bench) -> dict[str, Any]:
    motion = bench.folder / "motion.csv"
    bench.run("excite", "3r", "--kind", "random", "--duration", 4, "--to", motion)
    effect = "coulomb_friction:joint=2,Fc=0.6"
    log = bench.folder / "simulated.parquet"
    return bench.run("simulate", "3r", motion, "--effect", effect, "--to", log)


def _robot_file(bench: Bench) -> dict[str, Any]:
    path = bench.folder / "arm.yaml"
    write_robot(load_robot("3r_friction"), path)
    return bench.run("check", path)


def _pair(b: Bench) -> dict[str, Any]:
    """A simulator's log without the arm's friction of joint 2, and one with a torque's sign."""
    simulated, real = b.folder / "simulated.csv", b.folder / "real.csv"
    robot = load_robot("3r")
    motion = trajectory_log(random_trajectory(robot, 0, duration=8.0, fill=True), 100.0)
    arm = replace(robot, effects=(FRICTION,))
    noise = Sensors(torque_std=0.02)
    write_log(synthetic_log(robot, motion), simulated)
    write_log(measured_log(arm, synthetic_log(arm, motion), [], noise, seed=0), real)
    return b.run("pair", "3r", "--simulated", simulated, "--real", real, *FEW)


def _pair_fault(b: Bench) -> dict[str, Any]:
    """A simulator whose torque of joint 2 has the opposite sign."""
    robot = load_robot("3r")
    motion = trajectory_log(random_trajectory(robot, 0, duration=8.0, fill=True), 100.0)
    real = synthetic_log(robot, motion)
    assert real.tau is not None
    files = b.folder / "turned.csv", b.folder / "straight.csv"
    write_log(real.replace(tau=real.tau * torch.tensor([1, -1, 1])), files[0])
    write_log(real, files[1])
    return b.run("pair", "--simulated", files[0], "--real", files[1])


DOCUMENTS: dict[str, Callable[[Bench], dict[str, Any]]] = {
    "atlas": lambda b: b.run("atlas", "3r_friction", b.identified()),
    "check": lambda b: b.run("check", b.sets, "--robot", "3r"),
    "check_robot": _robot_file,
    "compare_diagnoses": _diagnoses,
    "compare_identifications": lambda b: b.run(
        "compare", b.identified(), b.identified(1), "--on", b.friction(9, 1)
    ),
    "compare_sets": lambda b: b.run(
        "compare", b.sets, b.kept("more.json", json.loads(b.sets.read_text()) | {"note": "b"})
    ),
    "correct": lambda b: b.run(
        "correct", "3r", *b.runs("friction"), *FEW, "--to", "mjcf", "--out", b.folder / "corrected"
    ),
    "doctor": _doctor,
    "effects": lambda b: b.run("effects"),
    "excite": lambda b: b.run(
        "excite", "3r", "--duration", 4, "--restarts", 1, "--to", b.folder / "best.csv"
    ),
    "export": lambda b: b.run("export", "3r", "--to", "urdf", "--out", b.folder / "exported"),
    "extract": lambda b: b.run("extract", "3r", *SEARCH),
    "extract_identified": lambda b: b.run(
        "extract", "3r_friction", b.identified(), "--method", "sdp", "--loss", "one-step"
    ),
    "fleet": lambda b: b.run(
        "fleet", "identify", "3r_friction", *(b.friction(k) for k in range(2)), "--cutoff", 8
    ),
    "fleet_gap": _fleet_gap,
    "gap_detected_unexplained": lambda b: b.gap("friction", *NEVER),
    "gap_explained": lambda b: b.gap("friction", *FEW),
    "gap_no_gap": lambda b: b.gap("none", *FEW),
    "gap_not_testable": lambda b: b.gap("short", *FEW),
    "gap_parametric_only": lambda b: b.gap("heavy", *FEW),
    "identify": lambda b: b.run(
        "identify", "3r_friction", b.friction(), "--held-out", b.friction(9, 1), "--cutoff", 8
    ),
    "log_show": lambda b: b.run("log", "show", b.friction(), "--robot", "3r"),
    "pair": _pair,
    "pair_fault": _pair_fault,
    "payload": _payload,
    "randomisation": lambda b: b.run(
        "export", b.kept("gap.json", b.gap("friction", *FEW)), "--randomise", 0.95,
        "--draws", 16, "--out", b.folder / "randomised",
    ),
    "robot": lambda b: b.run("robot", "3r_friction"),
    "simulate": _simulate,
    "since": lambda b: b.gap("friction", *FEW, "--before", b.runs("none")[1]),
    "study": lambda b: b.run("study", "3r", *SEARCH),
    "withheld_score": _score,
    "wrenches": lambda b: b.run("wrenches", "3r", "--per-kind", 15, "--resamples", 20),
    "wrenches_sets": lambda b: b.run("wrenches", "3r", "--sets", b.sets),
}  # fmt: skip
"""Name of the golden file -> the document. A gap's name says which status it must have."""

SLOW = (
    "compare_identifications", "excite", "fleet", "gap_detected_unexplained", "gap_no_gap",
    "gap_parametric_only", "payload", "randomisation", "simulate", "study", "withheld_score",
)  # fmt: skip
"""Those that take longer."""

LONG = ("atlas", "correct", "wrenches")
"""Those that take longer than CI has for them."""
