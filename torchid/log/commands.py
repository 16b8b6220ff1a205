"""Commands on a clock of their own, at the times of positions: each holds until the next."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from torchid.errors import LogError

LONG = 10.0
"""A pause of more than so many usual ones is told [1]."""


@dataclass(frozen=True, eq=False)
class Held:
    """Commands at the times of positions.

    Attributes:
        rows: (T,) positions that have a command.
        u: (T, n) commands, NaN where there is none yet.
        warnings: one sentence each.
    """

    rows: np.ndarray
    u: np.ndarray
    warnings: tuple[str, ...]


def held_commands(t: np.ndarray, t_command: np.ndarray, u: np.ndarray, label: str) -> Held:
    """The nearest earlier command of each position: what a servo goes by until it is sent another.

    Args:
        t: (T,) times of positions, rising [s].
        t_command: (M,) times of commands on the same clock, in any order [s].
        u: (M, n) commands; a row with a number missing is no command.
        label: of the log, for the messages.

    Raises:
        LogError: commands and positions were not recorded at the same time.
    """
    there = np.isfinite(u).all(1) & np.isfinite(t_command)
    order = np.argsort(t_command[there], kind="stable")
    sent, u_sent = t_command[there][order], u[there][order]
    _overlap(t, sent, label)
    at = np.searchsorted(sent, t, side="right") - 1
    values = np.where(at[:, None] >= 0, u_sent[at], np.nan)
    warnings = list(_late(t, at >= 0, label))
    if not there.all():
        warnings.append(
            f"{label}: {int((~there).sum())} of {len(there)} commands have no value: the one "
            "before is held."
        )
    # Pauses among the commands, and behind the last of them.
    steps = np.diff(sent, append=max(sent[-1], t[-1]))
    usual = float(np.median(steps))
    long = steps > LONG * usual
    if usual > 0 and long.any():
        longest = int(steps.argmax())
        warnings.append(
            f"{label}: commands pause {int(long.sum())} times, at most for {steps[longest]:.3g} s "
            f"(at {sent[longest] - t[0]:.3g} s; they come every {usual:.3g} s): the one before is "
            "held."
        )
    return Held(at >= 0, values, tuple(warnings))


def commands_along(
    t: np.ndarray,
    q: np.ndarray,
    trajectories: Sequence[tuple[float, np.ndarray, np.ndarray]],
    label: str,
) -> Held:
    """The set-points of a controller that follows trajectories, each until the next begins:
    straight lines between their points, from where the set-point is, and the last point is held
    (ros2_control's joint_trajectory_controller, of positions alone).

    Args:
        t: (T,) times of positions, rising [s].
        q: (T, n) positions: the first trajectory starts from them.
        trajectories: when each begins [s], seconds (P,) from then to its points, and the points
            (P, n).
        label: of the log, for the messages.

    Raises:
        LogError: commands and positions were not recorded at the same time.
    """
    listed = sorted(trajectories, key=lambda one: one[0])
    _overlap(t, np.array([begin for begin, _, _ in listed]), label)
    times: list[float] = []
    points: list[np.ndarray] = []
    for begin, after, goals in listed:
        if not times:
            now = np.array([np.interp(begin, t, column) for column in q.T])
        else:
            # Of the trajectory before remains what was reached until now.
            ahead: tuple[float, np.ndarray] | None = None
            while times and times[-1] > begin:
                ahead = times.pop(), points.pop()
            now = points[-1]
            if ahead is not None and ahead[0] > times[-1]:
                share = (begin - times[-1]) / (ahead[0] - times[-1])
                now = now + share * (ahead[1] - now)
        times += [begin, *(begin + after)]
        points += [now, *goals]
    known, values = np.array(times), np.stack(points)
    u = np.stack([np.interp(t, known, column) for column in values.T], 1)
    rows = t >= known[0]
    u[~rows] = np.nan
    return Held(rows, u, _late(t, rows, label))


def _overlap(t: np.ndarray, sent: np.ndarray, label: str) -> None:
    """Refuse commands that were not sent while positions were recorded."""
    if len(sent) == 0:
        raise LogError(f"{label} has no commands.", got=0, expected="commands with their times")
    if not (sent.min() < t[-1] and sent.max() >= t[0]):
        raise LogError(
            f"{label}: commands and positions were not recorded at the same time.",
            got=f"commands from {sent.min():.6g} to {sent.max():.6g} s, positions from "
            f"{t[0]:.6g} to {t[-1]:.6g} s",
            expected="times of one clock",
        )


def _late(t: np.ndarray, rows: np.ndarray, label: str) -> tuple[str, ...]:
    if rows.all():
        return ()
    first = float(t[rows.argmax()] - t[0])
    return (
        f"{label}: the first command comes {first:.3g} s after the first position: the "
        f"{int((~rows).sum())} positions before it are left out.",
    )
