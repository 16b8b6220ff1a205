"""How to diagnose a gap."""

import math
from dataclasses import dataclass
from typing import Literal, get_args

from torchid.errors import TorchidError
from torchid.identification.settings import require_between, require_choice
from torchid.statistics.criteria import WORTHWHILE, WORTHWHILE_TORQUE

Parameters = Literal["auto", "trusted", "free"]


@dataclass(frozen=True)
class GapSettings:
    """How to diagnose a gap.

    Attributes:
        effects: names of the effects that are searched over; None for the whole library.
        background: names of effects that are part of the model already, on every joint; fitted
            with the base parameters where the robot has no parameters.
        parameters: whether the robot's inertial parameters are `trusted`, `free` (refitted before
            effects are sought), or compete with the effects as far as the model says how sure it
            is (`auto`).
        cutoff: of the fit [Hz], or "auto".
        report_band: of the report [Hz]: the gap before and after is given below this frequency.
        worthwhile: least share of a joint's gap by which a cause must lower its held-out error to
            be worth a name.
        worthwhile_torque: the same as a share of the joint's torque.
        gain_std: how well the scale of each joint's torque is known, one standard deviation as a
            share of it; if absent 5 % where torque is current times a gain, else 1 %. Standard
            deviations hold it.
        folds: parts of the data, each left out in turn when the answer is judged.
        max_effects: number of effects accepted at most.
        held_out_fraction: share of each trajectory's end kept for validation, where no log is.
        seed: of everything random.

    Raises:
        TorchidError: an unknown effect or choice, one effect twice, a number out of range.

    >>> GapSettings(effects=("time_delay", "backlash"), cutoff=10.0).worthwhile
    0.05
    """

    effects: tuple[str, ...] | None = None
    background: tuple[str, ...] = ()
    parameters: Parameters = "auto"
    cutoff: float | Literal["auto"] = "auto"
    report_band: float = 20.0
    worthwhile: float = WORTHWHILE
    worthwhile_torque: float = WORTHWHILE_TORQUE
    gain_std: float | None = None
    folds: int = 5
    max_effects: int = 20
    held_out_fraction: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        require_choice("parameters", self.parameters, get_args(Parameters))
        if self.effects is not None and not self.effects:
            raise TorchidError("there is no effect to search over.", hint="None: the whole library")
        if self.effects or self.background:
            # Here, so that the command line has the defaults without torch.
            from torchid.effects.registry import column_kind, effect_kind

            for names, known in ((self.effects or (), effect_kind), (self.background, column_kind)):
                for name in names:
                    known(name)
                if len(set(names)) < len(names):
                    raise TorchidError("an effect is named twice.", got=", ".join(names))
        if self.cutoff != "auto":
            require_between(
                "the cut-off", self.cutoff, 0.0, math.inf, "a frequency in Hz, or `auto`"
            )
        require_between("the report's band", self.report_band, 0.0, math.inf, "a frequency in Hz")
        for name, share in (
            ("the least worthwhile share", self.worthwhile),
            ("the least worthwhile share", self.worthwhile_torque),
            ("the standard deviation of the gain", self.gain_std or 0),
            ("the held-out fraction", self.held_out_fraction),
        ):
            if share != 0:
                require_between(name, share, 0.0, 1.0, "0..1")
        _whole("the number of folds", self.folds, 2)
        _whole("the greatest number of effects", self.max_effects, 1)
        _whole("the seed", self.seed, 0)


def _whole(name: str, value: object, least: int) -> None:
    """Raise unless `value` is a whole number of at least `least`."""
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise TorchidError(
            f"{name} is out of range.", got=value, expected=f"a whole number of at least {least}"
        )
