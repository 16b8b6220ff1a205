"""Joint states as `rostopic echo -p` and `ros2 topic echo --csv` write them: text with the joints'
names in every row, in any order."""

import csv
import re
from itertools import chain
from pathlib import Path

import numpy as np

from torchid.log.joint_states import JointState, joint_columns_of
from torchid.log.table import Request, Table

_FIELD = re.compile(r"(?:.*\.)?(name|position|velocity|effort)(\d+)")
_SIGNALS = ("position", "velocity", "effort")

Places = dict[str, list[int]]
"""Columns of received and stamp ([ns], or s and ns), of name, position, velocity and effort."""


def echo_table(path: Path, request: Request) -> Table | None:
    """The joint states of such a file: t, q, dq, tau in the robot's order, and joint by joint; None
    of any other file.

    Raises:
        LogError: the robot's joints are not among the names.
    """
    with open(path, encoding="utf-8-sig", newline="") as file:
        first = file.readline(1_000_000)
        names = next(csv.reader([first]), []) if "," in first else []
        places = _named(names) or _unnamed(names)
        if places is None:
            return None
        rows = csv.reader(file if _named(names) else chain([first], file))
        messages = [_state(row, places) for row in rows if len(row) >= len(names)]
    joints = () if request.maps("q") else request.joints
    motion = joint_columns_of(messages, joints, f"'{path}'", request.spare_joints)
    origins = {
        "t": "stamp of the header" if motion.stamped else "time of receipt",
        **dict(zip(("q", "dq", "tau"), _SIGNALS, strict=True)),
    }
    return Table.in_memory(
        path, "echo of a ROS topic", motion.arrays,
        joints=motion.joints, origins=origins, warnings=motion.warnings,
    )  # fmt: skip


def _named(names: list[str]) -> Places | None:
    """Columns of each field of ROS 1, whose header counts them: field.name0, field.position0, ..;
    None of another header."""
    places: Places = {}
    for k, name in enumerate(names):
        if field := _FIELD.fullmatch(name.strip()):
            places.setdefault(field[1], []).append(k)
    if len(places.get("name", ())) != len(places.get("position", ())) or not places:
        return None
    stamp = [k for k, name in enumerate(names) if name.endswith("stamp")]
    return {"received": [0], "stamp": stamp[:1] or [0], **places}


def _unnamed(row: list[str]) -> Places | None:
    """Columns of each field of ROS 2, without a header: s, ns, the frame, names, then as many
    numbers of each signal; None of another row."""
    texts = [bool(re.search(r"[A-Za-z_]", x)) and x not in ("nan", "inf") for x in row]
    first, n = 3, texts[3:].index(False) if False in texts[3:] else 0
    signals, rest = divmod(len(row) - first - n, max(n, 1))
    if not n or rest or not 1 <= signals <= len(_SIGNALS) or any(texts[:2] + texts[first + n :]):
        return None
    places = {"received": [0, 1], "stamp": [0, 1], "name": list(range(first, first + n))}
    for k, signal in enumerate(_SIGNALS[:signals], start=1):
        places[signal] = list(range(first + k * n, first + (k + 1) * n))
    return places


def _state(row: list[str], places: Places) -> JointState:
    def instant(key: str) -> int:
        whole, *rest = (int(row[k]) for k in places[key])
        return whole * 1_000_000_000 + rest[0] if rest else whole

    numbers = {s: np.array([float(row[k]) for k in places.get(s, ())]) for s in _SIGNALS}
    names = tuple(row[k] for k in places["name"])
    return JointState(instant("received"), instant("stamp"), names, numbers)
