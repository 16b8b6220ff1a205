"""Extractions and atlases as their JSON has them: the schemas torchid.extraction/1 and atlas/1."""

import math
from dataclasses import dataclass
from typing import Annotated, Any

import torch
from msgspec import UNSET, UnsetType, field

from torchid.extraction.problem import Problem
from torchid.extraction.settings import SearchSettings
from torchid.feasibility.sets import SetEntry, SetsFile
from torchid.results.record import Col, Ends, Part, Real, RobotRecord, Rows
from torchid.robot.library import named_record
from torchid.typing import Float, Tensor


class CertificateRecord(Part, frozen=True, kw_only=True):
    """The least loss of any feasible set, and what forces it.

    Attributes:
        feasible: whether there is a strictly feasible set at all; False as well where one is known
            without the problem's conditions alone.
        with_conditions: whether the problem's conditions count beside physics and bounds.
        phi_min: lower bound of the loss of all feasible sets, proven by the dual problem to its
            rounding; infinite if there are none, nan if the solver failed. Without bounds of
            inertias they are still taken to be below `convex.sets.REACH`: the largest mass a
            hundred times, at a third of the arm's longest step.
        phi_strict: loss of one strictly feasible set that nearly reaches it; nan if there are none.
        exact: whether that set has no loss but rounding, so that phi_min is zero and is reached. A
            phi_min of zero alone says nothing: it is a lower bound.
        conflict: if there is no feasible set, conditions and bounds that exclude each other; of
            a name that stands alone, com_7z, the bounds exclude the condition.
        forcing: a small group of conditions, found greedily, without which phi_min is nearly zero,
            those of most effect first. Empty if phi_min is zero.
        phi_min_without: conditions whose release lowers it noticeably, and to what; those of most
            effect first.
        relaxed_active: bounds of barycentric inertias, bound_4yy, that count in phi_min by a
            relaxation only and not in full, so that phi_min may not be reached: without them,
            phi would be smaller than the best found within them. The strictly feasible set meets
            them wherever one that does was found.
        seconds: that it took.
    """

    feasible: bool
    with_conditions: Annotated[bool, Col("all conditions")]
    phi_min: Annotated[Real, Col(digits=".4g")]
    phi_strict: Annotated[Real, Col("reached", ".4g")] = math.nan
    exact: Annotated[bool, Col()] = False
    conflict: Annotated[tuple[str, ...], Col("no room for")] = ()
    forcing: Annotated[tuple[str, ...], Col("forced by")] = ()
    phi_min_without: dict[str, float] = field(default_factory=dict)
    relaxed_active: Annotated[tuple[str, ...], Col("relaxed")] = field(name="relaxed", default=())
    seconds: float


def certificate_record(proof: CertificateRecord) -> CertificateRecord:
    """As the JSON has it."""
    return CertificateRecord.of(proof, feasible=proof.feasible and proof.with_conditions)


@dataclass(frozen=True, kw_only=True)
class SearchRecord(SearchSettings):
    """Settings of a population search, and conditions that no point of the bounds meets."""

    contradictions: tuple[str, ...]


ON_THE_BOUNDARY = 1e-6
"""Degree below which a feasible set is said to be on the boundary."""


def _degree(value: float) -> str:
    return "boundary" if abs(value) < ON_THE_BOUNDARY else f"{value:.2g}"


class ExtractedSet(SetEntry, frozen=True, kw_only=True):
    """A set as in a file of sets, with its loss, penalty, verdict, and how far its torque is (n,)
    from the one asked for."""

    phi: Annotated[Real, Col(digits=".5g")]
    gamma: Annotated[Real, Col(digits=".2g")]
    feasible: Annotated[bool, Col()]
    reasons: Annotated[tuple[str, ...], Col()]
    degree: Annotated[Real, Col(words=_degree)]
    torque_error_percent: Float[Tensor, " n"]

    @property
    def far(self) -> Annotated[float, Col("torque of the worst joint", ".2g", "%")]:
        """Error of the joint whose torque is farthest from the one asked for."""
        return float(self.torque_error_percent.max())


class ProblemRecord(RobotRecord, frozen=True, kw_only=True):
    """What was asked for.

    Attributes:
        loss, bounds: what was asked for, and within what.
        base_names, base_values: the base parameters asked for.
        search_variables: their number. total_mass: interval [kg], or None.
    """

    robot_source: str
    loss: str
    bounds: str
    base_names: tuple[str, ...]
    base_values: Float[Tensor, " B"]
    search_variables: int
    total_mass: Ends | None


class ExtractionRecord(
    ProblemRecord, SetsFile, frozen=True, kw_only=True, tag="torchid.extraction/1"
):
    """An extraction as its JSON has it.

    Attributes:
        method: how it was searched. search: its course, of a population search.
        certificate: the least loss of any feasible set.
        best: id of the set of least loss.
        sets: all of them.
        at_bounds: parameters of the best one that lie on their bounds.
        seconds: it took.
        warnings: sentences for the user.
        knowledge: how sure the base parameters are, as a robot's yaml has it.
    """

    method: str
    search: SearchRecord | None
    certificate: CertificateRecord | None
    best: str
    sets: tuple[ExtractedSet, ...]
    at_bounds: tuple[str, ...]
    seconds: float
    warnings: tuple[str, ...]
    knowledge: dict[str, list[str]] | UnsetType = UNSET

    @property
    def table(self) -> Rows[ExtractedSet]:
        """The sets."""
        return Rows(self.sets)


class AtlasRange(Part, frozen=True, kw_only=True):
    """The range of one parameter over feasible sets of equal torque, and over those of any."""

    name: Annotated[str, Col("parameter")]
    unit: Annotated[str, Col()]
    low: Annotated[Real, Col(digits=".4g")]
    high: Annotated[Real, Col(digits=".4g")]
    bounds: Annotated[Ends, Col("within the bounds alone")]
    share_of_bounds: Real
    status: tuple[str, str]


class AtlasRecord(ProblemRecord, frozen=True, kw_only=True, tag="torchid.atlas/1"):
    """An atlas as its JSON has it; see ProblemRecord for what was asked.

    `kind` and `radius`: what equal torque means.
    """

    kind: str
    radius: Real
    parameters: tuple[AtlasRange, ...]
    warnings: tuple[str, ...] = ()

    @property
    def narrowed(self) -> Float[Tensor, " Q"]:
        """(Q,) width of the range over that of the bounds alone: 0 is known, 1 is not narrowed."""
        return torch.tensor([r.share_of_bounds for r in self.parameters], dtype=torch.float64)

    @property
    def table(self) -> Rows[AtlasRange]:
        """The ranges."""
        return Rows(self.parameters)


def problem_fields(problem: Problem) -> dict[str, Any]:
    """Which base parameters were asked for, within which bounds and conditions."""
    target, total = problem.target, problem.conditions.total_mass
    known = bool(total.isfinite().all())
    return {
        **named_record(problem.robot),
        "loss": target.loss,
        "bounds": problem.bounds.name,
        "base_names": target.base.names,
        "base_values": target.values,
        "search_variables": problem.size,
        "total_mass": tuple(total.tolist()) if known else None,
    }
