"""What motions are asked for, without torch: the command line reads its options off this."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from torchid.effects.names import EXCITED_EFFECTS
from torchid.errors import TorchidError
from torchid.excitation.settings import (
    CLEARANCE,
    DURATION,
    HARMONICS,
    RESTARTS,
    USAGE,
)


@dataclass(frozen=True, kw_only=True)
class MotionSettings:
    """What motions are asked for.

    Attributes:
        result: The next motion for an identification.json (fixes the parameters it knows least)
            or a gap.json (separates what it cannot tell apart, or shows what it could not test; of
            commands and positions: four motions in commands).
        kind: Optimised Fourier series, random ones, sinusoids for validation, or the report's
            table 5.1 (3R only).
        count: How many trajectories.
        criterion: What to improve: the condition number (default) or the determinant of the
            information; with --for an identification, its least known parameters (a_optimal,
            default) or all (d_optimal).
        effects: Effects to be identified with it, comma-separated; `none`.
        basis: Base parameters whose condition number it is: as the report groups them, or as logs
            tell them apart best (default: the robot's own). With --for, those of the result.
        duration: Seconds.
        rate: Samples per second in the file [Hz].
        harmonics: Harmonics of the series.
        restarts: Random starts of the design.
        usage: Share of the limits that may be used.
        speed: Share of the designed speed that the motion is written at: 0.1 for a first run.
        seed: of the first trajectory; the next ones have the next ones.
        device_name: where regressors are evaluated.

    Raises:
        TorchidError: a number that is out of range, or what does not go together.
    """

    result: Path | None = None
    kind: Literal["optimised", "random", "sinusoid", "paper"] = "optimised"
    count: int = 1
    criterion: Literal["condition", "d_optimal", "a_optimal"] | None = None
    effects: tuple[str, ...] = EXCITED_EFFECTS
    basis: Literal["report", "conditioned"] | None = None
    duration: float = DURATION
    rate: float = 100.0
    harmonics: int = HARMONICS
    restarts: int = RESTARTS
    usage: float = USAGE
    speed: float = 1.0
    seed: int = 0
    device_name: str = "cpu"

    def __post_init__(self) -> None:
        for name in ("duration", "rate", "usage", "speed"):
            if not getattr(self, name) > 0:
                raise TorchidError(f"`{name}=...` must be positive.", got=getattr(self, name))
        for name, share in (("usage", "limits"), ("speed", "designed speed")):
            if getattr(self, name) > 1:
                raise TorchidError(
                    f"`{name}=...` is a share of the {share}.",
                    got=getattr(self, name),
                    expected="0..1",
                )
        if self.duration / self.speed * self.rate > 1e7:
            raise TorchidError(
                "the trajectory would have more than ten million samples.",
                got=f"{self.duration / self.speed:g} s at {self.rate:g} Hz",
            )
        if self.result is not None and (self.kind != "optimised" or self.count != 1):
            raise TorchidError(
                "`result=...` designs one optimised trajectory.",
                got=f'`kind="{self.kind}"` `count={self.count}`',
            )
        if self.basis is not None and (self.result is not None or self.kind != "optimised"):
            raise TorchidError(
                "`basis=...` is of the condition number that a new design improves.",
                got=f'`kind="{self.kind}"`' if self.result is None else f'`result="{self.result}"`',
                expected='`kind="optimised"` without a result',
            )

    @property
    def series(self) -> dict[str, Any]:
        """Settings of the Fourier series."""
        return {"harmonics": self.harmonics, "duration": self.duration, "usage": self.usage}


@dataclass(frozen=True, kw_only=True)
class Room:
    """What a motion keeps clear of.

    Attributes:
        clearance: Distance that the links keep from each other, the floor and the workspace's
            sides [m].
        floor: Height of a floor, in the base frame [m].
        workspace: Box that no moving link leaves, in the base frame [m]:
            XMIN,XMAX,YMIN,YMAX,ZMIN,ZMAX.
    """

    clearance: float = CLEARANCE
    floor: float | None = None
    workspace: tuple[float, ...] | None = None
