"""The tasks of a fleet: pure functions of paths, settings and what a store holds, for any worker.

A task may be run twice, or be ended at any moment; its answer is in the store as a whole or not at
all. What crosses the wire is the row of a log or the estimate of a session.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from pathlib import Path
from typing import Any

import torch

from torchid.doctor.examine import signal_checks
from torchid.doctor.first import ask_first
from torchid.errors import LogError, TorchidError
from torchid.fleet.factors import (
    Estimate,
    Factors,
    Solved,
    bodies_explain,
    estimate,
    reduce_log,
    solved,
    tree,
    with_gain,
)
from torchid.fleet.factors import combined as both
from torchid.fleet.manifest import FleetLog
from torchid.fleet.model import FleetModel
from torchid.fleet.reading import first_minute, stretches
from torchid.fleet.record import Judged, LogRow
from torchid.log.model import Log
from torchid.parallel.store import Answer, Store, content_hash, key_of, local_file
from torchid.parallel.workers import Failure


@dataclass(frozen=True)
class LogTask:
    """A log to be reduced."""

    log: FleetLog
    model: FleetModel
    place: str


class LogAnswer(LogRow, frozen=True, kw_only=True):
    """What became of a log, and what its row in the JSON leaves out.

    Attributes:
        stored: whether the answer was there already.
    """

    stored: bool = False

    @classmethod
    def about(cls, log: FleetLog, verdict: Judged, *evidence: str, **more: Any) -> "LogAnswer":
        """A verdict on a log, with sentences, and more attributes by name."""
        place: dict[str, Any] = {"unit": log.unit, "session": log.session, "log": log.path}
        return cls(**place, verdict=verdict, evidence=evidence, **more)

    @classmethod
    def failed(cls, log: FleetLog, failure: Failure) -> "LogAnswer":
        """Of a log whose task gave nothing."""
        return cls.about(log, "failed", f"{failure.reason} ({failure.tries} tries)")

    @classmethod
    def unopened(cls, log: FleetLog, error: LogError) -> "LogAnswer":
        """Of a log that is not there, or cannot be opened."""
        return cls.about(log, "refused", " ".join(str(error).split()))


def answer_log(task: LogTask) -> LogAnswer:
    """Reduce a log, unless the store has its factors already.

    Raises:
        RefusedError: this worker has another torchid.
        TorchidError: the store cannot be written, or somebody writes to the log.
    """
    try:
        digest, key, (about, _), stored = answered(
            task.log,
            task.model,
            Store(task.place),
            {"kind": "factors"},
            lambda path: _reduced(task.model, path, task.log.path),
        )
    except LogError as error:  # there is no such file, or it cannot be opened
        return LogAnswer.unopened(task.log, error)
    verdict, evidence, more = about
    return LogAnswer.about(
        task.log, verdict, *evidence, sha256=digest, key=key, stored=stored, **more
    )


def answered(
    log: FleetLog,
    model: FleetModel,
    store: Store,
    question: Mapping[str, Any],
    compute: Callable[[Path], Answer],
) -> tuple[str, str, Answer, bool]:
    """The answer to a question about a log: SHA-256 of the log, key, answer, and whether the store
    had it.

    Args:
        log: which.
        model: who asks.
        store: where answers are kept.
        question: what is asked besides.
        compute: the answer, of the log in a file.

    Raises:
        RefusedError: this worker has another torchid.
        LogError: the log cannot be opened.
        TorchidError: the store cannot be written, or somebody writes to the log.
    """
    torch.set_num_threads(1)
    model.require_same_version()
    with local_file(log.path) as path:
        digest = content_hash(path)
        key = key_of({**question, "log": digest, "model": model.key})

        def of_whole_log() -> Answer:
            answer = compute(path)
            if content_hash(path) != digest:
                raise ChangedError(f"'{log.path}' changed while it was read.")
            return answer

        kept = key in store
        return digest, key, store.answer(key, of_whole_log), kept


class ChangedError(TorchidError):
    """A log that somebody writes to: another try may find it whole."""


def _reduced(
    model: FleetModel, path: Path, name: str
) -> tuple[tuple[Judged, list[str], dict[str, Any]], Factors | None]:
    """Verdict on a log, evidence, more that its row says, and its factors; none where it cannot be
    used, whatever is wrong with it."""
    evidence: list[str] = []

    def watched() -> Iterator[Log]:
        """The stretches, the first of which is looked at."""
        for k, log in enumerate(stretches(path, model.request)):
            if k == 0 and log.n == model.robot.n:
                checks, _ = signal_checks(model.robot, first_minute(with_gain(log, model)))
                odd = (c for c in checks if c.verdict in ("wrong", "doubtful"))
                evidence.extend(f"{c.name}: {c.evidence}" for c in odd)
            yield log

    def asked() -> None:
        """What the doctor says of the beginning, which is read again: it would keep the memory."""
        if (log := next(stretches(path, model.request))).n == model.robot.n:
            begin = first_minute(with_gain(log, model))
            evidence.extend(ask_first(model.robot, begin, force=model.settings.force).sentences)

    try:
        try:
            reduced = reduce_log(model, watched())
        except TorchidError:
            asked()  # whose words say more
            raise
        if evidence or not bodies_explain(model, reduced):
            asked()
    except TorchidError as error:
        text = " ".join(str(error).replace(str(path), name).split())
        return ("refused", [*evidence, text], {}), None
    more = {
        "seconds": reduced.seconds,
        "noise": tuple(reduced.fit.noise.tolist()),
        "correlation": reduced.correlation,
        "blocks": len(reduced.factors.rows),
    }
    verdict: Judged = "doubtful" if evidence else "good"
    return (verdict, [*evidence, *reduced.warnings], more), reduced.factors


@dataclass(frozen=True)
class UnitTask:
    """Sessions of one unit to be fitted.

    Attributes:
        unit: its name.
        sessions: by name the keys of their logs, sorted.
        model, place: of the fleet.
    """

    unit: str
    sessions: tuple[tuple[str, tuple[str, ...]], ...]
    model: FleetModel
    place: str


@dataclass(frozen=True, eq=False)
class UnitAnswer:
    """A unit fitted.

    Attributes:
        unit: its name.
        sessions: an estimate each.
        key: of the factors of all its rows, in the store.
    """

    unit: str
    sessions: tuple[tuple[str, Estimate], ...]
    key: str


def answer_unit(task: UnitTask) -> UnitAnswer:
    """Fit each session of a unit, and put the factors of all its rows into the store.

    Raises:
        RefusedError: this worker has another torchid.
        TorchidError: the store lacks what it should have, or cannot be written.
    """
    torch.set_num_threads(1)
    task.model.require_same_version()
    store, sessions, wholes = Store(task.place), [], []
    for name, keys in task.sessions:
        key = key_of({"kind": "session", "logs": keys, "model": task.model.key})
        fitted, whole = store.answer(key, partial(_session, store, keys, task.model))
        sessions.append((name, fitted))
        wholes.append(whole)
    # All sessions together, in the order of their names.
    every_key = tuple(k for _, keys in task.sessions for k in keys)
    key = key_of({"kind": "unit", "logs": every_key, "model": task.model.key})
    store.answer(key, lambda: tree(wholes, both))
    return UnitAnswer(task.unit, tuple(sessions), key)


def _session(store: Store, keys: Sequence[str], model: FleetModel) -> tuple[Estimate, Factors]:
    """The fit of a session's logs, and the factor of all their rows."""
    logs = [store.kept(key)[1] for key in keys]
    return estimate(reduce(Factors.beside, logs), model), tree([f.whole for f in logs], both)


def whole_type(store: Store, keys: list[str], model: FleetModel) -> tuple[Factors, Solved]:
    """The factors of all units, and the fit of all rows."""
    whole = tree(map(store.kept, keys), both)
    return whole, solved(whole, model.layout)
