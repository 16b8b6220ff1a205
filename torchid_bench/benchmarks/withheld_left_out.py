"""Every effect taken out of the library in turn: what is said when the right name is not there?

    python -m torchid_bench.benchmarks.withheld_left_out --out left --seed 4711 [--per-effect 2] [--effects a,b]

The answer should be `detected_unexplained`, a member of the same family, or an open one; never
another family's name for sure. Cases come from the simulator of `torchid_bench.withheld.plant`, one
planted effect each; their folder holds keys, for a diagnosis that is told what to leave out is not
a sealed one. What is there already is kept, so that an interrupted run goes on.
"""

import argparse
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, get_args

from joblib import cpu_count

from torchid import __version__
from torchid.effects.registry import FAMILIES, KINDS, effect_kind
from torchid.errors import TorchidError
from torchid.gap.settings import GapSettings
from torchid.json_data import plain, read_json, write_json
from torchid.parallel.workers import Progress, each
from torchid_bench.benchmarks.withheld_page import counts_table, listed, markdown_table
from torchid_bench.withheld.case_set import ANSWER, LOG, ROBOT, write_case
from torchid_bench.withheld.measures import Verdict, rate, verdict
from torchid_bench.withheld.rows import named_record, row_of
from torchid_bench.withheld.run import ERROR, Job, run

SCHEMA = "torchid.withheld.leave_out/1"
KEY = "key.json"


class LeftOut(NamedTuple):
    """One case, and the effect that its diagnosis must do without.

    Attributes:
        effect: its name.
        case: name of its folder.
        number: that it is drawn from: another one for every case of the seed.
    """

    effect: str
    case: str
    number: int


def leave_out(
    folder: Path,
    seed: int,
    *,
    effects: Sequence[str] | None = None,
    per_effect: int = 1,
    jobs: int = 1,
    again: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Diagnose cases of every effect with a library that lacks it.

    What is in the folder already is kept, so that an interrupted run goes on.

    Args:
        folder: of cases, keys and answers; made if it does not exist.
        seed: of the cases.
        effects: names; all that the plant has if None.
        per_effect: cases of each.
        jobs: processes.
        again: as `run.run`.
        progress: called with (stage, done, total).

    Raises:
        TorchidError: an effect unknown to torchid or to the plant; a folder of another seed.
        MissingExtraError: the simulator is not installed.
    """
    from torchid_bench.withheld.plant.catalogue import LIBRARY

    # The library's effects that the plant has under the same name.
    available = [name for name in KINDS if name in LIBRARY]
    for name in effects or ():
        effect_kind(name)
        if name not in available:
            raise TorchidError(f"the withheld plant has no effect '{name}'.", available=available)
    wanted = list(available if effects is None else dict.fromkeys(effects))
    folder.mkdir(parents=True, exist_ok=True)
    todo = [
        LeftOut(name, f"{name}-{k + 1}", k * len(available) + available.index(name))
        for name in wanted
        for k in range(per_effect)
    ]
    # Keys of all cases; those that are not there yet are simulated.
    keys: dict[str, dict[str, Any]] = {}
    new = []
    for one in todo:
        path = folder / one.case / KEY
        if not path.is_file():
            new.append(one)
            continue
        key = keys[one.case] = read_json(path, "a key")
        if key.get("seed") != seed:
            raise TorchidError(
                f"'{folder}' holds cases of another seed.", got=key.get("seed"), expected=seed
            )
    write = partial(write_left_out, folder, seed)
    made = each(write, new, jobs, "simulating cases", progress)
    keys |= {one.case: key for one, key in zip(new, made, strict=True)}
    diagnoses = []
    for one in todo:
        rest = tuple(name for name in KINDS if name != one.effect)
        place, settings = folder / one.case, GapSettings(effects=rest)
        diagnoses.append(Job(one.case, place / ROBOT, place / LOG, place / ANSWER, settings))
    answers = run(diagnoses, jobs=jobs, again=again, progress=progress)
    return summary(seed, todo, keys, answers)


def write_left_out(folder: Path, seed: int, one: LeftOut) -> dict[str, Any]:
    """Simulate one case and write it with its key, which is returned."""
    place = folder / one.case
    made = write_case(place, seed, one.number, kind="single", effects=[one.effect])
    key = {"id": one.case, "seed": seed} | made
    write_json(key, place / KEY)
    return key


def summary(
    seed: int,
    todo: Sequence[LeftOut],
    keys: Mapping[str, Mapping[str, Any]],
    answers: Mapping[str, Mapping[str, Any]],
) -> dict[str, Any]:
    """Verdicts in all, by effect, and case by case."""
    cases = []
    for one in todo:
        row = row_of(keys[one.case], answers[one.case])
        found = {
            "case": one.case,
            "effect": one.effect,
            "family": FAMILIES[one.effect],
            "size": row.planted[0].size,
            "verdict": ERROR if row.status == ERROR else verdict(row, every=False),
            "status": row.status,
            "named": named_record(row),
        }
        cases.append(found)
    judged = [c for c in cases if c["verdict"] != ERROR]
    by_effect = {
        name: dict(Counter(c["verdict"] for c in cases if c["effect"] == name))
        for name in dict.fromkeys(one.effect for one in todo)
    }
    return plain(
        {
            "schema": SCHEMA,
            "seed": seed,
            "version": __version__,
            "verdicts": {v: rate(c["verdict"] == v for c in judged) for v in get_args(Verdict)},
            "by_effect": by_effect,
            "errors": [c["case"] for c in cases if c["verdict"] == ERROR],
            "cases": cases,
        }
    )


_WORDS = {
    "right_family": "the right family is named",
    "hedged": "it is among the alternatives",
    "detected_unexplained": "detected, and reported as unexplained",
    "confident_wrong": "another family, for sure",
    "missed": "nothing is reported",
    "not_testable": "reported as invisible in these data",
}


def leave_out_headline(result: Mapping[str, Any]) -> str:
    """One sentence."""
    wrong = result["verdicts"]["confident_wrong"]
    text = f"{wrong['hits']} of {wrong['total']} answers name another family for sure"
    if wrong["share"] is not None:
        text += f": {_percent(wrong)}"
    if result["errors"]:
        text += f"; {len(result['errors'])} diagnoses failed"
    return text + "."


def leave_out_markdown(result: Mapping[str, Any]) -> str:
    """The whole report."""
    total = [
        [_WORDS[name], f"{found['hits']} of {found['total']}", _percent(found)]
        for name, found in result["verdicts"].items()
    ]
    cases = [
        [c["effect"], c["case"], c["verdict"].replace("_", " "), c["status"], listed(c["named"])]
        for c in result["cases"]
        if c["verdict"] in ("confident_wrong", "missed", "error")
    ]
    parts = [
        f"# Effects left out of the library: seed {result['seed']}",
        f"{leave_out_headline(result)} torchid {result['version']}. Intervals: 95 %.",
        markdown_table(["answer", "cases", "share"], total),
        "## By effect",
        counts_table("left out", result["by_effect"]),
        "## Cases that went wrong",
        markdown_table(["left out", "case", "answer", "status", "named"], cases),
    ]
    return "\n\n".join(parts) + "\n"


def _percent(found: Mapping[str, Any]) -> str:
    if found["share"] is None:
        return "-"
    low, high = found["ci95"]
    return f"{100 * found['share']:.1f} % ({100 * low:.1f} to {100 * high:.1f} %)"


def main() -> None:
    """Run, and write leave_out.json and leave_out.md."""
    parser = argparse.ArgumentParser(description="Take every effect out of the library in turn.")
    parser.add_argument("--out", type=Path, required=True, help="folder of cases and answers")
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--effects", help="comma-separated; all by default")
    parser.add_argument("--per-effect", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=cpu_count())
    parser.add_argument("--again", action="store_true", help="replace answers of another torchid")
    given = parser.parse_args()
    result = leave_out(
        given.out, given.seed, effects=given.effects and given.effects.split(","),
        per_effect=given.per_effect, jobs=given.jobs, again=given.again,
    )  # fmt: skip
    write_json(result, given.out / "leave_out.json")
    (given.out / "leave_out.md").write_text(leave_out_markdown(result), encoding="utf-8")
    print(leave_out_headline(result))


if __name__ == "__main__":
    main()
