"""A Log from named columns, and back.

Columns: t [s]; q1..qn [rad or m]; and, where there are any, dq1.. ddq1.. tau1.. [N m or N],
i1.. [A], ql1.. [rad or m] of encoders on the links' side, u1.. [rad or m] commanded; traj, an
integer that separates trajectories; and, of a base that moves, its pose and twist (`base_motion`),
whose six coordinates come before the joints'. Any other column is ignored.

ext1.. [N m or N] are what joints are known to give to something outside of the model, as a load
cell behind a drive tells it: they are subtracted from tau, and no part of the Log.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import torchid
from torchid.errors import LARGEST, LogError
from torchid.log.base_motion import COORDINATES, NAMES, base_signals, has_base

Columns = Mapping[str, np.ndarray]

PREFIXES = {
    "q": "q", "dq": "dq", "ddq": "ddq", "tau": "tau", "current": "i", "ql": "ql", "u": "u",
}  # fmt: skip
JOINT_SIGNALS = tuple(PREFIXES)
_JOINT_COLUMN = re.compile(r"(ql|q|dq|ddq|tau|i|u|ext)(\d+)")
_SINCE_1970 = (1e9, 5e9)  # seconds, from 2001 to 2128: no clock that starts with a log has them
EXPECTED = (
    "t, q1..qn and, where known, dq1..dqn, ddq1..ddqn, tau1..taun or i1..in, ql1..qln, u1..un, traj"
)


def log_from_columns(columns: Columns, path: str | Path) -> "torchid.Log":
    """A Log from named columns, each an array (T,) of numbers.

    Args:
        columns: as in the module's description; others are ignored.
        path: the file they came from, for names and errors.

    Raises:
        LogError: t or q is missing, joints are not numbered 1..n, counts differ, a column is not
            numeric or has another length, or there are fewer than two samples.
    """
    import torch

    path = Path(path)
    joints = joint_columns(columns, path)
    t = _numeric(seconds(numbers_of(columns["t"], f"'{path}': column t")), "t", path)
    samples = len(t)
    # Each column goes to its place alone: a second copy of all of them is a second log in memory.
    signals: dict[str, Any] = {}
    for signal, group in joints.items():
        values = np.empty((samples, len(group)), order="F")
        for k, name in enumerate(group):
            values[:, k] = _numeric(columns[name], name, path, samples)
        signals[signal] = torch.from_numpy(values)
    if samples < 2:
        what = "columns and no rows" if samples == 0 else "one sample only"
        wanted = "samples" if samples == 0 else "a trajectory"
        raise LogError(f"'{path}' has {what}.", got=samples, expected=wanted)
    trajectory, names = _trajectories(columns.get("traj"), samples, path)
    warnings = _without_external(signals, columns, path)
    if has_base(columns, f"'{path}'"):
        signals, left = _with_base(signals, columns, trajectory, path)
        warnings += left
    return torchid.Log(
        t=torch.from_numpy(t),
        **signals,
        trajectory=torch.from_numpy(trajectory),
        names=names,
        source=str(path),
        warnings=warnings,
    )


def _without_external(signals: dict[str, Any], columns: Columns, path: Path) -> tuple[str, ...]:
    """Take known external torques from the torque, and say so."""
    known = [(int(m[2]), m[0]) for name in columns
             if (m := _JOINT_COLUMN.fullmatch(name)) and m[1] == "ext"]  # fmt: skip
    tau = signals.get("tau")
    if not known:
        return ()
    if tau is None:
        raise LogError(f"'{path}' has external torques and no tau to take them from.",
                       got=", ".join(first_names([name for _, name in known])))  # fmt: skip
    count = tau.shape[1]
    for number, name in known:
        if not 1 <= number <= count:
            raise LogError(f"'{path}' has no joint of column {name}.", expected=f"ext1..ext{count}")
        tau[:, number - 1] -= tau.new_tensor(_numeric(columns[name], name, path, len(tau)))
    names = ", ".join(f"tau{k} - {name}" for k, name in sorted(known))
    return (f"External torque is subtracted: '{path}' gives {names}.",)


def _with_base(
    signals: dict[str, Any], columns: Columns, trajectory: np.ndarray, path: Path
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Signals with the base's six coordinates before the joints', and what to say of it: nothing
    holds the base, and its velocities are those of the log or none."""
    import torch

    samples = len(trajectory)
    own = {}
    for name in NAMES:
        if name in columns:
            own[name] = _numeric(columns[name], name, path, samples)
    starts = np.flatnonzero(np.diff(trajectory, prepend=-1))
    base = base_signals(own, starts, f"'{path}'")
    still = np.zeros((samples, COORDINATES))
    first = {"q": base["q"], "dq": base["dq"], "tau": still, "current": still}
    out, left = {}, []
    for signal, values in signals.items():
        lead = first.get(signal)
        if lead is None:
            left.append(PREFIXES[signal])
        else:
            out[signal] = torch.cat([torch.from_numpy(lead), values], 1)
    if not left:
        return out, ()
    return out, (f"{', '.join(left)} left out: '{path}' does not have it of the base.",)


def columns_of(log: "torchid.Log") -> dict[str, np.ndarray]:
    """Named columns (T,) of a log; `traj` only where there are several trajectories."""
    columns = {"t": log.t.detach().cpu().numpy()}
    if log.trajectory_count > 1:
        columns["traj"] = log.trajectory.cpu().numpy()
    for signal, values in log.signals.items():
        array = values.detach().cpu().numpy()
        columns |= {f"{PREFIXES[signal]}{k + 1}": array[:, k] for k in range(log.n)}
    return columns


def column_names(log: "torchid.Log") -> list[str]:
    """What a log holds, for a message: t, q1..q7, tau1..tau7."""
    return ["t", *(_range([f"{PREFIXES[s]}{k + 1}" for k in range(log.n)]) for s in log.signals)]


def is_wanted(name: str) -> bool:
    """Whether a log has a place for a column of this name."""
    return name in ("t", "traj", *NAMES) or _JOINT_COLUMN.fullmatch(name) is not None


def joint_columns(names: Iterable[str], path: Path) -> dict[str, list[str]]:
    """The columns of each joint signal in order, e.g. {"q": ["q1", "q2"], ...}."""
    names = list(names)
    groups = {signal: _numbered(names, prefix, path) for signal, prefix in PREFIXES.items()}
    if "t" not in names:
        raise LogError(
            f"'{path}' has no column t.", expected=EXPECTED, available=first_names(names)
        )
    count = len(groups["q"])
    if count == 0:
        raise LogError(
            f"'{path}' has no column q1.", expected=EXPECTED, available=first_names(names)
        )
    for signal, group in groups.items():
        if group and len(group) != count:
            prefix = PREFIXES[signal]
            raise LogError(
                f"'{path}' has {count} q columns and {len(group)} {prefix} columns.",
                got=_range(group),
                expected=_range([f"{prefix}{i + 1}" for i in range(count)]),
                hint=sensorless(f"{prefix}{i + 1}" for i in range(len(group), count)),
            )
    return {signal: group for signal, group in groups.items() if group}


def sensorless(names: Iterable[str]) -> str | None:
    """How a mapping says that these joints have no sensor of torque or current; None where that
    cannot be said."""
    entries = [f"{name}=none" for name in names if re.fullmatch(r"(tau|i)\d+", name)]
    return f'joints without a sensor: `columns="{",".join(entries)}"`' if entries else None


def _numbered(names: Sequence[str], prefix: str, path: Path) -> list[str]:
    matches = (_JOINT_COLUMN.fullmatch(name) for name in names)
    numbered = sorted((int(m[2]), m[0]) for m in matches if m is not None and m[1] == prefix)
    expected = [f"{prefix}{i + 1}" for i in range(len(numbered))]
    got = [name for _, name in numbered]
    numbers = {number for number, _ in numbered}
    missing = [name for k, name in enumerate(expected, 1) if k not in numbers]
    if missing and 0 not in numbers and len(numbers) == len(numbered):
        raise LogError(
            f"'{path}' has no column {', '.join(first_names(missing, 5))}.",
            got=", ".join(first_names(got)),
            expected=f"{prefix}1..{got[-1]} without a gap",
            hint=sensorless(missing),
        )
    if got != expected:
        raise LogError(
            f"'{path}': the {prefix} columns are not numbered {_range(expected)}.",
            got=", ".join(first_names(got)),
            expected=", ".join(first_names(expected)),
        )
    return got


def _range(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{names[0]}..{names[-1]}"


def first_names(names: Sequence[str], most: int = 40) -> list[str]:
    """The first names of a list, for an error message, and how many more there are."""
    more = [f"and {len(names) - most} more"] if len(names) > most else []
    return [*names[:most], *more]


def _numeric(values: np.ndarray, name: str, path: Path, samples: int | None = None) -> np.ndarray:
    """A column of numbers, of this length if any is asked for."""
    # A copy: arrow's buffers are read-only.
    numbers = np.array(numbers_of(values, f"'{path}': column {name}"), dtype=np.float64)
    beyond = np.abs(numbers) > LARGEST
    beyond &= np.isfinite(numbers)
    if beyond.any():
        raise LogError(
            f"'{path}': column {name} holds numbers that nothing measures.",
            got=f"{numbers[beyond][0]:g} in row {int(beyond.ravel().argmax()) + 1}",
            expected=f"less than {LARGEST:g}",
        )
    if samples is not None and numbers.ndim != 1:
        raise LogError(
            f"'{path}': column {name} has the wrong number of dimensions.",
            got=f"shape {numbers.shape}",
            expected="(samples,)",
        )
    if samples is not None and len(numbers) != samples:
        raise LogError(
            f"'{path}': column {name} has another length than t.",
            got=len(numbers),
            expected=samples,
        )
    return numbers


def seconds(stamps: np.ndarray, factor: float = 1.0, offset: float = 0.0) -> np.ndarray:
    """(T,) seconds from numbers of another unit, or of none that is known: stamps since 1970 that
    are finer than seconds say theirs by their size."""
    start, end = (float(stamps.min()), float(stamps.max())) if stamps.size else (0.0, 0.0)
    least, most = _SINCE_1970
    # Nanoseconds since 1970 are counted from the first, or they would round.
    # 2**53: larger whole numbers are not all floats
    if stamps.dtype.kind in "iu" and start > (2**53):
        stamps = stamps - stamps[0]
    # A clock goes on: numbers that are all the same are of none.
    finer = [1 / unit for unit in (1e3, 1e6, 1e9) if least * unit < start < end < most * unit]
    if finer and factor == 1.0:
        factor = finer[0]
    return (stamps.astype(np.float64) + offset) * factor


def numbers_of(values: np.ndarray, label: str) -> np.ndarray:
    """A column as it is, or a LogError where it does not hold numbers."""
    if values.dtype.kind not in "iuf":
        raise LogError(f"{label} is not numeric.", got=_sample_of(values), expected="numbers")
    return values


def _sample_of(values: np.ndarray) -> str:
    """The type of a column and one of its values that is not a number."""
    for value in values.ravel().tolist():
        try:
            float(value)
        except (TypeError, ValueError):
            if value is not None:
                return f"{values.dtype.name}, such as {str(value)[:40]!r}"
    return values.dtype.name


def _trajectories(
    column: np.ndarray | None, samples: int, path: Path
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Trajectory numbers from 0, and their names."""
    if column is None:
        return np.zeros(samples, dtype=np.int64), (path.stem,)
    ids = _numeric(column, "traj", path, samples)
    if not np.isfinite(ids).all() or (ids != np.round(ids)).any():
        wrong = ids[~np.isfinite(ids) | (ids != np.round(ids))]
        raise LogError(f"'{path}': column traj is not integer.", got=float(wrong[0]))
    starts = np.flatnonzero(np.diff(ids, prepend=ids[0] - 1))
    order = ids[starts].astype(np.int64).tolist()
    lengths = np.diff(starts, append=samples)
    if len(set(order)) < len(order):
        again = next(k for k, i in enumerate(order) if i in order[:k])
        raise LogError(
            f"'{path}': trajectory {order[again]} comes back in row {starts[again] + 1} after "
            f"trajectory {order[again - 1]}.",
            expected="the rows of a trajectory together",
            hint="sort the rows by traj, then by t",
        )
    if (lengths < 2).any():
        raise LogError(
            f"'{path}': trajectory {order[int(np.argmin(lengths))]} has one sample only.",
            got=1,
            expected="at least two",
        )
    if len(order) == 1:
        return np.zeros(samples, dtype=np.int64), (path.stem,)
    numbers = np.repeat(np.arange(len(order)), lengths)
    return numbers, tuple(f"{path.stem}[traj={i}]" for i in order)
