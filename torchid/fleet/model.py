"""What all logs of a fleet are reduced to: the columns of one robot type with its effects."""

from dataclasses import asdict, dataclass, field
from functools import lru_cache

from torchid import __version__
from torchid.errors import TorchidError
from torchid.fleet.settings import FleetSettings
from torchid.identification.asked import asked_effects
from torchid.identification.base_parameters import base_parameters
from torchid.identification.rows import Layout, layout
from torchid.log.table import Request
from torchid.parallel.store import code, key_of
from torchid.parallel.workers import RefusedError
from torchid.results.record import robot_record
from torchid.robot.model import Robot

ELSEWHERE = ("app", "report", "withheld", "study", "extraction", "wrenches")
"""Rooms that no answer in a fleet's store depends on."""


@dataclass(frozen=True)
class FleetModel:
    """A robot type, how its logs are read and reduced, and which torchid asks.

    Two of the same content are equal, and known by `key`.

    Attributes:
        robot, settings: as given.
        request: how logs are read.
        gain: (n,) drive gains [N m/A; N/A] of logs of currents; the robot's own if None.
        version: of the torchid that asks, and of its code.
        key: SHA-256 of all of this.
    """

    robot: Robot = field(compare=False)
    settings: FleetSettings = field(default=FleetSettings(), compare=False)
    request: Request = field(default=Request(), compare=False)
    gain: tuple[float, ...] | None = field(default=None, compare=False)
    version: tuple[str, str] = field(default=("", ""), compare=False)
    key: str = ""

    def __post_init__(self) -> None:
        self.robot.require_fixed_base("a fleet")
        if not self.key:
            object.__setattr__(self, "version", this_version())
            found = {
                "robot": robot_record(self.robot),
                "settings": {k: v for k, v in asdict(self.settings).items() if k != "level"},
                "request": repr(self.request),
                "gain": self.gain,
                "version": self.version,
            }
            object.__setattr__(self, "key", key_of(found))

    @property
    def layout(self) -> Layout:
        """The columns, worked out once a process.

        Raises:
            TorchidError: an effect whose columns are not known before a search.
        """
        return _layout(self)

    def require_same_version(self) -> None:
        """Refuse to answer for another torchid: the answers of two would be mixed.

        Raises:
            RefusedError: this process has another one.
        """
        here = this_version()
        if here != self.version:
            raise RefusedError(
                "a worker has another torchid than the command.",
                got=f"torchid {here[0]}, code {here[1][:12]}",
                expected=f"torchid {self.version[0]}, code {self.version[1][:12]}",
                hint="install the same version on all machines",
            )


def this_version() -> tuple[str, str]:
    """Version of this torchid and SHA-256 of its code."""
    return __version__, code(ELSEWHERE)


@lru_cache(maxsize=4)
def _layout(model: FleetModel) -> Layout:
    asked = asked_effects(model.settings.effects, model.robot)
    unknown = [a.effect.name for a in asked if not a.plain]
    if unknown:
        raise TorchidError(
            "a fleet is identified with effects whose columns are known before a search.",
            got=", ".join(dict.fromkeys(unknown)),
            hint="give their shapes: stribeck_friction:vs=0.1",
        )
    effects = [a.effect for a in asked]
    base = base_parameters(model.robot, effects, basis=model.settings.basis)
    return layout(model.robot, base, effects)
