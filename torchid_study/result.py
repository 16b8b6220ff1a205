"""What a study found, and the same as its JSON has it: the schema torchid.study/1."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from msgspec import field

from torchid.extraction.found import Extraction
from torchid.extraction.record import CertificateRecord
from torchid.feasibility.sets import ParameterSets
from torchid.identification.payload import Payload
from torchid.results.record import Col, Part, Real, Record, Rows
from torchid.typing import Float, Tensor
from torchid.wrenches.deviation import WrenchErrors
from torchid_study.wrenches.compare import Comparison
from torchid_study.wrenches.resampling import quartile_words, quartiles


class StudyIdentification(Part, frozen=True, kw_only=True):
    """Base parameters (B,), identified and true, and what they predict."""

    names: tuple[str, ...]
    values: Float[Tensor, " B"]
    true: Float[Tensor, " B"]
    largest_error: Real
    rows: int
    validation_error_percent: tuple[Real, ...]


def _spread(values: Tensor) -> str:
    return quartile_words(quartiles(values))


class RunsRecord(Part, frozen=True, kw_only=True):
    """All R runs of a scenario."""

    phi: Annotated[Float[Tensor, " R"], Col(words=_spread)]
    gamma: Annotated[Float[Tensor, " R"], Col(words=_spread)]
    feasible: Annotated[int, Col()]
    gamma_zero: Annotated[int, Col("gamma = 0")]
    reasons: tuple[tuple[str, ...], ...]
    degree: Annotated[Float[Tensor, " R"], Col(words=_spread)]


class ScenarioRecord(Part, frozen=True, kw_only=True):
    """One scenario: its best set, and all runs."""

    id: Annotated[str, Col("set")]
    bounds: Annotated[str, Col()]
    penalty: Annotated[str, Col("loss")] = field(name="loss")
    phi: Annotated[Real, Col(digits=".4g")]
    gamma: Annotated[Real, Col()]
    feasible: Annotated[bool, Col()]
    reasons: Annotated[tuple[str, ...], Col("why not")]
    degree: Annotated[Real, Col(digits=".2g")]
    torque_rms: Annotated[Float[Tensor, " n"], Col("torque error, new motion")]
    force_norm_difference_rms: Annotated[Float[Tensor, " n"], Col("force error", unit="N")]
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
    certificate: dict[str, CertificateRecord]
    wrenches: WrenchesRecord
    payload: StudyPayload
    search: StudySearch
    seconds: dict[str, float]
    warnings: tuple[str, ...]

    @property
    def table(self) -> Rows[ScenarioRecord]:
        """The scenarios."""
        return Rows(self.sets)


@dataclass(frozen=True, eq=False)
class Study:
    """Everything a study found.

    Attributes:
        title: of the study.
        record: as its JSON has it.
        extractions: of each scenario, in the settings' order.
        best: the best set of each scenario, under the report's id.
        every: the sets of all runs of all scenarios, under ids like p_25/run_3.
        errors: of the wrenches of every set, against the true set.
        comparison: of the largest force error over the joints, by reason and degree.
    """

    title: str
    record: StudyRecord
    extractions: Sequence[Extraction]
    best: ParameterSets
    every: ParameterSets
    errors: WrenchErrors
    comparison: Comparison
