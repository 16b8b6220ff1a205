"""Does the degree of infeasibility matter for internal forces, and if so, through what?

Medians by kind and by third of the degree, rank correlations, and comparisons at equal difference
of the carried mass, all with intervals that resample whole chains of the sampler.

The force at a joint does not depend on J (eq. 2.32): at rest it is the weight of what the joint
carries, M_i = m_i + ... + m_n, and in motion the first moments add to it. So a degree can matter
only as far as it goes with a difference of the carried masses; `matched` asks whether anything is
left beside that.
"""

from dataclasses import dataclass

import numpy as np

from torchid.results.record import Real
from torchid.wrenches.resampling import (
    LEAST_SETS,
    NO_ESTIMATE,
    Array,
    Estimate,
    Sample,
    cliffs_delta,
    hodges_lehmann_ratio,
    spearman,
)

THIRDS = ("nearest the boundary", "middle", "furthest from it")
"""Thirds of a kind's sets by the size of their degree."""
STRATA = 20
NEAR = 0.02
"""Degree up to which a set is near the boundary."""
TIGHTEST = ("inertia", "com", "mass", "total_mass")
"""Kinds of a single condition, which a feasible set can be near to violating."""


@dataclass(frozen=True, eq=False)
class Samples:
    """What is known of each of K sets, for statistics.

    Attributes:
        kind: (K,).
        error: (K,) largest over the joints of the root mean square force error [N].
        degree: (K,) signed: the firmest have the largest, infeasible ones negative.
        carried: (K,) largest difference of the carried mass over the joints [kg].
        coordinates: (K,) centres of mass's coordinates that are out of their box.
        tightest: (K,) kind of the condition with the smallest degree: inertia, com, mass, ...
        cluster: (K,) chain of the sampler.
    """

    kind: Array
    error: Array
    degree: Array
    carried: Array
    coordinates: Array
    tightest: Array
    cluster: Array

    def of(self, kind: str) -> Array:
        """Indices of a kind."""
        return np.flatnonzero(self.kind == kind)

    def third(self, kind: str, third: int) -> Array:
        """Indices of a third of a kind: 0 nearest the boundary, 2 furthest from it."""
        own = self.of(kind)
        own = own[np.argsort(np.abs(self.degree[own]), kind="stable")]
        return np.array_split(own, 3)[third]


@dataclass(frozen=True)
class ThirdSummary:
    """Errors of a third of a kind, and against the feasible sets nearest the boundary.

    Attributes:
        kind, third: which; see `THIRDS`.
        degree: lowest and highest.
        median: of the errors [N].
        ratio: of the errors to those of the feasible sets nearest the boundary (Hodges-Lehmann).
        delta: Cliff's, against the same.
    """

    kind: str
    third: str
    degree: tuple[Real, Real]
    median: Real
    ratio: Estimate
    delta: Estimate


@dataclass(frozen=True)
class KindCorrelations:
    """Rank correlations of the force error within one kind, or over all sets.

    Attributes:
        kind: or `all`.
        sets: how many.
        degree: Spearman's rho with the degree: negative when firmer sets, and less infeasible ones,
            have smaller errors.
        carried: rho with the difference of the carried mass.
        coordinates: rho with the number of coordinates of centres of mass out of their box.
    """

    kind: str
    sets: int
    degree: Estimate
    carried: Estimate
    coordinates: Estimate


@dataclass(frozen=True)
class Matched:
    """A kind against the feasible sets, among sets with about the same carried masses' difference.

    Attributes:
        kind: which.
        delta: Cliff's within strata of the difference, averaged by their pairs.
        share: of the kind's sets that are in strata with feasible ones.
        unmatched: Cliff's delta without strata.
    """

    kind: str
    delta: Estimate
    share: Real
    unmatched: Estimate


@dataclass(frozen=True)
class Across:
    """Just infeasible against just feasible: the sets of a kind whose degree is within `NEAR` of
    the boundary, against the feasible ones of which a condition of the same kind is as near (not
    always the same condition: sets leave through faces that feasible ones seldom approach).

    Attributes:
        kind: which.
        sets: just infeasible ones, just feasible ones.
        medians: of their errors [N]; nan where there is none.
        ratio, delta: of the errors, infeasible to feasible; without an interval where there are too
            few sets or chains.
    """

    kind: str
    sets: tuple[int, int]
    medians: tuple[Real, Real]
    ratio: Estimate
    delta: Estimate


@dataclass(frozen=True)
class Statistics:
    """All of them, for one family of sets."""

    thirds: tuple[ThirdSummary, ...]
    correlations: tuple[KindCorrelations, ...]
    matched: tuple[Matched, ...]
    across: tuple[Across, ...]


def statistics(samples: Samples, *, resamples: int = 1000, seed: int = 0) -> Statistics:
    """Thirds, correlations and matched comparisons of a family that has feasible sets.

    Args:
        samples: the sets.
        resamples: of the bootstrap.
        seed: of the bootstrap.
    """
    ask = _Asker(samples.error, samples.cluster, resamples, np.random.default_rng(seed), samples)
    kinds = list(dict.fromkeys(samples.kind.tolist()))
    large = [kind for kind in kinds if len(samples.of(kind)) >= 3 * LEAST_SETS]
    return Statistics(
        thirds=tuple(ask.third(kind, t) for kind in large for t in range(3)),
        correlations=tuple(ask.correlations(kind) for kind in ("all", *large)),
        matched=tuple(ask.matched(kind) for kind in large if kind != "feasible"),
        across=tuple(ask.across(kind) for kind in large if kind in TIGHTEST),
    )


def stratified_delta(a: Array, b: Array, by_a: Array, by_b: Array) -> float:
    """Cliff's delta within strata of equal numbers, averaged by n_a n_b / (n_a + n_b), as in a
    van Elteren test; nan when no stratum has both."""
    in_a, in_b = _strata(by_a, by_b)
    weights, deltas = [], []
    for s in range(STRATA):
        own_a, own_b = a[in_a == s], b[in_b == s]
        if len(own_a) and len(own_b):
            weights.append(len(own_a) * len(own_b) / (len(own_a) + len(own_b)))
            deltas.append(cliffs_delta(own_a, own_b))
    return float(np.average(deltas, weights=weights)) if weights else float("nan")


@dataclass(frozen=True)
class _Asker(Sample):
    samples: Samples

    def third(self, kind: str, third: int) -> ThirdSummary:
        s = self.samples
        own, base = s.third(kind, third), s.third("feasible", 0)
        degree = s.degree[own]
        return ThirdSummary(
            kind,
            THIRDS[third],
            (float(degree.min()), float(degree.max())),
            float(np.median(s.error[own])),
            *self._both(own, base),
        )

    def correlations(self, kind: str) -> KindCorrelations:
        s = self.samples
        own = np.arange(len(s.kind)) if kind == "all" else s.of(kind)

        def rho(x: Array) -> Estimate:
            return self.estimate(lambda k: spearman(x[k], s.error[k]), [own])

        return KindCorrelations(
            kind,
            len(own),
            rho(s.degree),
            rho(s.carried),
            rho(s.coordinates) if s.coordinates[own].any() else NO_ESTIMATE,
        )

    def matched(self, kind: str) -> Matched:
        s = self.samples
        own, base = s.of(kind), s.of("feasible")
        inside = np.isin(np.arange(len(s.kind)), own)

        def delta(k: Array) -> float:
            a, b = k[inside[k]], k[~inside[k]]
            return stratified_delta(s.error[a], s.error[b], s.carried[a], s.carried[b])

        return Matched(
            kind,
            self.estimate(delta, [own, base]),
            float(np.isin(*_strata(s.carried[own], s.carried[base])).mean()),
            self.against(cliffs_delta, own, base),
        )

    def across(self, kind: str) -> Across:
        s = self.samples
        own, base = s.of(kind), s.of("feasible")
        own = own[np.abs(s.degree[own]) < NEAR]
        base = base[(s.degree[base] < NEAR) & (s.tightest[base] == kind)]
        middle = [float(np.median(s.error[k])) if len(k) else float("nan") for k in (own, base)]
        return Across(
            kind,
            (len(own), len(base)),
            (middle[0], middle[1]),
            *self._both(own, base),
        )

    def _both(self, own: Array, base: Array) -> tuple[Estimate, Estimate]:
        """Ratio and delta of the errors of one group against another's; none against itself."""
        if np.array_equal(own, base):
            return NO_ESTIMATE, NO_ESTIMATE
        ratio, delta = (self.against(f, own, base) for f in (hodges_lehmann_ratio, cliffs_delta))
        return ratio, delta


def _strata(by_a: Array, by_b: Array) -> tuple[Array, Array]:
    """Stratum of each number of two samples: as many numbers in each, of both together."""
    edges = np.quantile(np.concatenate([by_a, by_b]), np.linspace(0, 1, STRATA + 1)[1:-1])
    return np.searchsorted(edges, by_a), np.searchsorted(edges, by_b)


Range = tuple[Real, Real, Real]
"""Median of several numbers, and the range of 95 % of them."""


@dataclass(frozen=True)
class OtherTruths:
    """The same question if another feasible set of equal torque were the arm.

    The torque cannot tell them apart, so every feasible set may be the true one: each is taken for
    the truth in turn.

    Attributes:
        kind: compared with the feasible sets.
        ratio: median error of the kind over that of the feasible sets.
        better: share of pairs of a set of the kind and a feasible set in which the infeasible one
            is nearer to the truth.
    """

    kind: str
    ratio: Range
    better: Range


@dataclass(frozen=True)
class FirmTruths:
    """Spearman's rho of degree and error among feasible sets, by how firm the truth is.

    Attributes:
        third: of the truths by their own degree, see `THIRDS`.
        rho: over these truths.
    """

    third: str
    rho: Range


def other_truths(
    kind: Array, degree: Array, distances: Array
) -> tuple[tuple[OtherTruths, ...], tuple[FirmTruths, ...]]:
    """Comparisons for every feasible set as the truth.

    Args:
        kind: (K,).
        degree: (K,).
        distances: (F, K) force error of each set if feasible set f, in their order, is the truth.
    """
    feasible = np.flatnonzero(kind == "feasible")
    others = distances[:, feasible]
    bare = others[~np.eye(len(feasible), dtype=bool)].reshape(len(feasible), -1)
    own = np.median(bare, 1)
    compared = []
    for name in dict.fromkeys(kind.tolist()):
        if name == "feasible":
            continue
        errors = distances[:, kind == name]
        ratio = np.median(errors, 1) / own
        better = [(1 - cliffs_delta(e, b)) / 2 for e, b in zip(errors, bare, strict=True)]
        compared.append(OtherTruths(name, middle_range(ratio), middle_range(np.array(better))))
    ranks = np.argsort(degree[feasible], kind="stable")
    firm = []
    for third, rows in zip(THIRDS, np.array_split(ranks, 3), strict=True):
        rho = []
        for k in rows:
            rest = np.delete(np.arange(len(feasible)), k)
            rho.append(spearman(degree[feasible][rest], others[k, rest]))
        firm.append(FirmTruths(third, middle_range(np.array(rho))))
    return tuple(compared), tuple(firm)


def middle_range(values: Array) -> Range:
    """Median of numbers, and the range of 95 % of them; nan counts as none."""
    low, middle, high = np.nanpercentile(values, [2.5, 50, 97.5]).tolist()
    return middle, low, high
