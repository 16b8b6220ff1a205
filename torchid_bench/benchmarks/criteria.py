"""What doubling and halving each number of `torchid.statistics.criteria` does to development cases.

    python cli.py withheld make --out cases --cases 60 --seed 5757
    python -m torchid_bench.benchmarks.criteria cases [--numbers LIKELY DOUBT ...] [--jobs 2] [--out table.md]

Every number is changed before anything of torchid is imported, in processes of their own. Answers
lie beside the set and are kept as long as the diagnosis does not change, so a table may be made in
parts; a number of positions alone needs a set of `--kind position`. The cases are for development:
their keys are read.
"""

import importlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from torchid_bench.benchmarks.runner import command, results, table

FACTORS = 0.5, 2.0
HEADINGS = "number", "default", "factor", "names", "how sure", "right", "alarms", "for sure wrong"


def answer_all(
    cases: Path, number: str, factor: float, count: int | None, folder: Path
) -> dict[str, Any]:
    """Figures of cases that are diagnosed with one number changed, in this process; answers go to a
    folder."""
    criteria = importlib.import_module("torchid.statistics.criteria")
    changed = _changed(getattr(criteria, number), factor) if number != "none" else None
    if changed is not None:
        setattr(criteria, number, changed)
    from torchid_bench.withheld.case_set import keys_beside, read_cases, read_keys
    from torchid_bench.withheld.run import job_of, run

    case_set = read_cases(cases)
    folder.mkdir(parents=True, exist_ok=True)
    jobs = [job_of(case_set, case, folder / f"{case}.json") for case in case_set.ids[:count]]
    return figures(read_keys(case_set, keys_beside(cases))[:count], run(jobs, again=True))


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
        "count": len(cases),
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


def main(
    cases: Path,
    *,
    numbers: Sequence[str] = (),
    count: int | None = None,
    jobs: int = 1,
    out: Path | None = None,
) -> None:
    """Change numbers (all) in the first cases (all), and write the table."""
    beside = cases.parent / f"{cases.name}.criteria"
    # Numbers are read from the file, whose import imports nothing else.
    criteria = importlib.import_module("torchid.statistics.criteria")
    asked = numbers or [name for name in vars(criteria) if name.isupper()]
    variants = {"none-1": ("none", 1.0)} | {f"{n}-{f:g}": (n, f) for n in asked for f in FACTORS}
    todo = {name: (cases, *of, count, beside / name) for name, of in variants.items()}
    answers = dict(results(answer_all, todo, jobs=jobs, fresh=True))

    plain = answers.pop("none-1")
    rows = [
        row(n, getattr(criteria, n), f, answers[name], plain)
        for name, (n, f) in variants.items() if name in answers
    ]  # fmt: skip
    text = (
        f"{plain['count']} cases: right {plain['right']}, alarms {plain['alarms']}, "
        f"wrong for sure {plain['for_sure_wrong']} with the numbers as they are."
    )
    print(text)
    table(HEADINGS, rows, out, text)


if __name__ == "__main__":
    command(main)
