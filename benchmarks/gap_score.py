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
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

from torchid.withheld import measures
from torchid.withheld.measures import Counts, Named, Verdict, added, f1, inside, named, wilson
from torchid.withheld.rows import Claim, Planted
from torchid.withheld.rows import Row as Case

Row = Mapping[str, Any]


def seen(row: Row) -> Case:
    """A row as the product scores it."""
    planted = [
        Planted(t["name"], t["family"], tuple(t["place"]), tuple(t["joints"]), t["size"])
        for t in row["truth"]
    ]
    return Case(row["status"], tuple(planted), tuple(claims(row)))


def claims(row: Row) -> list[Claim]:
    """Findings and parametric entries, the largest share first."""
    found = [
        Claim(
            c["name"],
            c["family"],
            tuple(c["place"]),
            tuple(c["joints"]),
            tuple(c["ambiguous"]),
            c["share"],
        )
        for c in (*row["findings"], *row["parametric"])
    ]
    return sorted(found, key=lambda c: -c.share)


def alarms(row: Row) -> dict[str, bool]:
    """What a log without any effect should not give, kind by kind."""
    return {
        "finding": bool(row["findings"]),
        "parametric": bool(row["parametric"]),
        "status": row["status"] not in ("no_gap", "not_testable"),
        "any": seen(row).alarm,
    }


def identified(row: Row) -> Named:
    """How a row's only effect was named."""
    return named(seen(row))


def joint_counts(row: Row) -> Counts:
    """(hits, too many, missed) of the joints that are claimed."""
    return measures.joint_counts(seen(row))


def matched(row: Row, strict: bool) -> Counts:
    """(hits, too many, missed) of (effect, joint); what could not be planted at the size of the
    noise (an encoder's offset on a vertical joint) is no miss."""
    hits, extra, missed = measures.matched(seen(row), strict)
    faint = sum(t["size"] < 1 for t in row["truth"])
    return hits, extra, max(0, missed - faint)


def without_its_name(row: Row, families: Mapping[str, str]) -> Verdict:
    """Verdict on a diagnosis whose library lacks the planted effect."""
    return measures.verdict(replace(seen(row), families=families), every=False)


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
        counts = [
            sum(getattr(s, k) for s in scores) for k in ("top1", "anywhere", "family", "exact")
        ]
        shown = [share(c, n) if name == "all" else f"{c}/{n}" for c in counts]
        sizes = mean(s.set_size for s in scores if s.set_size is not None)
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
    verdicts = get_args(Verdict)
    groups = {**by(rows, lambda r: r["truth"][0]["name"]), "all": rows}
    body = []
    for name, some in groups.items():
        said = [(without_its_name(r, families), r) for r in some]
        counts = Counter(v for v, _ in said)
        wrong = Counter(claims(r)[0].name for v, r in said if v == "confident_wrong")
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
            own = [seen(r) for r in some if r["level"] == level]
            out[name][level] = (
                sum(r.alarm for r in own),
                sum(named(r).anywhere for r in own),
                len(own),
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
