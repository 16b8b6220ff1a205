"""A fleet as its JSON has it: the schema torchid.fleet/1."""

from typing import TYPE_CHECKING, Annotated, Literal

from msgspec import UNSET, UnsetType, field

from torchid.fleet.settings import FleetSettings
from torchid.results.record import Col, Ends, Part, Real, RobotRecord, Rows, recorded
from torchid.results.words import short
from torchid.typing import Float, Tensor

Judged = Literal["good", "doubtful", "refused", "failed"]
USED: tuple[Judged, ...] = ("good", "doubtful")
"""Verdicts of logs that are fitted."""

PARAMETER = Annotated[str, Col("base parameter", words=lambda name: short(name, 22))]
"""A name that tables cut."""


class LogRow(Part, frozen=True, kw_only=True):
    """What became of a log.

    Attributes:
        unit, session, log: which, and its path.
        verdict: `good`; `doubtful`: used, and to be looked at; `refused`: not used; `failed`: the
            task gave nothing, and is tried again the next time.
        evidence: sentences.
        sha256: of its content, in hexadecimal; empty where it could not be read.
        key: of its factors in the store.
        seconds: of motion that was reduced.
        noise: (n,) what each joint leaves beside the log's own fit [N m; N].
        correlation: of that, the longest [s].
        blocks: number of blocks.
    """

    unit: Annotated[str, Col()]
    session: Annotated[str, Col()]
    log: str
    verdict: Annotated[Judged, Col()]
    evidence: tuple[str, ...]
    sha256: str = ""
    key: str = ""
    seconds: float = 0.0
    noise: tuple[Real, ...] = ()
    correlation: Real = field(default=0.0, name="correlation_s")
    blocks: int = 0

    @property
    def why(self) -> Annotated[str, Col()]:
        """The first of its evidence, or the last of a log that was not used."""
        return self.evidence[0 if self.verdict in USED else -1]


class Spread(Part, frozen=True, kw_only=True):
    """One parameter over units of one type.

    Attributes:
        name, unit: of it.
        mean, std: of the type, and how well it is known.
        between, between_ci95: spread from unit to unit, one standard deviation.
    """

    name: PARAMETER
    unit: str
    mean: Annotated[Real, Col(spread="std", unit_of="unit")]
    std: Real
    between: Annotated[Real, Col("units", ".2g")] = field(name="unit_std")
    between_ci95: Annotated[Ends, Col("95 %", ".2g")] = field(name="unit_std_ci95")


class PooledParameter(Spread, frozen=True, kw_only=True):
    """One base parameter over the fleet.

    Attributes:
        ci95: of the mean.
        daily, daily_ci95: from day to day of one unit.
        noise: standard deviation of a typical session's estimate.
        units, sessions: how many tell it.
        sessions_needed: of one unit, until its own standard deviation is half the spread between
            units; None where units do not differ.
    """

    ci95: Ends
    daily: Annotated[Real, Col("days", ".2g")] = field(name="day_std")
    daily_ci95: Ends = field(name="day_std_ci95")
    noise: Annotated[Real, Col(digits=".2g")] = field(name="noise_std")
    units: int
    sessions: int
    sessions_needed: Annotated[int | None, Col("needed")]


class UnitRow(Part, frozen=True, kw_only=True):
    """One unit.

    Attributes:
        unit: its name.
        sessions: theirs.
        logs: how many are used.
        odd: whether it is called odd.
        p: adjusted for the number of units.
        values, std: (B,) base parameters, drawn towards the type by what its sessions leave open.
        own, own_std: (B,) by its sessions alone.
    """

    unit: str
    sessions: tuple[str, ...]
    logs: int
    odd: bool
    p: Real = field(name="p_adjusted")
    values: Float[Tensor, " B"]
    std: Float[Tensor, " B"]
    own: Float[Tensor, " B"]
    own_std: Float[Tensor, " B"]


class Oddity(Part, frozen=True, kw_only=True):
    """What is odd about a unit.

    Attributes:
        unit, parameter: which.
        value, std: of the unit, by its sessions alone.
        others: mean of the other units.
        spread: between them.
        deviation: in standard deviations of what a normal unit's distance would be.
        p: of it alone.
        sentence: all of it in words.
    """

    unit: Annotated[str, Col()]
    parameter: PARAMETER
    value: Annotated[Real, Col("its value", spread="std")]
    std: Real
    others: Annotated[Real, Col(digits=".4g")]
    spread: Annotated[Real, Col(digits=".2g")]
    deviation: Annotated[Real, Col(digits="+.1f")]
    p: Annotated[Real, Col(digits=".1e")]
    sentence: str


class SessionRow(Part, frozen=True, kw_only=True):
    """One session of a unit by its own logs.

    Attributes:
        unit, session: which.
        values, std: (B,) base parameters; null where these logs do not determine one.
        noise: (n,) what each joint leaves [N m; N].
        blocks: number of blocks.
    """

    unit: str
    session: str
    values: Float[Tensor, " B"]
    std: Float[Tensor, " B"]
    noise: Float[Tensor, " n"]
    blocks: int


if TYPE_CHECKING:
    FleetSettingsRecord = FleetSettings
else:
    FleetSettingsRecord = recorded(FleetSettings, cutoff="cutoff_hz")


class FleetRecord(RobotRecord, frozen=True, kw_only=True, tag="torchid.fleet/1"):
    """A fleet of one robot type.

    Attributes:
        version: of torchid.
        base_names: (B,) of the base parameters.
        parameters: over the fleet.
        oddities: what is odd about which unit, the clearest first.
        units, sessions, logs: one entry each.
        values: (B,) one fit of all rows of all units.
        noise: (n,) what each joint leaves beside it [N m; N].
        settings: as given.
        notes: sentences for the user.
        seed: from a command.
    """

    version: str
    base_names: tuple[str, ...]
    parameters: tuple[PooledParameter, ...]
    oddities: tuple[Oddity, ...] = field(name="odd")
    units: tuple[UnitRow, ...]
    sessions: tuple[SessionRow, ...]
    logs: tuple[LogRow, ...]
    values: Float[Tensor, " B"] = field(name="one_fit")
    noise: Float[Tensor, " n"] = field(name="one_fit_noise")
    settings: FleetSettingsRecord
    notes: tuple[str, ...]
    seed: int | UnsetType = UNSET

    @property
    def odd(self) -> tuple[str, ...]:
        """Units that are called odd."""
        return tuple(u.unit for u in self.units if u.odd)

    @property
    def table(self) -> Rows[PooledParameter]:
        """The parameters over the fleet."""
        return Rows(self.parameters)
