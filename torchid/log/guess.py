"""A mapping that may be meant, from the names of a table's columns: proposed, never applied."""

import math
import re
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from torchid.errors import LogError
from torchid.log.columns import is_wanted
from torchid.log.joint_names import in_robot_order
from torchid.log.mapping import ColumnMapping, Source, read_mapping
from torchid.log.sources import Piece, resolve, signal_of, time_of
from torchid.log.table import Table
from torchid.log.units import STEPS, unit_factor
from torchid.log.words import (
    is_commanded,
    is_unit_word,
    looks_measured,
    quantity_of,
    source_words,
    unit_in,
    without_unit,
    words_of,
)


@dataclass(frozen=True)
class _Group:
    """Columns that may be one signal.

    Attributes:
        names: as a mapping gives them; a pattern is one.
        key: what the words say it is.
        joints: number of columns; 0 where the shape is not known.
        score: how much its name looks like a measurement.
        labels: what the names call the joints, where that is all that tells them apart.
        columns: that it takes; empty for arrays.
    """

    names: tuple[str, ...]
    key: str
    joints: int
    score: float
    labels: tuple[str, ...] = ()
    columns: frozenset[str] = frozenset()

    @property
    def unit(self) -> str | None:
        """The unit that a column's name says."""
        return unit_in(self.names[0], self.key)

    @property
    def written_unit(self) -> str:
        """The unit that a mapping must say: not the one that is taken anyway."""
        return self.unit if self.unit and unit_factor(self.key, self.unit) != 1.0 else ""

    def in_order(self, labels: Sequence[str]) -> "_Group":
        """With these joints only, in this order, where all of them are there."""
        if not labels or not set(labels) <= set(self.labels):
            return self
        names = tuple(self.names[self.labels.index(label)] for label in labels)
        return replace(self, names=names, joints=len(names), labels=tuple(labels))

    def first(self, count: int) -> "_Group":
        """The group with its first joints only."""
        if self.joints <= count or self.key == "t":
            return self
        pattern = re.sub(
            r"\{j(0?)\}", lambda m: f"{{{0 if m[1] else 1}..{count - bool(m[1])}}}", self.names[0]
        )
        one = len(self.names) == 1
        names = (
            (pattern if pattern != self.names[0] else f"{pattern}[:,0:{count}]",)
            if one
            else self.names[:count]
        )
        return replace(self, names=names, joints=count)


def proposed_mapping(table: Table, joints: Sequence[str] = ()) -> tuple[str, str] | None:
    """A text for --columns, and what in it is guessed from more than names; None where time or
    positions cannot be guessed.

    Columns that have our names need no mapping and are not in it.

    Args:
        table: that has other names.
        joints: of the robot, in order; empty where it is not known.
    """
    # Quotes, and what a shell takes for its own, cannot be written between quotes.
    names = [n for n in table.columns if not is_wanted(n) and not re.search(r"[\"'`$\\!]", n)]
    chosen, clear = _chosen(table, names, joints)
    timeless = "t" not in chosen and not _own(table, "t")
    if not (chosen or timeless) or ("q" not in chosen and not _own(table, "q")):
        return None
    silent = {key for key, group in chosen.items() if group.unit is None}
    units: dict[str, str] = {}
    with suppress(LogError):  # what cannot be read has its own error when it is read in earnest
        units = _guessed_units(read_mapping(_text(chosen, {})), table, silent)
    remarks = [f"{', '.join(units.values())}: guessed from the numbers"] if units else []
    if any(group.labels and _placed(group, joints) is None for group in chosen.values()):
        remarks.append("joints in the order of the file")
    if joints and "q" in chosen and (count := chosen["q"].joints) > len(joints):
        chosen = {key: group.first(len(joints)) for key, group in chosen.items()}
        remarks.append(f"the first {len(joints)} of {count} columns")
    text = _text(chosen, units)
    if "t" in chosen:
        text = _every_group(text, chosen["t"].names[0], names)
        clear |= "*" in text
    elif timeless:
        text = ",".join(["t=HZ Hz", text] if text else ["t=HZ Hz"])
        remarks.append("HZ: samples a second")
    return text, "; ".join(remarks if remarks or clear else ["several columns may be meant"])


def _chosen(
    table: Table, names: list[str], joints: Sequence[str]
) -> tuple[dict[str, _Group], bool]:
    """The group of each key, their joints in one order; and whether no other looks as good."""
    named = _named(names)
    whole = [g for g in _numbered(names) if not any(g.columns < other.columns for other in named)]
    named = [_placed(g, joints) or g for g in named]
    single = _unnumbered(names)
    times = [g for g in single if g.key == "t"]
    groups = [*times, *_arrays(table, names), *whole, *named]
    if len(joints) < 2 and not any(_is_of(g, "q") for g in groups):
        groups = [*single, *groups]  # of the only joint
    chosen: dict[str, _Group] = {}
    clear = True
    for key in ("t", "q", "dq", "tau", "i", "ql", "u"):
        fitting = [g for g in groups if _is_of(g, key)]
        if key == "q" and joints:
            fitting = [g for g in fitting if g.joints in (0, len(joints))] or fitting
        elif key != "t" and "q" in chosen:
            q = chosen["q"]
            fitting = [g.in_order(q.labels) for g in fitting]
            fitting = [g for g in fitting if not q.joints or g.joints in (0, q.joints)]
        if fitting and not _own(table, key):
            chosen[key] = max(fitting, key=lambda g: g.score)
            clear &= len({g.names for g in fitting if g.score == chosen[key].score}) == 1
    if "tau" in chosen:
        chosen.pop("i", None)
    return chosen, clear


def commanded_columns(table: Table) -> str | None:
    """A text for --columns that names the commanded positions beside our own q: q_cmd{j}, goal{j},
    action, ..; None where there are none, or several that may be meant."""
    names = [n for n in table.columns if not is_wanted(n)]
    count = sum(re.fullmatch(r"q\d+", name) is not None for name in table.columns)
    fitting = [
        g
        for g in (*_arrays(table, names), *_numbered(names))
        if _is_of(g, "u") and is_commanded(words_of(g.names[0])) and g.joints in (0, count)
    ]
    return _text({"u": fitting[0]}, {}) if len(fitting) == 1 else None


def torques_among(names: Sequence[str]) -> list[str]:
    """Patterns of the columns that may be a torque: tau_ext_{j}, .."""
    return [group.names[0] for group in _numbered(list(names)) if group.key == "tau"]


def _arrays(table: Table, names: Sequence[str]) -> list[_Group]:
    """Arrays (T, n), or of unknown shape in a file that may have some."""
    groups = []
    for array in names:
        shape = table.columns[array]
        if not (table.arrays or (shape and len(shape) == 2)) or (shape and len(shape) != 2):
            continue
        if shape and 1 in shape:
            continue
        words = words_of(array)
        quantity = quantity_of(reversed(words)) if words else None
        if quantity is None or quantity == "t":
            continue
        width = min((k for k in shape or () if k > 0), default=0)
        groups.append(_Group((array,), quantity, width, 0.5 + looks_measured(words)))
    return groups


def _is_of(group: _Group, key: str) -> bool:
    """Whether a group may be the signal of a key; commanded positions are u."""
    commanded = group.key == "q" and is_commanded(words_of(group.names[0]))
    return key == ("u" if commanded else group.key)


def _placed(group: _Group, joints: Sequence[str]) -> _Group | None:
    """With the robot's joints in their order; None where names do not tell them."""
    if not joints or not group.labels:
        return None
    try:
        return group.in_order(in_robot_order(group.labels, joints, "", group.labels)[0])
    except LogError:
        return None


def _text(chosen: Mapping[str, _Group], units: Mapping[str, str]) -> str:
    """As --columns takes it; units from the names, or else these."""
    return ",".join(
        f"{key}={_written(group.names)} {group.written_unit or units.get(key, '')}".strip()
        for key, group in chosen.items()
    )


def _written(names: Sequence[str]) -> str:
    """Columns as a mapping writes them: quoted if need be."""
    quoted = [f"'{n}'" if re.search(r"[\s,=\[\]()*-]", n) else n for n in names]
    return quoted[0] if len(names) == 1 else f"[{', '.join(quoted)}]"


def _every_group(text: str, time: str, names: list[str]) -> str:
    """With `*` for the number of a group, where there are several like it: demo_*/q."""
    group = re.match(r"(.*?)\d+([/.].*)", time)
    if group is None:
        return text
    before, after = (re.escape(part) for part in group.groups())
    if sum(re.fullmatch(rf"{before}\d+{after}", name) is not None for name in names) < 2:
        return text
    number = time[len(group[1]) : len(time) - len(group[2])]
    return text.replace(f"{group[1]}{number}{group[2][0]}", f"{group[1]}*{group[2][0]}")


def _own(table: Table, key: str) -> bool:
    return (f"{key}1" if key != "t" else "t") in table.columns or (
        table.arrays and key in table.columns
    )


def _numbered(names: list[str]) -> list[_Group]:
    """Columns that differ in one number, which counts from 0 or 1."""
    families: dict[tuple[str, str], dict[int, str]] = {}
    for name in names:
        for m in re.finditer(r"\d+", name):
            families.setdefault((name[: m.start()], name[m.end() :]), {})[int(m[0])] = name
    groups = []
    for (before, after), members in families.items():
        first, count = min(members), len(members)
        if first > 1 or max(members) != first + count - 1 or count < 2:
            continue
        words = words_of(f"{before} {after}")
        key = quantity_of(words)
        if key is None or key == "t":
            continue
        pattern = f"{before}{{{'j' if first else 'j0'}}}{after}"
        columns = frozenset(members.values())
        groups.append(_Group((pattern,), key, count, looks_measured(words), columns=columns))
    return groups


def _unnumbered(names: list[str]) -> list[_Group]:
    """Columns by themselves, without a number: the time, and signals of a single joint."""
    groups = []
    for name in names:
        last = without_unit(name)[0].rsplit("/", 1)[-1]
        key = quantity_of(words_of(last))
        if key is not None and not re.search(r"\d", last):
            groups.append(_Group((name,), key, 1, looks_measured(words_of(name))))
    return groups


def _named(names: list[str]) -> list[_Group]:
    """Columns such as shoulder.pos, `elbow act vel [deg/s]`: one quantity, joints by name."""
    families: dict[tuple[str, ...], dict[str, str]] = {}
    for name in names:
        plain, unit = without_unit(name)
        said = source_words(plain)
        tokens = [p for p in re.split(r"[._/ ]+", plain) if p and p.lower() not in said]
        while len(tokens) > 2 and is_unit_word(tokens[-1]):
            unit = f"{tokens.pop()} {unit}"
        # Which of the first and the last part of a name say what it is; `joint` only if no other.
        ends = sorted({0, len(tokens) - 1}) if len(tokens) > 1 else []
        fitting = [k for k in ends if quantity_of([tokens[k].lower()]) not in (None, "t")]
        others = [k for k in fitting if not re.fullmatch(r"joints?|state", tokens[k].lower())]
        for k in others or fitting:
            label = "_".join(tokens[:k] + tokens[k + 1 :])
            families.setdefault((tokens[k], unit, *said), {})[label] = name
    groups = []
    for (part, *_), members in families.items():
        columns = list(members.values())
        if len(columns) < 2 or set(columns) == {n for g in _numbered(columns) for n in g.columns}:
            continue
        key, score = str(quantity_of([part.lower()])), looks_measured(words_of(columns[0])) - 0.2
        labels = tuple(members)
        groups.append(_Group(tuple(columns), key, len(columns), score, labels, frozenset(columns)))
    return groups


_TURNS = 4 * math.pi
"""Angles beyond two turns are more likely degrees."""
_MILLI = (4e3, 1e6)
"""Torques that most joints reach in mN m and, but for the largest robots, none does in N m; parts
in a thousand of a rated torque, as drives send them, are less."""


def _guessed_units(mapping: ColumnMapping, table: Table, keys: Collection[str]) -> dict[str, str]:
    """Units of t, q, dq, tau and u by key, where the numbers are unlikely to be in ours.

    Args:
        mapping: of the table.
        keys: whose columns' names say no unit; of no others it is guessed.
    """
    silent = {
        key: source
        for key, source in mapping.sources.items()
        if source is not None and key in keys and key in ("t", "q", "dq", "tau", "u")
    }
    pieces = {key: resolve(key, source, table) for key, source in silent.items()}
    arrays = table.read([n for group in pieces.values() for piece in group for n in piece.names])
    units: dict[str, str] = {}
    step = 1.0
    if "t" in silent:
        steps = np.diff(time_of(silent["t"], pieces["t"], arrays, table))
        if not len(steps):
            return {}
        step = float(np.median(steps))
        units["t"] = next((unit for most, unit in STEPS.items() if abs(step) < most), "")
        step *= {"": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[units["t"]]

    def values(key: str, source: Source, parts: Sequence[Piece]) -> np.ndarray:
        rows = max(max(arrays[piece.name].shape) for piece in parts)
        return signal_of(key, source, parts, arrays, rows, table)

    # Angles beyond this are neither
    counts = 1000.0
    if "q" in silent:
        q = values("q", silent["q"], pieces["q"])
        if _TURNS < np.abs(q).max(initial=0.0) < counts:
            units["q"] = "deg"
            if "dq" in silent and _follows(q, values("dq", silent["dq"], pieces["dq"]), step):
                units["dq"] = "deg/s"
    if "u" in silent:
        u = np.nan_to_num(values("u", silent["u"], pieces["u"]))
        if _TURNS < np.abs(u).max(initial=0.0) < counts:
            units["u"] = "deg"
    if "tau" in silent:
        tau = values("tau", silent["tau"], pieces["tau"])
        size = np.where(np.isfinite(tau), np.abs(tau), 0.0)
        if len(tau) and _MILLI[0] < np.median(np.quantile(size, 0.99, axis=0)) < _MILLI[1]:
            units["tau"] = "mNm"
    return {key: unit for key, unit in units.items() if unit}


def _follows(q: np.ndarray, dq: np.ndarray, step: float) -> bool:
    """Whether dq is the derivative of q in the same angles, rather than in radians."""
    if not 0 < step < math.inf or dq.shape != q.shape or len(q) < 2:
        return False
    own = float(np.abs(np.diff(q, axis=0)).mean()) / step
    return float(np.abs(dq).mean()) > own * math.sqrt(math.pi / 180)
