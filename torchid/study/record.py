"""A study as its JSON has it: the schema torchid.study/1."""

from msgspec import field

from torchid.extraction.record import CertificateRecord
from torchid.identification.payload import Payload
from torchid.results.record import Part, Real, Record, Rows
from torchid.typing import Float, Tensor


class StudyIdentification(Part, frozen=True, kw_only=True):
    """Base parameters (B,), identified and true, and what they predict."""

    names: tuple[str, ...]
    values: Float[Tensor, " B"]
    true: Float[Tensor, " B"]
    largest_error: Real
    rows: int
    validation_error_percent: tuple[Real, ...]


class RunsRecord(Part, frozen=True, kw_only=True):
    """All R runs of a scenario."""

    phi: Float[Tensor, " R"]
    gamma: Float[Tensor, " R"]
    feasible: int
    gamma_zero: int
    reasons: tuple[tuple[str, ...], ...]
    degree: Float[Tensor, " R"]


class ScenarioRecord(Part, frozen=True, kw_only=True):
    """One scenario: its best set, and all runs."""

    id: str
    bounds: str
    penalty: str = field(name="loss")
    phi: Real
    gamma: Real
    feasible: bool
    reasons: tuple[str, ...]
    degree: Real
    torque_rms: Float[Tensor, " n"]
    force_norm_difference_rms: Float[Tensor, " n"]
    runs: RunsRecord
    contradictions: tuple[str, ...]


class ClassRecord(Part, frozen=True, kw_only=True):
    """Errors of one class of sets."""

    name: str = field(name="class")
    sets: int
    median: float | None = field(name="force_error_median")
    quartiles: tuple[float | None, float | None]


class WrenchesRecord(Part, frozen=True, kw_only=True):
    """Errors of internal forces by class."""

    classes: tuple[ClassRecord, ...]
    unit: str


class StudyPayload(Payload, frozen=True, kw_only=True, tag="torchid.payload/1"):
    """The payload, identified and true (10,) in the tool frame."""

    true: Float[Tensor, "10"]


class StudySearch(Part, frozen=True, kw_only=True):
    """Settings of the searches."""

    runs: int
    stages: int
    generations: int
    schedule: str
    seed: int


class StudyRecord(Record, frozen=True, kw_only=True, tag="torchid.study/1"):
    """A study as its JSON has it; see Study."""

    study: str
    robot: str
    section: str
    identification: StudyIdentification
    sets: tuple[ScenarioRecord, ...]
    certificate: dict[str, CertificateRecord | None]
    wrenches: WrenchesRecord
    payload: StudyPayload
    search: StudySearch
    seconds: dict[str, float]
    warnings: tuple[str, ...]

    @property
    def table(self) -> Rows[ScenarioRecord]:
        """The scenarios."""
        return Rows(self.sets)
