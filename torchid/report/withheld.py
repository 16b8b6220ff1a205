"""Scores of withheld cases: lines with targets, tables, Markdown, figures of what was named for
what and from which size on; and the check on one's own arm."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from torchid.report.colours import BLUE, GREY, INK, ORANGE
from torchid.report.panels import (
    SMALL,
    Figure,
    Figures,
    finish,
    new_figure,
    panel,
    shaded_map,
    tiles,
)
from torchid.report.table import Shown, Table
from torchid.withheld.own import LEVELS, OwnCheck, Planted
from torchid.withheld.score_record import ScoreRecord

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

    def parts(self, scores: Mapping[str, Any]) -> tuple[str, str, str]:
        """Value, interval and count."""
        value = self.value(scores)
        if value is None:
            return "-", "", ""
        entry = {} if self.path[-1] in ("set_size", "brier") else self.entry(scores)
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
    Line("gap closed, of the oracle's", ("closing", "ratio", "median"), low=0.97),
    Line("intervals hold the closed share", ("coverage", "closed", "share"), 0.9, 0.98),
    Line("intervals hold coefficients", ("coverage", "coefficients", "share"), 0.9, 0.98),
)


def shown(summary: Summary) -> Shown:
    """All that there is to see of a score."""
    sealed = f"SHA-256 of the keys: {summary['keys_sha256']}, as sealed"
    said: list[Table | str] = [score_table(summary), sealed]
    return Shown(verdict=headline(summary), parts=said, figures=figures(summary))


def score_table(summary: Summary) -> Table:
    """Scores that there are cases for, beside targets."""
    rows = []
    for line in LINES:
        met = line.met(summary["scores"])
        if line.value(summary["scores"]) is not None:
            target = line.target + ("" if met is None else " met" if met else " missed")
            rows.append((line.label, *line.parts(summary["scores"]), target))
    title = f"withheld cases of seed {summary['seed']}: {summary['cases']} answers"
    return Table(title, ("score", "torchid", "95 %", "cases", "target"), rows, "lrrrl")


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


def own_shown(found: OwnCheck) -> Shown:
    """All that there is to see of the check."""
    half = "untouched data: the second half of every trajectory (--held-out for others)"
    said: list[Table | str] = [*own_tables(found), *([] if found.whole else [half])]
    return Shown(verdict=own_headline(found), parts=said)


def own_headline(found: OwnCheck) -> str:
    """What was found again of what is there, in one sentence."""
    if not found.withheld:
        return "No effect was accepted on the first part of the logs, so none could be withheld."
    again = sum(w.in_set for w in found.withheld)
    judged = [w.as_much for w in found.withheld if w.as_much is not None]
    text = f"{again} of {len(found.withheld)} accepted effects were found again once withheld"
    if not judged:
        return f"{text}; without any of them these data show no gap."
    return (
        f"{text}; of {len(judged)} that leave a gap here, {sum(judged)} closed as much of it as "
        "they are known to."
    )


def own_tables(found: OwnCheck) -> list[Table]:
    """What was withheld, and the smallest sizes planted that were found: in units of the noise,
    those at which an effect was named, or in a set (in brackets)."""
    withheld = []
    for w in found.withheld:
        others = (
            f"{f.effect} {_joints(f.joints)}" if f.joints else f.effect
            for f in w.found
            if (f.effect, f.joints) != (w.effect, w.joints)
        )
        again = "yes" if w.named else "in a set" if w.in_set else "no"
        shares = ("no gap" if x is None else f"{100 * x:.0f} %" for x in (w.closed, w.known))
        withheld.append((w.effect, _joints(w.joints), again, ", ".join(others), *shares))
    heads = ("effect", "joint", "found again", "named instead", "closed", "known to close")
    joints = sorted({p.joint for p in found.planted})
    planted = [
        (effect, *(smallest(found.planted, effect, j) for j in joints))
        for effect in dict.fromkeys(p.effect for p in found.planted)
    ]
    columns = ("effect", *(f"joint {j + 1}" for j in joints))
    return [
        Table("Accepted effects, withheld", heads, withheld, "pppppp"),
        Table("Smallest size found, over noise", columns, planted, "p"),
    ]


def smallest(rows: Sequence[Planted], effect: str, joint: int) -> str:
    """`2`, `(2)` if only in a set, or `> 10`."""
    own = [p for p in rows if (p.effect, p.joint) == (effect, joint)]
    found = min((p for p in own if p.in_set), key=lambda p: p.level, default=None)
    if found is None:
        return f"> {max((p.level for p in own), default=LEVELS[-1]):g}"
    return f"{found.level:g}" if found.named else f"({found.level:g})"


def _joints(joints: Sequence[int]) -> str:
    return " ".join(str(j + 1) for j in joints) or "arm"


_COLUMNS = 3
_TICKS = (0.1, 0.3, 1, 3, 10, 30, 100)

Matrix = Mapping[str, Mapping[str, int]]


def figures(found: Summary | ScoreRecord) -> Figures:
    """What draws each figure that there are data for, by the names of their files."""
    summary = found.plain() if isinstance(found, ScoreRecord) else found
    scores, out = summary["scores"], {}
    inside, outside = scores["confusion"], scores["confusion_outside"]
    if inside or outside:
        out["confusion"] = partial(confusion_figure, inside, outside)
    if scores["detection"]:
        out["detection"] = partial(detection_figure, scores["detection"])
    if scores["how_sure"]["curve"]:
        out["reliability"] = partial(reliability_figure, scores["how_sure"]["curve"])
    return out


def reliability_figure(curve: Sequence[Mapping[str, Any]]) -> Figure:
    """Shares of right names over the probability that was given, with 95 % intervals."""
    figure, axes = panel(4.2, 3.4)
    axes.plot([0, 100], [0, 100], color=GREY, linewidth=1.0, label="as often as stated")
    x, y = ([100 * point[name] for point in curve] for name in ("mean", "share"))
    ends = np.array([[100 * e for e in point["ci95"]] for point in curve]).T
    axes.errorbar(
        x, y, np.abs(ends - np.array(y)), color=BLUE, marker="o", markersize=4, linewidth=1.2,
        capsize=2, label="names (95 %)",
    )  # fmt: skip
    axes.set(xlim=(-2, 102), ylim=(-2, 102))
    axes.set_xlabel("stated probability [%]", fontsize=SMALL, color=INK)
    axes.set_ylabel("right [%]", fontsize=SMALL, color=INK)
    return finish(figure, "How sure, and how often right", axes)


def confusion_figure(inside: Matrix, outside: Matrix) -> Figure:
    """Planted causes (rows) and what was named first (columns): share of the row as colour, cases
    as number. Causes outside the library are below the line, and have no right name."""
    from matplotlib.patches import Rectangle

    rows = [*sorted(inside), *sorted(outside)]
    # Names said: those that were planted first, in the same order, then others, then none.
    said = {name for matrix in (inside, outside) for row in matrix.values() for name in row}
    planted = [name for name in sorted(inside) if name in said]
    nothing = sorted(name for name in said if name.startswith("("))
    columns = [*planted, *sorted(said - set(planted) - set(nothing)), *nothing]
    table = np.array(
        [[{**inside, **outside}[r].get(c, 0) for c in columns] for r in rows], dtype=float
    )
    shares = table / np.maximum(table.sum(1, keepdims=True), 1)
    figure = new_figure(3.6 + 0.3 * len(columns), 2.6 + 0.24 * len(rows))
    axes = figure.subplots()
    names = [_words(c) for c in columns]
    shaded_map(axes, shares, names, [_words(r) for r in rows], "share of the row's cases", 1.0)
    axes.set_xticks(range(len(columns)), names, rotation=60, ha="right", rotation_mode="anchor")
    for (y, x), cases in np.ndenumerate(table):
        text = f"{cases:.0f}" if cases else ""
        axes.text(x, y, text, ha="center", va="center", fontsize=SMALL, color=INK)
        if rows[y] == columns[x]:
            corner = (x - 0.5, y - 0.5)
            axes.add_patch(Rectangle(corner, 1, 1, fill=False, edgecolor=GREY, linewidth=1.0))
    if inside and outside:
        axes.axhline(len(inside) - 0.5, color=INK, linewidth=1.0)
        axes.text(
            len(columns) - 0.4, len(inside) + 0.5 * len(outside) - 0.5, "outside\nthe library",
            fontsize=SMALL, color=INK, va="center",
        )  # fmt: skip
    axes.set_xlabel("named first", fontsize=SMALL, color=INK)
    axes.set_ylabel("planted", fontsize=SMALL, color=INK)
    return finish(figure, "What was planted and what was named first (number of cases)")


def detection_figure(curves: Mapping[str, Sequence[Mapping[str, Any]]]) -> Figure:
    """Shares of cases detected and named over the planted size, one panel a family, with 95 %
    intervals."""
    columns = min(_COLUMNS, len(curves))
    names, width = [_words(name) for name in curves], max(4.4, 3.2 * columns)
    figure, grid = tiles(
        names,
        columns,
        width,
        (2.2, 1.3),
        "size / noise",
        "cases [%]",
        "left",
        sharex=True,
        sharey=True,
    )
    levels = sorted({point["level"] for points in curves.values() for point in points})
    low, high = 0.8 * levels[0], 1.25 * levels[-1]
    ticks = [x for x in _TICKS if low <= x <= high]
    for axes, points in zip(grid, curves.values(), strict=True):
        x = [point["level"] for point in points]
        for which, colour, style in (("detected", ORANGE, (0, (4, 2))), ("named", BLUE, "-")):
            rates = [point[which] for point in points]
            axes.fill_between(
                x, [100 * r["ci95"][0] for r in rates], [100 * r["ci95"][1] for r in rates],
                color=colour, alpha=0.13, linewidth=0,
            )  # fmt: skip
            axes.plot(
                x, [100 * r["share"] for r in rates], color=colour, linestyle=style, marker="o",
                markersize=3, linewidth=1.5, label=f"{which} (band: 95 %)",
            )  # fmt: skip
        axes.set(xscale="log", xlim=(low, high), ylim=(-4, 104))
        axes.set_xticks(ticks, [f"{x:g}" for x in ticks])
        axes.minorticks_off()
    return finish(figure, "Detected and named, by the size of what was planted", grid[0], columns=2)


def _words(name: str) -> str:
    return name.replace("_", " ")
