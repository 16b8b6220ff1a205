"""Sets with equal torque and their internal forces, as tables for people."""

import math

from rich.table import Table

from torchid.report.identification import compact
from torchid.study.equal_torque.study import EqualTorqueStudy
from torchid.wrenches.classes import KINDS as CLASS_NAMES
from torchid.wrenches.resampling import Estimate


def tables(study: EqualTorqueStudy) -> list[Table]:
    """Errors by kind, their differences, the degree, what any set can do, other assumptions."""
    made = [kind_table(study), joint_table(study), effect_table(study)]
    made += [degree_table(study), third_table(study)]
    if study.reach:
        made.append(reach_table(study))
    made += [truth_table(study), firm_table(study)]
    if study.variants:
        made.append(variant_table(study))
    return made


def kind_table(study: EqualTorqueStudy) -> Table:
    """Quartiles of the largest force error over the joints by kind, and the moments' median."""
    table = compact(
        f"{study.setting.robot.name}: errors of the internal wrenches against the "
        f"{_reference(study)}, RMS over the motion, largest joint"
    )
    headings = ("kind", "sets", "chains", "degree", "force [N]: median (quartiles)", "moment [N m]")
    for heading in headings:
        table.add_column(heading, justify="left" if heading == "kind" else "right", no_wrap=True)
    moment = study.errors.moment_rms.amax(-1)
    for kind in study.kinds:
        rows = study.rows(kind)
        low, middle, high = (float(study.worst[rows].quantile(p)) for p in (0.25, 0.5, 0.75))
        degree = study.degree[rows]
        chains = len(set(study.family.cluster[rows].tolist()))
        table.add_row(
            label(kind), str(len(rows)), str(chains),
            f"{float(degree.min()):.2g} .. {float(degree.max()):.2g}",
            f"{middle:.3g} ({low:.3g} - {high:.3g})", f"{float(moment[rows].quantile(0.5)):.3g}",
        )  # fmt: skip
    own = study.errors
    table.add_row(
        "the wrench itself", "", "", "", f"{float(own.reference_force_rms.max()):.3g}",
        f"{float(own.reference_moment_rms.max()):.3g}",
    )  # fmt: skip
    return table


def joint_table(study: EqualTorqueStudy) -> Table:
    """Medians of the force error per joint."""
    table = compact("median force error per joint [N]")
    table.add_column("kind", no_wrap=True)
    for joint in range(study.setting.robot.n):
        table.add_column(f"j{joint + 1}", justify="right", no_wrap=True)
    for kind in study.kinds:
        middle = study.errors.force_rms[study.rows(kind)].median(0).values.tolist()
        table.add_row(label(kind), *(f"{v:.3g}" for v in middle))
    own = study.errors.reference_force_rms.tolist()
    table.add_row("the force itself", *(f"{v:.3g}" for v in own))
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


def _bracket(low: float, high: float) -> str:
    close = math.isclose(low, high, rel_tol=0.01, abs_tol=0.05)
    return f"{low:.3g}" if close else f"{low:.3g} - {high:.3g}"
