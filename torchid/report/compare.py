"""A comparison for people: the verdict, one table of coefficients, torque per joint, and a forest
of intervals."""

import math
from collections.abc import Sequence
from functools import partial
from statistics import median
from typing import get_args

from msgspec import UNSET

from torchid.fleet.comparison import (
    ComparedCause,
    ComparedParameter,
    Comparison,
    PositionErrors,
    TorqueSpread,
    Verdict,
)
from torchid.log.table import natural
from torchid.report.colours import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, RED, TEAL
from torchid.report.panels import Figure, finish, panel, rows_of
from torchid.report.table import Report, Table, cell, cells, joint_table, table_of
from torchid.results.words import count, effect_words, listed, short, unit_behind
from torchid.statistics.proportion import HALF_95
from torchid.typing import Tensor

NOTES = {
    "identifications": "A value without ± was held there by the fit",
    "gap diagnoses": "A value without ± is a shape that was not fitted",
    "position diagnoses": "A value without ± was given, or is of an older file",
    "parameter sets": "± is the spread of a file's sets: how far they leave a value open",
}
"""What ± is, or is missing of."""

MOST_COLUMNS = 3
"""Results whose values all fit into the table."""


def report_of_comparison(result: Comparison) -> Report:
    """All that there is to see of a comparison."""
    parts = [of(result) for of in (cause_table, parameter_table, torque_table, position_table)]
    drawn = partial(forest_figure, result)
    return Report(
        verdict=verdict(result), parts=parts, warnings=result.notes, figures={"parameters": drawn}
    )


def verdict(result: Comparison) -> str:
    """What agrees, in sentences."""
    said = [f"{len(result.labels)} {result.kind} of {result.robot}."]
    every = [c.label for c in result.causes if set(c.states) == {"named"}]
    unseen, rest = " (not testable in all)", [c for c in result.causes if c.label not in every]
    some = [c.label + unseen * ("not_testable" in c.states) for c in rest]
    if result.kind.endswith("diagnoses"):
        said.append(f"All name {_places(every)}." if every else "No effect is named in all.")
        said += [f"Only some name {_places(some)}."] if some else []
    differ = sorted(result.having("differ"), key=lambda p: p.p)
    agree, open_ = (len(result.having(v)) for v in ("agree", "never_determined"))
    if differ or agree or open_:
        parts = [f"{agree} agree", f"{len(differ)} differ{'s' * (len(differ) == 1)}"]
        parts += [f"{open_} may be zero in all"] if open_ else []
        said.append(f"Of the coefficients in common {listed(parts)}.")
    elif not result.kind.endswith("diagnoses"):
        said.append("No coefficient has a standard deviation in two results: none is tested.")
    if differ:
        named = [
            f"{p.name} {' -> '.join(cells(p.own))} {unit_behind(p.unit)}".rstrip()
            for p in differ[:3]
        ]
        said.append(f"Most significant: {'; '.join(named)}.")
    if len(differ) > agree + open_:
        said.append(
            "Most differ: if nothing about the arm changed, the standard deviations of single "
            "results are too small, and the spread tells how sure a coefficient is."
        )
    if result.kind == "position diagnoses" and (differ or agree):
        said.append(spread_sentence(differ + result.having("agree")))
    if result.torque is not None:
        said.append(torque_sentence(result.torque, result))
    if result.positions is not UNSET:
        said.append(position_sentence(result.positions, result))
    return " ".join(said)


def _places(labels: Sequence[str]) -> str:
    """Causes with the joints that they are on: `viscous friction of joints 2 and 3`."""
    each: dict[str, list[str]] = {}
    for label in labels:
        name, _, joint = label.partition(" of joint ")
        words = " or ".join(map(effect_words, name.split(" or ")))
        each.setdefault(words, []).append(joint)
    return listed(
        f"{words} of joint{'s' * (len(joints) > 1)} {listed(sorted(joints, key=natural))}"
        if joints[0]
        else words
        for words, joints in each.items()
    )


def spread_sentence(compared: Sequence[ComparedParameter]) -> str:
    """How far values are apart beside what each result states."""
    ratios = []
    for p in compared:
        own = p.own[p.own_std.isfinite()]
        stated = p.own_std[p.own_std.isfinite()].square().mean().sqrt()
        ratios.append(float(own.std() / stated.clamp(min=1e-300)))
    return (
        f"From result to result values spread {median(ratios):.2g} times as far as their standard "
        "deviations state, in the median."
    )


def position_sentence(errors: PositionErrors, result: Comparison) -> str:
    """Whose servos go nearest to where the arm went."""
    means = errors.whole.nanmean(1)
    each = ", ".join(f"{x:.3g}" for x in means.tolist())
    return (
        f"On {errors.source} {result.labels[int(means.argmin())]} is the closest "
        f"({each} {errors.unit}, mean of the joints)."
    )


def torque_sentence(t: TorqueSpread, result: Comparison) -> str:
    """Where models differ most in torque."""
    share = t.spread / t.size.clamp(min=1e-12)
    joint, largest = int(share.argmax()), int(t.spread.argmax())
    corrected = "corrected " * (result.kind == "gap diagnoses")
    out = (
        f"In torque, on {t.source}, the {corrected}models differ by {float(t.spread[joint]):.2g} "
        f"on joint {joint + 1}, {100 * float(share[joint]):.2g} % of its torque, the most of all "
        "joints"
    )
    if largest != joint:
        out += f", and by {float(t.spread[largest]):.2g} on joint {largest + 1}"
    if t.claimed is not None and float(t.claimed.norm()) > 0:
        ratio = float(t.spread.norm() / t.claimed.norm())
        out += f"; that is {ratio:.2g} times what their covariances claim"
    if t.errors is not None:
        best = int(t.errors.square().sum(1).argmin())
        out += f". On its measured torque {result.labels[best]} is the closest"
    return out + "."


def cause_table(result: Comparison) -> Table:
    """What each diagnosis says of every cause."""

    def state(cause: ComparedCause, k: int) -> str:
        least = cause.smallest[k]
        return cause.states[k].replace("_", " ") + (f" below {least:.2g}" if least else "")

    if len(result.labels) <= MOST_COLUMNS:
        said = {
            label: [state(c, k) for c in result.causes] for k, label in enumerate(result.labels)
        }
    else:
        said = {"named by": [str(c.states.count("named")) for c in result.causes]}
    return table_of(f"{result.robot}: causes", result.causes, beside=said)


def parameter_table(result: Comparison) -> Table:
    """Every coefficient: what is said of it, or its cause, and its values."""
    order = list(get_args(Verdict))
    of_causes = result.kind == "gap diagnoses" and bool(result.causes)
    rows = (
        result.parameters
        if of_causes
        else sorted(result.parameters, key=lambda p: order.index(p.verdict))
    )
    pairs = [list(zip(p.own.tolist(), p.own_std.tolist(), strict=True)) for p in rows]
    heads = [f"{name}\n{said}" for name, said in zip(result.labels, result.about, strict=True)]
    if len(heads) > MOST_COLUMNS:
        heads = ["lowest", "highest"]
        known = [sorted(x for x in own if not math.isnan(x[0])) or own for own in pairs]
        pairs = [[own[0], own[-1]] for own in known]
    values = [
        [cell(x, ".4g") if math.isnan(std) else f"{x:.3g} ± {std:.1g}" for x, std in column]
        for column in zip(*pairs, strict=True)
    ]
    return table_of(
        f"{result.robot}: value ± std",
        rows,
        f"name {'cause' if of_causes else 'verdict'} mean between p",
        f"{NOTES[result.kind]}. Mean, and spread from result to result: as of units of one type "
        "(random effects). p: of the test that all are equal; 5 % of those that differ are "
        "expected to be false (Benjamini and Hochberg).",
        beside=dict(zip(heads, values, strict=False)),
    )


def torque_table(result: Comparison) -> Table | None:
    """Torque, where it was compared: joints as columns."""
    t = result.torque
    if t is None:
        return None
    rows: list[tuple[str, Tensor]] = [("torque", t.size), ("std between models", t.spread)]
    if t.claimed is not None:
        rows.append(("std their covariances claim", t.claimed))
    if t.errors is not None:
        names = (f"measured - {label}" for label in result.labels)
        rows += zip(names, t.errors, strict=True)
    return joint_table(f"torque on {t.source}, RMS per joint [N m; N]", rows)


def position_table(result: Comparison) -> Table | None:
    """Position errors along a log, where they were asked for: joints as columns."""
    if result.positions is UNSET:
        return None
    own = result.positions
    names = (f"{label}, {part}" for part in ("whole", "2 s") for label in result.labels)
    rows = zip(names, (*own.whole, *own.windows), strict=True)
    return joint_table(f"position errors on {own.source}, RMS per joint [{own.unit}]", rows)


COLOURS = (BLUE, ORANGE, GREEN, RED, PURPLE, TEAL, GREY, INK)
SHADES = {"differ": RED, "never_determined": GREY}


def forest_figure(result: Comparison) -> Figure | None:
    """95 % intervals of every result about the mean, in the geometric mean of the standard
    deviations; the spread between results is the grey bar."""
    drawn = [p for v in ("differ", "agree", "never_determined") for p in result.having(v)]
    if not drawn:
        return None
    m = len(result.labels)
    figure, axes = panel(10, 1.6 + (0.2 + 0.05 * m) * len(drawn))
    # Standard deviations beyond which a value is drawn at the edge
    clip = 10.0
    for row, p in enumerate(drawn):
        known = p.own_std[~p.own_std.isnan()]
        unit = max(float(known.clamp(min=1e-300).log().mean().exp()), 1e-300)
        half = HALF_95 * p.between / unit
        axes.barh(row, 2 * half, left=-half, height=0.8, color=GREY, alpha=0.22, linewidth=0)
        for k, (value, std) in enumerate(zip(p.own.tolist(), p.own_std.tolist(), strict=True)):
            if math.isnan(std):
                continue
            x, y = (value - p.mean) / unit, row + 0.6 * ((k + 0.5) / m - 0.5)
            wide, colour = HALF_95 * std / unit, COLOURS[k % len(COLOURS)]
            axes.plot([x - wide, x + wide], [y, y], color=colour, linewidth=1.1)
            marker = "o" if abs(x) <= clip else ("<" if x < 0 else ">")
            axes.plot(max(-clip, min(clip, x)), y, marker, color=colour, markersize=3.2)
    axes.axvline(0, color=GREY, linewidth=0.8)
    axes.set_xlim(-clip - 0.5, clip + 0.5)
    rows_of(axes, [short(", ".join(filter(None, (p.name, p.cause))), 44) for p in drawn])
    axes.set_xlabel(
        "value - mean, in the geometric mean of the standard deviations (lines: 95 %; grey: spread "
        "of the results)\nred: differs, black: agrees, grey: never determined; triangles lie "
        "beyond the edge"
    )
    for name, p in zip(axes.get_yticklabels(), drawn, strict=True):
        name.set_color(SHADES.get(p.verdict, INK))
    styles = (
        {"color": COLOURS[k % len(COLOURS)], "marker": "o", "markersize": 4} for k in range(m)
    )
    keys = dict(zip(result.labels, styles, strict=True))
    return finish(figure, f"{result.robot}: do {count(m, 'result')} agree?", keys=keys)
