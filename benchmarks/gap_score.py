"""Scores of the gap benchmark: pure functions of its rows, and Markdown tables of them.

A row is what was planted and what was answered, as `gap_check.py` writes it:

    truth       [{name, family, place, joints, size, record}], joints from 1; place: where the
                effect is, empty for the whole arm; joints: whose torque it changes
    status      of the diagnosis
    findings    [{name, family, place, joints, ambiguous, share, coefficients, values, std}]
    parametric  the same, for `link_inertia` and `all_base`

A claim is a finding or a parametric entry; the top claim is the one with the largest share.
"""

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

Row = Mapping[str, Any]
Claim = Mapping[str, Any]


def wilson(hits: int, total: int, z: float = 1.96) -> tuple[float, float]:
    """Interval of a share (Wilson 1927); (0, 1) where nothing was tried."""
    if total == 0:
        return 0.0, 1.0
    p, zz = hits / total, z * z
    middle = (p + zz / (2 * total)) / (1 + zz / total)
    half = z / (1 + zz / total) * math.sqrt(p * (1 - p) / total + zz / (4 * total**2))
    return max(0.0, middle - half), min(1.0, middle + half)


def claims(row: Row) -> list[Claim]:
    """Findings and parametric entries, the largest share first."""
    return sorted([*row["findings"], *row["parametric"]], key=lambda c: -c["share"])


def names_of(claim: Claim) -> set[str]:
    """The claimed name and those it may be instead."""
    return {claim["name"], *claim["ambiguous"]}


def alarms(row: Row) -> dict[str, bool]:
    """What a log without any effect should not give, kind by kind."""
    found = {
        "finding": bool(row["findings"]),
        "parametric": bool(row["parametric"]),
        "status": row["status"] != "no_gap",
    }
    return found | {"any": any(found.values())}


def identified(row: Row) -> dict[str, Any]:
    """Scores of a row with one planted effect: top1, in_set, set_size (None without a claim),
    family, exact, detected."""
    (planted,) = row["truth"]
    found = claims(row)
    top = found[0] if found else None
    return {
        "detected": alarms(row)["any"],
        "top1": top is not None and top["name"] == planted["name"],
        "in_set": any(planted["name"] in names_of(c) for c in found),
        "set_size": None if top is None else len(names_of(top)),
        "family": top is not None and top["family"] == planted["family"],
        "exact": len(found) == 1
        and found[0]["name"] == planted["name"]
        and list(found[0]["place"]) == list(planted["place"]),
    }


def joint_counts(row: Row) -> tuple[int, int, int]:
    """(hits, too many, missed) of the joints that are claimed: those an effect is on, and where it
    is on the whole arm those whose torque it changes."""
    true = {j for t in row["truth"] for j in _located(t)}
    said = {j for c in claims(row) for j in _located(c)}
    return len(true & said), len(said - true), len(true - said)


def _located(effect: Mapping[str, Any]) -> list[int]:
    return list(effect["place"] or effect["joints"])


def f1(counts: tuple[int, int, int]) -> float:
    """2 hits / (2 hits + too many + missed); 1 where there is nothing to find and to say."""
    hits, extra, missed = counts
    total = 2 * hits + extra + missed
    return 2 * hits / total if total else 1.0


def matched(row: Row, strict: bool) -> tuple[int, int, int]:
    """(hits, too many, missed) of (effect, joint), each claim for one planted effect at most.

    Args:
        row: any.
        strict: whether name and place must be the same; else the name may be among a claim's
            alternatives, on a common joint or where one of them is on the whole arm.
    """
    planted, found = row["truth"], claims(row)
    fits = [[_fits(t, c, strict) for c in found] for t in planted]
    hits = largest_matching(fits)
    return hits, len(found) - hits, len(planted) - hits


def _fits(planted: Mapping[str, Any], claim: Claim, strict: bool) -> bool:
    here, there = list(planted["place"]), list(claim["place"])
    if strict:
        return planted["name"] == claim["name"] and here == there
    same = not here or not there or bool(set(here) & set(there))
    return planted["name"] in names_of(claim) and same


def largest_matching(fits: Sequence[Sequence[bool]]) -> int:
    """Most pairs (i, j) with fits[i][j], each i and each j in one pair (augmenting paths)."""
    owner: dict[int, int] = {}

    def place(i: int, seen: set[int]) -> bool:
        for j, good in enumerate(fits[i]):
            if good and j not in seen:
                seen.add(j)
                if j not in owner or place(owner[j], seen):
                    owner[j] = i
                    return True
        return False

    return sum(place(i, set()) for i in range(len(fits)))


def without_its_name(row: Row, families: Mapping[str, str]) -> str:
    """Verdict on a diagnosis whose library lacks the planted effect.

    `right_family`: explained by the planted family; `hedged`: by another one, a member of the right
    one among the alternatives; `confident_wrong`: by another one; `detected_unexplained`; `missed`.

    Args:
        row: with one planted effect.
        families: family of every effect.
    """
    (planted,) = row["truth"]
    if row["status"] == "detected_unexplained":
        return "detected_unexplained"
    found = claims(row)
    if not found:
        return "missed"
    if found[0]["family"] == planted["family"]:
        return "right_family"
    others = {families.get(name) for name in found[0]["ambiguous"]}
    return "hedged" if planted["family"] in others else "confident_wrong"


def inside(value: float, std: float, true: float, z: float = 1.96) -> bool:
    """Whether an interval holds the truth."""
    return abs(value - true) <= z * std


def table(head: Sequence[str], body: Iterable[Sequence[object]]) -> str:
    """Markdown."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(str(x) for x in cells) + " |" for cells in body]
    return "\n".join(lines)


def share(hits: int, total: int) -> str:
    """12/40 (18-45 %)"""
    if total == 0:
        return "-"
    low, high = wilson(hits, total)
    return f"{hits}/{total} ({100 * low:.0f}-{100 * high:.0f} %)"


def mean(values: Iterable[float]) -> float:
    """Of what there is; nan of nothing."""
    known = list(values)
    return sum(known) / len(known) if known else math.nan


def number(value: float, digits: int = 2) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def by(rows: Iterable[Row], key: Callable[[Row], str]) -> dict[str, list[Row]]:
    """Rows in groups, in order of appearance."""
    out: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        out[key(row)].append(row)
    return dict(out)


def added(counts: Iterable[tuple[int, int, int]]) -> tuple[int, int, int]:
    """Sums, for micro-averages."""
    every = [*counts, (0, 0, 0)]
    return tuple(sum(column) for column in zip(*every, strict=True))  # type: ignore[return-value]


def none_table(rows: Sequence[Row]) -> str:
    """False alarms, by colour of the noise and robot."""
    groups = {
        **by(rows, lambda r: "white" if r["colour_hz"] is None else "coloured"),
        **by(rows, lambda r: r["robot"]),
        "all": rows,
    }
    kinds = ("any", "finding", "parametric", "status")
    body = []
    for name, some in groups.items():
        body.append([name, *(share(sum(alarms(r)[k] for r in some), len(some)) for k in kinds)])
    return table(["no effect planted", "any alarm", "finding", "parametric", "status"], body)


def single_table(rows: Sequence[Row]) -> str:
    """Names of single effects, effect by effect."""
    groups = {
        **by(rows, lambda r: r["truth"][0]["name"]),
        **by(rows, lambda r: "white noise" if r["colour_hz"] is None else "coloured noise"),
        "all": rows,
    }
    body = []
    for name, some in groups.items():
        scores = [identified(r) for r in some]
        n = len(some)
        counts = [sum(s[k] for s in scores) for k in ("top1", "in_set", "family", "exact")]
        shown = [share(c, n) if name == "all" else f"{c}/{n}" for c in counts]
        sizes = mean(s["set_size"] for s in scores if s["set_size"] is not None)
        joints = f1(added(joint_counts(r) for r in some))
        statuses = Counter(r["status"] for r in some)
        body.append(
            [
                name,
                *shown,
                number(sizes, 1),
                number(joints),
                ", ".join(f"{k} {v}" for k, v in statuses.items()),
                number(mean(r["truth"][0]["size"] for r in some), 1),
            ]
        )
    head = [
        "effect",
        "top-1",
        "in set",
        "family",
        "exact",
        "set size",
        "joint F1",
        "status",
        "size",
    ]
    return table(head, body)


def several_table(rows: Sequence[Row]) -> str:
    """Micro-F1 of several effects at once."""
    groups = {
        **by(rows, lambda r: "one joint" if r["same_joint"] else "anywhere"),
        **by(rows, lambda r: "white noise" if r["colour_hz"] is None else "coloured noise"),
        "all": rows,
    }
    body = []
    for name, some in groups.items():
        loose = added(matched(r, False) for r in some)
        strict = added(matched(r, True) for r in some)
        whole = sum(matched(r, False)[1:] == (0, 0) for r in some)
        cells = [
            f"{number(f1(c))} ({c[0]} hits, {c[1]} extra, {c[2]} missed)" for c in (loose, strict)
        ]
        body.append([name, len(some), *cells, share(whole, len(some))])
    return table(["effects", "cases", "F1 with sets", "F1 strict", "all right"], body)


def withheld_table(rows: Sequence[Row], families: Mapping[str, str]) -> str:
    """What is said when the right name is not in the library."""
    verdicts = ("right_family", "hedged", "detected_unexplained", "confident_wrong", "missed")
    groups = {**by(rows, lambda r: r["truth"][0]["name"]), "all": rows}
    body = []
    for name, some in groups.items():
        said = [(without_its_name(r, families), r) for r in some]
        counts = Counter(v for v, _ in said)
        wrong = Counter(claims(r)[0]["name"] for v, r in said if v == "confident_wrong")
        listed = "" if name == "all" else ", ".join(f"{k} {v}" for k, v in wrong.items())
        shown = [share(counts[v], len(some)) if name == "all" else counts[v] for v in verdicts]
        body.append([name, *shown, listed])
    return table(["withheld effect", *(v.replace("_", " ") for v in verdicts), "wrong names"], body)


def rates(rows: Sequence[Row]) -> dict[str, dict[float, tuple[int, int, int]]]:
    """By effect and level: (detected, named, cases)."""
    out: dict[str, dict[float, tuple[int, int, int]]] = {}
    for name, some in by(rows, lambda r: r["truth"][0]["name"]).items():
        out[name] = {}
        for level in sorted({r["level"] for r in some}):
            scores = [identified(r) for r in some if r["level"] == level]
            out[name][level] = (
                sum(s["detected"] for s in scores),
                sum(s["in_set"] for s in scores),
                len(scores),
            )
    return out


def severity_table(rows: Sequence[Row]) -> str:
    """Detected / named of all cases, by size."""
    found = rates(rows)
    levels = sorted({level for one in found.values() for level in one})
    body = []
    for name, one in found.items():
        cells = [one.get(level, (0, 0, 0)) for level in levels]
        body.append([name, *(f"{d} / {k} of {n}" for d, k, n in cells)])
    return table(["detected / named", *(f"{level:g} x noise" for level in levels)], body)


def severity_figure(rows: Sequence[Row], path: Path) -> None:
    """Shares detected and named over the size, one panel an effect."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    found = rates(rows)
    columns = 3
    lines = math.ceil(len(found) / columns)
    size = (3.2 * columns, 2.5 * lines)
    figure, axes = plt.subplots(
        lines, columns, figsize=size, sharex=True, sharey=True, squeeze=False
    )
    for axis, (name, one) in zip(axes.flat, found.items(), strict=False):
        levels = sorted(one)
        for which, label, style in ((0, "detected", "--"), (1, "named", "-")):
            values = [100 * one[level][which] / one[level][2] for level in levels]
            axis.plot(levels, values, style, marker="o", markersize=3, label=label)
        axis.set_xscale("log")
        axis.set_title(name.replace("_", " "), fontsize=9)
        axis.grid(alpha=0.3)
    for axis in axes[-1]:
        axis.set_xlabel("size / torque noise")
    for axis in axes[:, 0]:
        axis.set_ylabel("cases [%]")
    axes[0, 0].legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=130)
    plt.close(figure)


def closing_table(rows: Sequence[Row]) -> str:
    """Closed fractions against the oracle's and on fresh logs, and coverage."""
    groups = {**by(rows, lambda r: r["truth"][0]["name"]), "all": rows}
    body = []
    for name, some in groups.items():
        body.append([name, len(some), *_closing_cells(some)])
    head = [
        "effect",
        "cases",
        "closed",
        "oracle",
        "ratio",
        "closed, fresh log",
        "oracle, fresh log",
        "closed_ci95 holds fresh",
        "coefficients in 1.96 std",
    ]
    return table(head, body)


def _closing_cells(some: Sequence[Row]) -> list[str]:
    own = [r for r in some if r.get("closed") is not None]
    both = [r for r in own if r.get("oracle_closed") is not None]
    told = mean(r["oracle_closed"] for r in both)
    ratio = mean(r["closed"] for r in both) / told if both and told > 0 else math.nan
    fresh = [r for r in some if r.get("fresh_closed") is not None]
    best = [r["oracle_fresh_closed"] for r in some if r.get("oracle_fresh_closed") is not None]
    covered = [r for r in fresh if r.get("closed_ci95") is not None]
    holds = sum(r["closed_ci95"][0] <= r["fresh_closed"] <= r["closed_ci95"][1] for r in covered)
    coefficients = [c for r in some for c in r.get("coverage", ())]
    good = sum(inside(c["value"], c["std"], c["true"]) for c in coefficients)
    return [
        number(mean(r["closed"] for r in own)),
        number(told),
        number(ratio),
        number(mean(r["fresh_closed"] for r in fresh)),
        number(mean(best)),
        share(holds, len(covered)),
        share(good, len(coefficients)),
    ]
