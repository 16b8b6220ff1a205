"""A comparison of identifications, or of sets, for people: the verdict in sentences, and tables."""

import math
from collections.abc import Sequence

from rich.table import Table

from torchid.compare.identifications import Compared, Comparison, Verdict
from torchid.compare.sets import Range, SetComparison
from torchid.compare.torque import TorqueSpread
from torchid.report.identification import compact

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


def verdict(result: Comparison) -> str:
    """What agrees, in sentences."""
    compared = result.having("agree", "drift", "differ", "never_determined")
    if not compared:
        return "No parameter is estimated in two results: nothing can be compared."
    said = [_counts(result, len(compared))]
    changed = result.having("drift", "differ")
    if changed:
        worst = sorted(changed, key=lambda p: p.p_holm or 0.0)[:3]
        said.append("Most significant: " + "; ".join(_change(p) for p in worst) + ".")
    if result.whole is not None:
        said.append(_scatter(result))
    if result.torque is not None:
        said.append(torque_sentence(result.torque, result.labels))
    return " ".join(said)


def _counts(result: Comparison, count: int) -> str:
    agree, drift, differ, never = (
        len(result.having(v)) for v in ("agree", "drift", "differ", "never_determined")
    )
    out = f"{len(result.labels)} identifications of {result.robot}, {count} parameters in common: "
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
        parts.append(f"{never} cannot be told from zero in any, and agree in that")
    return out + ", ".join(parts) + " (5 %, Holm)."


def _change(p: Compared) -> str:
    values = " -> ".join("-" if math.isnan(s) else f"{v:.3g}" for v, s in _pairs(p))
    return f"{p.name} {values} {p.unit}"


def _scatter(result: Comparison) -> str:
    """How far the standard deviations can be trusted."""
    whole, typical = result.whole, result.birge
    assert whole is not None
    assert typical is not None
    low, _, high = whole.pooled_expected
    claim = (
        f"The results scatter {whole.pooled:.2g} times as much as their standard deviations claim "
        f"(by chance {low:.2g} to {high:.2g})"
    )
    together = (
        f"; all together, correlations included, the chi-square is {whole.q:.0f} where "
        f"{whole.expected[0]:.0f} to {whole.expected[2]:.0f} is expected (p = {whole.p:.2g})"
    )
    if whole.pooled <= high and whole.p >= 0.05:
        if result.same_motion:
            return (
                claim
                + together
                + (
                    ": no contradiction, but fitted on the same trajectory they say nothing "
                    "about the standard deviations from run to run."
                )
            )
        if whole.pooled < low:
            return (
                claim
                + together
                + (
                    ": they agree better than chance allows, so they share data, or their standard "
                    "deviations are too large."
                )
            )
        return claim + together + ": the standard deviations can be trusted from run to run."
    if typical > NOTABLE:
        return (
            claim + together + f". The typical parameter does so {typical:.2g} times: if nothing "
            f"about the arm changed, its standard deviations are too small by a factor "
            f"{whole.pooled:.2g}; the consensus accounts for it."
        )
    if whole.pooled <= high:
        return (
            claim + together + ". What differs shows in combinations of parameters more than in "
            "single ones: look at the torque."
        )
    return (
        claim + together + f", but the typical parameter only {typical:.2g} times: some parameters "
        "changed, or their standard deviations are too small, not those of all."
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


def tables(result: Comparison) -> list[Table]:
    """Parameters, then torque."""
    out = [_parameter_table(result)]
    if result.torque is not None:
        out.append(torque_table(result.torque, result.labels))
    return out


def _parameter_table(result: Comparison) -> Table:
    table = compact("parameters (value ± std; scatter in claimed std; p after Holm)")
    table.add_column("parameter", no_wrap=True)
    wide = len(result.labels) <= MOST_COLUMNS
    for label in result.labels if wide else ("lowest", "highest"):
        table.add_column(label, justify="right", no_wrap=True, overflow="ellipsis")
    for heading in ("consensus", "scatter", "p"):
        table.add_column(heading, justify="right", no_wrap=True)
    for kind in ORDER:
        of_kind = result.having(kind)
        if of_kind:
            table.add_row(f"[bold]{WORDS[kind]}[/]")
        for p in of_kind:
            name = f"  {short(p.name, LONGEST - len(p.unit))} \\[{p.unit}]"
            table.add_row(name, *_cells(p, wide), *_consensus(p))
        table.add_section()
    return table


def short(name: str, length: int = LONGEST) -> str:
    """A name cut to `length` characters."""
    return name if len(name) <= length else name[: length - 1] + "…"


def _cells(p: Compared, wide: bool) -> list[str]:
    cells = [
        "held at 0" if held else "-" if math.isnan(s) else f"{v:.3g} ± {s:.2g}"
        for (v, s), held in zip(_pairs(p), p.held.tolist(), strict=True)
    ]
    if wide:
        return cells
    known = sorted((v, c) for (v, s), c in zip(_pairs(p), cells, strict=True) if not math.isnan(s))
    return [known[0][1], known[-1][1]] if known else ["-", "-"]


def _pairs(p: Compared) -> list[tuple[float, float]]:
    return list(zip(p.values.tolist(), p.std.tolist(), strict=True))


def _consensus(p: Compared) -> list[str]:
    s = p.scatter
    if s is None or p.p_holm is None:
        return ["", "", ""]
    return [f"{s.consensus:.3g} ± {s.std:.2g}", f"{s.birge:.2f}", f"{p.p_holm:.2g}"]


def torque_table(t: TorqueSpread, labels: Sequence[str]) -> Table:
    """Joints as columns."""
    table = compact(f"torque on {t.source}, RMS per joint [N m; N]")
    table.add_column("")
    for j in range(len(t.size)):
        table.add_column(str(j + 1), justify="right", no_wrap=True)
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
    for name, values in rows:
        table.add_row(name, *(f"{v:.3g}" for v in values.tolist()))
    return table


def set_verdict(result: SetComparison) -> str:
    """What the sets agree on, in sentences."""
    total = ", ".join(
        f"{k} set{'s' * (k != 1)} ({name})"
        for k, name in zip(result.counts, result.labels, strict=True)
    )
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


def set_tables(result: SetComparison) -> list[Table]:
    """Ranges of physical and of base parameters, and torque."""
    out = [
        _range_table(title, ranges, result.labels)
        for title, ranges in (
            ("physical parameters, lowest .. highest", result.physical),
            ("base parameters, lowest .. highest", result.base),
        )
    ]
    return [*out, torque_table(result.torque, result.labels)]


def _range_table(title: str, ranges: Sequence[Range], labels: Sequence[str]) -> Table:
    table = compact(title)
    table.add_column("parameter", overflow="fold", ratio=1)
    for label in labels:
        table.add_column(label, justify="right", overflow="fold")
    table.add_column("unit")
    table.add_column("verdict", no_wrap=True)
    for kind in ORDER:
        for r in (r for r in ranges if r.verdict == kind):
            bounds = zip(r.low.tolist(), r.high.tolist(), strict=True)
            cells = [f"{a:.4g}" if a == b else f"{a:.4g} .. {b:.4g}" for a, b in bounds]
            table.add_row(r.name, *cells, r.unit, WORDS[r.verdict])
        table.add_section()
    return table
