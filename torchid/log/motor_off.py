"""Stretches of a log of commands in which the motors are off: an arm that falls is no servo that
fails.

A motor is off where a column such as `torque_enable` says so, and where no joint has a command for
longer than `OFF_S`: a shorter gap is a command that was not sent, and the one before holds.
"""

from collections.abc import Sequence

import numpy as np

from torchid.errors import LogError
from torchid.log.columns import Columns
from torchid.log.table import Table
from torchid.log.words import NAMES, words_of

OFF_S = 1.0
"""Commands come every 1 to 100 ms, and pause for some tenths of a second where a link is bad."""


def enabling_columns(table: Table) -> list[str]:
    """Columns that say whether motors are on: torque_enable, motor_on, enabled_1, .."""
    ends = [tuple(end.split()) for end in NAMES["enabled"]]
    return [
        name for name in table.columns if any(tuple(words_of(name)[-len(e) :]) == e for e in ends)
    ]


def while_on(
    columns: dict[str, np.ndarray], switches: Sequence[np.ndarray], label: str
) -> tuple[Columns, tuple[str, ...]]:
    """The columns of a log of commands without the rows in which motors are off, and a note.

    What is left on either side of them is a trajectory each, for a motion does not go on there.

    Args:
        columns: t, q1.., u1.. and others (T,).
        switches: (T,) or (T, k) each: numbers, or text; zero or `false` is off.
        label: of the log, for the messages.

    Raises:
        LogError: the motors are never on.
    """
    commands = [x for name, x in columns.items() if name[0] == "u" and name[1:].isdigit()]
    if not commands or any(name.startswith(("tau", "i")) for name in columns):
        return columns, ()
    on = np.ones(len(columns["t"]), dtype=bool)
    for switch in switches:
        on &= ~_is_off(switch.reshape(len(on), -1)).any(1)
    on &= ~_silent(np.asarray(columns["t"], dtype=np.float64), np.stack(commands, 1))
    traj = np.asarray(columns.get("traj", np.zeros(len(on), dtype=np.int64)))
    # Another run begins where motors are switched, and where a trajectory begins.
    begins = np.diff(on, prepend=on[:1]) | (np.diff(traj, prepend=traj[:1]) != 0)
    runs = np.cumsum(begins)
    keep = on & (np.bincount(runs)[runs] > 1)
    if keep.all():
        return columns, ()
    if not keep.any():
        raise LogError(
            f"{label}: the motors are off in all of it.",
            got="no row with motors on and commands",
            expected="commands that servos follow",
        )
    parts = np.unique(runs[keep], return_inverse=True)[1]
    left = {name: x[keep] for name, x in columns.items()} | {"traj": parts}
    note = f"{label}: in {int((~keep).sum())} of {len(keep)} rows the motors are off: left out"
    return left, (f"{note}; {int(parts.max()) + 1} trajectories are left" if parts.any() else note,)


def _is_off(switch: np.ndarray) -> np.ndarray:
    """Which numbers and texts say that a motor is off; what is absent says nothing."""
    words = ("false", "0", "0.0", "off", "no")
    return np.vectorize(lambda x: str(x).strip().lower() in words, otypes=[bool])(switch)


def _silent(t: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Rows (T,) in stretches without any command: before the first, and longer than `OFF_S`."""
    none = ~np.isfinite(u).any(1)
    runs = np.cumsum(np.diff(none, prepend=none[:1]))
    lasts = np.array([np.ptp(t[runs == k]) > OFF_S for k in range(runs.max() + 1)])
    return none & (lasts | (np.arange(len(lasts)) == 0))[runs]
