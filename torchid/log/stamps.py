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


def regular_clock(t: np.ndarray, q: np.ndarray) -> np.ndarray | None:
    """The regular clock (T,) [s], with rows that are missing, that stamps jitter about by less than
    half a step, where positions are smoother over it; None where stamps tell more, or where
    they are regular.

    Args:
        t: (T,) stamps without long gaps [s].
        q: (T, n) positions.
    """
    steps, since = np.diff(t), t - t[0]
    place = np.r_[0.0, np.rint(steps / np.median(steps)).cumsum()]
    # Two stamps that jitter towards each other are one place at first.
    for _ in range(2):
        step, start = np.polyfit(place, since, 1)
        place = np.rint((since - start) / step)
    clock = t[0] + start + step * place
    if (np.diff(place) < 1).any() or np.abs(t - clock).max() <= UNIFORM * step:
        return None
    # 1.1: ratio of what is chance, where neither moves or noise is all that there is
    return clock if roughness_ratio(t, clock, q) > 1.1 else None


def roughness_ratio(t: np.ndarray, other: np.ndarray, q: np.ndarray) -> float:
    """How badly a cubic through four neighbours predicts positions (T, n), over the given stamps
    (T,) and over others (T,): their ratio, the median over joints."""
    if len(t) < 50:
        return 1.0
    step = np.diff(t)
    windows = np.lib.stride_tricks.sliding_window_view(step, 4)
    clean = (windows < SMALL_GAP * np.median(step)).all(1)
    ends = np.ptp(q, 0)
    moving = ends > 0.1 * ends.max()
    if not moving.any() or clean.sum() < 20:
        return 1.0
    given, smooth = (
        np.sqrt((_cubic_error(x, q[:, moving])[clean] ** 2).mean(0)) for x in (t, other)
    )
    return float(np.median(given / np.maximum(smooth, 1e-12)))


def _cubic_error(t: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Each position minus the cubic through its two neighbours on either side (Lagrange)."""
    nodes = {k: t[k : len(t) - 4 + k] for k in (0, 1, 3, 4)}
    error = q[2:-2].copy()
    for k, own in nodes.items():
        others = [x for j, x in nodes.items() if j != k]
        weight = np.prod([(t[2:-2] - x) / (own - x) for x in others], axis=0)
        error -= weight[:, None] * q[k : len(t) - 4 + k]
    return error
