# ruff: noqa: E402 (threads are set before numpy and torch are imported)
"""The gap diagnosis on simulated arms under control, whose effects are known.

    python benchmarks/gap_check.py --suite none single --count 4 --work DIR --results FILE.jsonl
        [--seed S] [--effects NAME ...] [--no-repeats] [--processes 2] [--plot FILE.png] [--tables]

Suites: `none` (false alarms), `single` (every effect alone), `pairs`, `triples`, `leave_one_out`
(the library lacks the planted effect), `severity` (six effects, 0.1 to 10 times the noise),
`closing` (how far the gap is closed, against an oracle and on fresh logs; coverage).

An arm follows four trajectories of 15 s at 500 Hz at two speed levels, one a repeat of another. It is
simulated under a nominal model's control with effects that change its motion; positions are counted
by 18-bit encoders, torques have noise of 1 % of their RMS, white or (every other case) AR(1) with a
cut-off of 5 Hz. The diagnosis sees the nominal model and the log. An effect is planted at five times
the noise (see gap_plant.py), the severity suite apart.

Rows go to FILE as JSON lines; cases that are there already are not run again, errors are. Simulated
motions stay in DIR. Tables go to the standard output.
"""

import os

for _name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[_name] = "1"
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import argparse
import json
import sys
import time
import traceback
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import replace
from pathlib import Path
from typing import Any

import gap_score as score
import torch
from gap_cases import (  # fmt: skip
    ARMS,
    RECIPE,
    SIMULATED_AS,
    SUITES,
    Arm,
    Case,
    cases,
    drawn,
    files_of,
    measured,
    place_of,
    simulate,
    truth,
)
from gap_oracle import EVENTS, coverage, fresh_closed, model_of, oracle

from torchid.effects.registry import FAMILIES, KINDS
from torchid.gap.diagnosis import Diagnosis, Finding
from torchid.gap.record import Parametric
from torchid.gap.settings import GapSettings
from torchid.gap.torque import diagnose_torque
from torchid.parallel.workers import opened


def finding_row(found: Finding) -> dict[str, Any]:
    effect = found.effect
    return {
        "name": effect.name,
        "family": effect.family,
        "place": place_of(effect),
        "joints": [j + 1 for j in found.joints],
        "ambiguous": list(found.ambiguous_with),
        "share": found.share,
        "first": found.first,
        "p": found.p_value,
        "coefficients": [c.name for c in effect.coefficients],
        "values": list(found.values),
        "std": list(found.std),
        "shapes": list(effect.shape_values),
    }


def parametric_row(found: Parametric) -> dict[str, Any]:
    links = [link + 1 for link in found.links]
    return {
        "name": "link_inertia" if links else "all_base",
        "family": "inertia",
        "place": links,
        "joints": links,
        "ambiguous": list(found.ambiguous_with),
        "share": found.share,
        "p": found.p_value,
    }


def answer_row(found: Diagnosis) -> dict[str, Any]:
    far = found.how_far
    return {
        "status": found.status,
        "findings": [finding_row(f) for f in found.findings],
        "parametric": [parametric_row(p) for p in found.parametric],
        "closed": far.closed,
        "closed_ci95": far.closed_ci95,
        "rms_before": far.rms_before.tolist(),
        "rms_after": far.rms_after.tolist(),
        "floor": [found.floor.low.tolist(), found.floor.high.tolist(), found.floor.source],
        "not_testable": len(found.not_testable),
        "band": found.band,
        "cutoff": found.cutoff,
        "warnings": list(found.warnings),
        "model": model_of(found),
    }


def case_row(arm: Arm) -> dict[str, Any]:
    case = arm.case
    return {
        "id": case.id,
        "recipe": RECIPE,
        "suite": case.suite,
        "robot": case.robot,
        "colour_hz": case.colour_hz,
        "level": case.size,
        "same_joint": case.same_joint,
        "noise": arm.scene.noise.tolist(),
        "truth": truth(arm),
    }


def run_case(case: Case, work: Path, known: dict[str, Any] | None) -> dict[str, Any]:
    """Diagnose one case in this process; `known`: the row of the same log's plain diagnosis."""
    torch.set_num_threads(1)
    begin = time.perf_counter()
    try:
        arm = drawn(case)
        log = measured(arm, work)
        row = case_row(arm)
        if known is None:
            left_out = case.names if case.suite == "leave_one_out" else ()
            effects = tuple(n for n in KINDS if n not in left_out) if left_out else None
            settings = GapSettings(effects=effects, rollout=False, seed=case.seed)
            row |= answer_row(diagnose_torque(arm.scene.robot, log, settings=settings))
        else:
            row = known | row
        if case.suite == "closing":
            row |= closing_row(arm, log, row, work)
        return row | {"seconds": time.perf_counter() - begin}
    except Exception:
        return {"id": case.id, "suite": case.suite, "error": traceback.format_exc()}


def closing_row(arm: Arm, log: Any, row: dict[str, Any], work: Path) -> dict[str, Any]:
    told = oracle(arm.scene.robot, log, row["truth"][0], arm.case.seed)
    out = {
        "oracle_closed": told.how_far.closed,
        "oracle_findings": [finding_row(f) for f in told.findings],
        "coverage": coverage(row),
    }
    if arm.case.names[0] not in EVENTS:
        both = fresh_closed(arm, [row["model"], model_of(told)], work, row["band"])
        out |= dict(zip(("fresh_closed", "oracle_fresh_closed"), both, strict=True))
    return out


def run_simulation(some: Sequence[Case], work: Path, fresh: bool) -> dict[str, str]:
    torch.set_num_threads(1)
    return simulate(some, work, fresh)


class Results:
    """Rows on file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows: dict[str, dict[str, Any]] = {}
        if path.exists():
            lines = path.read_text().splitlines()
            self.rows = {row["id"]: row for row in map(json.loads, filter(None, lines))}

    def done(self, case_id: str) -> bool:
        row = self.rows.get(case_id, {"error": "not run"})
        return "error" not in row and row["recipe"] == RECIPE

    def add(self, row: dict[str, Any]) -> None:
        self.rows[row["id"]] = row
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("a") as file:
            file.write(json.dumps(row) + "\n")

    def of(self, wanted: Sequence[Case]) -> list[dict[str, Any]]:
        return [self.rows[c.id] for c in wanted if self.done(c.id)]


def batches(some: Sequence[Case], work: Path) -> list[tuple[list[Case], bool]]:
    """Cases to simulate together: arms of one robot, each log once."""
    wanted: dict[tuple[str, bool], dict[str, Case]] = {}
    for case in some:
        for fresh in (False, True) if case.suite == "closing" else (False,):
            event = fresh and case.names[0] in EVENTS
            if not event and not files_of(case, work, fresh).exists():
                wanted.setdefault((case.robot, fresh), {}).setdefault(case.arm, case)
    out = []
    for (_, fresh), by_arm in wanted.items():
        every = list(by_arm.values())
        # No larger than shares the work between the processes.
        size = min(ARMS // 4, max(1, -(-len(every) // 2)))
        out += [(every[k : k + size], fresh) for k in range(0, len(every), size)]
    return out


def run(some: Sequence[Case], results: Results, work: Path, processes: int) -> None:
    todo = [c for c in some if not results.done(c.id)]
    with opened(processes, run_case, 2) as (pool, _):
        failed: dict[str, str] = {}
        made = [pool.submit(run_simulation, cs, work, f) for cs, f in batches(todo, work)]
        for k, future in enumerate(made):
            failed |= future.result()
            say(f"simulated {k + 1}/{len(made)} batches")
        jobs: set[Future[dict[str, Any]]] = set()
        for case in todo:
            if case.id in failed:
                results.add({"id": case.id, "suite": case.suite, "error": failed[case.id]})
                continue
            plain = replace(case, suite=SIMULATED_AS.get(case.suite, case.suite)).id
            known = case.suite == "closing" and results.done(plain)
            jobs.add(pool.submit(run_case, case, work, results.rows[plain] if known else None))
        total = len(jobs)
        while jobs:
            finished, jobs = wait(jobs, return_when=FIRST_COMPLETED)
            for job in finished:
                row = job.result()
                results.add(row)
                say(f"{total - len(jobs)}/{total} {summary(row)}")


def summary(row: dict[str, Any]) -> str:
    if "error" in row:
        return f"{row['id']}: ERROR {row['error'].strip().splitlines()[-1]}"
    claimed = [f"{c.name} {list(c.place)} +{len(c.ambiguous)}" for c in score.claims(row)]
    planted = [f"{t['name']} {t['place']} {t['size']:.1f}" for t in row["truth"]]
    return (
        f"{row['id']} {row['robot']}: {', '.join(planted) or 'none'} -> {row['status']}: "
        f"{', '.join(claimed) or 'none'} ({row['seconds']:.0f} s)"
    )


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def tables(suite: str, rows: Sequence[dict[str, Any]]) -> str:
    if suite == "none":
        return score.none_table(rows)
    if suite == "single":
        return score.single_table(rows)
    if suite in ("pairs", "triples"):
        return score.several_table(rows)
    if suite == "leave_one_out":
        return score.withheld_table(rows, FAMILIES)
    if suite == "severity":
        return score.severity_table(rows)
    return score.closing_table(rows)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--suite", nargs="+", choices=SUITES, required=True)
    parser.add_argument(
        "--count", type=int, default=2, help="cases an effect (and level), or in all"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--effects", nargs="+", choices=list(KINDS), help="of suites with one effect"
    )
    parser.add_argument("--no-repeats", action="store_true", help="all trajectories differ")
    parser.add_argument("--work", type=Path, required=True, help="folder of simulated motions")
    parser.add_argument("--results", type=Path, required=True, help="JSON lines, added to")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--plot", type=Path, help="figure of the severity suite, PNG")
    parser.add_argument(
        "--tables", action="store_true", help="run nothing: tables of what is there"
    )
    args = parser.parse_args()
    results = Results(args.results)
    for suite in args.suite:
        some = list(cases(suite, args.count, args.seed, args.effects, not args.no_repeats))
        if not args.tables:
            run(some, results, args.work, args.processes)
        rows = results.of(some)
        print(f"\n## {suite}: {len(rows)} of {len(some)} cases\n\n{tables(suite, rows)}")
        lost = [c.id for c in some if c.id in results.rows and not results.done(c.id)]
        if lost:
            print(f"\nerrors: {', '.join(lost)}")
        if suite == "severity" and args.plot:
            score.severity_figure(rows, args.plot)


if __name__ == "__main__":
    main()
