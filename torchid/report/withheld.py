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
        return f"≥ {low}" if low is not None else "" if high is None else f"≤ {high}"

    def beats(self, scores: Mapping[str, Any], others: Mapping[str, Any]) -> bool:
        """Whether a score is better than another method's; no if the better side is not known."""
        own, other = self.value(scores), self.value(others)
        if own is None or other is None or (self.low is None) == (self.high is None):
            return False
        return own < other if self.low is None else own > other

    def text(self, scores: Mapping[str, Any]) -> str:
        """Value, interval and count."""
        value, interval, count = self._parts(scores)
        return value + (f" ({interval})" if interval else "") + (f", {count}" if count else "")

    def cells(self, scores: Mapping[str, Any]) -> tuple[str, str, str, str]:
        """Value, interval, count, and the target with whether it is met."""
        met = self.met(scores)
        words = "" if met is None else " met" if met else " missed"
        return (*self._parts(scores), self.target + words)

    def brief(self, scores: Mapping[str, Any]) -> str:
        """The value alone."""
        return self._parts(scores)[0]

    def _parts(self, scores: Mapping[str, Any]) -> tuple[str, str, str]:
        value = self.value(scores)
        if value is None:
            return "-", "", ""
        entry = {} if self.path[-1] == "set_size" else self.entry(scores)
        interval = entry.get("ci95")
        between = "" if interval is None else " to ".join(self._plain(end) for end in interval)
        count = f"{entry['cases']} cases" if "cases" in entry else ""
        if "total" in entry:
            count = f"{entry['hits']} of {entry['total']}"
        return self.shown(value), between, count

    def shown(self, value: float) -> str:
        """A value of this score."""
        return self._plain(value) + (" %" if self.percent else "")

    def _plain(self, value: float) -> str:
        return f"{100 * value:.1f}" if self.percent else f"{value:.2f}"


LINES = (
    Line("false alarms, white noise", ("false_alarms", "white", "share"), high=0.03),
    Line("false alarms, coloured noise", ("false_alarms", "coloured", "share"), high=0.03),
    Line("false alarms, all", ("false_alarms", "all", "share"), high=0.03),
    Line("parameters only: other effect named", ("parameters", "structural", "share")),
    Line("one effect: detected", ("single", "detected", "share")),
    Line("one effect: first name right", ("single", "top1", "share"), low=0.85),
    Line("one effect: in the first set", ("single", "in_set", "share"), low=0.95),
    Line("one effect: names in the set", ("single", "set_size"), high=2.0, percent=False),
    Line("one effect: in any set", ("single", "anywhere", "share")),
    Line("one effect: family right", ("single", "family", "share"), low=0.95),
    Line("one effect: that alone, right joint", ("single", "exact", "share")),
    Line("one clear effect: first name right", ("single_clear", "top1", "share")),
    Line("one clear effect: in the first set", ("single_clear", "in_set", "share")),
    Line("one clear effect: family right", ("single_clear", "family", "share")),
    Line("one effect, any size: wrong family for sure", ("wrong_for_sure", "share")),
    Line("joints, F1", ("joints", "f1"), low=0.95, percent=False),
    Line("two effects, F1", ("several", "pairs", "with_sets", "f1"), low=0.9, percent=False),
    Line("two effects, F1, first names", ("several", "pairs", "strict", "f1"), percent=False),
    Line("three effects, F1", ("several", "triples", "with_sets", "f1"), percent=False),
    Line(
        "outside: wrong family for sure",
        ("outside", "confident_wrong", "share"),
        high=0.05,
    ),
    Line("poor data: said so, or right", ("poor", "honest", "share")),
    Line("poor data: said so", ("poor", "not_testable_or_hedged", "share")),
    Line("gap closed, of the oracle's", ("closing", "ratio", "median"), low=0.97),
    Line("intervals hold the closed share", ("coverage", "closed", "share"), 0.9, 0.98),
    Line("intervals hold coefficients", ("coverage", "coefficients", "share"), 0.9, 0.98),
)

BASELINES = {
    "friction": "always friction, worst joint",
    "stlsq": "STLSQ",
    "bic": "BIC stepwise",
}
SHORT = {"friction": "friction", "stlsq": "STLSQ", "bic": "BIC"}


def score_table(summary: Summary) -> Table:
    """Scores that there are cases for, beside targets and baselines."""
    table = compact(f"withheld cases of seed {summary['seed']}: {summary['cases']} answers")
    table.add_column("score", no_wrap=True)
    for heading in ("torchid", "95 %", "cases"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("target", no_wrap=True)
    for name in summary["baselines"]:
        table.add_column(SHORT.get(name, name), justify="right", no_wrap=True)
    for line in LINES:
        if line.value(summary["scores"]) is not None:
            others = [line.brief(scores) for scores in summary["baselines"].values()]
            table.add_row(line.label, *line.cells(summary["scores"]), *others)
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


def beaten_by(summary: Summary) -> list[str]:
    """Scores in which a simple method is better, in words."""
    ours = summary["scores"]
    return [
        f"{line.label}: {BASELINES.get(name, name)} {line.brief(scores)}, ours {line.brief(ours)}"
        for line in LINES
        for name, scores in summary["baselines"].items()
        if line.beats(scores, ours)
    ]


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
        _comparison(summary),
        *(f"![{name}]({name})" for name in figures),
        "## Status by kind",
        counts_table("kind", scores["status"]),
        "## One effect, by effect",
        _by_effect(scores["single"]["by_effect"]),
        "## What was named first instead of one effect",
        _confusion(scores["confusion"]),
        "## Outside the library",
        counts_table("cause", scores["outside"]["by_cause"]),
        *([_confusion(scores["confusion_outside"])] if scores["confusion_outside"] else []),
        "## Poor excitation",
        counts_table("cases", {"poor": scores["poor"]["verdicts"]}),
        "## Detected / named, by size in standard deviations of the noise",
        _detection(scores["detection"]),
        "## Cases that went wrong",
        _wrong(summary["answers"]),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _comparison(summary: Summary) -> str:
    if not summary["baselines"]:
        return ""
    better = beaten_by(summary)
    if not better:
        return "No simple method is better on any score that has a target."
    return "A simple method is better on:\n\n" + "\n".join(f"- {text}" for text in better)


def _score_rows(summary: Summary) -> tuple[list[str], list[list[str]]]:
    baselines = summary["baselines"]
    names = [BASELINES.get(name, name) for name in baselines]
    head = ["score", "torchid gap", "target", "met", *names]
    body = []
    for line in LINES:
        met = line.met(summary["scores"])
        words = "" if met is None else "yes" if met else "no"
        others = [line.brief(scores) for scores in baselines.values()]
        body.append([line.label, line.text(summary["scores"]), line.target, words, *others])
    return head, body


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
    return markdown_table(["planted", "named first instead", "cases"], body) if body else "None."


def _detection(curves: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    levels = sorted({point["level"] for points in curves.values() for point in points})
    if not levels:
        return "None."
    body = []
    for name, points in curves.items():
        by_level = {point["level"]: point for point in points}
        cells = [_rates(by_level[level]) if level in by_level else "" for level in levels]
        body.append([name, *cells])
    return markdown_table(["family", *(f"{level:.2g}" for level in levels)], body)


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
