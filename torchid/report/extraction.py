"""An extraction for people: verdict, tables, the search's course; and the null-space atlas: which
parameters the torque determines, and how far."""

import math
from collections.abc import Sequence
from functools import partial

import torch
from rich.text import Text

from torchid.extraction.convex.atlas import Atlas
from torchid.extraction.convex.certificate import Certificate
from torchid.extraction.extract import Extraction
from torchid.extraction.found import Found, at_bounds
from torchid.extraction.problem import FAR_TORQUE, Problem
from torchid.extraction.record import ON_THE_BOUNDARY, AtlasRecord
from torchid.identification.values import BaseValues
from torchid.report.colours import BLUE, GREEN, GREY, INK, ORANGE, RED
from torchid.report.panels import Figure, Figures, finish, panel, rows_of
from torchid.report.table import Report, Table, table_of
from torchid.results.words import count, listed
from torchid.robot.inertia import InertialParameters

_SHOWN = 12


def report_of_extraction(result: Found) -> Report:
    """All that there is to see of an extraction."""
    said, last = tables(result), headline(result)
    return Report(parts=said, warnings=result.warnings, last=last, figures=figures(result))


def report_of_atlas(atlas: Atlas, problem: Problem, notes: Sequence[str]) -> Report:
    """All that there is to see of an atlas."""
    return Report(
        parts=[atlas_table(atlas)],
        warnings=notes,
        last=atlas_headline(atlas, problem),
        figures={"atlas": partial(atlas_figure, atlas)},
    )


def headline(result: Found) -> str:
    """One or two sentences: what came out."""
    k, verdict, name = result.best, result.verdict, result.problem.robot.name
    degree = float(verdict.degree[k])
    said = (
        f"feasible ({'on the boundary' if degree < ON_THE_BOUNDARY else f'degree {degree:.2g}'})"
        if bool(verdict.feasible[k])
        else f"infeasible: {', '.join(verdict.reasons(k))}"
    )
    text = (
        f"{count(len(result.sets), 'set')} of {name} by {result.method}, "
        f"{int(verdict.feasible.sum())} of them feasible. Best: {result.sets.ids[k]}, phi "
        f"{float(result.phi[k]):.5g}, {said}; its torque is up to "
        f"{100 * float(result.torque[k].max()):.2g} % from the asked-for one (joint "
        f"{int(result.torque[k].argmax()) + 1})."
    )
    # The loss does not choose between sets that have it alike; how different are they?
    phi = result.phi[verdict.feasible]
    alike = phi <= 1.01 * phi.min() + 1e-18 if len(phi) else phi > 0
    if int(alike.sum()) > 1:
        total = result.sets.parameters.mass[verdict.feasible][alike].sum(-1)
        text += (
            f" {int(alike.sum())} feasible sets have this loss (to 1 %); their total mass ranges "
            f"from {float(total.min()):.4g} to {float(total.max()):.4g} kg."
        )
    edges = at_bounds(result)
    if edges:
        text += f" On its bounds: {listed(edges, most=_SHOWN)}."
    proof = result.proof
    return text if proof is None or not proof.feasible else f"{text} {least_loss(result, proof)}"


def loss_notes(result: Found, values: BaseValues) -> tuple[str, ...]:
    """Says that the loss is to blame, where the best set's torque is far off and a log is there to
    ask."""
    far = float(result.torque[result.best].max()) > FAR_TORQUE
    if not far or result.problem.target.loss != "two-step" or values.factor is None:
        return ()
    return (
        "the two-step loss counts coefficients, all alike, not torque: --loss one-step asks for "
        "the log's torque",
    )


def least_loss(result: Found, proof: Certificate) -> str:
    """A sentence or two: what is known of the least loss, and no more than that."""
    whose, start = "feasible", ""
    if not proof.with_conditions:
        whose, start = "physical", "No set within the bounds meets all conditions. "
    if proof.exact:
        return f"{start}Some {whose} set reproduces the base parameters exactly (phi_min = 0)."
    relaxed = (
        f" {', '.join(proof.relaxed_active)} count in phi_min by a relaxation only: it may not be "
        "reached."
        if proof.relaxed_active
        else ""
    )
    if proof.phi_min <= 0:
        best = min([proof.phi_strict, *result.phi[result.verdict.feasible].tolist()])
        return (
            f"{start}Whether some {whose} set reproduces the base parameters exactly is not known: "
            f"the least loss lies between phi_min = 0 and {best:.5g}.{relaxed}"
        )
    forcing = [n for n, v in proof.phi_min_without.items() if v < 0.95 * proof.phi_min][:4]
    names = forcing or proof.forcing
    forced = f", forced by {', '.join(names)}" if names else ""
    return f"{start}No {whose} set has a loss below phi_min = {proof.phi_min:.5g}{forced}.{relaxed}"


def tables(result: Found) -> list[Table]:
    """The best sets, and what forces the least loss."""
    proof = result.proof
    sets = sorted(result.record.sets, key=lambda one: (not one.feasible, one.phi))
    least = {} if proof is None else proof.phi_min_without
    without = [(name, f"{value:.5g}") for name, value in least.items()][:_SHOWN]
    forced = "" if proof is None else f"what forces phi_min = {proof.phi_min:.5g}"
    title = f"{count(len(sets), 'set')} within the bounds '{result.problem.bounds.name}'"
    return [
        table_of(title, sets, "id phi far gamma feasible degree reasons", most=_SHOWN),
        Table(forced, ("without the condition", "phi_min would be"), without, "p"),
    ]


def figures(result: Found) -> Figures:
    """What draws the search's course, where there was one."""
    search = result.search
    return {} if search is None else {"search": partial(search_figure, search, result.proof)}


def search_figure(search: Extraction, proof: Certificate | None = None) -> Figure:
    """Loss and penalty of all runs against the stage, and the loss of the sets they end in."""
    figure, (upper, lower) = panel(9, 5.4, 2, 1, sharex=True)
    for axes, history in ((upper, search.history_phi), (lower, search.history_gamma)):
        shown = history.nan_to_num(nan=math.inf).clamp(min=_LEAST).numpy()
        stages = range(1, shown.shape[1] + 1)
        axes.plot(stages, shown.T, color=GREY, linewidth=0.7, alpha=0.6, label="runs")
        axes.plot(stages, shown[search.best], color=BLUE, linewidth=1.8, label="best run")
    upper.set_yscale("log")
    least = 0.0 if proof is None else proof.phi_min
    if 0 < least < math.inf:
        upper.axhline(least, color=RED, linewidth=1.2, label="least possible, phi_min")
    gamma = search.history_gamma
    # Linear below the least penalty that is one.
    linear = min(gamma[(gamma > 0) & gamma.isfinite()].tolist(), default=1.0)
    lower.set_yscale("symlog", linthresh=linear)
    lower.set_ylim(bottom=-0.1 * linear)
    end = [search.settings.stages + 0.6] * len(search.phi)
    upper.scatter(end, search.phi.clamp(min=_LEAST).numpy(), s=10, color=BLUE, label="in the end")
    upper.set_ylabel("loss phi of the best so far")
    lower.set(xlabel="stage of Algorithm 1", ylabel="penalty gamma")
    title = (
        f"{search.problem.robot.name}: {search.settings.runs} runs within the bounds "
        f"'{search.problem.bounds.name}', {search.settings.penalty} loss"
    )
    return finish(figure, title, upper)


_LEAST = 1e-34
"""Losses below it are drawn on it."""
_KNOWN, _NARROWED = 0.01, 0.5
"""Shares of the bounds' range below which a parameter counts as known, and as narrowed."""


def atlas_headline(atlas: Atlas, problem: Problem) -> str:
    """How many parameters the torque determines, narrows and leaves open."""
    share = atlas.narrowed
    known = int((share < _KNOWN).sum())
    some = int(((share >= _KNOWN) & (share < _NARROWED)).sum())
    meaning = {
        "exact": "reproduce the base parameters exactly",
        "least loss": "have nearly the least loss that is possible",
        "confidence": "lie in the confidence region of the base parameters",
    }
    text = (
        f"Of {len(atlas.names)} physical parameters of {problem.robot.name}, over feasible sets "
        f"that {meaning.get(atlas.kind, atlas.kind)}: {known} are known to 1 % of their bounds, "
        f"{some} are narrowed to less than half, {len(atlas.names) - known - some} hardly or not "
        "at all."
    )
    if atlas.widened:
        text += " No feasible set lies in the confidence region; it was widened until one does."
    # Sets at the ends need not meet the bounds of the barycentric inertias, which are relaxed.
    sets = InertialParameters.from_paper_order(atlas.extremes[..., : 10 * problem.n])
    inertia = sets.inertia_about_com
    low, high = problem.bounds.inertia.to(inertia).unbind(-1)
    # 1e-6: share of an interval between bounds by which a set at an end may miss it: rounding
    slack = 1e-6 * (high - low)
    out = (inertia < low - slack) | (inertia > high + slack)
    outside = int(out.flatten(2).any(-1).sum())
    if outside:
        text += (
            f" The bounds of the barycentric inertias count by a relaxation: the sets at {outside} "
            f"of {atlas.low.numel() * 2} ends are outside them, so ranges may be narrower than "
            "shown."
        )
    return text


def atlas_table(atlas: Atlas) -> Table:
    """One row a parameter: range, range of the bounds, share."""
    shares = []
    for one in atlas.record.parameters:
        share = one.share_of_bounds
        colour = "green" if share < _KNOWN else "yellow" if share < _NARROWED else "red"
        shares.append(Text(f"{100 * share:.2g}", colour))
    title = "ranges over feasible sets of equal torque"
    return table_of(title, atlas.record.parameters, beside={"share %": shares})


def atlas_figure(drawn: Atlas | AtlasRecord) -> Figure:
    """Each parameter's range inside the range that the bounds alone allow."""
    atlas = drawn.record
    assert isinstance(atlas, AtlasRecord)
    kinds = {"m": "masses", "c": "centres of mass", "J": "inertias about the link frame"}
    columns: dict[str, list[int]] = {title: [] for title in kinds.values()}
    for k, parameter in enumerate(atlas.parameters):
        columns.setdefault(kinds.get(parameter.name[0], "coefficients"), []).append(k)
    height = 1.6 + 0.17 * max(len(rows) for rows in columns.values())
    figure, grid = panel(11, height, 1, len(columns))
    ends = torch.tensor([(p.low, p.high, *p.bounds) for p in atlas.parameters], dtype=torch.float64)
    least, most = ends[:, 2], ends[:, 3]
    low, high = ((end - least) / (most - least) for end in (ends[:, 0], ends[:, 1]))
    for axes, (title, rows) in zip(grid, columns.items(), strict=True):
        for y, k in enumerate(rows):
            share = atlas.parameters[k].share_of_bounds
            colour = GREEN if share < _KNOWN else ORANGE if share < _NARROWED else RED
            colour = GREY if not bool(torch.isfinite(low[k] + high[k])) else colour
            start, end = float(low[k].nan_to_num(0.0)), float(high[k].nan_to_num(1.0))
            axes.plot([0, 1], [y, y], color="#eaeef2", linewidth=4, solid_capstyle="butt")
            axes.plot([start, end], [y, y], color=colour, linewidth=4, solid_capstyle="butt")
            axes.plot([(start + end) / 2], [y], "|", color=colour, markersize=7)
        rows_of(axes, [atlas.parameters[k].name for k in rows])
        axes.set_xlim(-0.02, 1.02)
        axes.set_title(title, fontsize=9, color=INK)
        axes.grid(False, axis="y")
    grid[1].set_xlabel(
        "0 and 1: least and largest value that feasible sets of any torque have within the bounds",
    )
    keys = {
        "known to 1 % of its bounds": {"color": GREEN, "linewidth": 4},
        "narrowed to less than half": {"color": ORANGE, "linewidth": 4},
        "hardly or not narrowed": {"color": RED, "linewidth": 4},
    }
    title = f"{atlas.robot}: what the torque determines"
    return finish(figure, title, columns=3, keys=keys)
