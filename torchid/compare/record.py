"""Comparisons as their JSON has them: the schema torchid.compare/1."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Generic, Literal, Protocol, TypeVar, runtime_checkable

from msgspec import UNSET, UnsetType, field

from torchid.results.record import Part, Real, Record, Rows
from torchid.typing import Bool, Float, Tensor

Verdict = Literal["agree", "drift", "differ", "never_determined", "not_compared"]
State = Literal["named", "not_testable", "not_found"]


@runtime_checkable
class _Verdict(Protocol):
    @property
    def verdict(self) -> Verdict: ...


_P = TypeVar("_P", bound=_Verdict)


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
    """One parameter in m identifications; see torchid.compare.identifications.Compared."""

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
    """Ratios of the scatter to what standard deviations claim."""

    pooled: float | None
    pooled_expected: tuple[float, ...] | None
    typical: float | None


class WholeRecord(Part, frozen=True, kw_only=True):
    """All parameters together."""

    q: Real = field(name="chi_square")
    count: int = field(name="degrees_of_freedom")
    expected: tuple[float, ...]
    p: Real
    birge: Real


class Judged(Generic[_P]):
    """Parameters with verdicts, compared just now or read back."""

    __slots__ = ()

    if TYPE_CHECKING:

        @property
        def parameters(self) -> Sequence[_P]:
            """All of them."""

    def having(self, *verdicts: Verdict) -> list[_P]:
        """Parameters of these verdicts."""
        return [p for p in self.parameters if p.verdict in verdicts]


class ComparisonRecord(
    Judged[ComparedParameter], Record, frozen=True, kw_only=True, tag="torchid.compare/1"
):
    """Identifications compared, as the JSON has it."""

    robot: str
    results: tuple[str, ...]
    compared: Literal["identifications"] = "identifications"
    counts: dict[str, int]
    parameters: tuple[ComparedParameter, ...]
    correction: str
    birge: BirgeRecord
    whole: WholeRecord | None
    torque: TorqueSpread | None
    notes: tuple[str, ...]
    seed: int | UnsetType = UNSET

    @property
    def table(self) -> Rows[ComparedParameter]:
        """The parameters."""
        return Rows(self.parameters)


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
    """A coefficient that two or more diagnoses give."""

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


class SharedRecord(Part, frozen=True, kw_only=True):
    """One cause over all diagnoses; joints from 1."""

    effects: tuple[str, ...]
    place: tuple[int, ...] = field(name="joints")
    everywhere: bool = field(name="named_in_all")
    states: tuple[State, ...]
    named: tuple[Named | None, ...]
    smallest: tuple[float | None, ...] = field(name="smallest_detectable")
    coefficients: tuple[ComparedCoefficient, ...]


class GapComparisonRecord(Record, frozen=True, kw_only=True, tag="torchid.compare/1"):
    """Diagnoses compared, as the JSON has it."""

    robot: str
    results: tuple[str, ...]
    compared: Literal["gap diagnoses"] = "gap diagnoses"
    statuses: tuple[str, ...] = field(name="status")
    closed: tuple[float | None, ...]
    effects: tuple[SharedRecord, ...]
    torque: TorqueSpread | None
    notes: tuple[str, ...]
    seed: int | UnsetType = UNSET

    @property
    def table(self) -> Rows[SharedRecord]:
        """The causes."""
        return Rows(self.effects)


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


class SetComparisonRecord(Record, frozen=True, kw_only=True, tag="torchid.compare/1"):
    """Files of sets compared, as the JSON has it."""

    robot: str
    results: tuple[str, ...]
    compared: Literal["parameter sets"] = "parameter sets"
    counts: tuple[int, ...] = field(name="sets")
    physical: tuple[Range, ...] = field(name="parameters")
    base: tuple[Range, ...] = field(name="base_parameters")
    torque: TorqueSpread | None
    notes: tuple[str, ...]
    seed: int | UnsetType = UNSET

    @property
    def table(self) -> Rows[Range]:
        """The physical parameters."""
        return Rows(self.physical)
