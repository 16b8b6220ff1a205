"""Sets of any method, judged: loss, penalty, torque and feasibility."""

from dataclasses import dataclass
from functools import cached_property

import torch
from msgspec import UNSET

from torchid.errors import TorchidError
from torchid.extraction.convex.certificate import Certificate, certificate
from torchid.extraction.entropic import AT_A_WALL
from torchid.extraction.penalty import gamma
from torchid.extraction.problem import Problem, torque_error
from torchid.extraction.record import (
    ExtractedSet,
    ExtractionRecord,
    SearchRecord,
    certificate_record,
    problem_fields,
)
from torchid.extraction.settings import SearchSettings
from torchid.feasibility.margins import Feasibility, feasibility
from torchid.feasibility.plausibility import search_names
from torchid.feasibility.sets import ParameterSets, sets_record
from torchid.results.record import Result
from torchid.robot.knowledge import to_mapping
from torchid.typing import Float, Tensor


@dataclass(frozen=True, eq=False)
class Extraction(Result):
    """What a search found, all runs.

    Attributes:
        problem, settings: as given.
        sets: one set a run, ids run_1, run_2, ...
        phi, gamma: (R,) loss and penalty of the sets.
        history_phi, history_gamma: (R, K) of the best so far, after each stage of the search.
        contradictions: conditions that no point of the bounds meets.
        seconds: the search took, without time before an interruption.
    """

    problem: Problem
    settings: SearchSettings
    sets: ParameterSets
    phi: Float[Tensor, " R"]
    gamma: Float[Tensor, " R"]
    history_phi: Float[Tensor, "R K"]
    history_gamma: Float[Tensor, "R K"]
    contradictions: tuple[str, ...]
    seconds: float

    def __repr__(self) -> str:
        name, best = self.problem.robot.name, float(self.phi[self.best])
        return f"Extraction('{name}', {len(self.sets)} sets, best {self.best} with phi {best:.4g})"

    @cached_property
    def found(self) -> "Found":
        """The search's sets with their verdicts."""
        return judged(self.problem, "cma-es", self.sets, self.seconds, search=self)

    @property
    def record(self) -> ExtractionRecord:
        """As the JSON has it."""
        return self.found.record

    @property
    def best(self) -> int:
        """The run with the lowest final loss phi + xi gamma (phi alone if partial)."""
        # The weight of the next stage: with one stage only, the last one's would be zero.
        weight = self.settings.weight(self.settings.stages)
        return int((self.phi + weight * self.gamma).argmin())


@dataclass(frozen=True, eq=False)
class Found(Result):
    """Sets of any method, judged.

    Attributes:
        problem: what was asked for.
        method: cma-es, sdp or near.
        sets: K of them.
        phi, gamma: (K,) loss and penalty.
        torque: (K, n) difference from the asked-for torque, relative (see `torque_error`).
        verdict: feasibility.
        search: the course of a population search, or None.
        seconds: it took.
        proof: the least loss of any feasible set, where it was asked for.
        warnings: sentences for the user.
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
    proof: Certificate | None = None
    warnings: tuple[str, ...] = ()

    def __repr__(self) -> str:
        feasible = int(self.verdict.feasible.sum())
        return (
            f"Found('{self.problem.robot.name}', {len(self.sets)} sets by {self.method}, "
            f"{feasible} feasible)"
        )

    @cached_property
    def record(self) -> ExtractionRecord:
        """As the JSON has it."""
        robot, search = self.problem.robot, self.search
        entries = sets_record(self.sets, robot).sets
        return ExtractionRecord(
            **problem_fields(self.problem),
            method=self.method,
            search=None
            if search is None
            else SearchRecord(**vars(search.settings), contradictions=search.contradictions),
            certificate=self.proof and certificate_record(self.proof),
            best=self.sets.ids[self.best],
            sets=tuple(
                ExtractedSet.of(
                    entry,
                    phi=self.phi[k],
                    gamma=self.gamma[k],
                    feasible=self.verdict.feasible[k],
                    reasons=self.verdict.reasons(k),
                    degree=self.verdict.degree[k],
                    torque_error_percent=100 * self.torque[k],
                )
                for k, entry in enumerate(entries)
            ),
            at_bounds=tuple(at_bounds(self)),
            seconds=self.seconds,
            warnings=self.warnings,
            knowledge=UNSET if robot.knowledge is None else to_mapping(robot.knowledge),
        )

    @property
    def best(self) -> int:
        """The set with the lowest final loss."""
        if self.search is not None:
            return self.search.best
        return int(self.phi.nan_to_num(torch.inf).argmin())


def judged(
    problem: Problem,
    method: str,
    sets: ParameterSets,
    seconds: float,
    *,
    search: Extraction | None = None,
    proof: Certificate | None = None,
) -> Found:
    """Sets of a method with loss, penalty, torque and feasibility; the others as `Found` has
    them."""
    phi = problem.residual_of_vector(sets.vector).square().sum(-1)
    penalty, torque = gamma(problem, sets.search_vector), torque_error(problem, sets)
    verdict = feasibility(sets, problem.conditions)
    return Found(problem, method, sets, phi, penalty, torque, verdict, search, seconds, proof)


def best_set(
    problem: Problem, *, proof: Certificate | None = None, search_anyway: bool = False
) -> Found:
    """The feasible set nearest to what was identified: a semidefinite program, whose loss no search
    can beat.

    Args:
        problem: loss, bounds and conditions, from `problem_of`.
        proof: its `certificate`, if that is known already.
        search_anyway: leave conditions out that no set of the bounds meets.

    Returns:
        One set; `proof` says what its loss is at least, and which conditions hold it there.

    Raises:
        TorchidError: no feasible set exists within the bounds, or the solver failed.

    >>> import torchid
    >>> from torchid.identification.values import nominal_base
    >>> robot = torchid.load_robot("3r")
    >>> problem, _ = torchid.problem_of(robot, nominal_base(robot))
    >>> found = best_set(problem)
    >>> found.sets.parameters.mass.shape, bool(found.verdict.feasible[0])
    (torch.Size([1, 3]), True)
    """
    proof = certificate(problem) if proof is None else proof
    if not (proof.feasible or proof.conflict):
        raise TorchidError(
            "the convex solver failed on this problem.",
            got=proof.status,
            hint='`torchid extract` searches without it: `method="cma-es"`',
        )
    if proof.sets is None or not (proof.with_conditions or search_anyway):
        raise TorchidError(
            "no feasible set exists within these bounds.",
            got=", ".join(proof.conflict) or proof.status,
            hint="other `bounds=...`, `geometry=...` or `total_mass=...`; `search_anyway=True` "
            "leaves the conditions out",
        )
    return judged(problem, "sdp", proof.sets, proof.seconds, proof=proof)


def at_bounds(extraction: Found) -> list[str]:
    """Parameters of the best set that lie on their bounds, e.g. m3 (upper). That masses and moments
    of inertia are not below 0 is physics, and no bound."""
    problem = extraction.problem
    n = problem.n
    own = extraction.sets.search_vector[extraction.best]
    low, high = problem.box.unbind(-1)
    # 1e-4: share of a bound's span within which a parameter counts as lying on it, of searches that
    # reach it
    near = (AT_A_WALL if extraction.method == "near" else 1e-4) * (high - low)
    physics = torch.zeros_like(low, dtype=torch.bool)
    physics[:n] = True
    physics[4 * n : 10 * n].view(n, 6)[:, [0, 3, 5]] = True
    physics &= low <= 0
    lower, upper = ((own - low < near) & ~physics).tolist(), (high - own < near).tolist()
    return [
        f"{name} ({'lower' if below else 'upper'})"
        for name, below, above in zip(search_names(extraction.sets), lower, upper, strict=True)
        if below or above
    ]
