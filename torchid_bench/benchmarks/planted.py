"""Effects planted into one half of real logs, the other half being the model's.

    python -m torchid_bench.benchmarks.planted DATA --work DIR [--set library] [--logs panda,ur10e]
                       [--effects coulomb_friction,...] [--sizes 2 5] [--before] [--jobs 2] [--again]
    python -m torchid_bench.benchmarks.planted DATA --work DIR [...] --classes
    python -m torchid_bench.benchmarks.planted DATA --work DIR [...] --score

From one half of each log a model is fitted (base parameters, friction, and what the diagnosis
names). The other half is diagnosed with that model as it is: whatever is named there is a false
name, or a change of the arm between the halves. Then an effect is added to its torque, `size` times
as large as what the model leaves on the joint, and `torchid.diagnose` is asked again; with --before
beside the model's half. Logs, their halves (of time, or of motions) and the sets of effects are in
`withheld/into_logs/sources.yaml`; files in DIR (`planting.py`), answers among them.

What can be known of a case an oracle says (`withheld/oracle/classes.py`; --classes for those that
are not stored). Right is to name a decidable effect first, on its joint; of an ambiguous one a set
of four at most that holds it; of the others nothing new. A name that is neither in the set nor in
the answer without anything planted is false.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from torchid.json_data import read_json
from torchid.statistics.criteria import SET_MASS
from torchid_bench.benchmarks.runner import command, share, table
from torchid_bench.withheld.into_logs.drawing import Key
from torchid_bench.withheld.into_logs.planting import (
    NONE,
    SETS,
    SOURCES,
    Bed,
    known_classes,
)
from torchid_bench.withheld.run import UNANSWERED, run

Answer = Mapping[str, Any]

HEADS = ("log", "decidable: named first", "ambiguous: in a set of 4 at most",
         "undecidable or below 1 %: no new name", "false names, in cases", "above .9: right",
         "nothing planted: names above .9", "named first, of all", "without an answer")  # fmt: skip


def names_it(key: Key, cause: Answer, *, in_set: bool = False) -> bool:
    """Whether a cause is what was planted at a joint that feels it, or holds it in its set."""
    places = {*key["joints"], *key["felt_by"]}
    right = set(key.get("acceptable", [key["name"]]))
    also = cause.get("ambiguous_with", ()) if in_set else ()
    # Felt by no joint as much as by another: it is the whole arm's.
    near = not cause["joints"] or not places or bool(places & set(cause["joints"]))
    return near and bool(right & {cause["effect"], *also})


def identity(cause: Answer) -> tuple[str, ...]:
    """Effect of a cause, and joints that it is at: none of the whole arm's, whoever feels it."""
    return cause["effect"], *map(str, cause.get("located", cause["joints"]))


def counted(key: Key, answer: Answer, none: Answer, known: str) -> Counter[str]:
    """What one case adds to the sums of its line.

    Args:
        key: what was planted.
        answer, none: to the log with it, and without.
        known: its class.
    """
    names = answer["which"]
    before = {identity(w) for w in none["which"]}
    new = [w for w in names if w.get("when") != "in both" and identity(w) not in before]
    sure = [w for w in new if w["probabilities"].get(w["effect"], 0.0) >= SET_MASS]
    # Known on the joint before it was planted, it can only change its size.
    older = any(names_it(key, w) for w in none["which"] if w["joints"])
    first = names_it(key, new[0]) if new else older and any(names_it(key, w) for w in names)
    false = sum(not names_it(key, w, in_set=True) for w in new)
    kind = "silent" if known in ("undecidable", "below") else known
    right = {
        "decidable": first,
        # 4: members of a set that still says something
        "ambiguous": any(
            names_it(key, w, in_set=True) and len({w["effect"], *w.get("ambiguous_with", ())}) <= 4
            for w in names
        ),
        "silent": not new,
    }
    return Counter({
        "cases": 1, "first": int(first), "false": false, "with false": int(false > 0),
        "sure": len(sure), "sure and right": sum(names_it(key, w) for w in sure),
        "unanswered": int(answer["status"] in UNANSWERED),
        kind: 1, f"right {kind}": int(right.get(kind, False)),
    })  # fmt: skip


def row(name: str, counts: Counter[str]) -> tuple[str, ...]:
    """A row of the table: name, then counts of cases."""
    of = "{} of {}".format
    return (
        name,
        *(of(counts[f"right {c}"], counts[c]) for c in ("decidable", "ambiguous", "silent")),
        f"{counts['false']}, in {of(counts['with false'], counts['cases'])}",
        of(counts["sure and right"], counts["sure"]),
        str(counts["named above .9"]),
        of(counts["first"], counts["cases"]),
        str(counts["unanswered"]),
    )


def scored(
    beds: Sequence[Bed],
    effects: Sequence[str],
    sizes: Sequence[float],
    before: bool,
    classes: Answer,
) -> None:
    """A table: a line a log, and one of all; and what is named without anything planted."""
    total, rows, lines = Counter[str](), [], []
    for bed in beds:
        none = read_json(bed.job(NONE, before).answer, "an answer")
        counts = Counter({"named above .9": sum(w["how_sure"] >= SET_MASS for w in none["which"])})
        for case in bed.cases(effects, sizes):
            file = bed.job(case, before).answer
            known = classes.get(f"{bed.label}-{case}", {}).get("class", "")
            if file.exists():
                counts += counted(bed.key(case), read_json(file, "an answer"), none, known)
        rows.append(row(bed.label, counts))
        total += counts
        named = ", ".join(f"{w['effect']} {w['joints']}" for w in none["which"])
        lines.append(f"- {bed.label}: {none['status']}: {named or 'nothing'}")
    table(HEADS, [*rows, row("all", total)])
    print(f"cases with false names: {share(total['with false'], total['cases'])}")
    print("without anything planted:\n\n" + "\n".join(lines))


def main(
    data: Path,
    *,
    work: Path,
    set: Literal["library", "forms"] = "library",
    logs: tuple[str, ...] = tuple(SOURCES),
    effects: tuple[str, ...] = (),
    sizes: Sequence[float] = (),
    before: bool = False,
    classes: bool = False,
    score: bool = False,
    again: bool = False,
    jobs: int = 1,
) -> None:
    """Answer all cases that have no answer yet, classify them, or count what was answered.

    Args:
        data, work: folders of the real logs, and of what is made of them.
        set: of effects, with their sizes.
        logs: of these.
        effects, sizes: in the place of the set's.
        before: whether to ask beside the model's half.
        classes: whether to ask the oracle of those that have no class.
        score: whether to count.
        again: whether answers of another torchid are replaced.
        jobs: processes.
    """
    effects, sizes = effects or tuple(SETS[set]["effects"]), sizes or SETS[set]["sizes"]
    beds = []
    for label in logs:
        beds.append(bed := Bed.of(label, data, work))
        if not (classes or score):
            bed.plant(effects, sizes)
        cases = bed.cases(effects, sizes)
        if classes:
            bed.classify(cases, work)
        elif not score:
            todo = [bed.job(case, before) for case in (NONE, *cases)]
            for case, answer in run(todo, jobs=jobs, again=again).items():
                names = [(w["effect"], w["joints"]) for w in answer["which"]]
                print(case, answer["status"], names, f"{answer['seconds']} s", flush=True)
    if score:
        scored(beds, effects, sizes, before, known_classes(work))


if __name__ == "__main__":
    command(main)
