"""What doubling and halving each number of `torchid.statistics.criteria` does to development cases.

    python cli.py withheld make --out cases --cases 60 --seed 5757
    python -m torchid_bench.benchmarks.criteria cases [--numbers LIKELY DOUBT ...] [--jobs 2] [--out table.md]

Every number is changed before anything of torchid is imported, in processes of their own. Answers
lie beside the set and are kept as long as the diagnosis does not change, so a table may be made in
parts; a number of positions alone needs a set of `--kind position`. The cases are for development:
their keys are read.
"""

import argparse
import importlib
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

FACTORS = 0.5, 2.0
HEADINGS = "number", "default", "factor", "names", "how sure", "right", "alarms", "for sure wrong"


def answer_all(cases: Path, number: str, factor: float, count: int | None, folder: Path) -> None:
    """Diagnose cases with one number changed, in this process; answers go to a folder."""
    criteria = importlib.import_module("torchid.statistics.criteria")
    changed = _changed(getattr(criteria, number), factor) if number != "none" else None
    if changed is not None:
        setattr(criteria, number, changed)
    from torchid_bench.withheld.case_set import read_cases
    from torchid_bench.withheld.run import job_of, run

    found = read_cases(cases)
    folder.mkdir(parents=True, exist_ok=True)
    jobs = [job_of(found, case, folder / f"{case}.json") for case in found.ids[:count]]
    run(jobs, again=True)


def _changed(value: float, factor: float) -> float:
    """A number times a factor; of what lies between 0 and 1 its odds, so that it stays there."""
    if not 0 < value < 1:
        return value * factor
    odds = factor * value / (1 - value)
    return odds / (1 + odds)


def figures(keys: Sequence[Mapping[str, Any]], answers: Mapping[str, Any]) -> dict[str, Any]:
    """What is counted of answers: those that are right, false alarms, and wrong names for sure."""
    from torchid_bench.withheld.measures import verdict
    from torchid_bench.withheld.score import is_right, scored_case

    cases = [scored_case(key, answers[key["id"]]) for key in keys if key["id"] in answers]
    quiet = [c for c in cases if c.kind in ("none", "parameters")]
    return {
        "right": sum(is_right(c.kind, c.row) for c in cases),
        "alarms": sum(any(claim.structural for claim in c.row.claims) for c in quiet),
        "for_sure_wrong": sum(
            verdict(c.row, every=True) == "confident_wrong" for c in cases if c.row.planted
        ),
        "names": {c.case: sorted((k.name, k.joints) for k in c.row.claims) for c in cases},
        "sure": {
            c.case: {f"{k.name} {k.joints}": k.how_sure or 0.0 for k in c.row.claims} for c in cases
        },
    }


def row(number: str, value: float, factor: float, one: Mapping, plain: Mapping) -> tuple[str, ...]:
    """A line of the table: what differs from answers with the number as it is."""
    renamed = sum(one["names"][case] != plain["names"][case] for case in one["names"])
    moves = [
        abs(sure - plain["sure"][case][name])
        for case, names in one["sure"].items()
        for name, sure in names.items()
        if name in plain["sure"][case]
    ]
    moved = f"{sum(moves) / len(moves):.3f}" if moves else "-"
    counts = [f"{one[k]} ({one[k] - plain[k]:+d})" for k in ("right", "alarms", "for_sure_wrong")]
    return number, f"{value:.3g}", f"{factor:g}", f"{renamed}", moved, *counts


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", type=Path)
    parser.add_argument("--numbers", nargs="+")
    parser.add_argument("--count", type=int, help="first cases alone")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, help="the table, as Markdown")
    parser.add_argument("--one", nargs=3, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.one:
        number, factor, folder = given.one
        answer_all(given.cases, number, float(factor), given.count, Path(folder))
        return
    beside = given.cases.parent / f"{given.cases.name}.criteria"

    # Numbers are read from the file, whose import imports nothing else.
    criteria = importlib.import_module("torchid.statistics.criteria")
    numbers = given.numbers or [name for name in vars(criteria) if name.isupper()]
    variants = [("none", 1.0), *((n, f) for n in numbers for f in FACTORS)]
    running: list[subprocess.Popen] = []
    for number, factor in variants:
        while len(running) >= given.jobs:
            if running.pop(0).wait():
                raise SystemExit("a process failed")
        command = [sys.executable, __file__, str(given.cases)]
        command += ["--one", number, str(factor), str(beside / f"{number}-{factor:g}")]
        command += ["--count", str(given.count)] if given.count else []
        running.append(subprocess.Popen(command))
    if sum(one.wait() != 0 for one in running):
        raise SystemExit("a process failed")

    from torchid.json_data import read_json
    from torchid.report.table import pipe_table
    from torchid_bench.withheld.case_set import keys_beside, read_cases, read_keys

    found = read_cases(given.cases)
    keys = read_keys(found, keys_beside(given.cases))[: given.count]

    def counted(number: str, factor: float) -> dict[str, Any]:
        folder = beside / f"{number}-{factor:g}"
        return figures(
            keys, {k["id"]: read_json(folder / f"{k['id']}.json", "an answer") for k in keys}
        )

    plain = counted("none", 1.0)
    lines = [row(n, getattr(criteria, n), f, counted(n, f), plain) for n, f in variants[1:]]
    text = pipe_table(HEADINGS, lines)
    said = (
        f"{len(keys)} cases: right {plain['right']}, alarms {plain['alarms']}, "
        f"wrong for sure {plain['for_sure_wrong']} with the numbers as they are.\n\n{text}\n"
    )
    print(said)
    if given.out:
        given.out.write_text(said)


if __name__ == "__main__":
    main()
