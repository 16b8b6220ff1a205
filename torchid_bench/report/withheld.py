"""Scores of withheld cases: lines with targets, and their table."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from torchid.report.table import Report, Table

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
        value: Any = scores
        for key in self.path[:-1]:
            value = value[key]
        return value

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

    def parts(self, scores: Mapping[str, Any]) -> tuple[str, str, str]:
        """Value, interval and count."""
        value = self.value(scores)
        if value is None:
            return "-", "", ""
        entry = self.entry(scores)
        between = " to ".join(self._plain(end) for end in entry.get("ci95") or ())
        count = f"{entry['cases']} cases" if "cases" in entry else ""
        if "total" in entry:
            count = f"{entry['hits']} of {entry['total']}"
        return self.shown(value), between, count

    def shown(self, value: float) -> str:
        """A value of this score."""
        return self._plain(value) + (" %" if self.percent else "")

    def _plain(self, value: float) -> str:
        return f"{100 * value:.1f}" if self.percent else f"{value:.2f}"


OUTCOMES = (
    Line("good logs refused", ("outcomes", "refused", "share"), high=0.0),
    Line("faults of the program (exit 70)", ("outcomes", "error", "share"), high=0.0),
    Line("out of time", ("outcomes", "out_of_time", "share"), high=0.0),
    Line("nothing named", ("outcomes", "silent", "share")),
    Line("CPU seconds a case, median", ("seconds", "median"), percent=False),
    Line("CPU seconds a case, worst", ("seconds", "worst"), percent=False),
)

BACKGROUND = (
    Line("decidable: named first", ("background", "first", "in_practice", "strictly", "share")),
    Line(
        "decidable: first of what is no small thing",
        ("background", "first", "in_practice", "beside_small", "share"),
    ),
    Line("decidable: in its set", ("background", "first", "in_practice", "in_set", "share")),
    Line(
        "decidable if the background were known: first of what is no small thing",
        ("background", "first", "ideally", "beside_small", "share"),
    ),
    Line("new names above .9: right", ("background", "sure", "share")),
    Line(
        "new names above .9: right, or there without an earlier log",
        ("background", "sure_or_there", "share"),
    ),
    Line("cases with a false name above .9", ("background", "cases_with_false_sure", "share")),
    Line("nothing planted: false name above .5", ("background", "nothing", "likely", "share")),
    Line("nothing planted: false name above .9", ("background", "nothing", "sure", "share")),
    Line("nothing planted: unexplained", ("background", "nothing", "unexplained", "share")),
    Line("of no library: unexplained, or an honest set", ("background", "outside", "share")),
    Line("sizes within 1 std", ("background", "within", "1", "share")),
    Line("sizes within 1.96 std", ("background", "within", "1.96", "share")),
    Line("names a case", ("background", "names_a_case"), percent=False),
)

LINES = (
    Line("false alarms, white noise", ("false_alarms", "white", "share"), high=0.03),
    Line("false alarms, coloured noise", ("false_alarms", "coloured", "share"), high=0.03),
    Line(
        "false alarms, noise that grows with speed", ("false_alarms", "growing", "share"), high=0.03
    ),
    Line("false alarms, all", ("false_alarms", "all", "share"), high=0.03),
    Line("parameters only: other effect named", ("parameters", "structural", "share")),
    Line("one effect: detected", ("single", "detected", "share")),
    Line("one effect: first name right", ("single", "top1", "share"), low=0.85),
    Line("one effect: in the first set", ("single", "in_set", "share"), low=0.95),
    Line("one effect: names in the set", ("single", "set_size"), high=2.0, percent=False),
    Line("one effect: in any set", ("single", "anywhere", "share")),
    Line("one effect: family right", ("single", "family", "share"), low=0.95),
    Line("one effect: its branch named at its place", ("single", "branch", "share")),
    Line("one effect: that alone, right joint", ("single", "exact", "share")),
    Line("one clear effect: first name right", ("single_clear", "top1", "share")),
    Line("one clear effect: in the first set", ("single_clear", "in_set", "share")),
    Line("one clear effect: family right", ("single_clear", "family", "share")),
    Line("one effect, any size: wrong family for sure", ("wrong_for_sure", "share")),
    Line("how sure: Brier score", ("how_sure", "brier"), percent=False),
    Line("joints, F1", ("joints", "f1"), low=0.95, percent=False),
    Line("two effects, F1", ("several", "pairs", "with_sets", "f1"), low=0.9, percent=False),
    Line("two effects, F1, first names", ("several", "pairs", "strict", "f1"), percent=False),
    Line("three effects, F1", ("several", "triples", "with_sets", "f1"), percent=False),
    Line("outside: wrong family for sure", ("outside", "confident_wrong", "share"), high=0.05),
    Line("poor data: reported so, or right", ("poor", "honest", "share")),
    Line("poor data: reported so", ("poor", "not_testable_or_hedged", "share")),
    Line("intervals hold coefficients", ("coverage", "share"), 0.9, 0.98),
)


def report_of_summary(summary: Summary) -> Report:
    """All that there is to see of a score."""
    sealed = f"SHA-256 of the keys: {summary['keys_sha256']}, as sealed"
    lines = OUTCOMES + (BACKGROUND if "background" in summary["scores"] else LINES)
    said: list[Table | str] = [score_table(summary, lines), sealed]
    return Report(verdict=headline(summary, lines), parts=said)


def score_table(summary: Summary, lines: Sequence[Line] = OUTCOMES + LINES) -> Table:
    """Scores that there are cases for, beside targets."""
    rows = []
    for line in lines:
        met = line.met(summary["scores"])
        if line.value(summary["scores"]) is not None:
            target = line.target + ("" if met is None else " met" if met else " missed")
            rows.append((line.label, *line.parts(summary["scores"]), target))
    title = f"withheld cases of seed {summary['seed']}: {summary['cases']} answers"
    return Table(title, ("score", "torchid", "95 %", "cases", "target"), rows, "lrrrl")


def headline(summary: Summary, lines: Sequence[Line] = OUTCOMES + LINES) -> str:
    """How many targets are met."""
    judged = [line.met(summary["scores"]) for line in lines]
    met, missed = judged.count(True), judged.count(False)
    text = f"{met} of {met + missed} targets met on {summary['cases']} cases"
    if summary["unanswered"]:
        text += f"; {summary['unanswered']} cases have no answer"
    return text + "."
