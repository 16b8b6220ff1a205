"""A fleet of one robot type: what its units have in common, and which of them are odd.

logs -> factors of blocks -> sessions -> units -> type        reduced once, kept in a store
sessions' estimates -> spread between units and days -> odd units
"""

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cached_property
from tempfile import TemporaryDirectory

import fsspec
import pyarrow as pa
import pyarrow.parquet
import torch

from torchid import __version__
from torchid.errors import IdentificationError, TorchidError, visible
from torchid.fleet.factors import FAR_FROM_PHYSICAL, Solved
from torchid.fleet.manifest import FleetLog, in_order
from torchid.fleet.model import FleetModel
from torchid.fleet.record import (
    USED,
    FleetRecord,
    FleetSettingsRecord,
    Oddity,
    PooledParameter,
    SessionRow,
    UnitRow,
)
from torchid.fleet.tasks import (
    LogAnswer,
    LogTask,
    UnitAnswer,
    UnitTask,
    answer_log,
    answer_unit,
    whole_type,
)
from torchid.identification.base_parameters import BaseParameters, physical_signs
from torchid.parallel.store import Store
from torchid.parallel.workers import Failure, Progress, Workers, attempted
from torchid.results.record import Result
from torchid.robot.library import named_record
from torchid.statistics.random_effects import FEWEST_UNITS, Pooled, Sessions, pooled

INDEX = "index.parquet"
"""Of a store: one row a log, for duckdb or pandas."""


OF_EACH = (
    "mean", "std", "between", "between_ci95", "daily", "daily_ci95", "noise", "units", "sessions",
)  # fmt: skip
"""Random effects that a parameter has one of."""

Part = tuple[int, int]
"""The i-th of n parts of the logs, i from 1."""


@dataclass(frozen=True, eq=False)
class Fleet(Result):
    """A fleet of one robot type.

    Attributes:
        model: the type, and how its logs were reduced.
        logs: what became of each.
        units: fitted, in the order of their names.
        pooled: random effects of the base parameters over them.
        one_fit: all rows of all units fitted at once, in the layout's order.
        notes: sentences for the user.
    """

    model: FleetModel
    logs: tuple[LogAnswer, ...]
    units: tuple[UnitAnswer, ...]
    pooled: Pooled
    one_fit: Solved
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        return (
            f"Fleet('{self.model.robot.name}', {len(self.units)} units, "
            f"{int(self.pooled.odd.sum())} odd)"
        )

    @property
    def base(self) -> BaseParameters:
        """The base parameters' structure."""
        return self.model.layout.base

    @property
    def odd(self) -> tuple[str, ...]:
        """Units that are called odd."""
        return tuple(u.unit for u, odd in zip(self.units, self.pooled.odd, strict=True) if odd)

    @cached_property
    def record(self) -> FleetRecord:
        """As the JSON has it."""
        used = Counter(a.unit for a in self.logs if a.verdict in USED)
        found, order = self.pooled, self.model.layout.back
        ci = found.interval()
        units = [
            UnitRow(
                unit=u.unit,
                sessions=tuple(name for name, _ in u.sessions),
                logs=used[u.unit],
                odd=bool(found.odd[k]),
                p=float(found.p_unit[k]),
                values=found.shrunk[:, k],
                std=found.shrunk_std[:, k],
                own=found.own[:, k],
                own_std=found.own_std[:, k],
            )
            for k, u in enumerate(self.units)
        ]
        return FleetRecord.of(
            self,
            **named_record(self.model.robot),
            version=__version__,
            base_names=self.base.names,
            parameters=[self._parameter(b, ci[b].tolist()) for b in range(len(self.base))],
            units=units,
            sessions=[
                SessionRow.of(estimate, unit=u.unit, session=name)
                for u in self.units
                for name, estimate in u.sessions
            ],
            values=torch.where(self.one_fit.held, torch.nan, self.one_fit.x)[order],
            noise=self.one_fit.noise,
            settings=FleetSettingsRecord(**asdict(self.model.settings)),
        )

    def _parameter(self, b: int, ci: list[float]) -> PooledParameter:
        found = self.pooled
        between, noise = float(found.between[b]), float(found.noise[b])
        daily = float(found.daily[b].nan_to_num())
        needed = None
        if between > 0 and noise == noise:
            needed = max(1, -(-(daily**2 + noise**2) // (between / 2) ** 2))
        return PooledParameter.of(
            **{name: getattr(found, name)[b].tolist() for name in OF_EACH},
            name=self.base.names[b],
            unit=self.base.units[b],
            ci95=ci,
            sessions_needed=None if needed is None or needed > 1e6 else int(needed),
        )

    @cached_property
    def oddities(self) -> tuple[Oddity, ...]:
        """What is odd about which unit, the clearest first."""
        found, out = self.pooled, []
        for b, k in found.odd_in.nonzero().tolist():
            numbers = torch.stack([
                found.own[b, k], found.own_std[b, k], found.mean[b], found.between[b],
                found.deviation[b, k], found.p[b, k],
            ])  # fmt: skip
            value, std, mean, spread, z, p = numbers.tolist()
            name, unit = self.base.names[b], self.base.units[b]
            word = "above" if z > 0 else "below"
            sentence = (
                f"{self.units[k].unit}: {name} = {value:.4g} ± {std:.2g} {unit}, the other units "
                f"{mean:.4g} with a spread of {spread:.2g}: {abs(z):.1f} standard deviations {word}"
            )
            out.append(
                Oddity(
                    unit=self.units[k].unit,
                    parameter=name,
                    value=value,
                    std=std,
                    others=mean,
                    spread=spread,
                    deviation=z,
                    p=p,
                    sentence=sentence,
                )
            )
        return tuple(sorted(out, key=lambda o: (o.p, o.unit, o.parameter)))


def reduce_fleet(
    model: FleetModel,
    logs: Sequence[FleetLog],
    store: Store,
    *,
    workers: Workers = 1,
    part: Part | None = None,
    progress: Progress | None = None,
) -> tuple[LogAnswer, ...]:
    """Every log reduced to factors in the store; those that are there stay.

    A log that cannot be used, or whose task fails, is a row with the reason and stops nothing.

    Args:
        model: of all logs.
        logs: which.
        store: that all workers see.
        workers: who does it; see torchid.parallel.workers.
        part: only this part of the logs.
        progress: called with (stage, done, total).

    Raises:
        RefusedError: a worker has another torchid.
        TorchidError: a part that there is not.
    """
    tasks = [LogTask(log, model, store.place) for log in part_of(logs, part)]
    found = attempted(answer_log, tasks, workers, "reducing logs", progress)
    answers = [
        LogAnswer.failed(task.log, a) if isinstance(a, Failure) else a
        for task, a in zip(tasks, found, strict=True)
    ]
    # The same motion counts once, whatever it is called.
    first: dict[str, LogAnswer] = {}
    for k, a in enumerate(answers):
        other = first.setdefault(a.sha256, a) if a.sha256 else a
        if other is not a:
            same = f"the same content as {other.log} of unit {other.unit}, which is used"
            answers[k] = LogAnswer.about(tasks[k].log, "refused", same, sha256=a.sha256, key=a.key)
    return tuple(answers)


def part_of(logs: Sequence[FleetLog], part: Part | None) -> list[FleetLog]:
    """The logs in their order, or every n-th of them.

    Raises:
        TorchidError: a part that there is not.
    """
    ordered = in_order(logs)
    if part is None:
        return ordered
    i, n = part
    if not 1 <= i <= n:
        raise TorchidError("there is no such part.", got=f"{i}/{n}", expected="i/n, 1 <= i <= n")
    return ordered[i - 1 :: n]


def fleet_identify(
    model: FleetModel,
    logs: Sequence[FleetLog],
    *,
    store: Store | None = None,
    workers: Workers = 1,
    progress: Progress | None = None,
) -> Fleet:
    """Identify every session, unit and the type from a fleet's logs.

    The answer is the same to the last bit whoever computes it and in whatever order.

    Args:
        model: the robot type, and how its logs are reduced.
        logs: from `fleet_logs` or `read_manifest`.
        store: where factors are kept; for this call only if None.
        workers: who does it; see torchid.parallel.workers.
        progress: called with (stage, done, total).

    Raises:
        IdentificationError: no log can be used.
        RefusedError: a worker has another torchid.

    >>> import torchid
    >>> from torchid.fleet.manifest import FleetLog, in_order
    >>> robot = torchid.load_robot("3r")
    >>> motion = torchid.excite(robot, seed=1, duration=10.0, restarts=1, iterations=0).log()
    >>> with TemporaryDirectory() as folder:
    ...     logs = []
    ...     for k in range(2):
    ...         file = Path(folder) / f"{k}.parquet"
    ...         torchid.write_log(torchid.simulate(robot, motion, seed=k), file)
    ...         logs.append(FleetLog(f"arm {k}", "monday", str(file)))
    ...     found = fleet_identify(FleetModel(robot, FleetSettings(effects=())), logs)
    >>> found
    Fleet('3r', 2 units, 0 odd)
    """
    with kept(store, workers) as place:
        answers = reduce_fleet(model, logs, place, workers=workers, progress=progress)
        write_index(place, answers)
        used = [a for a in answers if a.verdict in USED]
        if not used:
            reasons = [f"{a.log}: {a.evidence[-1]}" for a in answers[:5]]
            raise IdentificationError("no log of the fleet can be used.", got="; ".join(reasons))
        # Logs of a session in the order of their content, which no name changes.
        sessions: dict[str, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
        for a in used:
            sessions[a.unit][a.session].append(a.key)
        tasks = [
            UnitTask(
                unit,
                tuple((name, tuple(sorted(keys))) for name, keys in own.items()),
                model,
                place.place,
            )
            for unit, own in sessions.items()
        ]
        # A unit is fitted in tenths of a second, and a process starts in seconds.
        # 40: units from which on processes are started to fit them
        crew = 1 if isinstance(workers, int) and len(tasks) < 40 else workers
        units = attempted(answer_unit, tasks, crew, "fitting units", progress)
        done = [u for u in units if isinstance(u, UnitAnswer)]
        lost = [
            f"unit {task.unit} could not be fitted: {u.reason}"
            for task, u in zip(tasks, units, strict=True)
            if isinstance(u, Failure)
        ]
        if not done:
            raise IdentificationError("no unit could be fitted.", got=lost[0])
        _, one_fit = whole_type(place, [u.key for u in done], model)
    estimates = [(k, e) for k, u in enumerate(done) for _, e in u.sessions]
    data = Sessions(
        torch.stack([e.values for _, e in estimates], 1),
        torch.stack([e.std.square() for _, e in estimates], 1),
        torch.tensor([k for k, _ in estimates]),
    )
    found = pooled(data, model.settings.level)
    notes = (*model.robot.warnings, *lost, *_notes(model, answers, done, found))
    return Fleet(model, answers, tuple(done), found, one_fit, tuple(dict.fromkeys(notes)))


@contextmanager
def kept(store: Store | None, workers: Workers) -> Iterator[Store]:
    """The store, or one for the time being."""
    if store is not None:
        yield store
    elif isinstance(workers, int):
        with TemporaryDirectory() as folder:
            yield Store(folder)
    else:
        raise TorchidError(
            "workers on other machines need a store that all of them see.", expected="`store=...`"
        )


def write_index(store: Store, answers: Sequence[LogAnswer], name: str = INDEX) -> None:
    """A table of all logs into the store, for duckdb or pandas."""
    rows = [
        {
            "log": visible(a.log), "unit": visible(a.unit), "session": visible(a.session),
            "sha256": a.sha256, "key": a.key, "verdict": a.verdict, "seconds": a.seconds,
            "evidence": visible("\n".join(a.evidence)),
        }
        for a in answers
    ]  # fmt: skip
    files, place = fsspec.url_to_fs(store.place)
    table, file = pa.Table.from_pylist(rows), f"{place}/{name}"
    pa.parquet.write_table(table, file, filesystem=files, write_page_checksum=True)


def _notes(
    model: FleetModel, answers: Sequence[LogAnswer], units: Sequence[UnitAnswer], found: Pooled
) -> list[str]:
    """What a user must know, one sentence each."""
    said = []
    if len(units) < FEWEST_UNITS:
        said.append(
            f"with {len(units)} unit{'s' * (len(units) > 1)} no unit can be called odd: the spread "
            f"between {FEWEST_UNITS} at least must be known"
        )
    if not bool(found.daily.isfinite().any()):
        said.append("no unit has two sessions, so the spread between units holds that between days")
    base = model.layout.base
    signs = physical_signs(base, model.layout.effects).double()
    for unit in units:
        for name, e in unit.sessions:
            beyond = signs * e.values + FAR_FROM_PHYSICAL * e.std < 0
            bad = beyond.nonzero().flatten().tolist()
            if bad:
                worst = base.names[bad[0]]
                said.append(
                    f"{unit.unit}, session {name}: {len(bad)} values that no body has, {worst} = "
                    f"{float(e.values[bad[0]]):.3g} ± {float(e.std[bad[0]]):.2g} the first: are "
                    "its joints, signs and gains those of the type?"
                )
    return said
