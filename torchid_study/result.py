"""What a study found, and the same as its JSON has it: the schema torchid.study/1."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from msgspec import field

from torchid.extraction.convex.certificate import Certificate
from torchid.extraction.extract import Extraction
from torchid.extraction.record import CertificateRecord, certificate_record
from torchid.feasibility.margins import Feasibility
from torchid.feasibility.sets import ParameterSets
from torchid.identification.identify import Identification
from torchid.identification.payload import Payload
from torchid.log.model import Log
from torchid.results.record import Part, Real, Record, Result, Rows
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor
from torchid.wrenches.deviation import WrenchErrors
from torchid_study.settings import Scenario, StudySettings
from torchid_study.wrenches.compare import Comparison


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


@dataclass(frozen=True, eq=False)
class ScenarioResult:
    """One scenario: all runs, and the best set under the report's id.

    Attributes:
        scenario: bounds and loss.
        extraction: all runs.
        feasibility: of all runs.
        best: the best set, K = 1, with the report's id.
        torque_rms: (n,) its torque against the true one on a new motion [N m].
        torque_relative: the same over the root mean square torque, largest joint.
    """

    scenario: Scenario
    extraction: Extraction
    feasibility: Feasibility
    best: ParameterSets
    torque_rms: Float[Tensor, " n"]
    torque_relative: float

    @property
    def phi(self) -> float:
        """Loss of the best set."""
        return float(self.extraction.phi[self.extraction.best])

    @property
    def gamma(self) -> float:
        """Penalty of the best set."""
        return float(self.extraction.gamma[self.extraction.best])

    @property
    def feasible(self) -> bool:
        """Whether the best set is."""
        return bool(self.feasibility.feasible[self.extraction.best])

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the best set is not feasible."""
        return self.feasibility.reasons(self.extraction.best)

    @property
    def degree(self) -> float:
        """Degree of the best set."""
        return float(self.feasibility.degree[self.extraction.best])


@dataclass(frozen=True, eq=False)
class SetsOnMotion:
    """Truth and sets along one motion.

    Attributes:
        motion: t, q, dq, ddq.
        labels: `real`, then the sets' ids.
        torque: (S + 1, T, n) [N m], real first; empty where not wanted.
        force, moment: (S + 1, T, n) norms of the internal wrenches [N], [N m], real first.
    """

    motion: Log
    labels: tuple[str, ...]
    torque: Float[Tensor, "S T n"]
    force: Float[Tensor, "S T n"]
    moment: Float[Tensor, "S T n"]


@dataclass(frozen=True, eq=False)
class PayloadResult:
    """A payload identified from the change of base parameters, and what it does inside.

    Attributes:
        true: (10,) in the tool frame, as simulated.
        estimate: from logs with noise of encoder and torque.
        force: (3, T, n) norms: without, with the true, with the estimated payload [N].
    """

    true: Float[Tensor, "10"]
    estimate: Payload
    force: Float[Tensor, "3 T n"]


@dataclass(frozen=True, eq=False)
class Study(Result):
    """Everything a study found.

    Attributes:
        settings, robot: what was studied.
        excitation: planned motion; log: with torque and noise.
        identification, truth: base parameters, identified and true (B,).
        validation: log of a new motion.
        scenarios: six, in the settings' order.
        certificates: by group of bounds: with all conditions, or with the bounds alone where the
            conditions leave no set.
        sets_motion: torques of the best sets; wrench_motion: their wrenches.
        errors: of all runs of all scenarios, against the true set; comparison: by reason, degree.
        payload: the last part.
        seconds: by part.
        warnings: sentences.
    """

    settings: StudySettings
    robot: Robot
    excitation: Log
    log: Log
    identification: Identification
    truth: Float[Tensor, " B"]
    validation: Log
    scenarios: tuple[ScenarioResult, ...]
    certificates: Mapping[str, Certificate]
    sets_motion: SetsOnMotion
    wrench_motion: SetsOnMotion
    errors: WrenchErrors
    comparison: Comparison
    payload: PayloadResult
    seconds: Mapping[str, float]
    warnings: tuple[str, ...]

    def __repr__(self) -> str:
        feasible = sum(s.feasible for s in self.scenarios)
        return (
            f"Study('{self.settings.name}', {feasible} of {len(self.scenarios)} best sets feasible)"
        )

    @cached_property
    def record(self) -> StudyRecord:
        """As the JSON has it."""
        result = self.identification
        errors = result.held_out
        return StudyRecord(
            study=self.settings.name,
            robot=self.robot.name,
            section=self.settings.section,
            identification=StudyIdentification.of(
                result,
                names=result.base.names,
                true=self.truth,
                largest_error=float((result.values - self.truth).abs().max()),
                rows=int(self.log.samples * self.robot.n),
                validation_error_percent=(
                    () if errors is None else tuple(errors.relative_percent.tolist())
                ),
            ),
            sets=tuple(_scenario(self, s) for s in self.scenarios),
            certificate={
                group: certificate_record(proof) for group, proof in self.certificates.items()
            },
            wrenches=WrenchesRecord(
                classes=tuple(
                    ClassRecord.of(c, quartiles=(c.lower_quartile, c.upper_quartile))
                    for c in self.comparison.classes
                ),
                unit="N, largest joint's rms against the true set, all runs of all scenarios",
            ),
            payload=StudyPayload.of(self.payload.estimate.record, true=self.payload.true),
            search=StudySearch.of(self.settings.search),
            seconds=dict(self.seconds),
            warnings=self.warnings,
        )


def _scenario(study: Study, result: ScenarioResult) -> ScenarioRecord:
    extraction, scenario = result.extraction, result.scenario
    at = study.wrench_motion.labels.index(scenario.id)
    force = study.wrench_motion.force
    return ScenarioRecord.of(
        result,
        scenario,
        force_norm_difference_rms=(force[at] - force[0]).square().mean(0).sqrt(),
        runs=RunsRecord.of(
            extraction,
            feasible=int(result.feasibility.feasible.sum()),
            gamma_zero=int((extraction.gamma == 0).sum()),
            reasons=[result.feasibility.reasons(k) for k in range(len(extraction.phi))],
            degree=result.feasibility.degree,
        ),
        contradictions=extraction.contradictions,
    )
