"""Scores of withheld cases in words: lines with targets, tables, Markdown."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rich.table import Table

from torchid.report.identification import compact

Summary = Mapping[str, Any]


@dataclass(frozen=True)
class Line:
    """One score: where it is in the summary, and what it should be.

    Attributes:
        label: for people.
        path: keys into the scores; the last is that of the value.
        low, high: target; None where there is none.
        percent: whether the value is a share, shown in per cent.
    """

    label: str
    path: tuple[str, ...]
    low: float | None = None
    high: float | None = None
    percent: bool = True

    def entry(self, scores: Mapping[str, Any]) -> Mapping[str, Any]:
        """What holds the value and its interval."""
        found: Any = scores
        for key in self.path[:-1]:
            found = found[key]
        return found

    def value(self, scores: Mapping[str, Any]) -> float | None:
        """The score; None where nothing was tried."""
        value = self.entry(scores)[self.path[-1]]
        return None if value is None else float(value)

    def met(self, scores: Mapping[str, Any]) -> bool | None:
        """Whether the target is met; None without value or target."""
        value = self.value(scores)
        if value is None or (self.low is None and self.high is None):
            return None
        return (self.low is None or value >= self.low) and (self.high is None or value <= self.high)

    @property
    def target(self) -> str:
        """In words."""
        low, high = (None if x is None else self.shown(x) for x in (self.low, self.high))
        if low is not None and high is not None:
            return f"{low} to {high}"
        return f"at least {low}" if low is not None else "" if high is None else f"at most {high}"

    def text(self, scores: Mapping[str, Any]) -> str:
        """Value, interval and count."""
        value = self.value(scores)
        if value is None:
            return "-"
        entry = self.entry(scores)
        text = self.shown(value)
        interval = None if self.path[-1] == "set_size" else entry.get("ci95")
        if interval is not None:
            text += f" ({self.shown(interval[0])} to {self.shown(interval[1])})"
        if "hits" in entry and "total" in entry:
            text += f", {entry['hits']} of {entry['total']}"
        return text

    def shown(self, value: float) -> str:
        """A value of this score."""
        return f"{100 * value:.1f} %" if self.percent else f"{value:.2f}"


LINES = (
    Line("false alarms, white noise", ("false_alarms", "white", "share"), high=0.03),
    Line("false alarms, coloured noise", ("false_alarms", "coloured", "share"), high=0.03),
    Line("false alarms, all", ("false_alarms", "all", "share"), high=0.03),
    Line("parameters only: structural effect named", ("parameters", "structural", "share")),
    Line("one effect: detected", ("single", "detected", "share")),
    Line("one effect: first name right", ("single", "top1", "share"), low=0.85),
    Line("one effect: in the first set", ("single", "in_set", "share"), low=0.95),
    Line("one effect: names in the set", ("single", "set_size"), high=2.0, percent=False),
    Line("one effect: in any set", ("single", "anywhere", "share")),
    Line("one effect: family right", ("single", "family", "share"), low=0.95),
    Line("one effect: nothing else, right joint", ("single", "exact", "share")),
    Line("joints, F1", ("joints", "f1"), low=0.95, percent=False),
    Line("two effects, F1", ("several", "pairs", "with_sets", "f1"), low=0.9, percent=False),
    Line("two effects, F1, first names", ("several", "pairs", "strict", "f1"), percent=False),
    Line("three effects, F1", ("several", "triples", "with_sets", "f1"), percent=False),
    Line(
        "outside the library: wrong family, for sure",
        ("outside", "confident_wrong", "share"),
        high=0.05,
    ),
    Line("poor excitation: said so, or right", ("poor", "honest", "share")),
    Line("poor excitation: said so", ("poor", "not_testable_or_hedged", "share")),
    Line("gap closed, of the oracle's (median)", ("closing", "ratio", "median"), low=0.97),
    Line("95 % intervals hold the closed share", ("coverage", "closed", "share"), 0.9, 0.98),
    Line("95 % intervals hold coefficients", ("coverage", "coefficients", "share"), 0.9, 0.98),
)

BASELINES = {
    "friction": "always friction, worst joint",
    "stlsq": "STLSQ",
    "bic": "BIC stepwise",
}


def score_table(summary: Summary) -> Table:
    """Scores beside targets and baselines."""
    head, body = _score_rows(summary)
    table = compact(f"withheld cases of seed {summary['seed']}: {summary['cases']} answers")
    for heading in head:
        table.add_column(heading)
    for row in body:
        table.add_row(*row)
    return table


def headline(summary: Summary) -> str:
    """How many targets are met."""
    judged = [line.met(summary["scores"]) for line in LINES]
    met, missed = judged.count(True), judged.count(False)
    text = f"{met} of {met + missed} targets met on {summary['cases']} cases"
    errors = len(summary["scores"]["errors"])
    if errors:
        text += f"; {errors} diagnoses failed"
    if summary["unanswered"]:
        text += f"; {summary['unanswered']} cases have no answer"
    return text + "."


def markdown(summary: Summary, figures: Sequence[str] = ()) -> str:
    """The whole report.

    Args:
        summary: from `torchid.withheld.summary`.
        figures: files to show, relative to the report's.
    """
    scores = summary["scores"]
    kinds = ", ".join(f"{kind} {count}" for kind, count in sorted(summary["kinds"].items()))
    parts = [
        f"# Withheld cases: seed {summary['seed']}",
        f"{headline(summary)} Kinds: {kinds}. SHA-256 of the keys: `{summary['keys_sha256']}`. "
        f"torchid {summary['scored_with']}. Intervals: 95 %.",
        markdown_table(*_score_rows(summary)),
        *(f"![{name}]({name})" for name in figures),
        "## Status by kind",
        counts_table("kind", scores["status"]),
        "## One effect, by effect",
        _by_effect(scores["single"]["by_effect"]),
        "## What was named first (one effect planted)",
        _confusion(scores["confusion"]),
        "## Outside the library",
        counts_table("cause", scores["outside"]["by_cause"]),
        _confusion(scores["confusion_outside"]),
        "## Poor excitation",
        counts_table("cases", {"poor": scores["poor"]["verdicts"]}),
        "## Detected / named, by size in standard deviations of the noise",
        _detection(scores["detection"]),
        "## Cases that went wrong",
        _wrong(summary["answers"]),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _score_rows(summary: Summary) -> tuple[list[str], list[list[str]]]:
    baselines = summary["baselines"]
    names = [BASELINES.get(name, name) for name in baselines]
    head = ["score", "torchid gap", "target", "met", *names]
    body = []
    for line in LINES:
        met = line.met(summary["scores"])
        words = "" if met is None else "yes" if met else "no"
        others = [_short(line, scores) for scores in baselines.values()]
        body.append([line.label, line.text(summary["scores"]), line.target, words, *others])
    return head, body


def _short(line: Line, scores: Mapping[str, Any]) -> str:
    value = line.value(scores)
    return "-" if value is None else line.shown(value)


def markdown_table(head: Sequence[str], body: Iterable[Sequence[object]]) -> str:
    """Rows as Markdown."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(str(x) for x in cells) + " |" for cells in body]
    return "\n".join(lines)


def counts_table(first: str, groups: Mapping[str, Mapping[str, int]]) -> str:
    """Counts in groups as Markdown; the groups are the rows."""
    columns = list(dict.fromkeys(name for counts in groups.values() for name in counts))
    if not columns:
        return "None."
    body = [[name, *(counts.get(c, 0) for c in columns)] for name, counts in groups.items()]
    return markdown_table([first, *(c.replace("_", " ") for c in columns)], body)


def _by_effect(groups: Mapping[str, Mapping[str, Any]]) -> str:
    if not groups:
        return "None."
    keys = ("detected", "top1", "in_set", "family", "exact")
    body = []
    for name, found in groups.items():
        size = found["set_size"]
        cells = [f"{found[k]['hits']}/{found[k]['total']}" for k in keys]
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
    return markdown_table(["planted", "named first instead", "cases"], body) if body else ""


def _detection(curves: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    levels = sorted({point["level"] for points in curves.values() for point in points})
    if not levels:
        return "None."
    body = []
    for name, points in curves.items():
        by_level = {point["level"]: point for point in points}
        cells = [_rates(by_level[level]) if level in by_level else "" for level in levels]
        body.append([name, *cells])
    return markdown_table(["effect", *(f"{level:g}" for level in levels)], body)


def _rates(point: Mapping[str, Any]) -> str:
    detected, named = point["detected"], point["named"]
    return f"{detected['hits']} / {named['hits']} of {named['total']}"


def _wrong(answers: Sequence[Mapping[str, Any]]) -> str:
    body = [
        [a["case"], a["kind"], a["arm"], listed(a["planted"]), a["status"], listed(a["named"])]
        for a in answers
        if not a["right"]
    ]
    if not body:
        return "None."
    return markdown_table(["case", "kind", "arm", "planted", "status", "named"], body)


def listed(effects: Iterable[Mapping[str, Any]]) -> str:
    """Names, alternatives and joints."""
    out = []
    for effect in effects:
        names = "/".join([effect["name"], *effect.get("ambiguous_with", ())])
        joints = ",".join(str(j) for j in effect["joints"])
        size = f" ({effect['size']:.1f})" if effect.get("size") is not None else ""
        out.append(f"{names} {joints}{size}".strip())
    return "; ".join(out) or "-"
