"""A comparison of identifications, sets or diagnoses for people: the verdict, tables, a forest of
intervals, and torque per joint."""

import math
from collections.abc import Sequence
from functools import partial

from rich.text import Text

from torchid.compare.diagnoses import ALPHA
from torchid.compare.record import (
    ComparedParameter,
    Comparison,
    GapComparison,
    Named,
    SetComparison,
    Shared,
    TorqueSpread,
    Verdict,
)
from torchid.report.colours import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, RED, TEAL
from torchid.report.panels import Figure, Figures, finish, panel, rows_of
from torchid.report.table import Cell, Shown, Table, cells, joint_numbers
from torchid.results.words import count, short, unit_behind
from torchid.statistics.proportion import HALF_95

ORDER: tuple[Verdict, ...] = ("drift", "differ", "agree", "never_determined", "not_compared")
WORDS = {
    "drift": "drifts",
    "differ": "differs",
    "agree": "agrees",
    "never_determined": "undetermined",
    "not_compared": "in one only",
}
MOST_COLUMNS = 3
"""Results whose values all fit into the table."""

LONGEST = 20
"""Characters of a parameter's name in the table; the JSON has all of it."""

NOTABLE = 2.0
"""Typical Birge ratio from which standard deviations, not single parameters, are to blame."""


def shown(result: Comparison | GapComparison | SetComparison) -> Shown:
    """All that there is to see of a comparison."""
    if isinstance(result, Comparison):
        answer, said = verdict(result), tables(result)
    elif isinstance(result, SetComparison):
        answer, said = set_verdict(result), set_tables(result)
    else:
        answer, said = gap_verdict(result), gap_tables(result)
    return Shown(verdict=answer, parts=said, warnings=result.notes, figures=figures(result))


def verdict(result: Comparison) -> str:
    """What agrees, in sentences."""
    common = len(result.having("agree", "drift", "differ", "never_determined"))
    if not common:
        return "No parameter is estimated in two results: nothing can be compared."
    agree, drift, differ, never = (
        len(result.having(v)) for v in ("agree", "drift", "differ", "never_determined")
    )
    parts = [f"{agree} agree within their intervals"] if agree else []
    if differ:
        parts.append(f"{differ} differ{'s' * (differ == 1)}")
    if drift:
        chance = 2 / math.factorial(len(result.labels))
        parts.append(
            f"{drift} drift{'s' * (drift == 1)} in the order given (of values that differ, a share "
            f"of {chance:.2g} would be in order by chance)"
        )
    if never:
        parts.append(f"{never} are not distinguishable from zero in any, and agree in that")
    said = [
        f"{len(result.labels)} identifications of {result.robot}, {common} parameters in common: "
        f"{', '.join(parts)} (5 %, Holm)."
    ]
    changed = []
    for p in sorted(result.having("drift", "differ"), key=lambda p: p.p_holm or 0.0)[:3]:
        values = " -> ".join("-" if math.isnan(s) else f"{v:.3g}" for v, s in _pairs(p))
        changed.append(f"{p.name} {values} {p.unit}")
    if changed:
        said.append(f"Most significant: {'; '.join(changed)}.")
    if result.whole is not None:
        said.append(_scatter(result))
    if result.torque is not None:
        said.append(torque_sentence(result.torque, result.labels))
    return " ".join(said)


def _scatter(result: Comparison) -> str:
    """How far the standard deviations can be trusted."""
    whole, pooled, typical = result.whole, result.birge.pooled, result.birge.typical
    assert whole is not None
    assert pooled is not None
    assert typical is not None
    low, _, high = result.birge.pooled_expected or (0.0, 0.0, 0.0)
    if pooled <= high and whole.p >= 0.05:
        meaning = ": the standard deviations can be trusted from run to run."
        if result.same_motion:
            meaning = (
                ": no contradiction, but fitted on the same trajectory they say nothing about the "
                "standard deviations from run to run."
            )
        elif pooled < low:
            meaning = (
                ": they agree better than chance allows, so they share data, or their standard "
                "deviations are too large."
            )
    elif typical > NOTABLE:
        meaning = (
            f". The typical parameter does so {typical:.2g} times: if nothing about the arm "
            f"changed, its standard deviations are too small by a factor {pooled:.2g}; the "
            "consensus accounts for it."
        )
    elif pooled <= high:
        meaning = (
            ". What differs shows in combinations of parameters more than in single ones: look at "
            "the torque."
        )
    else:
        meaning = (
            f", but the typical parameter only {typical:.2g} times: some parameters changed, or "
            "their standard deviations are too small, not those of all."
        )
    return (
        f"The results scatter {pooled:.2g} times as much as their standard deviations claim "
        f"(by chance {low:.2g} to {high:.2g}); all together, correlations included, the "
        f"chi-square is {whole.q:.0f} where {whole.expected[0]:.0f} to {whole.expected[2]:.0f} is "
        f"expected (p = {whole.p:.2g}){meaning}"
    )


def torque_sentence(t: TorqueSpread, labels: Sequence[str]) -> str:
    """Where models differ most in torque."""
    share = t.spread / t.size.clamp(min=1e-12)
    joint = int(share.argmax())
    largest = int(t.spread.argmax())
    out = (
        f"In torque, on {t.source}, the models differ by {float(t.spread[joint]):.2g} on joint "
        f"{joint + 1}, {100 * float(share[joint]):.2g} % of its torque, the most of all joints"
    )
    if largest != joint:
        out += f", and by {float(t.spread[largest]):.2g} on joint {largest + 1}"
    if t.claimed is not None and float(t.claimed.norm()) > 0:
        ratio = float(t.spread.norm() / t.claimed.norm())
        out += f"; that is {ratio:.2g} times what their covariances claim"
    if t.errors is not None:
        best = int(t.errors.square().sum(1).argmin())
        out += f". On its measured torque {labels[best]} is the closest"
    return out + "."


def tables(result: Comparison) -> list[Table | None]:
    """Parameters, then torque."""
    wide = len(result.labels) <= MOST_COLUMNS
    rows: list[list[Cell]] = []
    for kind in ORDER:
        of_kind = result.having(kind)
        if of_kind:
            rows.append([Text(WORDS[kind], "bold")])
        for p in of_kind:
            name = f"  {short(p.name, LONGEST - len(p.unit))} [{p.unit}]"
            texts = [
                "held at 0" if held else "-" if math.isnan(s) else f"{v:.3g} ± {s:.2g}"
                for (v, s), held in zip(_pairs(p), p.held.tolist(), strict=True)
            ]
            if not wide:
                values = zip(_pairs(p), texts, strict=True)
                known = sorted((v, c) for (v, s), c in values if not math.isnan(s))
                texts = [known[0][1], known[-1][1]] if known else ["-", "-"]
            consensus = ["", "", ""]
            if p.p_holm is not None:
                mean = f"{p.consensus:.3g} ± {p.consensus_std:.2g}"
                consensus = [mean, f"{p.birge:.2f}", f"{p.p_holm:.2g}"]
            rows.append([name, *texts, *consensus])
        rows.append([])
    labels = result.labels if wide else ("lowest", "highest")
    title = "parameters (value ± std; scatter in claimed std; p after Holm)"
    columns = ("parameter", *labels, "consensus", "scatter", "p")
    return [Table(title, columns, rows, "l"), torque_table(result.torque, result.labels)]


def _pairs(p: ComparedParameter) -> list[tuple[float, float]]:
    return list(zip(p.values.tolist(), p.std.tolist(), strict=True))


def torque_table(t: TorqueSpread | None, labels: Sequence[str]) -> Table | None:
    """Torque, where it was compared: joints as columns."""
    if t is None:
        return None
    rows = [("torque", t.size), ("std between models", t.spread)]
    if t.claimed is not None:
        rows.append(("std their covariances claim", t.claimed))
    rows += [
        (f"{labels[a]} - {labels[b]}", t.pairs[a, b])
        for a in range(len(labels))
        for b in range(a + 1, len(labels))
        if len(labels) <= MOST_COLUMNS
    ]
    if t.errors is not None:
        rows += [(f"measured - {label}", e) for label, e in zip(labels, t.errors, strict=True)]
    title = f"torque on {t.source}, RMS per joint [N m; N]"
    texts = [(name, *cells(values)) for name, values in rows]
    return Table(title, ("", *joint_numbers(len(t.size))), texts, "p")


def set_verdict(result: SetComparison) -> str:
    """What the sets agree on, in sentences."""
    named = zip(result.counts, result.labels, strict=True)
    total = ", ".join(f"{count(k, 'set')} ({name})" for k, name in named)
    parts = []
    for what, ranges in (("physical", result.physical), ("base", result.base)):
        of = {v: sum(r.verdict == v for r in ranges) for v in ORDER}
        text = f"of {len(ranges)} {what} parameters the ranges of {of['agree']} overlap"
        if of["differ"] + of["drift"]:
            text += f", of {of['differ'] + of['drift']} they do not"
        if of["drift"]:
            text += f" ({of['drift']} in the order given)"
        if of["never_determined"]:
            text += f", and {of['never_determined']} are open to ±50 % or more in every file"
        parts.append(text)
    return (
        f"{result.robot}, {total}: {'; '.join(parts)}. "
        + torque_sentence(result.torque, result.labels)
    )  # fmt: skip


def set_tables(result: SetComparison) -> list[Table | None]:
    """Ranges of physical and of base parameters, and torque."""
    out = []
    for what, ranges in (("physical", result.physical), ("base", result.base)):
        rows: list[list[Cell]] = []
        for kind in ORDER:
            for r in (r for r in ranges if r.verdict == kind):
                bounds = zip(r.low.tolist(), r.high.tolist(), strict=True)
                texts = [f"{a:.4g}" if a == b else f"{a:.4g} .. {b:.4g}" for a, b in bounds]
                rows.append([r.name, *texts, r.unit, WORDS[r.verdict]])
            rows.append([])
        title = f"{what} parameters, lowest .. highest"
        columns = ("parameter", *result.labels, "unit", "verdict")
        out.append(Table(title, columns, rows, f"p{'r' * len(result.labels)}ll"))
    return [*out, torque_table(result.torque, result.labels)]


def gap_verdict(result: GapComparison) -> str:
    """Which effects all diagnoses share, in sentences."""
    everywhere = [s for s in result.shared if s.everywhere]
    elsewhere = [s for s in result.shared if not s.everywhere]
    out = [f"{len(result.labels)} diagnoses of {result.robot}:"]
    if not result.shared:
        return out[0] + " none names an effect."
    if everywhere:
        out.append("all name " + ", ".join(_name(s) for s in everywhere) + ".")
    else:
        out.append("no effect is named in all.")
    if elsewhere:
        some = []
        for s in elsewhere:
            hidden = sum(state == "not_testable" for state in s.states)
            lost = sum(state == "not_found" for state in s.states)
            why = [f"{lost} did not find it"] * bool(lost)
            why += [f"{hidden} could not test it"] * bool(hidden)
            some.append(f"{_name(s)} ({'; '.join(why)})")
        out.append("Only some name " + ", ".join(some) + ".")
    changed = [c for s in result.shared for c in s.coefficients if c.p_holm < ALPHA]
    known = sum(len(s.coefficients) for s in result.shared)
    if known:
        words = f"{known - len(changed)} agree, {len(changed)} do not"
        out.append(f"Of the coefficients named twice or more, {words} (5 %, Holm).")
    if result.torque is not None:
        out.append(
            torque_sentence(result.torque, result.labels).replace("models", "corrected models")
        )
    return " ".join(out)


def _name(s: Shared) -> str:
    names = " or ".join(s.effects)
    if not s.place:
        return names
    word = "link" if s.effects == ("link_inertia",) else "joint"
    return f"{names} on {word} {', '.join(str(j) for j in s.place)}"


def gap_tables(result: GapComparison) -> list[Table | None]:
    """Diagnoses, effects with coefficients, torque."""
    labels = []
    for label, status, closed in zip(result.labels, result.statuses, result.closed, strict=True):
        share = "" if closed is None else f", {100 * closed:.0f} % closed"
        labels.append(f"{label}\n{status}{share}")
    rows: list[list[str]] = []
    for s in result.shared:
        rows.append([_name(s), "", *(_state(s, k) for k in range(len(s.states))), "", ""])
        for c in s.coefficients:
            texts = [
                "" if value is None else f"{value:.4g} ± {std:.2g} {unit_behind(c.unit)}".rstrip()
                for value, std in zip(c.values, c.std, strict=True)
            ]
            rows.append(["", c.name, *texts, f"{c.birge:.2f}", f"{c.p_holm:.2g}"])
        # Coefficients that no other diagnosis gives with a standard deviation, then shapes.
        alike = [c.name for c in s.coefficients]
        named = [n for n in s.named if n is not None]
        others = [k for n in named for k in n.values if k not in alike]
        for name in dict.fromkeys([*others, *(k for n in named for k in n.shapes)]):
            rows.append(["", name, *(_size(n, name) for n in s.named), "", ""])
        rows.append([])
    columns = ("effect", "", *labels, "scatter", "p (Holm)")
    effects = Table("effects (coefficient ± std)", columns, rows, "pp")
    return [effects, torque_table(result.torque, result.labels)]


def _state(s: Shared, k: int) -> str:
    entry, smallest = s.named[k], s.smallest[k]
    if entry is not None:
        also = f" (or {', '.join(entry.also)})" if entry.also else ""
        return ("named" if len(s.effects) == 1 else entry.effect) + also
    if s.states[k] == "not_testable":
        return "not testable" + ("" if smallest is None else f" below {smallest:.2g}")
    return "not found"


def _size(n: Named | None, name: str) -> str:
    value = None if n is None else {**n.shapes, **n.values}.get(name)
    if n is None or value is None:
        return ""
    std = f" ± {n.std[name]:.2g}" if name in n.std else ""
    return f"{value:.4g}{std} {unit_behind(n.units.get(name, '1'))}".rstrip()


COLOURS = (BLUE, ORANGE, GREEN, RED, PURPLE, TEAL, GREY, INK)
SHADES = {"drift": RED, "differ": ORANGE, "never_determined": GREY}
CLIP = 10.0
"""Claimed standard deviations beyond which a value is drawn at the edge."""


def figures(result: Comparison | GapComparison | SetComparison) -> Figures:
    """The forest of identifications; tables say the rest."""
    if isinstance(result, Comparison) and result.having(*ORDER[:4]):
        return {"parameters": partial(forest_figure, result)}
    return {}


def forest_figure(result: Comparison) -> Figure:
    """95 % intervals of every result about the consensus, in the geometric mean of the claimed
    standard deviations; the consensus' own interval is the grey bar."""
    shown = [p for kind in ORDER[:4] for p in result.having(kind)]
    m = len(result.labels)
    quantiles = result.quantiles or [HALF_95] * m
    figure, axes = panel(10, 1.6 + (0.2 + 0.05 * m) * len(shown))
    for row, p in enumerate(shown):
        assert p.consensus is not None
        assert isinstance(p.consensus_ci95, tuple)
        known = p.std[~p.std.isnan()]
        unit = max(float(known.clamp(min=1e-300).log().mean().exp()), 1e-300)
        half = (p.consensus_ci95[1] - p.consensus) / unit
        axes.barh(row, 2 * half, left=-half, height=0.8, color=GREY, alpha=0.22, linewidth=0)
        for k, (value, std) in enumerate(zip(p.values.tolist(), p.std.tolist(), strict=True)):
            if math.isnan(std):
                continue
            x = (value - p.consensus) / unit
            y = row + 0.6 * ((k + 0.5) / m - 0.5)
            wide = quantiles[k] * std / unit
            axes.plot([x - wide, x + wide], [y, y], color=_colour(k), linewidth=1.1)
            marker = "o" if abs(x) <= CLIP else ("<" if x < 0 else ">")
            axes.plot(max(-CLIP, min(CLIP, x)), y, marker, color=_colour(k), markersize=3.2)
    axes.axvline(0, color=GREY, linewidth=0.8)
    axes.set_xlim(-CLIP - 0.5, CLIP + 0.5)
    rows_of(axes, [short(p.name, 44) for p in shown])
    axes.set_xlabel(
        "value - consensus, in the geometric mean of the claimed standard deviations (bars: 95 %)\n"
        "red: drifts, orange: differs, black: agrees, grey: never determined; "
        "triangles lie beyond the edge"
    )
    for name, p in zip(axes.get_yticklabels(), shown, strict=True):
        name.set_color(SHADES.get(p.verdict, INK))
    styles = ({"color": _colour(k), "marker": "o", "markersize": 4} for k in range(m))
    keys = dict(zip(result.labels, styles, strict=True))
    return finish(figure, f"{result.robot}: do {m} identifications agree?", keys=keys)


def _colour(k: int) -> str:
    return COLOURS[k % len(COLOURS)]
