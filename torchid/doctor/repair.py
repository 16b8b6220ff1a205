"""Repairs: what turns a log with a fault into one without, as data. A log is never altered."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from torchid.log.columns import PREFIXES
from torchid.log.model import Log
from torchid.typing import Tensor

MOTION = ("q", "dq", "ddq", "ql", "u")
PLACES = ("q", "ql", "u")
TORQUE = ("tau", "current")


class Repair(ABC):
    """One change of a log; `str` says it as a person would write it."""

    @abstractmethod
    def apply(self, log: Log) -> Log:
        """The log as the repair changes it, a copy."""

    @abstractmethod
    def __str__(self) -> str: ...


def repaired(log: Log, repairs: Iterable[Repair]) -> Log:
    """The log after all repairs, in order."""
    for repair in repairs:
        log = repair.apply(log)
    return log


@dataclass(frozen=True)
class DropRows(Repair):
    """Rows left out.

    Attributes:
        rows: their numbers, from 0.
        why: for people.
    """

    rows: tuple[int, ...]
    why: str

    def apply(self, log: Log) -> Log:
        """The log without those rows."""
        keep = torch.ones(log.samples, dtype=torch.bool)
        keep[list(self.rows)] = False
        return log.select(keep)

    def __str__(self) -> str:
        return f"leave out {len(self.rows)} rows ({self.why})"


@dataclass(frozen=True)
class Bridge(Repair):
    """Rows that only repeat the one before, interpolated between those that do not: motion by
    cubic splines, torque linearly, as resampling does.

    Attributes:
        rows: their numbers, from 0.
    """

    rows: tuple[int, ...]

    def apply(self, log: Log) -> Log:
        """With values in those rows that lie between their neighbours'."""
        from scipy.interpolate import CubicSpline

        fresh = torch.ones(log.samples, dtype=torch.bool)
        fresh[list(self.rows)] = False
        signals = {name: signal.clone() for name, signal in log.signals.items()}
        for rows in log.slices():
            t, kept = log.t[rows].numpy(), fresh[rows].numpy().copy()
            kept[0] = kept[-1] = True
            for name, signal in signals.items():
                values = signal[rows].numpy()
                if name in TORQUE:
                    columns = [np.interp(t, t[kept], c[kept]) for c in values.T]
                    signal[rows] = torch.from_numpy(np.stack(columns, 1))
                else:
                    signal[rows] = torch.from_numpy(CubicSpline(t[kept], values[kept])(t))
        fields: dict[str, Any] = dict(signals)
        return log.replace(**fields)

    def __str__(self) -> str:
        return f"{len(self.rows)} held rows interpolated between the others"


@dataclass(frozen=True)
class Map:
    """What joint columns become: column k is `factors[k]` times column `order[k]`, plus
    `offsets[k]` [rad or m]; joints from 0.

    Attributes:
        coupled: (k, j, c): of these, one after the other, c times column j is added to column k.
    """

    order: tuple[int, ...]
    factors: tuple[float, ...]
    offsets: tuple[float, ...]
    coupled: tuple[tuple[int, int, float], ...] = ()

    @classmethod
    def of(
        cls,
        n: int,
        *,
        order: Iterable[int] | None = None,
        factors: Iterable[float] | None = None,
        offsets: Iterable[float] | None = None,
    ) -> "Map":
        """The map of n columns; what is not given changes nothing."""
        return cls(
            tuple(range(n) if order is None else order),
            (1.0,) * n if factors is None else tuple(factors),
            (0.0,) * n if offsets is None else tuple(offsets),
        )

    def then(self, after: "Map") -> "Map":
        """This one, and another one of what it makes."""
        at = {j: k for k, j in enumerate(after.order)}
        factors = dict(zip(after.order, after.factors, strict=True))
        coupled = tuple((at[k], at[j], c * factors[k] / factors[j]) for k, j, c in self.coupled)
        # What is added after couplings, as what is added before them.
        offsets = list(after.offsets)
        for k, j, c in reversed(coupled):
            offsets[k] -= c * offsets[j]
        steps = list(zip(after.order, after.factors, offsets, strict=True))
        return Map(
            tuple(self.order[j] for j, _, _ in steps),
            tuple(f * self.factors[j] for j, f, _ in steps),
            tuple(f * self.offsets[j] + x for j, f, x in steps),
            coupled + after.coupled,
        )

    def of_columns(self, x: Tensor, *, places: bool = False) -> Tensor:
        """Columns (.., n) mapped; offsets are added to `places` alone."""
        made = x[..., list(self.order)] * torch.tensor(self.factors, dtype=x.dtype)
        if places:
            made = made + torch.tensor(self.offsets, dtype=x.dtype)
        for k, j, c in self.coupled:
            made[..., k] += c * made[..., j]
        return made

    @property
    def shifts_only(self) -> bool:
        """Whether order and factors stay as they are."""
        plain = self.order == tuple(range(len(self.order))) and set(self.factors) == {1.0}
        return plain and not self.coupled


@dataclass(frozen=True)
class MappedColumns(Repair):
    """Joint columns of some signals mapped; offsets are those of positions alone.

    Attributes:
        signals: among those of a Log; absent ones are passed over.
        map: what their columns become.
    """

    signals: tuple[str, ...]
    map: Map

    def mapped(self, signals: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Signals (T, n) with their columns mapped."""
        made = dict(signals)
        for name in set(self.signals) & set(signals):
            made[name] = self.map.of_columns(signals[name], places=name in PLACES)
        return made

    def apply(self, log: Log) -> Log:
        """The log with its columns mapped."""
        return log.replace(**self.mapped(log.signals))

    def __str__(self) -> str:
        names = [PREFIXES[s] for s in self.signals]
        places = [PREFIXES[s] for s in self.signals if s in PLACES]
        moved = [(k + 1, j + 1) for k, j in enumerate(self.map.order) if k != j]
        texts = [", ".join(f"{x}{k} = {x}{j}" for k, j in moved) for x in names] if moved else []
        texts.append(_changes(names, self.map.factors, 1.0, _factor))
        texts.append(_changes(places, self.map.offsets, 0.0, lambda x, o: f"{x} {o:+.6g}"))
        texts += [
            ", ".join(f"{x}{k + 1} = {x}{k + 1} {_added(c, x, j)}" for x in names)
            for k, j, c in self.map.coupled
        ]
        return "; ".join(filter(None, texts))


def _changes(
    names: Sequence[str], values: Sequence[float], none: float, made: Callable[[str, float], str]
) -> str:
    """What every column of some signals becomes by its value, in few words."""
    changed, end = [(str(k + 1), v) for k, v in enumerate(values) if v != none], ""
    if len(changed) == len(values) > 1 == len(set(values)):
        changed, end = [("", values[0])], " in all joints"
    return ", ".join(f"{x}{k} = {made(x + k, v)}{end}" for x in names for k, v in changed)


def _added(factor: float, name: str, joint: int) -> str:
    """`- q2`; `+ 0.5 q2`."""
    size = "" if abs(factor) == 1.0 else f"{abs(factor):.6g} "
    return f"{'-' if factor < 0 else '+'} {size}{name}{joint + 1}"


def _factor(name: str, value: float) -> str:
    return f"-{name}" if value == -1.0 else f"{value:.6g} {name}"


def scaled(signals: tuple[str, ...], factors: Sequence[float]) -> MappedColumns:
    """Joint columns multiplied by factors, one a joint."""
    return MappedColumns(signals, Map.of(len(factors), factors=factors))


def shifted(signals: tuple[str, ...], offsets: Sequence[float]) -> MappedColumns:
    """Offsets [rad or m] added to columns of positions, one a joint."""
    return MappedColumns(signals, Map.of(len(offsets), offsets=offsets))


def reordered(signals: tuple[str, ...], order: Sequence[int]) -> MappedColumns:
    """Column k is what was column order[k], from 0."""
    return MappedColumns(signals, Map.of(len(order), order=order))


@dataclass(frozen=True)
class ShiftTorque(Repair):
    """Torques and currents moved earlier in time by interpolation; the ends without any are cut.

    Attributes:
        seconds: how late the torque is; negative where it is early.
    """

    seconds: float

    def apply(self, log: Log) -> Log:
        """With torque and position of the same instants."""
        parts = []
        for part in log.trajectories():
            t = part.t.numpy()
            wanted = t + self.seconds
            moved: dict[str, Any] = {
                name: np.stack([np.interp(wanted, t, column) for column in x.T.numpy()], 1)
                for name, x in part.signals.items()
                if name in TORQUE
            }
            inside = torch.from_numpy((wanted >= t[0]) & (wanted <= t[-1]))
            parts.append(part.replace(**moved).select(inside))
        return Log.concatenate(parts).replace(source=log.source, warnings=log.warnings)

    def __str__(self) -> str:
        return f"tau(t) = tau(t {'+' if self.seconds > 0 else '-'} {abs(self.seconds):.4g} s)"


@dataclass(frozen=True)
class Unwrap(Repair):
    """Whole turns added to positions after each jump, so that they run on.

    Attributes:
        joints: from 0.
        turn: what a jump is a multiple of, in the unit of the positions.
    """

    joints: tuple[int, ...]
    turn: float = 2.0 * np.pi

    def apply(self, log: Log) -> Log:
        """The log with continuous angles."""
        q = log.q.clone()
        for rows in log.slices():
            for k in self.joints:
                q[rows, k] = torch.from_numpy(np.unwrap(q[rows, k].numpy(), period=self.turn))
        return log.replace(q=q)

    def __str__(self) -> str:
        return "unwrap " + ", ".join(f"q{k + 1}" for k in self.joints)


@dataclass(frozen=True)
class Signed(Repair):
    """Columns whose negative numbers were read as large positive ones.

    Attributes:
        signal: whose columns.
        joints: from 0.
        zero: the first number that stands for a negative one: the half of all numbers, or the bit
            that is the sign.
        magnitude: whether what is above it is the size of a negative number, and not its
            complement.
    """

    signal: str
    joints: tuple[int, ...]
    zero: float
    magnitude: bool

    def apply(self, log: Log) -> Log:
        """The log with the signs that its numbers had."""
        x = log.signals[self.signal]
        negative = self.zero - x if self.magnitude else x - 2.0 * self.zero
        columns = torch.zeros(log.n, dtype=torch.bool)
        columns[list(self.joints)] = True
        return log.replace(**{self.signal: torch.where(columns & (x >= self.zero), negative, x)})

    def __str__(self) -> str:
        names = ", ".join(f"{PREFIXES[self.signal]}{k + 1}" for k in self.joints)
        change = f"{self.zero:.10g} - x" if self.magnitude else f"x - {2 * self.zero:.10g}"
        return f"{names}: {change} from {self.zero:.10g} on"


@dataclass(frozen=True)
class DropSignal(Repair):
    """A signal left out, where another one gives it better."""

    signal: str

    def apply(self, log: Log) -> Log:
        """The log without the signal."""
        fields: dict[str, Any] = {self.signal: None}
        return log.replace(**fields)

    def __str__(self) -> str:
        return f"leave out the {PREFIXES[self.signal]} columns"


@dataclass(frozen=True)
class Differentiate(Repair):
    """Velocities of some joints from their positions, where a channel is dead.

    Attributes:
        joints: from 0.
    """

    joints: tuple[int, ...]

    def apply(self, log: Log) -> Log:
        """With differences of the positions on either side of each row."""
        assert log.dq is not None
        dq, joints = log.dq.clone(), list(self.joints)
        for rows in log.slices():
            (slope,) = torch.gradient(log.q[rows][:, joints], spacing=(log.t[rows],), dim=0)
            dq[rows, joints] = slope
        return log.replace(dq=dq)

    def __str__(self) -> str:
        return ", ".join(f"dq{k + 1} = the derivative of q{k + 1}" for k in self.joints)


@dataclass(frozen=True)
class ScaleTime(Repair):
    """Time stamps multiplied by a factor."""

    factor: float

    def apply(self, log: Log) -> Log:
        """The log with t in other units."""
        return log.replace(t=log.t * self.factor)

    def __str__(self) -> str:
        return f"t = {self.factor:.6g} t"


@dataclass(frozen=True)
class RejoinTime(Repair):
    """Steps that go back, repeat or jump are replaced by the median step.

    Attributes:
        steps: numbers of the rows before those steps, from 0.
    """

    steps: tuple[int, ...]

    def apply(self, log: Log) -> Log:
        """The log with a clock that runs on."""
        t = log.t.clone()
        for rows in log.slices():
            step = t[rows].diff()
            usual = step[step > 0].median()
            mine = [k - rows.start for k in self.steps if rows.start <= k < rows.stop - 1]
            late = usual - step
            step[mine] = usual
            # Where stamps stood still and the clock then caught up, the step after them is shorter
            # by as much: all later stamps were right.
            for last in [k for k in mine if k + 1 not in mine and k + 1 < len(step)]:
                first = last
                while first - 1 in mine:
                    first -= 1
                caught_up = step[last + 1] - late[first : last + 1].sum()
                if usual / 2 < caught_up < step[last + 1]:
                    step[last + 1] = caught_up
            t[rows] = torch.cat([t[rows][:1], t[rows][0] + step.cumsum(0)])
        return log.replace(t=t)

    def __str__(self) -> str:
        return f"t: {len(self.steps)} steps of the clock replaced by the median step"


@dataclass(frozen=True)
class SplitRuns(Repair):
    """New trajectories begin at some rows.

    Attributes:
        rows: their numbers, from 0.
    """

    rows: tuple[int, ...]

    def apply(self, log: Log) -> Log:
        """The log in more trajectories."""
        new = log.trajectory.diff(prepend=log.trajectory[:1]) != 0
        new[list(self.rows)] = True
        return log.replace(trajectory=new.long().cumsum(0), names=())

    def __str__(self) -> str:
        return f"number the runs in a column traj: new ones begin at {len(self.rows)} rows"


@dataclass(frozen=True)
class EvenTime(Repair):
    """Every trajectory's stamps spread evenly between its first and its last."""

    def apply(self, log: Log) -> Log:
        """The log with a uniform clock."""
        t = log.t.clone()
        for rows in log.slices():
            count = rows.stop - rows.start
            first, last = float(log.t[rows][0]), float(log.t[rows][-1])
            t[rows] = first + (last - first) / (count - 1) * torch.arange(count).to(t)
        return log.replace(t=t)

    def __str__(self) -> str:
        return "t: even steps between the first and the last stamp of each trajectory"
