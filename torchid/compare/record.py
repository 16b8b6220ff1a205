"""Comparisons as their JSON has them: the schema torchid.compare/1."""

from typing import Literal

from msgspec import UNSET, UnsetType, field

from torchid.results.record import Part, Real, Record, Rows
from torchid.typing import Bool, Float, Tensor

Verdict = Literal["agree", "drift", "differ", "never_determined", "not_compared"]
State = Literal["named", "not_testable", "not_found"]


class TorqueSpread(Part, frozen=True):
    """Torque of m models on one motion [N m; N].

    Attributes:
        source: of the motion, in words.
        size: (n,) RMS of the models' mean.
        spread: (n,) standard deviation between models, RMS over the motion.
        pairs: (m, m, n) RMS of every difference of two models.
        claimed: (n,) RMS of the standard deviation that the parameters' covariances claim for a
            model's torque; None where there are none.
        errors: (m, n) RMS of the measured torque minus each model's; None without a log.
    """

    source: str = field(name="on")
    size: Float[Tensor, " n"] = field(name="rms")
    spread: Float[Tensor, " n"]
    pairs: Float[Tensor, "m m n"]
    claimed: Float[Tensor, " n"] | None = field(name="claimed_std", default=None)
    errors: Float[Tensor, "m n"] | None = None


class ComparedParameter(Part, frozen=True, kw_only=True):
    """One parameter in m identifications.

    Attributes:
        name, unit: as in the results.
        verdict: `differ`: Welch's test rejects equal values at 5 % after Holm's correction;
            `drift`: and the values rise or fall from each result to the next; `never_determined`:
            relative standard deviation above 50 % in every result that has it; `not_compared`:
            estimated in fewer than two results; else `agree`.
        values, std: (m,) per result; std is nan where it is not estimated, value where it is not
            even in the result's structure.
        held: (m,) held at zero by the fit.
        p_holm: adjusted for all parameters compared; None where not compared, as what follows.
        p, birge, between, consensus, consensus_std, consensus_ci95: as
            `torchid.compare.scatter.Scatter` has them.
    """

    name: str
    unit: str
    verdict: Verdict
    values: Float[Tensor, " m"]
    std: Float[Tensor, " m"]
    held: Bool[Tensor, " m"] = field(name="held_at_zero")
    p_holm: float | None
    p: float | None = None
    birge: float | None = None
    between: float | None = field(name="between_std", default=None)
    consensus: float | None = None
    consensus_std: float | None = None
    consensus_ci95: tuple[float, float] | UnsetType = UNSET


class BirgeRecord(Part, frozen=True, kw_only=True):
    """Ratios of the scatter to what standard deviations claim.

    Attributes:
        pooled: over the parameters, without their correlations.
        pooled_expected: 2.5 %, 50 % and 97.5 % of its distribution without a difference.
        typical: of the typical parameter (median).
    """

    pooled: float | None = None
    pooled_expected: tuple[float, ...] | None = None
    typical: float | None = None


class Whole(Part, frozen=True, kw_only=True):
    """All parameters together.

    Attributes:
        q: the statistic.
        count: D (m - 1), its degrees of freedom were the covariances known.
        expected: 2.5 %, 50 % and 97.5 % of its distribution without a difference.
        p: share of that beyond q (one more of each counted, so never 0).
        birge: sqrt(q / mean of that distribution).
    """

    q: Real = field(name="chi_square")
    count: int = field(name="degrees_of_freedom")
    expected: tuple[float, ...]
    p: Real
    birge: Real


class Comparison(Record, frozen=True, kw_only=True, tag="torchid.compare/1"):
    """Identifications compared.

    Attributes:
        robot: its name, or names.
        labels: (m,) of the results, in the order given.
        counts: of parameters by verdict.
        parameters: every parameter that any result has.
        correction: of the p-values.
        birge: by how much the results scatter more than they claim.
        whole: all parameters that every result estimates, with their correlations; None where
            there are none.
        torque: None without the robot.
        notes: sentences for the user.
        quantiles: (m,) half-widths of the results' 95 % intervals in standard deviations; none in
            older files, as `same_motion`.
        same_motion: whether two were fitted on a trajectory of the same name.
        seed: from a command.
    """

    robot: str
    labels: tuple[str, ...] = field(name="results")
    compared: Literal["identifications"] = "identifications"
    counts: dict[str, int]
    parameters: tuple[ComparedParameter, ...]
    correction: str = "Holm, family-wise 5 %"
    birge: BirgeRecord
    whole: Whole | None
    torque: TorqueSpread | None
    notes: tuple[str, ...]
    quantiles: tuple[float, ...] = field(name="quantile95", default=())
    same_motion: bool = False
    seed: int | UnsetType = UNSET

    @property
    def table(self) -> Rows[ComparedParameter]:
        """The parameters."""
        return Rows(self.parameters)

    def having(self, *verdicts: Verdict) -> list[ComparedParameter]:
        """Parameters of these verdicts."""
        return [p for p in self.parameters if p.verdict in verdicts]

    def __repr__(self) -> str:
        return (
            f"Comparison('{self.robot}', {len(self.labels)} identifications, "
            f"{len(self.having('agree'))} of {len(self.parameters)} parameters agree)"
        )


class Named(Part, frozen=True):
    """An effect as one diagnosis names it.

    Attributes:
        effect, family: which.
        place: joints (from 1) it is at; empty for the whole arm.
        also: names that it cannot be told from.
        values, std: coefficients and their standard deviations [units].
        shapes: its shape parameters.
        units: of both.
        share: of the gap.
    """

    effect: str
    family: str
    place: tuple[int, ...] = field(name="joints")
    also: tuple[str, ...] = field(name="ambiguous_with")
    values: dict[str, float]
    std: dict[str, float]
    shapes: dict[str, float]
    units: dict[str, str]
    share: float | None


class ComparedCoefficient(Part, frozen=True, kw_only=True):
    """A coefficient that two or more diagnoses give: estimates, and whether they agree."""

    name: str
    unit: str
    values: tuple[float | None, ...]
    std: tuple[float | None, ...]
    p_holm: Real
    p: Real
    birge: Real
    between: Real = field(name="between_std")
    consensus: Real
    consensus_std: Real
    consensus_ci95: tuple[float, float]


class Shared(Part, frozen=True, kw_only=True):
    """One cause over all diagnoses: effects at one place that name each other as alternatives.

    Attributes:
        effects: their names, the most frequent first.
        place: joints, from 1.
        everywhere: whether every diagnosis names it.
        states: (m,) what each diagnosis says.
        named: (m,) entries, None where not named.
        smallest: (m,) smallest detectable size where it was not testable.
        coefficients: those of an effect that two or more name alike.
    """

    effects: tuple[str, ...]
    place: tuple[int, ...] = field(name="joints")
    everywhere: bool = field(name="named_in_all")
    states: tuple[State, ...]
    named: tuple[Named | None, ...]
    smallest: tuple[float | None, ...] = field(name="smallest_detectable")
    coefficients: tuple[ComparedCoefficient, ...]


class GapComparison(Record, frozen=True, kw_only=True, tag="torchid.compare/1"):
    """Gap diagnoses compared.

    Attributes:
        robot: its name, or names.
        labels, statuses, closed: (m,) of the diagnoses, in the order given.
        shared: causes, those that most name first.
        torque: of the corrected models; None where they were not recorded.
        notes: sentences for the user.
        seed: from a command.
    """

    robot: str
    labels: tuple[str, ...] = field(name="results")
    compared: Literal["gap diagnoses"] = "gap diagnoses"
    statuses: tuple[str, ...] = field(name="status")
    closed: tuple[float | None, ...]
    shared: tuple[Shared, ...] = field(name="effects")
    torque: TorqueSpread | None
    notes: tuple[str, ...]
    seed: int | UnsetType = UNSET

    @property
    def table(self) -> Rows[Shared]:
        """The causes."""
        return Rows(self.shared)

    def __repr__(self) -> str:
        shared = sum(s.everywhere for s in self.shared)
        return (
            f"GapComparison('{self.robot}', {len(self.labels)} diagnoses, {shared} of "
            f"{len(self.shared)} causes in all)"
        )


class Range(Part, frozen=True):
    """One parameter: its lowest and highest value in each file, (m,).

    `differ`: two files' ranges have no value in common; `drift`: and the middles of all rise or
    fall in the order given; `never_determined`: the range exceeds +-50 % in every file.
    """

    name: str
    unit: str
    verdict: Verdict
    low: Float[Tensor, " m"]
    high: Float[Tensor, " m"]


class SetComparison(Record, frozen=True, kw_only=True, tag="torchid.compare/1"):
    """Files of parameter sets compared.

    Attributes:
        robot: its name.
        labels, counts: (m,) of the files: names, and how many sets each holds.
        physical, base: ranges of the physical parameters and of the base parameters.
        torque: of each file's mean set.
        notes: sentences for the user.
        seed: from a command.
    """

    robot: str
    labels: tuple[str, ...] = field(name="results")
    compared: Literal["parameter sets"] = "parameter sets"
    counts: tuple[int, ...] = field(name="sets")
    physical: tuple[Range, ...] = field(name="parameters")
    base: tuple[Range, ...] = field(name="base_parameters")
    torque: TorqueSpread
    notes: tuple[str, ...]
    seed: int | UnsetType = UNSET

    @property
    def table(self) -> Rows[Range]:
        """The physical parameters."""
        return Rows(self.physical)
