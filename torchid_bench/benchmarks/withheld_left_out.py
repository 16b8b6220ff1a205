"""Every effect taken out of the library in turn: what is said when the right name is not there?

    python -m torchid_bench.benchmarks.withheld_left_out --out left --seed 4711 [--per-effect 2] [--effects a,b]

The answer should be `detected_unexplained`, a member of the same family, or an open one; never
another family's name for sure. Cases come from the simulator of `torchid_bench.withheld.plant`, one
planted effect each; their folder holds keys, for a diagnosis that is told what to leave out is not
a sealed one. What is there already is kept, so that an interrupted run goes on.
"""

from collections import Counter
from pathlib import Path
from typing import Any, get_args

from joblib import cpu_count

from torchid.effects.registry import KINDS, effect_kind
from torchid.errors import TorchidError
from torchid.gap.settings import GapSettings
from torchid_bench.benchmarks.runner import command, results, share, table
from torchid_bench.benchmarks.withheld_page import listed
from torchid_bench.withheld.case_set import ANSWER, LOG, ROBOT, write_case
from torchid_bench.withheld.measures import Verdict, verdict
from torchid_bench.withheld.plant.catalogue import LIBRARY
from torchid_bench.withheld.rows import named_record, row_of
from torchid_bench.withheld.run import ERROR, Job, diagnose_case

AVAILABLE = tuple(name for name in KINDS if name in LIBRARY)
"""The library's effects that the plant has under the same name."""


def left_out(place: Path, effect: str, seed: int, number: int) -> dict[str, Any]:
    """What is said of one case by a library that lacks its effect; the case is simulated first.

    Args:
        place: folder of its files.
        effect: its name.
        seed, number: that it is drawn from: another number for every case of a seed.
    """
    key = {"id": place.name, "seed": seed}
    key |= write_case(place, seed, number, kind="single", effects=[effect])
    rest = GapSettings(effects=tuple(name for name in KINDS if name != effect))
    job = Job(place.name, place / ROBOT, (place / LOG,), place / ANSWER, rest)
    row = row_of(key, diagnose_case(job))
    failed = row.status == ERROR
    return {
        "effect": effect, "size": row.planted[0].size, "status": row.status, "key": key,
        "verdict": ERROR if failed else verdict(row, every=False), "named": named_record(row),
    }  # fmt: skip


def main(
    *,
    out: Path,
    seed: int,
    effects: tuple[str, ...] = AVAILABLE,
    per_effect: int = 1,
    jobs: int = cpu_count(),
) -> None:
    """Print verdicts in all and by effect, and the cases that went wrong; results are kept in `out`
    beside the folders of the cases."""
    for name in effects:
        effect_kind(name)
        if name not in AVAILABLE:
            raise TorchidError(f"the plant has no effect '{name}'.", available=AVAILABLE)
    cases = {}
    for name in effects:
        for k in range(per_effect):
            case, number = f"{seed}-{name}-{k + 1}", k * len(AVAILABLE) + AVAILABLE.index(name)
            cases[case] = out / case, name, seed, number
    answers = dict(results(left_out, cases, out, jobs=jobs))
    judged = [one["verdict"] for one in answers.values() if one["verdict"] != ERROR]
    kinds = get_args(Verdict)
    print("95 % intervals; of another family for sure is `confident_wrong`")
    table(("answer", "cases"), [(v, share(judged.count(v), len(judged))) for v in kinds])
    by = {
        name: Counter(r["verdict"] for r in answers.values() if r["effect"] == name)
        for name in effects
    }
    table(
        ("left out", *kinds, ERROR), [(n, *(c[v] for v in (*kinds, ERROR))) for n, c in by.items()]
    )
    wrong = [
        (case, one["verdict"], one["status"], listed(one["named"])) for case, one in answers.items()
        if one["verdict"] in ("confident_wrong", "missed", ERROR)
    ]  # fmt: skip
    table(("case that went wrong", "answer", "status", "named"), wrong)


if __name__ == "__main__":
    command(main)
