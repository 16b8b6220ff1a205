"""A diagnosis of every log of a fleet: which effects the type has, and which are a unit's own."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal

from msgspec import UNSET, UnsetType

from torchid import __version__
from torchid.doctor.first import ask_first
from torchid.errors import LogError, TorchidError
from torchid.fleet.factors import with_gain
from torchid.fleet.identify import Part as Share
from torchid.fleet.identify import kept, part_of, write_index
from torchid.fleet.manifest import FleetLog
from torchid.fleet.model import FleetModel
from torchid.fleet.tasks import LogAnswer, LogTask, answered
from torchid.gap.settings import GapSettings
from torchid.gap.torque import diagnose_torque
from torchid.json_data import plain
from torchid.log.readers import open_log
from torchid.parallel.store import Store
from torchid.parallel.workers import Failure, Progress, Workers, attempted
from torchid.results.record import Col, Joint, Part, Real, RobotRecord, Rows
from torchid.results.words import interval, listed, percent, regime_words
from torchid.robot.library import named_record
from torchid.statistics.proportion import clopper_pearson

Scope = Literal["type", "some", "unit"]

SCOPES: dict[Scope, str] = {"type": "the type's", "some": "some units'", "unit": "a unit's own"}
"""In words."""


@dataclass(frozen=True)
class GapTask(LogTask):
    """A log to be diagnosed."""

    settings: GapSettings


def answer_gap(task: GapTask) -> tuple[LogAnswer, dict[str, Any]]:
    """Diagnose a log, unless the store has its diagnosis already; what became of the log, and the
    diagnosis as its JSON has it, as far as a fleet needs it.

    Raises:
        RefusedError: this worker has another torchid.
        TorchidError: the store cannot be written, or somebody writes to the log.
    """

    def compute(path):  # type: ignore[no-untyped-def]
        try:
            log = with_gain(open_log(path, task.model.request)[1], task.model)
            robot, force = task.model.robot, task.model.settings.force
            doubts = ask_first(robot, log, force=force)
            diagnosis = diagnose_torque(robot, log, settings=task.settings, force=force)
        except TorchidError as error:
            text = " ".join(str(error).replace(str(path), task.log.path).split())
            return {"refused": text}
        return {
            "gap": diagnosis.plain(),
            "seconds": sum(log.duration),
            "doubts": list(doubts.sentences),
        }

    question = {"kind": "gap", "settings": asdict(task.settings)}
    try:
        digest, key, words, stored = answered(
            task.log, task.model, Store(task.place), question, compute
        )
    except LogError as error:
        return LogAnswer.unopened(task.log, error), {}
    if "refused" in words:
        return LogAnswer.about(task.log, "refused", words["refused"], sha256=digest, key=key), {}
    gap, doubts = words["gap"], words["doubts"]
    wanted = ("status", "where", "which", "how_far")
    answer = LogAnswer.about(
        task.log, "doubtful" if doubts else "good", *doubts, sha256=digest, key=key,
        seconds=words["seconds"], stored=stored,
    )  # fmt: skip
    return answer, {name: gap[name] for name in wanted}


def _largest(gap: tuple[float, ...]) -> str:
    """`2.1 on joint 3`."""
    return f"{max(gap):.2g} on joint {gap.index(max(gap)) + 1}" if gap else "-"


class DiagnosedLog(Part, frozen=True, kw_only=True):
    """One log and its diagnosis.

    Attributes:
        unit, session, log: which.
        status: of the diagnosis; `refused` or `failed` where there is none.
        evidence: why there is none.
        key: of the whole diagnosis in the store.
        gap: (n,) RMS gap of each joint as a share of the upper end of its noise floor.
        closed: share of the gap beyond noise that the effects close.
        effects: that are named, e.g. `viscous_friction of joint 2`.
    """

    unit: Annotated[str, Col()]
    session: Annotated[str, Col()]
    log: str
    status: Annotated[str, Col(words=regime_words)]
    evidence: str
    key: str
    gap: Annotated[tuple[Real, ...], Col("largest gap / noise", words=_largest)]
    closed: Annotated[float | None, Col(words=percent)]
    effects: tuple[str, ...]

    @property
    def named(self) -> Annotated[str, Col()]:
        """Its effects, or why there is no diagnosis."""
        return "; ".join(self.effects) or self.evidence


class FleetEffect(Part, frozen=True, kw_only=True):
    """An effect at a place, over the fleet.

    Attributes:
        effect, family, joints: which.
        units: that have it in one of their logs at least.
        share, ci95: of the units, and its interval (Clopper and Pearson 1934).
        scope: `type`: surely more than half of the units have it; `unit`: surely fewer; `some`.
        ambiguous_with: that some diagnosis could not tell it from.
        coefficients: by unit; of several logs the first one's.
    """

    effect: str
    family: str
    joints: tuple[Joint, ...]
    units: Annotated[tuple[str, ...], Col("which", words=lambda units: listed(units, most=4))]
    share: float
    ci95: Annotated[tuple[float, float], Col("95 %", words=interval)]
    scope: Annotated[Scope, Col("is", words=SCOPES.__getitem__)]
    ambiguous_with: Annotated[tuple[str, ...], Col("or")]
    coefficients: dict[str, dict[str, float]]

    @property
    def label(self) -> Annotated[str, Col("effect")]:
        """Name and place."""
        return effect_label(self.effect, [j + 1 for j in self.joints])


class FleetGap(RobotRecord, frozen=True, eq=False, kw_only=True, tag="torchid.fleet_gap/1"):
    """A fleet's gaps as the JSON has them.

    Attributes:
        version: of torchid.
        units: that have a diagnosis.
        effects: the most common first.
        logs: one entry each.
        notes: sentences for the user.
        seed: from a command.
    """

    version: str
    units: tuple[str, ...]
    effects: tuple[FleetEffect, ...]
    logs: tuple[DiagnosedLog, ...]
    notes: tuple[str, ...]
    seed: int | UnsetType = UNSET

    def __repr__(self) -> str:
        return f"FleetGap('{self.robot}', {len(self.units)} units)"

    @property
    def table(self) -> Rows[FleetEffect]:
        """The effects."""
        return Rows(self.effects)


def effect_label(effect: str, joints: Sequence[int]) -> str:
    """`backlash of joint 2`; joints from 1."""
    if not joints:
        return effect
    return f"{effect} of joint {', '.join(map(str, joints))}"


def described(model: FleetModel, answers: Sequence[tuple[LogAnswer, dict[str, Any]]]) -> FleetGap:
    """Diagnoses of a fleet's logs, each with what became of the log; empty where there is none."""
    units = list(dict.fromkeys(a.unit for a, gap in answers if gap))
    # By effect and place: units, what it cannot be told from, coefficients.
    having: dict[tuple[str, str, tuple[int, ...]], list[tuple[str, dict]]] = defaultdict(list)
    for answer, gap in answers:
        for entry in gap.get("which", ()):
            place = entry["effect"], entry["family"], tuple(entry["joints"])
            having[place].append((answer.unit, entry))
    effects = []
    # Share of the units: an effect that surely more of them have is the type's, one that surely
    # fewer have is a unit's own
    half = 0.5
    for (effect, family, joints), entries in having.items():
        by_unit = dict(reversed(entries))
        low, high = clopper_pearson(len(by_unit), len(units))
        scope: Scope = "type" if low > half else "unit" if high < half else "some"
        effects.append(
            FleetEffect(
                effect=effect,
                family=family,
                joints=tuple(Joint(j - 1) for j in joints),
                units=tuple(u for u in units if u in by_unit),
                share=len(by_unit) / len(units),
                ci95=(low, high),
                scope=scope,
                ambiguous_with=tuple(
                    sorted({name for _, e in entries for name in e["ambiguous_with"]})
                ),
                coefficients={
                    unit: {
                        name: value
                        for name, value in by_unit[unit]["parameters"].items()
                        if isinstance(value, float)
                    }
                    for unit in units
                    if unit in by_unit
                },
            )
        )
    return FleetGap(
        **named_record(model.robot),
        version=__version__,
        units=tuple(units),
        effects=tuple(sorted(effects, key=lambda e: (-e.share, e.effect, e.joints))),
        logs=tuple(_row(*pair) for pair in answers),
        notes=model.robot.warnings,
    )


def _row(answer: LogAnswer, gap: dict[str, Any]) -> DiagnosedLog:
    joints = gap["where"]["joints"] if gap else ()
    return DiagnosedLog(
        unit=answer.unit,
        session=answer.session,
        log=answer.log,
        status=gap["status"] if gap else answer.verdict,
        evidence=" ".join(answer.evidence),
        key=answer.key,
        # Over the upper end of the noise, or the lower one where that alone is known.
        gap=tuple(
            _ratio(j["gap_rms"], max(filter(None, j["noise_floor_rms"]), default=None))
            for j in joints
        ),
        closed=gap["how_far"]["closed"] if gap else None,
        effects=tuple(effect_label(e["effect"], e["joints"]) for e in gap.get("which", ())),
    )


def _ratio(gap: float | None, floor: float | None) -> float:
    return gap / floor if gap is not None and floor else float("nan")


def fleet_gap(
    model: FleetModel,
    logs: Sequence[FleetLog],
    *,
    settings: GapSettings | None = None,
    store: Store | None = None,
    workers: Workers = 1,
    part: Share | None = None,
    progress: Progress | None = None,
) -> FleetGap:
    """Diagnose every log of a fleet, and tell the type's effects from a unit's own.

    Args:
        model: the simulator, and how logs are read.
        logs: which.
        settings: of every diagnosis; defaults if None.
        store: where diagnoses are kept; for this call only if None.
        workers: who does it; see torchid.parallel.workers.
        part: only this part of the logs.
        progress: called with (stage, done, total).

    Raises:
        RefusedError: a worker has another torchid.
        TorchidError: no log could be diagnosed, or a part that there is not.
    """
    settings = settings or GapSettings()
    with kept(store, workers) as place:
        tasks = [GapTask(log, model, place.place, settings) for log in part_of(logs, part)]
        outcomes = attempted(answer_gap, tasks, workers, "diagnosing logs", progress)
        answers = [
            (LogAnswer.failed(task.log, one), {}) if isinstance(one, Failure) else one
            for task, one in zip(tasks, outcomes, strict=True)
        ]
        if part is None:
            write_index(place, [a for a, _ in answers], "gap.parquet")
    if not any(gap for _, gap in answers):
        first = plain([a.evidence[-1] for a, _ in answers[:3]])
        raise TorchidError("no log of the fleet could be diagnosed.", got="; ".join(first))
    return described(model, answers)
