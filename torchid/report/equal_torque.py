"""Sets with equal torque and their internal forces, as tables and sentences for people."""

import math

import torch
from rich.table import Table

from torchid.report.identification import compact
from torchid.study.equal_torque_statistics import Across
from torchid.study.equal_torque_study import EqualTorqueStudy
from torchid.wrenches.classes import KINDS as CLASS_NAMES
from torchid.wrenches.compare import EffectSize
from torchid.wrenches.resampling import Estimate

_AGAINST_EACH_OTHER = ("CoM only", "inertia only")
_WORDS = {"inertia": "inertia", "com": "centres of mass"}


def tables(study: EqualTorqueStudy) -> list[Table]:
    """Errors by kind, their differences, the degree, what any set can do, other assumptions."""
    made = [kind_table(study), effect_table(study), degree_table(study), third_table(study)]
    if study.reach:
        made.append(reach_table(study))
    made += [truth_table(study), firm_table(study)]
    if study.variants:
        made.append(variant_table(study))
    return made


def findings(study: EqualTorqueStudy) -> list[str]:
    """What the numbers say, a sentence each; `cannot tell` where an interval says so."""
    _, low, high = study.static_share
    told = [
        f"The torque is equal: the largest difference of any set at any joint is "
        f"{float(study.torque_relative.max()):.0e} of that joint's torque.",
        f"The force error is the weight of the carried mass's error to {_percent(low, high)}: what "
        "counts is how far the masses are off, whatever the reason for which a set is infeasible.",
    ]
    told += [_effect_sentence(e) for e in study.comparison.effects if _of_interest(e)]
    for c in study.statistics.correlations:
        if c.kind in ("feasible", "inertia", "com"):
            told.append(_degree_sentence(c.kind, c.degree))
    told += [_across_sentence(a) for a in study.statistics.across if a.kind in ("inertia", "com")]
    told += _reach_sentences(study)
    return told


def kind_table(study: EqualTorqueStudy) -> Table:
    """Force errors by kind: quartiles of the largest over the joints, medians per joint."""
    n = study.setting.robot.n
    table = compact(
        f"{study.setting.robot.name}: force error against the {_reference(study)} [N], RMS over "
        "the motion"
    )
    for heading in ("kind", "sets", "chains", "degree", "largest joint: median (quartiles)"):
        table.add_column(heading, justify="left" if heading == "kind" else "right", no_wrap=True)
    for joint in range(n):
        table.add_column(f"j{joint + 1}", justify="right")
    for kind in study.kinds:
        rows = study.rows(kind)
        low, middle, high = (float(study.worst[rows].quantile(p)) for p in (0.25, 0.5, 0.75))
        degree = study.checked.degree[rows]
        chains = len(set(study.family.cluster[rows].tolist()))
        table.add_row(
            label(kind), str(len(rows)), str(chains),
            f"{float(degree.min()):.2g} .. {float(degree.max()):.2g}",
            f"{middle:.3g} ({low:.3g} - {high:.3g})",
            *(f"{v:.3g}" for v in study.errors.force_rms[rows].median(0).values.tolist()),
        )  # fmt: skip
    own = study.errors.reference_force_rms.tolist()
    table.add_row("the force itself", "", "", "", f"{max(own):.3g}", *(f"{v:.3g}" for v in own))
    return table


def effect_table(study: EqualTorqueStudy) -> Table:
    """Differences of the classes, with 95 % intervals."""
    table = compact("differences of the classes (95 % intervals from whole chains)")
    for heading in (
        "class",
        "against",
        "times the error",
        "Cliff's delta",
        "at equal carried mass",
    ):
        table.add_column(heading, no_wrap=heading != "against")
    matched = {_class(m.kind): m for m in study.statistics.matched}
    for e in study.comparison.effects:
        own = matched.get(e.first) if e.second == "feasible" else None
        same = "" if own is None else f"{interval(own.delta)}, {100 * own.share:.0f} % matched"
        table.add_row(e.first, e.second, interval(e.ratio), interval(e.delta), same)
    return table


def degree_table(study: EqualTorqueStudy) -> Table:
    """Rank correlations of the error."""
    table = compact("Spearman's rho of the force error with ... (95 % intervals)")
    for heading in ("sets", "degree", "coordinates out of box", "carried mass's error"):
        table.add_column(heading, no_wrap=True)
    for c in study.statistics.correlations:
        table.add_row(
            label(c.kind), interval(c.degree), interval(c.coordinates), f"{c.carried.value:.4f}"
        )
    return table


def third_table(study: EqualTorqueStudy) -> Table:
    """Slight and gross violations, barely and firmly feasible sets."""
    table = compact("by thirds of the degree, against the feasible sets nearest the boundary")
    for heading in ("sets", "third", "degree", "median [N]", "times the error"):
        table.add_column(heading, no_wrap=True)
    for t in study.statistics.thirds:
        low, high = t.degree
        ratio = "1" if (t.kind, t.third[0]) == ("feasible", "n") else interval(t.ratio)
        table.add_row(label(t.kind), t.third, f"{low:.2g} .. {high:.2g}", f"{t.median:.3g}", ratio)
    for a in study.statistics.across:
        if min(a.sets) > 0:
            table.add_row(
                f"just {label(a.kind)}", "vs just feasible", f"{a.sets[0]} and {a.sets[1]} sets",
                f"{a.medians[0]:.3g}, {a.medians[1]:.3g}", interval(a.ratio),
            )  # fmt: skip
    return table


def reach_table(study: EqualTorqueStudy) -> Table:
    """The greatest force error of any set, per joint."""
    table = compact("greatest force error of any set with this torque [N] (reached - bound)")
    table.add_column("what may be violated", no_wrap=True)
    for joint in range(study.setting.robot.n):
        table.add_column(f"j{joint + 1}", justify="right")
    for r in study.reach:
        both = zip(r.reached.tolist(), r.bound.tolist(), strict=True)
        name = "nothing (feasible)" if r.kind == "feasible" else label(r.kind)
        table.add_row(name, *(_bracket(low, high) for low, high in both))
    return table


def truth_table(study: EqualTorqueStudy) -> Table:
    """If another feasible set were the arm."""
    table = compact("each feasible set as the true arm (median and 95 % range over them)")
    for heading in ("kind", "times the feasible sets' error", "nearer to it than a feasible set"):
        table.add_column(heading, no_wrap=True)
    for t in study.truths:
        ratio = f"{t.ratio[0]:.2f} ({t.ratio[1]:.2f} - {t.ratio[2]:.2f})"
        better, low, high = (100 * b for b in t.better)
        table.add_row(label(t.kind), ratio, f"{better:.0f} % ({low:.0f} - {high:.0f})")
    return table


def firm_table(study: EqualTorqueStudy) -> Table:
    """Are firmer sets better? That depends on how firm the truth is."""
    table = compact("rho of degree and error among feasible sets, by how firm the true one is")
    for heading in ("the true set's degree", "rho: median and 95 % range"):
        table.add_column(heading, no_wrap=True)
    for f in study.firm_truths:
        table.add_row(f"third {f.third}", f"{f.rho[0]:.2f} ({f.rho[1]:.2f} .. {f.rho[2]:.2f})")
    return table


def variant_table(study: EqualTorqueStudy) -> Table:
    """Medians and greatest errors under other assumptions."""
    table = compact("other outer bounds: median of the largest force error [N] (greatest of any)")
    table.add_column("assumption")
    shown = [k for k in study.kinds if k != "total_mass"]
    for kind in shown:
        table.add_column(label(kind), justify="right", no_wrap=True)
    table.add_column("rho with degree", no_wrap=True)
    rho = study.comparison.correlation.rho
    medians = {k: float(study.worst[study.rows(k)].median()) for k in study.kinds}
    lines = [("as above", medians, study.reach, (rho.value, rho.low, rho.high))]
    lines += [(v.name, v.medians, v.reach, v.rho) for v in study.variants]
    for name, own, reach, (value, low, high) in lines:
        greatest = {r.kind: float(r.reached.max()) for r in reach}
        cells = [
            (f"{own[k]:.3g}" if k in own else "-")
            + (f" ({greatest[k]:.3g})" if k in greatest else "")
            for k in shown
        ]
        table.add_row(name, *cells, f"{value:.2f} [{low:.2f}, {high:.2f}]".replace("[", "\\["))
    return table


def label(kind: str) -> str:
    """A kind as people read it."""
    names = {"com": "CoM", "inertia+com": "inertia + CoM", "total_mass": "total mass"}
    return names.get(kind, kind)


def interval(found: Estimate) -> str:
    """Value and interval, escaped for rich."""
    if math.isnan(found.value):
        return "-"
    if math.isnan(found.low):
        return f"{found.value:.2f} (too few chains)"
    return f"{found.value:.2f} \\[{found.low:.2f}, {found.high:.2f}]"


def _class(kind: str) -> str:
    return CLASS_NAMES.get(kind, "mixed")


def _reference(study: EqualTorqueStudy) -> str:
    if study.setting.origin == "nominal":
        return "nominal parameters"
    return "nearest feasible set"


def _percent(low: float, high: float) -> str:
    return f"{100 * max(abs(1 - low), abs(1 - high)):.2g} % (95 % of all sets)"


def _of_interest(effect: EffectSize) -> bool:
    pair = (effect.first, effect.second)
    return pair in (("inertia only", "feasible"), ("CoM only", "feasible"), _AGAINST_EACH_OTHER)


def _effect_sentence(effect: EffectSize) -> str:
    ratio = effect.ratio
    names = {"inertia only": "inertia", "CoM only": "centres of mass"}
    who = f"Drawn sets that violate {names[effect.first]} only"
    against = (
        "drawn feasible sets"
        if effect.second == "feasible"
        else f"those that violate {names[effect.second]} only"
    )
    if math.isnan(ratio.low):
        return f"{who}, against {against}: too few independent chains to tell."
    how = f"{ratio.value:.2f} times the force error (95 %: {ratio.low:.2f} to {ratio.high:.2f})"
    if ratio.low <= 1 <= ratio.high:
        return f"{who} cannot be told from {against}: {how}."
    return f"{who} have {how} of {against}."


def _degree_sentence(kind: str, rho: Estimate) -> str:
    among = "feasible sets" if kind == "feasible" else f"sets that violate {_WORDS[kind]} only"
    if math.isnan(rho.low):
        return f"Among {among}: too few independent chains to tell whether the degree matters."
    how = f"rho = {rho.value:.2f} (95 %: {rho.low:.2f} to {rho.high:.2f})"
    if rho.low <= 0 <= rho.high:
        return f"Among {among} no effect of the degree can be told: {how}."
    which = "firmer" if kind == "feasible" else "less violating"
    side = "smaller" if rho.value < 0 else "larger"
    return f"Among {among} {which} ones have {side} errors: {how}."


def _across_sentence(across: Across) -> str:
    what = f"Just outside and just inside the boundary of {_WORDS[across.kind]}"
    low, high = across.ratio.low, across.ratio.high
    if math.isnan(low):
        return f"{what}: too few independent chains to tell whether the error jumps."
    how = f"{across.ratio.value:.2f} times (95 %: {low:.2f} to {high:.2f})"
    if low <= 1 <= high:
        return f"{what} no jump of the error can be told: {how}."
    return f"{what} the errors differ: {how}."


def _reach_sentences(study: EqualTorqueStudy) -> list[str]:
    found = {r.kind: r for r in study.reach}
    if "feasible" not in found:
        return []
    feasible = found["feasible"].bound
    told = [f"Even feasible sets can be off by {_newton(found['feasible'].reached.max())}."]
    for kind in ("inertia", "com"):
        if kind in found:
            times = (found[kind].reached / feasible).clamp(min=1.0).tolist()
            listed = ", ".join(f"{t:.2f}" for t in times)
            told.append(
                f"With {_WORDS[kind]} violated alone, the greatest error of any set is {listed} "
                "times that of feasible ones (joint by joint)."
            )
    return told


def _newton(value: torch.Tensor) -> str:
    return f"{float(value):.3g} N"


def _bracket(low: float, high: float) -> str:
    close = math.isclose(low, high, rel_tol=0.01, abs_tol=0.05)
    return f"{low:.3g}" if close else f"{low:.3g} - {high:.3g}"
