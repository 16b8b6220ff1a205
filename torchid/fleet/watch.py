"""What drifts: each parameter of each unit over its sessions, with an alarm that holds its rate."""

from collections import defaultdict
from collections.abc import Mapping
from typing import Annotated

import torch
from msgspec import UNSET, UnsetType, field

from torchid import __version__
from torchid.errors import TorchidError
from torchid.fleet.identify import Fleet
from torchid.fleet.record import PARAMETER, USED
from torchid.fleet.tasks import UnitAnswer
from torchid.identification.base_parameters import BaseParameters
from torchid.results.record import Col, Part, Real, RobotRecord, Rows
from torchid.robot.library import named_record
from torchid.statistics.drift import drift
from torchid.statistics.robust import MAD_TO_SIGMA
from torchid.typing import Float, Tensor

SESSIONS = 1000.0
"""Sessions of a unit until a false alarm, at the least and on average."""

FEWEST = 3
"""Sessions of a unit below which nothing is watched: two to know it by, one to compare."""


class Alarm(Part, frozen=True, kw_only=True):
    """A parameter of a unit that has changed.

    Attributes:
        unit, parameter: which.
        since: first session after the change.
        said_at: session at which it was sure.
        before, after: values, temperature apart.
        percent: by how much.
        by_temperature: change that the temperature explains between the same sessions, in percent;
            None without temperatures.
        evidence: the detector's value, and what it must exceed.
        threshold: that.
        sentence: all of it in words.
    """

    unit: Annotated[str, Col()]
    parameter: PARAMETER
    since: Annotated[str, Col()]
    said_at: Annotated[str, Col("sure at")]
    before: Annotated[Real, Col(digits=".4g")]
    after: Annotated[Real, Col(digits=".4g")]
    percent: Annotated[Real, Col("by", "+.0f", "%")]
    by_temperature: Annotated[float | None, Col("temperature's", "+.0f", "%")] = field(
        name="percent_by_temperature"
    )
    evidence: Real
    threshold: Real
    sentence: str


class WatchedUnit(Part, frozen=True, kw_only=True):
    """A unit and its sessions in order.

    Attributes:
        unit, sessions: which.
        temperature: of each session [degC]; empty without.
        evidence: the largest detector over the parameters after each session, as a share of the
            threshold.
    """

    unit: str
    sessions: tuple[str, ...]
    temperature: tuple[Real, ...]
    evidence: tuple[Real, ...]


class Watch(RobotRecord, frozen=True, eq=False, kw_only=True, tag="torchid.fleet_watch/1"):
    """What drifts in a fleet, as the JSON has it.

    Attributes:
        version: of torchid.
        false_alarm_every: sessions of a unit until a false alarm.
        alarms: the clearest first.
        units: that are watched.
        notes: sentences for the user.
        seed: from a command.
    """

    version: str
    false_alarm_every: float = field(name="sessions_per_false_alarm")
    alarms: tuple[Alarm, ...]
    units: tuple[WatchedUnit, ...]
    notes: tuple[str, ...]
    seed: int | UnsetType = UNSET

    def __repr__(self) -> str:
        return f"Watch('{self.robot}', {len(self.alarms)} alarms)"

    @property
    def table(self) -> Rows[Alarm]:
        """The alarms."""
        return Rows(self.alarms)


def watch(fleet: Fleet, every: float = SESSIONS) -> Watch:
    """Watch every parameter of every unit over its sessions, in the order of their names.

    The spread from day to day, which no alarm shall be raised for, is that of the fleet. Of P
    parameters each one must exceed P times `every`, so that the unit keeps the rate.

    Args:
        fleet: identified; sessions are named so that their order is that of time.
        every: sessions of a unit until a false alarm, at the least and on average.

    Raises:
        TorchidError: no unit has enough sessions, or a rate below one session.
    """
    if not every >= 1:
        raise TorchidError("a false alarm comes after one session at least.", got=every)
    if not any(len(u.sessions) >= FEWEST for u in fleet.units):
        raise TorchidError(
            "no unit has sessions enough to be watched.",
            got=max(len(u.sessions) for u in fleet.units),
            expected=f"{FEWEST} of one unit",
        )
    warm, daily = _temperatures(fleet), _daily(fleet)
    alarms, units = list[Alarm](), list[WatchedUnit]()
    for unit in fleet.units:
        if len(unit.sessions) >= FEWEST:
            watched, changes = _watched(unit, fleet.base, warm, daily, every)
            units.append(watched)
            alarms += changes
    alarms.sort(key=lambda a: (-a.evidence, a.unit, a.parameter))
    return Watch(
        **named_record(fleet.model.robot), version=__version__, false_alarm_every=every,
        alarms=tuple(alarms), units=tuple(units), notes=fleet.notes,
    )  # fmt: skip


def _watched(
    unit: UnitAnswer,
    base: BaseParameters,
    warm: Mapping[tuple[str, str], float],
    daily: tuple[Float[Tensor, " B"], int],
    every: float,
) -> tuple[WatchedUnit, list[Alarm]]:
    """One unit, and what has changed in it."""
    names, estimates = zip(*unit.sessions, strict=True)
    degrees = [warm.get((unit.unit, name)) for name in names]
    heat = torch.tensor([[t] for t in degrees if t is not None], dtype=torch.float64)
    if len(heat) < len(names) or float(heat.std()) == 0:
        heat = torch.zeros(len(names), 0, dtype=torch.float64)
    values = torch.stack([e.values for e in estimates], 1)
    variances = torch.stack([e.std.square() for e in estimates], 1) + daily[0].unsqueeze(1)
    freedom = torch.stack([e.freedom for e in estimates], 1).clamp(max=daily[1])
    alarms, threshold = list[Alarm](), every * len(values)
    strongest = torch.zeros(len(names), dtype=torch.float64)
    for b, (name, of) in enumerate(zip(base.names, base.units, strict=True)):
        there = values[b].isfinite().nonzero().flatten()
        if len(there) < FEWEST:
            continue
        change = drift(values[b, there], variances[b, there], freedom[b, there], heat[there])
        share = change.evidence / threshold
        strongest[there] = torch.maximum(strongest[there], share)
        over = (share >= 1).nonzero().flatten().tolist()
        if not over or change.since is None:
            continue
        since, sure_at = names[there[change.since]], names[there[over[0]]]
        percent = 100 * (change.after - change.before) / abs(change.before)
        by_heat = None
        if heat.shape[1]:
            late = torch.arange(len(there)) >= change.since
            warmer = heat[there][late].mean(0) - heat[there][~late].mean(0)
            by_heat = float(100 * (change.slope @ warmer) / abs(change.before))
        word = "rose" if percent > 0 else "fell"
        apart = "" if by_heat is None else f", the temperature's {by_heat:+.0f} % apart"
        alarms.append(
            Alarm.of(
                change,
                unit=unit.unit,
                parameter=name,
                since=since,
                said_at=sure_at,
                percent=percent,
                by_temperature=by_heat,
                evidence=float(change.evidence.max()),
                threshold=threshold,
                sentence=f"{unit.unit}: {name} {word} by {abs(percent):.0f} % since {since}, from "
                f"{change.before:.4g} to {change.after:.4g} {of}{apart}",
            )
        )
    watched = WatchedUnit(
        unit=unit.unit,
        sessions=names,
        temperature=tuple(heat[:, 0].tolist()) if heat.shape[1] else (),
        evidence=tuple(strongest.tolist()),
    )
    return watched, alarms


def _daily(fleet: Fleet) -> tuple[Float[Tensor, " B"], int]:
    """Variance from day to day (B,), and from how many steps it is known.

    It is taken from the steps between neighbouring sessions of all units, by their median: a change
    is one step among many, and does not hide itself as it would in the likelihood.
    """
    steps, noise = [], []
    for unit in fleet.units:
        values = torch.stack([e.values for _, e in unit.sessions], 1)
        variances = torch.stack([e.std.square() for _, e in unit.sessions], 1)
        steps.append(values.diff(dim=1))
        noise.append(variances[:, 1:] + variances[:, :-1])
    every = torch.cat(steps, 1)
    typical = MAD_TO_SIGMA * every.abs().nanmedian(1).values
    of_estimates = torch.cat(noise, 1).nanmedian(1).values
    return ((typical.square() - of_estimates) / 2).clamp(min=0).nan_to_num(), every.shape[1]


def _temperatures(fleet: Fleet) -> dict[tuple[str, str], float]:
    """Mean temperature by unit and session, over logs that have one."""
    degrees: dict[tuple[str, str], list[float]] = defaultdict(list)
    for a in fleet.logs:
        if a.verdict in USED and a.temperature is not None:
            degrees[a.unit, a.session].append(a.temperature)
    return {key: sum(several) / len(several) for key, several in degrees.items()}
