"""What every result can do, and how it becomes JSON and is read back.

A `Record` is a result as its JSON has it: frozen, one field a key, whose types say what a file must
hold. Tensors are lists there, what is not finite is null, robots are their yaml, and joints, which
count from 0 here, count from 1.
"""

import math
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cache, partial
from html import escape
from importlib import import_module
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Any,
    Self,
    TypeGuard,
    TypeVar,
    get_args,
    get_origin,
    get_type_hints,
)

import msgspec
import numpy as np
from jaxtyping import AbstractArray, jaxtyped
from msgspec import UNSET, UnsetType

from torchid.errors import TorchidError
from torchid.json_data import plain, write_json
from torchid.notebooks import data_frame, html_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame
    from torch import Tensor

    from torchid.robot.model import Robot

FINITE = "finite"
"""Marks a tensor that is computed with: no entry may be null."""

Value = str | bool | int | float | list[str | float | list[float | None] | None] | None
Values = dict[str, Value]
"""An effect's record, or a part of one: coefficients, shapes and places by name."""

_PLACE = re.compile(r" - at `\$([^`]*)`")
_T = TypeVar("_T")
_P = TypeVar("_P", bound=msgspec.Struct)


def is_robot(value: object) -> "TypeGuard[Robot]":
    """Whether it is a `Robot`. What prints an answer again loads neither robots nor torch; before
    they are loaded nothing is one."""
    loaded = sys.modules.get("torchid.robot.model")
    return loaded is not None and isinstance(value, loaded.Robot)


class _Robots(type):
    def __instancecheck__(cls, value: object) -> bool:
        return is_robot(value)


class _Floats(type):
    def __instancecheck__(cls, value: object) -> bool:
        return isinstance(value, float)


if TYPE_CHECKING:
    Joint = int
    Real = float
    Model = Robot
else:

    class Model(metaclass=_Robots):
        """A robot, which is its yaml in JSON, without bounds."""

    class Joint(int):
        """A joint or link, from 0; from 1 in JSON."""

    class Real(metaclass=_Floats):
        """A float that is null in JSON where it is not finite, and nan read back."""


Ends = tuple[Real, Real]
"""Of an interval."""


@dataclass(frozen=True)
class Col:
    """A column of the tables for people, declared on the field of a part, or on the value of its
    property, that it shows: `Annotated[Real, Col("gain", ".1f", "N m/rad")]`.

    Attributes:
        heading: the field's name in words if empty.
        digits: of numbers that are no integers.
        unit: of all of its numbers, in the heading.
        unit_of: name of the field with the unit of this number.
        spread: name of the field with its standard deviation, or its interval.
        words: what writes a cell, where no rule of `table_of` does.
    """

    heading: str = ""
    digits: str = ".3g"
    unit: str = ""
    unit_of: str = ""
    spread: str = ""
    words: Callable[[Any], str] | None = None


class Rows(tuple[_T, ...]):
    """Entries of a result that make a table."""

    __slots__ = ()

    def to_frame(self) -> "DataFrame":
        """A pandas DataFrame of one row an entry, one column a key of the JSON; joints from 1.

        Raises:
            MissingExtraError: pandas is not installed.
        """
        return data_frame()(self.plain())

    def plain(self) -> list[dict[str, Any]]:
        """The entries as their JSON has them."""
        return [as_plain(entry) for entry in self]

    def _repr_html_(self) -> str:
        rows = self.plain()
        most_rows = 60
        cells = ([_cell(value) for value in row.values()] for row in rows[:most_rows])
        more = f"<p>and {len(rows) - most_rows} more</p>" if len(rows) > most_rows else ""
        return html_table(rows[0] if rows else (), cells) + more


class Result:
    """What every result can do, in memory or read back from its file."""

    __slots__ = ()

    @property
    def record(self) -> "Record":
        """The result as its JSON has it."""
        raise NotImplementedError

    def plain(self) -> dict[str, Any]:
        """The JSON as plain Python data."""
        return as_plain(self.record)

    def save(self, path: str | Path) -> None:
        """Write the JSON that the command writes with `--json`, whole or not at all.

        Raises:
            TorchidError: the file cannot be written.
        """
        write_json(self.plain(), Path(path))

    def to_frame(self) -> "DataFrame":
        """The result's main table as a pandas DataFrame, one column a key of its JSON; joints
        from 1.

        Raises:
            MissingExtraError: pandas is not installed.
        """
        return self.record.table.to_frame()

    def plot(self, kind: str | None = None, **which: Any) -> "Figure":
        """A figure, as the commands and their pages draw it.

        Args:
            kind: which figure; the first of its kinds if None.
            which: what else it asks for, e.g. `joint=0`.

        Raises:
            TorchidError: there is no such figure of this result, with those that there are.
        """
        return face("draw")(self, kind, **which)

    def _repr_html_(self) -> str:
        return f"<p>{escape(repr(self))}</p>{self.record.table._repr_html_()}"


def face(name: str) -> Any:
    """What the public face calls by this name: it knows who draws and who designs motions, for both
    stand above all results."""
    return getattr(import_module("torchid"), name)


class Part(msgspec.Struct, frozen=True):
    """A part of a record: its tensors fit each other, its joints are joints, its lists are rows.

    Raises:
        ValueError: tensors of other shapes, or one that must be finite and is not.
    """

    def __post_init__(self) -> None:
        put = partial(msgspec.structs.force_setattr, self)
        with jaxtyped("context"):
            for name, key, kind, finite in _plan(type(self)):
                value = getattr(self, name)
                if value is None or value is UNSET:
                    continue
                if kind is Joint:
                    put(name, Joint(value))
                elif kind is Rows:
                    put(name, Rows(value))
                elif kind is tuple:
                    put(name, tuple(Joint(joint) for joint in value))
                elif not isinstance(value, kind):
                    size = "x".join(map(str, value.shape))
                    raise ValueError(f"`{key}` is of size {size}, not {kind.dim_str.strip()}")
                elif finite and not bool(value.isfinite().all()):
                    raise ValueError(f"`{key}` is not all finite")

    @classmethod
    def of(cls: type[_P], *live: object, **own: Any) -> _P:
        """The part of what was computed: parts with more than their JSON has lose it.

        Args:
            live: objects that have its fields as attributes, the first that has one counts.
            own: fields that none of them has so.
        """
        return msgspec.convert(_View(live, own), cls, from_attributes=True, dec_hook=_computed)


def recorded(settings: type[_T], later: Sequence[str] = (), **keys: str) -> type[_T]:
    """The part of a record that says settings, whose fields are those of their dataclass. It is
    known as `SettingsRecord` of the module `record` beside theirs.

    Args:
        settings: a dataclass.
        later: fields that older files lack: those have the default.
        keys: what the JSON calls fields that it calls otherwise.
    """
    hints = get_type_hints(settings).items()
    parts = [(k, hint, *([getattr(settings, k)] if k in later else [])) for k, hint in hints]
    module = f"{settings.__module__.rpartition('.')[0]}.record"
    how: Any = {"bases": (Part,), "module": module, "frozen": True, "kw_only": True, "rename": keys}
    return msgspec.defstruct(f"{settings.__name__}Record", parts, **how)  # type: ignore[return-value]


def by_joint(part: type[_P], **columns: "Tensor | Sequence[Any]") -> tuple[_P, ...]:
    """A part a joint, of columns of n entries each: tensors (n,), (n, 2) of intervals, or
    sequences."""
    lists = (x.tolist() if hasattr(x, "tolist") else x for x in columns.values())
    each = ([tuple(x) if isinstance(x, list) else x for x in column] for column in lists)
    rows = enumerate(zip(*each, strict=True))
    return tuple(part(joint=j, **dict(zip(columns, row, strict=True))) for j, row in rows)


class Record(Part, Result, frozen=True, eq=False, kw_only=True, tag_field="schema"):
    """A result as its JSON has it; see torchid.results."""

    @property
    def record(self) -> Self:
        """The record itself, as results have one."""
        return self

    @property
    def schema(self) -> str:
        """Name of its schema."""
        return str(self.__struct_config__.tag)

    @property
    def table(self) -> Rows:
        """The entries of its main table."""
        raise NotImplementedError

    def __repr__(self) -> str:
        robot = getattr(self, "robot", "")
        return f"{type(self).__name__}({robot!r}, {len(self.table)} rows)"


class RobotRecord(Record, frozen=True, kw_only=True):
    """A result that names its robot, and what it is loaded by (`robot.library.named_record`)."""

    robot: str
    robot_source: str | None = None
    robot_tip: str | UnsetType = UNSET
    robot_root: str | UnsetType = UNSET
    robot_lock: dict[str, float] | UnsetType = UNSET


@dataclass(frozen=True)
class _View:
    """Attributes of several objects, and own ones before them."""

    live: tuple[object, ...]
    own: Mapping[str, Any]

    def __getattr__(self, name: str) -> Any:
        if name in self.own:
            value = self.own[name]
        else:
            value = next((getattr(o, name) for o in self.live if hasattr(o, name)), UNSET)
            if value is UNSET:
                raise AttributeError(name)
        # What is one number is a tensor where it was computed.
        return value.item() if getattr(value, "ndim", None) == 0 else value


@cache
def _plan(part: type[Part]) -> tuple[tuple[str, str, Any, bool], ...]:
    """Fields that are checked or made anew: name, key, kind (Joint, tuple for several, Rows, a type
    of tensors), and whether it must be finite."""
    checked: list[tuple[str, str, Any, bool]] = []
    keys = dict(zip(part.__struct_fields__, part.__struct_encode_fields__, strict=True))
    declared = get_type_hints(part, include_extras=True)
    for name, given in get_type_hints(part).items():
        whole = (declared[name], *get_args(declared[name]))
        finite = any(FINITE in getattr(part_of, "__metadata__", ()) for part_of in whole)
        # X | None is checked as X is.
        kinds = [k for k in get_args(given) if k not in (type(None), UnsetType)]
        hint = kinds[0] if get_origin(given) is not tuple and len(kinds) == 1 else given
        entry = get_args(hint)[0] if get_origin(hint) is tuple else None
        if hint is Joint:
            checked.append((name, keys[name], Joint, False))
        elif entry is Joint:
            checked.append((name, keys[name], tuple, False))
        elif isinstance(entry, type) and issubclass(entry, Part):
            checked.append((name, keys[name], Rows, False))
        elif isinstance(hint, type) and issubclass(hint, AbstractArray):
            checked.append((name, keys[name], hint, finite))
    return tuple(checked)


def _computed(kind: Any, value: Any) -> Any:
    if kind in (Joint, Real):
        return Joint(value) if kind is Joint else float(value)
    if hasattr(value, "isfinite") or is_robot(value):
        return value
    raise TypeError(f"{type(value).__name__} is no {kind}")


def as_plain(value: Any) -> Any:
    """JSON-ready data of a record or a part."""
    if isinstance(value, Part):
        kind = type(value)
        tag = {"schema": value.schema} if isinstance(value, Record) else {}
        names = zip(kind.__struct_encode_fields__, kind.__struct_fields__, strict=True)
        entries = ((key, getattr(value, name)) for key, name in names)
        return tag | {key: as_plain(entry) for key, entry in entries if entry is not UNSET}
    if isinstance(value, Joint) and not TYPE_CHECKING:
        return int(value) + 1
    if is_robot(value):
        return robot_record(value)
    if is_dataclass(value):
        return {f.name: as_plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): as_plain(entry) for key, entry in value.items()}
    if isinstance(value, tuple | list):
        return [as_plain(entry) for entry in value]
    return plain(value)


def robot_record(robot: "Robot") -> dict[str, Any]:
    """The robot's yaml as JSON-ready data, without bounds; infinite limits are null."""
    from torchid.robot.writer import to_mapping

    return {key: plain(entry) for key, entry in to_mapping(robot).items() if key != "bounds"}


def decode(content: bytes, kind: type[_T], source: str) -> _T:
    """A record of JSON.

    Args:
        content: of a file.
        kind: which.
        source: what the robots in it are called in errors.

    Raises:
        msgspec.MsgspecError: JSON that is not of this kind; its text ends with the place.
        ValueError, RecursionError: what is no JSON at all.
    """
    return msgspec.json.decode(content, type=kind, dec_hook=partial(_decoded, source))


def _decoded(source: str, kind: Any, value: Any) -> Any:
    if kind is Joint:
        if type(value) is not int or value < 1:
            raise ValueError("Expected the number of a joint, from 1")
        return Joint(value - 1)
    if kind is Real:
        if value is not None and type(value) not in (int, float):
            raise ValueError(f"Expected `float | null`, got `{type(value).__name__}`")
        try:
            return math.nan if value is None else float(value)
        except OverflowError as error:
            raise ValueError("the number is too large") from error
    return _robot(value, source) if kind is Model else _tensor(kind, value)


def _tensor(kind: type[AbstractArray], value: Any) -> "Tensor":
    """A tensor of nested lists, with as many axes as its kind has; null is not a number."""
    import torch

    flags = "bool" in kind.dtypes
    entries: Any = bool if flags else float | None
    for _ in kind.dims:
        entries = list[entries]
    try:
        numbers = np.array(msgspec.convert(value, entries), bool if flags else np.float64)
    except OverflowError as error:
        raise ValueError("a number is too large") from error
    except msgspec.ValidationError as error:
        # Its place is one in the tensor; the tensor's own follows.
        raise ValueError(_PLACE.sub(r", entry \1", str(error))) from error
    if not isinstance(tensor := torch.from_numpy(numbers), kind):
        raise ValueError(f"Expected {kind.dim_str.strip()} numbers, got {tuple(tensor.shape)}")
    return tensor


def _robot(value: Any, source: str) -> "Robot":
    from torchid.robot.yaml_file import from_mapping

    if not isinstance(value, Mapping):
        raise ValueError(f"Expected a robot, got {type(value).__name__}")
    limits = value.get("limits") or {}
    if isinstance(limits, Mapping):
        limits = {name: _endless(bounds) for name, bounds in limits.items()}
    try:
        return from_mapping({**value, **({"limits": limits} if limits else {})}, source)
    except TorchidError as error:
        raise ValueError(" ".join(str(error).split())) from error


def _endless(bounds: Any) -> Any:
    """Limits whose null is infinite."""
    if not isinstance(bounds, Sequence) or not all(
        isinstance(ends, Sequence) and len(ends) == 2 for ends in bounds
    ):
        return bounds
    return [
        [-math.inf if low is None else low, math.inf if high is None else high]
        for low, high in bounds
    ]


def _cell(value: Any) -> str:
    """Text of a cell of a table in a notebook."""
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} = {_cell(entry)}" for key, entry in value.items())
    if isinstance(value, list):
        return ", ".join(map(_cell, value)) if len(value) <= 12 else f"{len(value)} values"
    return "" if value is None else str(value)
