"""Folders of SAGE (github.com/isaac-sim2real/sage): one motion, commands and states apart.

control.csv: timestamp, positions: what was commanded. state_motor.csv: timestamp, positions,
velocities, torques: what was measured. Time is in microseconds, a cell holds a list of all joints.
joint_list.txt names the joints, event.csv says when the motion began and when motors were switched
off; both may be missing.
"""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv

from torchid.errors import LogError
from torchid.log.commands import held_commands
from torchid.log.joint_names import in_robot_order
from torchid.log.table import Request, Table

_STATES, _COMMANDS, _EVENTS = "state_motor.csv", "control.csv", "event.csv"


def is_sage(path: Path) -> bool:
    """Whether a folder holds a motion as SAGE writes it."""
    return (path / _STATES).is_file()


def sage_table(path: Path, request: Request) -> Table:
    """The table of a motion: t, q, and u, the last command before each position.

    `velocities` and `torques` are there under these names: their units differ from robot to robot.

    Raises:
        LogError: a file is damaged or lacks columns, joints are not the robot's, or commands were
            not recorded with the positions.
    """
    states = _lists(path / _STATES, ("positions", "velocities", "torques"))
    # Microseconds, unless the steps are too short for that.
    stamps = states.pop("timestamp")
    # 1.0: no log has samples closer than this: smaller steps are seconds
    second = 1.0 if np.median(np.diff(stamps)) < 1.0 else 1e-6
    t, rows = second * stamps, np.ones(len(stamps), dtype=bool)
    order, joints, warnings = _order(path, states["positions"].shape[1], request)
    signals = {name: values[:, order] for name, values in states.items()}
    signals["q"] = signals.pop("positions")
    if (path / _COMMANDS).is_file():
        sent = _lists(path / _COMMANDS, ("positions",))
        if sent["positions"].shape[1] != states["positions"].shape[1]:
            raise LogError(
                f"'{path}': {_COMMANDS} and {_STATES} have different joints.",
                got=f"{sent['positions'].shape[1]} and {states['positions'].shape[1]}",
                expected="as many values in a row",
            )
        commands = held_commands(
            t, second * sent["timestamp"], sent["positions"][:, order], f"'{path}'"
        )
        signals["u"], rows, warnings = commands.u, commands.rows, warnings + commands.warnings
    else:
        warnings += (f"'{path}': no {_COMMANDS}: positions without commands.",)
    off = second * _switched_off(path)
    if bool((t > off).any()):
        warnings += (
            f"'{path}': {int((t > off).sum())} positions after the motors were switched off are "
            "left out.",
        )
        rows = rows & (t <= off)
    others = [name for name in ("velocities", "torques") if name in signals]
    if others:
        warnings += (
            f"'{path}': {' and '.join(others)} are left aside, as their units differ from robot to "
            'robot; where they are known: `columns="dq=velocities,tau=torques"`',
        )
    arrays = {"t": t[rows] - t[rows][:1], **{name: x[rows] for name, x in signals.items()}}
    origins = {"t": "timestamp", "q": f"{_STATES} positions"}
    if "u" in arrays:
        origins["u"] = f"{_COMMANDS} positions, each until the next"
    return Table.in_memory(
        path, "SAGE motion", arrays, joints=joints, origins=origins, warnings=warnings
    )


def _lists(file: Path, wanted: Sequence[str]) -> dict[str, np.ndarray]:
    """timestamp (T,) as it is and those of the wanted columns that there are, (T, n)."""
    table = pa.csv.read_csv(file)
    missing = [name for name in ("timestamp", "positions") if name not in table.column_names]
    if missing:
        raise LogError(f"'{file}' has no column {missing[0]}.", available=table.column_names)
    if table.num_rows < 2:
        raise LogError(f"'{file}' has fewer than two rows.", got=table.num_rows)
    out = {}
    for name in [name for name in wanted if name in table.column_names]:
        try:
            rows = [json.loads(cell) for cell in table.column(name).to_pylist()]
            values = np.array(rows, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise LogError(
                f"'{file}': column {name} does not hold lists of numbers, equally long.",
                got=str(error)[:100],
                expected='cells such as "[0.1, 0.2]"',
            ) from error
        if values.ndim != 2:
            raise LogError(f"'{file}': column {name} holds no lists.", got=rows[0])
        out[name] = values
    try:
        t = table.column("timestamp").cast(pa.float64(), safe=False).to_numpy()
    except pa.ArrowInvalid as error:
        raise LogError(f"'{file}': column timestamp is not numeric.") from error
    return {**out, "timestamp": t}


def _order(
    path: Path, count: int, request: Request
) -> tuple[list[int], tuple[str, ...], tuple[str, ...]]:
    """Which values are the robot's joints, in its order, what they are called, and what to say."""
    file = path / "joint_list.txt"
    names = [line.strip() for line in file.read_text().splitlines()] if file.is_file() else []
    names = [name for name in names if name]
    everything = list(range(count))
    if len(names) != count:
        if names:
            raise LogError(
                f"'{path}': joint_list.txt names other joints than {_STATES} has.",
                got=f"{len(names)} names, {count} values in a row",
            )
        return everything, (), ()
    if not request.joints or request.maps("q"):
        return everything, tuple(names), ()
    try:
        ordered, notes = in_robot_order(names, request.joints, f"'{path}'", request.spare_joints)
    except LogError:
        if count != len(request.joints):
            raise
        note = "its joints do not have the robot's names; taken in the order of the file"
        return everything, tuple(names), (f"'{path}': {note}: {', '.join(names)}",)
    return [names.index(name) for name in ordered], tuple(ordered), notes


def _switched_off(path: Path) -> float:
    """The timestamp at which motors were switched off; infinite where that is not known."""
    file = path / _EVENTS
    if not file.is_file():
        return np.inf
    table = pa.csv.read_csv(file).to_pydict()
    events = zip(table.get("event", ()), table.get("timestamp", ()), strict=False)
    off = [float(when) for event, when in events if event == "DISABLE"]
    return off[-1] if off else np.inf
