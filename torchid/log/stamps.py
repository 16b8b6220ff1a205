"""Time stamps of a log's trajectories: whether they increase, and how many samples a second there
are."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from torchid.errors import LogError

if TYPE_CHECKING:
    from torchid.log.model import Log

UNIFORM = 1e-3
"""Largest deviation from a uniform grid, in steps."""

ROUNDING = 1e-6
"""Relative difference below which steps are one: stamps far from zero are rounded."""


SMALL_GAP = 3.0
"""Longer steps are counted as gaps, in median steps."""


@dataclass(frozen=True)
class Steps:
    """How even the time stamps of one trajectory are.

    Attributes:
        shortest, median, longest: steps [s].
        gaps: number of steps longer than 3 median steps.
    """

    shortest: float
    median: float
    longest: float
    gaps: int

    @classmethod
    def of(cls, t: np.ndarray) -> "Steps":
        """How even stamps (T,) [s] are."""
        d = np.diff(t)
        median = float(np.median(d))
        return cls(float(d.min()), median, float(d.max()), int((d > SMALL_GAP * median).sum()))

    def __str__(self) -> str:
        text = (
            f"steps of {1e3 * self.shortest:.3g} / {1e3 * self.median:.4g} / "
            f"{1e3 * self.longest:.3g} ms (shortest / median / longest)"
        )
        if self.gaps == 0:
            return text
        return f"{text}, {self.gaps} gap{'s' if self.gaps > 1 else ''} of more than 3 steps"


def place_of(log: "Log", row: int) -> str:
    """Which sample of which trajectory, counted from 1."""
    rows = log.slices()[int(log.trajectory[row])]
    name = log.names[int(log.trajectory[row])]
    return f"row {row - rows.start + 1} of '{name}'"


def check_increasing(log: "Log") -> None:
    """Refuse a log whose time does not increase within each trajectory, or has one sample there."""
    for name, rows in zip(log.names, log.slices(), strict=True):
        t = log.t[rows]
        steps = t.diff()
        # Not `<= 0`: this way NaN is refused too.
        wrong = (~(steps > 0)).nonzero().flatten()
        if len(t) < 2:
            raise LogError(f"trajectory '{name}' has one sample only.", got=1, expected="many")
        if len(wrong) == 0:
            continue
        k = int(wrong[0])
        repeated, back = int((steps == 0).sum()), int((steps < 0).sum())
        raise LogError(
            f"{log.label}: time does not increase in {place_of(log, rows.start + k + 1)}.",
            got=f"{float(t[k]):.9g} s, then {float(t[k + 1]):.9g} s; in all {repeated} repeated "
            f"and {back} decreasing time stamps",
            expected="increasing time within a trajectory",
            hint="delete repeated rows, or number the trajectories in an integer column `traj`",
        )


def stamps_of(log: "Log") -> list[np.ndarray]:
    """The time stamps of each trajectory, which must increase."""
    check_increasing(log)
    return [log.t[rows].detach().cpu().numpy() for rows in log.slices()]


def off_grid(t: np.ndarray, step: float) -> float:
    """Largest distance of the stamps from t[0], t[0] + step, ..., in steps."""
    return float(np.abs((t - t[0]) / step - np.arange(len(t))).max())


def typical_step(t: np.ndarray) -> float:
    """The median step; the mean, which is more exact, where all steps are alike."""
    mean = float((t[-1] - t[0]) / (len(t) - 1))
    return mean if off_grid(t, mean) <= UNIFORM else float(np.median(np.diff(t)))


def rates_of(log: "Log") -> tuple[float, ...]:
    """Samples per second of each trajectory [Hz], from its median step; exactly the same where
    only the stamps' rounding differs.

    Raises:
        LogError: a trajectory has one sample only, or its time does not increase.
    """
    rates = [1.0 / typical_step(t) for t in stamps_of(log)]
    if max(rates) <= (1.0 + ROUNDING) * min(rates):
        return (float(np.median(rates)),) * len(rates)
    return tuple(rates)
