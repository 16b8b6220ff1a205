"""Injected truths by family: how many answers to sealed cases name them, and how many of their 95 %
intervals hold the true number.

    python -m torchid_bench.benchmarks.withheld_truths CASES... [--page docs/withheld.md]

CASES are folders of `torchid withheld make` with answers, their keys beside them. Of cases with one
cause; recovered is one that is named first. An interval counts where the cause is found on its joint
and has a number without a shape.
"""

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

from torchid_bench.benchmarks.runner import command, share, table
from torchid_bench.withheld.case_set import keys_beside, read_answers, read_cases, read_keys
from torchid_bench.withheld.measures import coefficient_coverage, how_named
from torchid_bench.withheld.score import scored_case

ALL = "all"


def main(folders: Sequence[Path], *, page: Path | None = None) -> None:
    """Print the table, and put it into a page."""
    named, held = defaultdict[str, list[bool]](list), defaultdict[str, list[bool]](list)
    for folder in folders:
        cases = read_cases(folder)
        answers = read_answers(cases)
        for key in read_keys(cases, keys_beside(folder)):
            if key["kind"] != "single" or key["id"] not in answers:
                continue
            row = scored_case(key, answers[key["id"]]).row
            for family in (row.planted[0].family, ALL):
                named[family].append(how_named(row).top1)
                held[family] += coefficient_coverage(row)
    heads, rows = ["family of the injected truth", "recovered", "interval holds"], []
    for family in [*sorted(set(named) - {ALL}), ALL]:
        right, kept = named[family], held[family]
        interval = share(sum(kept), len(kept)) if kept else "no number to hold"
        rows.append((family, share(sum(right), len(right)), interval))
    table(heads, rows, page=page)


if __name__ == "__main__":
    command(main)
