"""How to identify."""

import math
from dataclasses import dataclass
from typing import Literal, get_args

from torchid.effects.names import DEFAULT_EFFECTS
from torchid.errors import TorchidError

# As in torchid.robot.model, which loads torch: the command line has these settings without it.
Basis = Literal["report", "conditioned"]

Method = Literal["ols", "wls", "huber"]
Covariance = Literal["diagonal", "full"]
Rows = Literal["all", "moving"]
Signs = Literal["bounded", "free"]


@dataclass(frozen=True)
class Settings:
    """How to identify.

    Attributes:
        effects: names of the effects, on every joint; or at one place and with its shape, e.g.
            `joint_spring:joint=2,curvature=0`. Shapes that are not given are searched.
        cutoff: [Hz]; "auto"; or None for no filter.
        reversal: speed at which a joint's direction counts as reversed, as a fraction of its 99 %
            speed; or "auto".
        rows: rows used for the fit: those whose own joint moves, or all. At rest friction can hold
            any torque.
        basis: base parameters as the report groups them, or as a log tells them apart best; the
            robot's own choice if None. The torque is the same.
        method: least squares: plain (`ols`), weighted (`wls`) or robust (`huber`).
        covariance: of the noise between joints, `diagonal` or `full`.
        signs: `bounded` holds coefficients that physics forbids to be negative at zero or above;
            `free` leaves them and reports the wrong ones.
        essential: drop parameters that cannot be told from zero.
        held_out_fraction: share of each trajectory's end kept for validation, where no log is.
        error_cutoff: [Hz] filter under which errors are reported; the fit's if None.
        force: show a result that predicts its own log worse than no model does, too.

    >>> Settings(effects=("viscous_friction",), cutoff=10.0).method
    'huber'
    """

    effects: tuple[str, ...] = DEFAULT_EFFECTS
    cutoff: float | Literal["auto"] | None = "auto"
    reversal: float | Literal["auto"] = "auto"
    rows: Rows = "moving"
    basis: Basis | None = None
    method: Method = "huber"
    covariance: Covariance = "diagonal"
    signs: Signs = "bounded"
    essential: bool = False
    held_out_fraction: float = 0.0
    error_cutoff: float | None = None
    force: bool = False

    def __post_init__(self) -> None:
        require_choice("rows", self.rows, get_args(Rows))
        require_choice("basis", self.basis, (None, *get_args(Basis)))
        require_choice("method", self.method, get_args(Method))
        require_choice("covariance", self.covariance, get_args(Covariance))
        require_choice("signs", self.signs, get_args(Signs))
        if len(set(self.effects)) < len(self.effects):
            raise TorchidError("an effect is named twice.", got=", ".join(self.effects))
        if self.cutoff is not None and self.cutoff != "auto":
            require_between(
                "the cut-off", self.cutoff, 0.0, math.inf, "a frequency in Hz, `auto` or none"
            )
        if self.error_cutoff is not None:
            require_between(
                "the errors' cut-off", self.error_cutoff, 0.0, math.inf, "a frequency in Hz"
            )
        if self.reversal != "auto" and self.reversal != 0:
            what = "a fraction of the 99 % speed, or `auto`"
            require_between("the reversal speed", self.reversal, 0.0, 1.0, what)
        if self.held_out_fraction != 0:
            require_between("the held-out fraction", self.held_out_fraction, 0.0, 1.0, "0..1")


def require_choice(name: str, value: object, known: tuple[object, ...]) -> None:
    """Raise TorchidError unless a setting has one of its values."""
    if value not in known:
        raise TorchidError(f"unknown choice for {name}.", got=value, available=known)


def require_between(name: str, value: object, low: float, high: float, expected: str) -> None:
    """Raise TorchidError unless a setting is a number strictly between two bounds."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not low < value < high:  # type: ignore[operator]
        raise TorchidError(f"{name} is out of range.", got=value, expected=expected)
