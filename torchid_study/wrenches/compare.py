"""Are infeasible sets worse? Wrench errors by the reasons and by the degree of infeasibility.

The report compares classes of sets by eye (sections 5.1 to 5.4): those that violate inertias only,
centres of mass only, or both, and how many. Here: medians and quartiles per class, effect sizes
between classes, rank correlation of the error with the degree, each with an interval that knows
which sets belong together.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from torchid.errors import TorchidError
from torchid.results.record import Col
from torchid.typing import Float, Int, Tensor
from torchid_study.wrenches.classes import FEASIBLE, class_of, ordered_classes
from torchid_study.wrenches.resampling import (
    LEAST_CLUSTERS,
    LEAST_SETS,
    NO_ESTIMATE,
    Array,
    Estimate,
    Sample,
    cliffs_delta,
    hodges_lehmann_ratio,
    spearman,
)

RESAMPLES = 1000


@dataclass(frozen=True)
class ClassSummary:
    """Errors of one class of sets.

    Attributes:
        name: feasible, inertia only, CoM only, mass only, total mass only, mixed, or `<kind> only`.
        sets: how many, those without a usable error included.
        usable: how many have a finite error.
        clusters: independent units among the usable.
        median, lower_quartile, upper_quartile: of the usable errors, in their unit; None when there
            are fewer than `LEAST_SETS`.
        note: why there is none, else empty.
    """

    name: Annotated[str, Col("sets that violate")]
    sets: Annotated[int, Col()]
    usable: int
    clusters: int
    median: Annotated[float | None, Col("median force error", unit="N")]
    lower_quartile: Annotated[float | None, Col()]
    upper_quartile: Annotated[float | None, Col()]
    note: str = ""


@dataclass(frozen=True)
class DegreeCorrelation:
    """Spearman's rank correlation between the degree of infeasibility and the error.

    Attributes:
        rho: with its 95 % interval; nan where it is not defined.
        sets: with a finite degree and a finite error.
        note: why there is no value or no interval, else empty.
    """

    rho: Estimate
    sets: int
    note: str = ""


@dataclass(frozen=True)
class EffectSize:
    """How the errors of one class differ from another's, with 95 % cluster-bootstrap intervals.

    Attributes:
        first, second: names of the classes.
        delta: Cliff's, P(first > second) - P(first < second): 0 for no difference, 1 when every
            error of the first exceeds every one of the second.
        ratio: of the errors, first to second (Hodges-Lehmann on logarithms): 1 for no difference.
        sets: with a finite error, in the first and in the second.
        note: why there is no value or no interval, else empty.
    """

    first: Annotated[str, Col("class")]
    second: Annotated[str, Col("against")]
    delta: Annotated[Estimate, Col("Cliff's delta")]
    ratio: Annotated[Estimate, Col("times the error")]
    sets: tuple[int, int]
    note: str = ""


@dataclass(frozen=True)
class Comparison:
    """Errors of K sets by class and by degree.

    Attributes:
        classes: those that occur, feasible first, mixed last.
        per_reason: the same summary for all sets that have a reason, alone or among others.
        correlation: over all sets.
        correlation_infeasible: over the infeasible sets alone: does more matter, once it is not 0?
        effects: every class against the first, or the pairs asked for.
        seed: of the bootstrap.
    """

    classes: tuple[ClassSummary, ...]
    per_reason: tuple[ClassSummary, ...]
    correlation: DegreeCorrelation
    correlation_infeasible: DegreeCorrelation
    effects: tuple[EffectSize, ...]
    seed: int

    def of(self, name: str) -> ClassSummary:
        """The summary of a class; TorchidError when no set is in it."""
        for summary in self.classes:
            if summary.name == name:
                return summary
        raise TorchidError(
            "no set is in this class.", got=name, available=[c.name for c in self.classes]
        )


def compare(
    errors: Float[Tensor, " K"],
    reasons: Sequence[Collection[str]],
    degree: Float[Tensor, " K"],
    *,
    cluster: Int[Tensor, " K"] | None = None,
    pairs: Sequence[tuple[str, str]] | None = None,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Comparison:
    """Errors of K sets by class of reasons and by degree of infeasibility.

    Args:
        errors: (K,) one error per set, for instance a column of WrenchErrors.force_rms [N]; a set
            whose error is not finite is counted and left out.
        reasons: per set the reasons why it is infeasible, none for a feasible set.
        degree: (K,) of infeasibility.
        cluster: (K,) which sets belong together (one chain, one direction); each its own if None.
        pairs: classes to compare (first, second); by default every class with feasible (or with
            the first class there is).
        resamples: of the bootstrap.
        seed: of the bootstrap.

    Raises:
        TorchidError: lengths differ, or a pair names a class that does not exist here.
    """
    k = errors.shape[0]
    _check(k, reasons, degree, cluster, resamples)
    values, degrees = (x.detach().double().cpu().numpy() for x in (errors, degree))
    clusters = np.arange(k) if cluster is None else cluster.cpu().numpy()
    names = [class_of(r) for r in reasons]
    members = {name: np.flatnonzero([n == name for n in names]) for name in ordered_classes(names)}
    every_reason = sorted({reason for r in reasons for reason in r})
    present = list(members)
    wanted = [(name, present[0]) for name in present[1:]] if pairs is None else pairs
    for pair in wanted:
        if not set(pair) <= set(present) or pair[0] == pair[1]:
            raise TorchidError(
                "these are not two of the classes here.", got=pair, available=present
            )
    sample = _Sample(values, clusters, resamples, np.random.default_rng(seed))
    infeasible = np.flatnonzero([name != FEASIBLE for name in names])
    return Comparison(
        classes=tuple(sample.summary(name, own) for name, own in members.items()),
        per_reason=tuple(
            sample.summary(reason, np.flatnonzero([reason in r for r in reasons]))
            for reason in every_reason
        ),
        correlation=sample.correlation(degrees, np.arange(k)),
        correlation_infeasible=sample.correlation(degrees, infeasible),
        effects=tuple(sample.effect(a, b, members[a], members[b]) for a, b in wanted),
        seed=seed,
    )


class _Sample(Sample):
    def summary(self, name: str, own: Array) -> ClassSummary:
        usable = own[np.isfinite(self.errors[own])]
        clusters = len(np.unique(self.cluster[usable]))
        if len(usable) < LEAST_SETS:
            note = f"{len(usable)} sets with a finite error, at least {LEAST_SETS} are needed"
            return ClassSummary(name, len(own), len(usable), clusters, None, None, None, note)
        low, median, high = np.percentile(self.errors[usable], [25, 50, 75]).tolist()
        return ClassSummary(name, len(own), len(usable), clusters, median, low, high)

    def correlation(self, degree: Array, own: Array) -> DegreeCorrelation:
        usable = own[np.isfinite(self.errors[own]) & np.isfinite(degree[own])]
        if len(usable) < LEAST_SETS:
            note = f"{len(usable)} usable sets, at least {LEAST_SETS} are needed"
            return DegreeCorrelation(NO_ESTIMATE, len(usable), note)
        rho = self.estimate(lambda s: spearman(degree[s], self.errors[s]), [usable])
        note = "degree or error is the same in all sets" if np.isnan(rho.value) else _note(rho)
        return DegreeCorrelation(rho, len(usable), note)

    def effect(self, first: str, second: str, a: Array, b: Array) -> EffectSize:
        a, b = (x[np.isfinite(self.errors[x])] for x in (a, b))
        if min(len(a), len(b)) < LEAST_SETS:
            note = f"{len(a)} and {len(b)} usable sets, at least {LEAST_SETS} of each are needed"
            return EffectSize(first, second, NO_ESTIMATE, NO_ESTIMATE, (len(a), len(b)), note)
        delta, ratio = (self.against(f, a, b) for f in (cliffs_delta, hodges_lehmann_ratio))
        note = "no ratio: an error is zero" if np.isnan(ratio.value) else _note(delta)
        return EffectSize(first, second, delta, ratio, (len(a), len(b)), note)


def _note(estimate: Estimate) -> str:
    if np.isfinite(estimate.low):
        return ""
    return (
        f"no interval: too few clusters ({estimate.clusters} together), "
        f"at least {LEAST_CLUSTERS} of each class are needed"
    )


def _check(
    k: int,
    reasons: Sequence[Collection[str]],
    degree: Tensor,
    cluster: Tensor | None,
    resamples: int,
) -> None:
    sizes = {"reasons": len(reasons), "degree": degree.shape[0]}
    if cluster is not None:
        sizes["cluster"] = cluster.shape[0]
    wrong = {name: length for name, length in sizes.items() if length != k}
    if k == 0 or wrong:
        raise TorchidError(
            "errors, reasons, degree and cluster are one per set.",
            got=f"{k} errors and {', '.join(f'{v} of {n}' for n, v in (wrong or sizes).items())}",
            expected="the same number of each, one at least",
        )
    if any(isinstance(r, str) for r in reasons):
        raise TorchidError(
            "the reasons of a set are a collection of names, not one string.",
            got=next(repr(r) for r in reasons if isinstance(r, str)),
            expected='("inertia_3", "com_7z"), or () for a feasible set',
        )
    if resamples < 1:
        raise TorchidError("the bootstrap needs resamples.", got=resamples, expected="at least 1")
