"""Scores of withheld cases as a page in Markdown: what was named for what, effect by effect, and the
cases that went wrong. `withheld_score.py` and `withheld_left_out.py` write it."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from torchid.report.table import pipe_table
from torchid_bench.benchmarks.withheld_beside import ALL_LINES
from torchid_bench.report.withheld import Summary, headline, score_table


def markdown(summary: Summary, drawn: Sequence[str] = ()) -> str:
    """The whole report.

    Args:
        summary: from `torchid.withheld.summary`.
        drawn: files to show, relative to the report's.
    """
    scores = summary["scores"]
    kinds = ", ".join(f"{kind} {count}" for kind, count in sorted(summary["kinds"].items()))
    parts = [
        f"# Withheld cases: seed {summary['seed']}",
        f"{headline(summary, ALL_LINES)} Kinds: {kinds}. SHA-256 of the keys: `{summary['keys_sha256']}`. "
        f"torchid {summary['scored_with']}. Intervals: 95 %.",
        score_table(summary, ALL_LINES).markdown().rstrip(),
        *(f"![{name}]({name})" for name in drawn),
        "## Status by kind",
        counts_table("kind", scores["status"]),
        "## One effect, by effect",
        _by_effect(scores["single"]["by_effect"]),
        "## What was named first instead of one effect",
        _confusion(scores["confusion"]),
        "## Outside the library",
        counts_table("cause", scores["outside"]["by_cause"]),
        _confusion(scores["confusion_outside"]) if scores["confusion_outside"] else "",
        "## Poor excitation",
        counts_table("cases", {"poor": scores["poor"]["verdicts"]}),
        "## Detected / named, by size in standard deviations of the noise",
        _detection(scores["detection"]),
        "## Cases that went wrong",
        markdown_table(
            ["case", "kind", "arm", "planted", "status", "named"],
            [
                (a["case"], a["kind"], a["arm"], listed(a["planted"]), a["status"],
                 listed(a["named"]))
                for a in summary["answers"] if not a["right"]
            ],
        ),
    ]  # fmt: skip
    return "\n\n".join(part for part in parts if part) + "\n"


def markdown_table(head: Sequence[str], body: Sequence[Sequence[object]]) -> str:
    """Rows as Markdown; `None.` where there are none."""
    return pipe_table(head, body) if body else "None."


def counts_table(first: str, groups: Mapping[str, Mapping[str, int]]) -> str:
    """Counts in groups as Markdown; the groups are the rows."""
    columns = list(dict.fromkeys(name for counts in groups.values() for name in counts))
    body = [[name, *(counts.get(c, 0) for c in columns)] for name, counts in groups.items()]
    head = [first, *(c.replace("_", " ") for c in columns)]
    return markdown_table(head, body if columns else [])


def _by_effect(groups: Mapping[str, Mapping[str, Any]]) -> str:
    keys = ("detected", "top1", "in_set", "family", "exact")
    body = []
    for name, group in groups.items():
        size = group["set_size"]
        cells = [f"{group[k]['hits']}/{group[k]['total']}" for k in keys]
        body.append([name, *cells, "-" if size is None else f"{size:.1f}"])
    head = ["effect", "detected", "first name", "in set", "family", "nothing else", "set size"]
    return markdown_table(head, body)


def _confusion(matrix: Mapping[str, Mapping[str, int]]) -> str:
    """Off-diagonal entries alone, the most frequent first."""
    body = [
        [planted, said, count]
        for planted, row in matrix.items()
        for said, count in sorted(row.items(), key=lambda item: -item[1])
        if said != planted
    ]
    return markdown_table(["planted", "named first instead", "cases"], body)


def _detection(curves: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    levels = sorted({point["level"] for points in curves.values() for point in points})
    body = []
    for name, points in curves.items():
        rates = {
            p["level"]: f"{p['detected']['hits']} / {p['named']['hits']} of {p['named']['total']}"
            for p in points
        }
        body.append([name, *(rates.get(level, "") for level in levels)])
    head = ["family", *(f"{level:.2g}" for level in levels)]
    return markdown_table(head, body if levels else [])


def listed(effects: Iterable[Mapping[str, Any]]) -> str:
    """Names, alternatives and joints."""
    out = []
    for effect in effects:
        names = "/".join([effect["name"], *effect.get("ambiguous_with", ())])
        joints = ",".join(str(j) for j in effect["joints"])
        size = f" ({effect['size']:.1f})" if effect.get("size") is not None else ""
        out.append(f"{names} {joints}{size}".strip())
    return "; ".join(out) or "-"
