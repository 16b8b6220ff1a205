"""What a file holds before it is a Log: named arrays, some of them under our names."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from torchid.errors import LogError
from torchid.log.mapping import ColumnMapping

Shape = tuple[int, ...]


class AbsentColumnError(LogError):
    """A mapping names what the table does not have."""


@dataclass(frozen=True)
class Request:
    """How a log is to be read.

    Attributes:
        columns: which columns are what, where they have other names than ours.
        topic: of the joint states in a bag.
        joints: names of the robot's joints in order, where the robot is known; empty otherwise.
        spare_joints: names of other joints of the robot that a recording may have (`Robot.spare`).
    """

    columns: ColumnMapping | None = None
    topic: str | None = None
    joints: tuple[str, ...] = ()
    spare_joints: tuple[str, ...] = ()

    def maps(self, key: str) -> bool:
        """Whether the mapping says where `key` is."""
        return self.columns is not None and key in self.columns.sources


@dataclass(frozen=True)
class Table:
    """Named arrays of a file, read when asked for.

    Attributes:
        path: of the file or folder.
        kind: of the file, for people: "csv", "ROS bag", ...
        columns: shape of each array as far as it is known before reading; -1 for a size that is
            not, None where nothing is.
        read: arrays by name, each (T,) or (T, k).
        one_by_one: whether columns had better be read one by one, being long.
        arrays: whether q, dq, .. may be arrays (T, n) instead of columns q1, q2, ..
        repeated: columns that are there more than once.
        joints: names of the joints of q, where the file tells.
        topic: of a bag, the one that was read.
        origins: what t, q, dq, .. are in the file's words, where the format itself says so.
        warnings: what was noticed, one sentence each.
        servos: as in `Log`.
    """

    path: Path
    kind: str
    columns: Mapping[str, Shape | None]
    read: Callable[[Sequence[str]], dict[str, np.ndarray]]
    one_by_one: bool = False
    arrays: bool = False
    repeated: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    topic: str | None = None
    origins: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    servos: str = ""

    @classmethod
    def in_memory(
        cls, path: Path, kind: str, arrays: Mapping[str, np.ndarray], **known: Any
    ) -> "Table":
        """A table of arrays that are read already; what else is known are fields by name."""
        shapes = {name: array.shape for name, array in arrays.items()}
        return cls(
            path, kind, shapes, lambda names: {n: arrays[n] for n in names}, arrays=True, **known
        )

    @property
    def described(self) -> list[str]:
        """The columns for an error message, with the size of those that are arrays."""
        sizes = {
            name: " x ".join("?" if k < 0 else str(k) for k in shape)
            for name, shape in self.columns.items()
            if shape is not None and len(shape) > 1
        }
        return [f"{name} ({sizes[name]})" if name in sizes else name for name in self.columns]


def natural(text: str) -> list[tuple[int, int, str]]:
    """A key that sorts numbers within names by value, of any length: joint2 before joint10."""
    return [
        (0, len(part.lstrip("0")), part.lstrip("0")) if part.isdecimal() else (1, 0, part)
        for part in re.split(r"(\d+)", text)
        if part
    ]
