"""An extraction for people: verdict, tables, the search's course."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch

from torchid.extraction.convex.certificate import Certificate
from torchid.extraction.extract import Extraction
from torchid.extraction.penalty import gamma
from torchid.extraction.problem import FAR, Problem, torque_error
from torchid.extraction.record import (
    SCHEMA,
    certificate_record,
    noticeable,
    problem_record,
    sets_record,
)
from torchid.feasibility.margins import Feasibility, feasibility
from torchid.feasibility.sets import ParameterSets, to_record
from torchid.identification.values import BaseValues
from torchid.json_data import plain
from torchid.report.colours import BLUE, GREY, RED
from torchid.report.panels import finish, label, new_figure, styled
from torchid.report.table import Table
from torchid.typing import Float, Tensor

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SHOWN = 12
_ON_A_BOUND = 1e-4
"""Share of a bound's span within which a parameter counts as lying on it."""
ON_THE_BOUNDARY = 1e-6
"""Degree below which a feasible set is said to be on the boundary."""


@dataclass(frozen=True, eq=False)
class Found:
    """Sets of any method, judged.

    Attributes:
        problem: what was asked for.
        method: cma-es, log-cholesky or sdp.
        sets: K of them.
        phi, gamma: (K,) loss and penalty.
        torque: (K, n) difference from the asked-for torque, relative (see `torque_error`).
        verdict: feasibility.
        search: the course of a population search, or None.
        seconds: it took.
    """

    problem: Problem
    method: str
    sets: ParameterSets
    phi: Float[Tensor, " K"]
    gamma: Float[Tensor, " K"]
    torque: Float[Tensor, "K n"]
    verdict: Feasibility
    search: Extraction | None
    seconds: float

    @property
    def best(self) -> int:
        """The set with the lowest final loss."""
        if self.search is not None:
            return self.search.best
        return int(self.phi.nan_to_num(torch.inf).argmin())


def judged(
    problem: Problem, sets: ParameterSets
) -> tuple[ParameterSets, Tensor, Tensor, Tensor, Feasibility]:
    """Sets with loss, penalty, torque and feasibility."""
    return (
        sets,
        problem.residual_of_vector(sets.vector).square().sum(-1),
        gamma(problem, problem.search_vector(sets)),
        torque_error(problem, sets),
        feasibility(sets, problem.conditions),
    )


def at_bounds(found: Found) -> list[str]:
    """Parameters of the best set that lie on their bounds, e.g. m3 (upper)."""
    problem = found.problem
    n = problem.n
    names = [f"m{i + 1}" for i in range(n)]
    names += [f"c{i + 1}{axis}" for i in range(n) for axis in "xyz"]
    names += [f"I{i + 1}{e}" for i in range(n) for e in ("xx", "xy", "xz", "yy", "yz", "zz")]
    names += found.sets.coefficient_names()
    own = problem.search_vector(found.sets)[found.best]
    low, high = problem.box.unbind(-1)
    near = _ON_A_BOUND * (high - low)
    lower, upper = (own - low < near).tolist(), (high - own < near).tolist()
    return [
        f"{name} ({'lower' if below else 'upper'})"
        for name, below, above in zip(names, lower, upper, strict=True)
        if below or above
    ]


def headline(found: Found, proof: Certificate | None) -> str:
    """One or two sentences: what came out."""
    k, verdict, name = found.best, found.verdict, found.problem.robot.name
    degree = float(verdict.degree[k])
    said = (
        f"feasible ({'on the boundary' if degree < ON_THE_BOUNDARY else f'degree {degree:.2g}'})"
        if bool(verdict.feasible[k])
        else f"infeasible: {', '.join(verdict.reasons(k))}"
    )
    text = (
        f"{len(found.sets)} set{'s' * (len(found.sets) > 1)} of {name} by {found.method}, "
        f"{int(verdict.feasible.sum())} of them feasible. Best: {found.sets.ids[k]}, phi "
        f"{float(found.phi[k]):.5g}, {said}; its torque is up to "
        f"{100 * float(found.torque[k].max()):.2g} % from the asked-for one (joint "
        f"{int(found.torque[k].argmax()) + 1})."
    )
    # The loss does not choose between sets that have it alike; how different are they?
    phi = found.phi[verdict.feasible]
    alike = phi <= 1.01 * phi.min() + 1e-18 if len(phi) else phi > 0
    if int(alike.sum()) > 1:
        total = found.sets.parameters.mass[verdict.feasible][alike].sum(-1)
        text += (
            f" {int(alike.sum())} feasible sets have this loss (to 1 %); their total mass ranges "
            f"from {float(total.min()):.4g} to {float(total.max()):.4g} kg."
        )
    edges = at_bounds(found)
    if edges:
        more = "" if len(edges) <= _SHOWN else f" and {len(edges) - _SHOWN} more"
        text += f" On its bounds: {', '.join(edges[:_SHOWN])}{more}."
    return text if proof is None or not proof.feasible else f"{text} {least_loss(found, proof)}"


def loss_notes(found: Found, values: BaseValues) -> tuple[str, ...]:
    """Says that the loss is to blame, where the best set's torque is far off and a log is there to
    ask."""
    far = float(found.torque[found.best].max()) > FAR
    if not far or found.problem.target.loss != "two-step" or values.factor is None:
        return ()
    return (
        "the two-step loss counts coefficients, all alike, not torque: --loss one-step asks for "
        "the log's torque",
    )


def least_loss(found: Found, proof: Certificate) -> str:
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
        best = min([proof.phi_strict, *found.phi[found.verdict.feasible].tolist()])
        return (
            f"{start}Whether some {whose} set reproduces the base parameters exactly is not known: "
            f"the least loss lies between phi_min = 0 and {best:.5g}.{relaxed}"
        )
    forcing = [n for n, v in noticeable(proof).items() if v < 0.95 * proof.phi_min][:4]
    names = forcing or proof.forcing
    forced = f", forced by {', '.join(names)}" if names else ""
    return f"{start}No {whose} set has a loss below phi_min = {proof.phi_min:.5g}{forced}.{relaxed}"


def tables(found: Found, proof: Certificate | None) -> list[Table]:
    """The best sets, and what forces the least loss."""
    count = len(found.sets)
    which = f"the best {_SHOWN} of {count} sets" if count > _SHOWN else f"set{'s' * (count > 1)}"
    verdict = found.verdict.feasible.tolist()
    order = sorted(range(count), key=lambda k: (not verdict[k], float(found.phi[k])))
    rows = []
    for k in order[:_SHOWN]:
        degree = float(found.verdict.degree[k])
        rows.append(
            (
                found.sets.ids[k], f"{float(found.phi[k]):.5g}",
                f"{100 * float(found.torque[k].max()):.2g}", f"{float(found.gamma[k]):.2g}",
                "yes" if verdict[k] else "no",
                "boundary" if abs(degree) < ON_THE_BOUNDARY else f"{degree:.2g}",
                ", ".join(found.verdict.reasons(k)),
            )
        )  # fmt: skip
    out = [
        Table(
            f"{which} within the bounds '{found.problem.bounds.name}' (torque: largest joint)",
            ("set", "phi", "torque [%]", "gamma", "feasible", "degree", "reasons"),
            rows,
            words=("set", "reasons"),
        )
    ]
    if proof is not None and noticeable(proof):
        title = f"what forces phi_min = {proof.phi_min:.5g}"
        columns = ("without the condition", "phi_min would be")
        least = [(name, f"{value:.5g}") for name, value in noticeable(proof).items()]
        out.append(Table(title, columns, least[:_SHOWN], words=columns[:1]))
    return out


def extraction_record(
    found: Found, proof: Certificate | None, warnings: tuple[str, ...]
) -> dict[str, Any]:
    """JSON-ready data."""
    search: dict[str, Any] | None = None
    if found.search is not None:
        s = found.search
        settings = (
            "runs", "stages", "generations", "population", "penalty", "schedule", "engine",
            "polish", "seed",
        )  # fmt: skip
        search = {name: getattr(s.settings, name) for name in settings}
        search["phi_before_polish"] = s.searched_phi.tolist()
        search["gamma_before_polish"] = s.searched_gamma.tolist()
        search["contradictions"] = list(s.contradictions)
    return {
        "schema": SCHEMA,
        **problem_record(found.problem),
        "method": found.method,
        "search": search,
        "certificate": certificate_record(proof),
        "best": found.sets.ids[found.best],
        "sets": [
            {**physical, **entry, "torque_error_percent": plain([100 * x for x in torque])}
            for physical, entry, torque in zip(
                to_record(found.sets, found.problem.robot)["sets"],
                sets_record(found.sets.ids, found.phi, found.gamma, found.verdict),
                found.torque.tolist(),
                strict=True,
            )
        ],
        "at_bounds": at_bounds(found),
        "seconds": found.seconds,
        "warnings": list(warnings),
    }


def search_figure(search: Extraction, proof: Certificate | None) -> "Figure":
    """Loss and penalty of all runs against the stage, and the loss after the polish."""
    figure = new_figure(9, 5.4)
    upper, lower = (styled(axes) for axes in figure.subplots(2, 1, sharex=True))
    stages = range(1, search.settings.stages + 1)
    for axes, history, what in (
        (upper, search.history_phi, "loss phi of the best so far"),
        (lower, search.history_gamma, "penalty gamma"),
    ):
        shown = history.clamp(min=1e-34).numpy()
        axes.plot(stages, shown.T, color=GREY, linewidth=0.7, alpha=0.6)
        axes.plot(stages, shown[search.best], color=BLUE, linewidth=1.6, label="best run")
        label(axes, y=what)
    upper.set_yscale("log")
    lower.set_yscale("symlog", linthresh=1e-8)
    lower.set_ylim(bottom=-1e-9)
    if search.settings.polish:
        end = [search.settings.stages + 0.6] * len(search.phi)
        phi = search.phi.clamp(min=1e-34).numpy()
        upper.scatter(end, phi, s=10, color=BLUE, label="after the polish")
    if proof is not None and proof.feasible and proof.phi_min > 0:
        upper.axhline(proof.phi_min, color=RED, linewidth=1.0, label="least possible, phi_min")
    upper.legend(fontsize=8, frameon=False, loc="best")
    label(lower, "stage of Algorithm 1")
    return finish(
        figure,
        f"{search.problem.robot.name}: {search.settings.runs} runs within the bounds "
        f"'{search.problem.bounds.name}', {search.settings.penalty} loss",
    )
