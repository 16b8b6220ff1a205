"""How a fleet's logs are reduced and pooled."""

import math
from dataclasses import dataclass

from torchid.effects.names import DEFAULT_EFFECTS
from torchid.errors import TorchidError
from torchid.identification.settings import Basis, Rows, require_between


@dataclass(frozen=True)
class FleetSettings:
    """How a fleet's logs are reduced and pooled.

    Every log must be reduced alike, whatever other logs there are, so nothing is chosen from the
    data here: tomorrow's logs join today's.

    Attributes:
        effects: names of the effects, on every joint; of those whose columns need no search.
        cutoff: of the zero-phase filter [Hz].
        reversal: speed that a joint must reach before its direction counts as reversed [rad/s;
            m/s].
        rows: rows that are fitted: while the own joint moves, or all.
        basis: base parameters as the report groups them, or as a log tells them apart best; the
            robot's own choice if None.
        level: share of false ones among the units that are called odd, on average.
        force: use logs that the doctor's decisive checks say are wrong.

    >>> FleetSettings().cutoff
    10.0
    """

    effects: tuple[str, ...] = DEFAULT_EFFECTS
    cutoff: float = 10.0
    reversal: float = 0.02
    rows: Rows = "moving"
    basis: Basis | None = None
    level: float = 0.05
    force: bool = False

    def __post_init__(self) -> None:
        require_between("the cut-off", self.cutoff, 0.0, math.inf, "a frequency in Hz")
        require_between("the level", self.level, 0.0, 1.0, "0..1")
        if not 0 <= self.reversal < math.inf:
            raise TorchidError("the reversal speed is out of range.", got=self.reversal)
