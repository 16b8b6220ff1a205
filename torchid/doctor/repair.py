"""Repairs: what turns a log with a fault into one without, as data. A log is never altered."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from torchid.log.columns import PREFIXES
from torchid.log.model import Log
from torchid.typing import Float, Tensor

MOTION = ("q", "dq", "ddq", "ql", "u")
PLACES = ("q", "ql", "u")
TORQUE = ("tau", "current")


class Repair(ABC):
    """One change of a log; `str` says it as a person would write it."""

    @abstractmethod
    def apply(self, log: Log) -> Log:
        """The changed copy."""

    @abstractmethod
    def __str__(self) -> str: ...


def repaired(log: Log, repairs: Iterable[Repair]) -> Log:
    """The log after all repairs, in order."""
    for repair in repairs:
        log = repair.apply(log)
    return log


def of_signals(repair: Repair, signals: Collection[str]) -> Repair:
    """The repair of those signals only that a log has."""
    if not isinstance(repair, Scale | Shift | Reorder):
        return repair
    return replace(repair, signals=tuple(s for s in repair.signals if s in signals))


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
        """Without those rows."""
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
class Scale(Repair):
    """Joint columns multiplied by factors, one a joint.

    Attributes:
        signals: among those of a Log; absent ones are passed over.
        factors: (n,), 1 where nothing changes.
    """

    signals: tuple[str, ...]
    factors: tuple[float, ...]

    def apply(self, log: Log) -> Log:
        """With the columns multiplied."""
        factors = torch.tensor(self.factors, dtype=torch.float64)
        return _changed(log, self.signals, lambda x: x * factors)

    def __str__(self) -> str:
        changed = [(k + 1, f) for k, f in enumerate(self.factors) if f != 1.0]
        same = len({f for _, f in changed}) == 1 and len(changed) == len(self.factors) > 1
        names = [PREFIXES[s] for s in self.signals]
        if same:
            factor = _factor(changed[0][1])
            return ", ".join(f"{x} = {factor}{x} in all joints" for x in names)
        return ", ".join(f"{x}{k} = {_factor(f)}{x}{k}" for x in names for k, f in changed)


@dataclass(frozen=True)
class Shift(Repair):
    """Offsets added to joint columns, one a joint.

    Attributes:
        signals: among those of a Log; absent ones are passed over.
        offsets: (n,) in the unit that the columns have then [rad or m], 0 where nothing changes.
    """

    signals: tuple[str, ...]
    offsets: tuple[float, ...]

    def apply(self, log: Log) -> Log:
        """With the columns moved."""
        offsets = torch.tensor(self.offsets, dtype=torch.float64)
        return _changed(log, self.signals, lambda x: x + offsets)

    def __str__(self) -> str:
        names = [PREFIXES[s] for s in self.signals]
        if len(set(self.offsets)) == 1 < len(self.offsets):
            return ", ".join(f"{x} = {x} {self.offsets[0]:+.6g} in all joints" for x in names)
        changed = [(k + 1, o) for k, o in enumerate(self.offsets) if o]
        return ", ".join(f"{x}{k} = {x}{k} {o:+.6g}" for x in names for k, o in changed)


@dataclass(frozen=True)
class Reorder(Repair):
    """Joint columns in another order.

    Attributes:
        signals: among those of a Log; absent ones are passed over.
        order: (n,) column k of the repaired log is column order[k] of this one, from 0.
    """

    signals: tuple[str, ...]
    order: tuple[int, ...]

    def apply(self, log: Log) -> Log:
        """With the columns moved."""
        order = list(self.order)
        return _changed(log, self.signals, lambda x: x[:, order])

    def __str__(self) -> str:
        return "; ".join(
            ", ".join(
                f"{PREFIXES[s]}{k + 1} = {PREFIXES[s]}{j + 1}"
                for k, j in enumerate(self.order)
                if k != j
            )
            for s in self.signals
        )


@dataclass(frozen=True)
class ShiftTorque(Repair):
    """Torques and currents moved earlier in time by interpolation; the ends without any are cut.

    Attributes:
        seconds: how late the torque is; negative where it is early.
    """

    seconds: float

    def apply(self, log: Log) -> Log:
        """With torque and position of the same instants."""
        parts = [self._one(part) for part in log.trajectories()]
        return Log.concatenate(parts).replace(source=log.source, warnings=log.warnings)

    def _one(self, log: Log) -> Log:
        t = log.t.numpy()
        wanted = t + self.seconds
        inside = torch.from_numpy((wanted >= t[0]) & (wanted <= t[-1]))

        def moved(x: Tensor) -> Tensor:
            columns = [np.interp(wanted, t, column) for column in x.T.numpy()]
            return torch.from_numpy(np.stack(columns, 1))

        return _changed(log, TORQUE, moved).select(inside)

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
        """With continuous angles."""
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
        """With the signs that the numbers had."""
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
        """Without it."""
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
        """With t in other units."""
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
        """With a clock that runs on."""
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
        """With more trajectories."""
        new = log.trajectory.diff(prepend=log.trajectory[:1]) != 0
        new[list(self.rows)] = True
        return log.replace(trajectory=new.long().cumsum(0), names=())

    def __str__(self) -> str:
        return f"number the runs in a column traj: new ones begin at {len(self.rows)} rows"


@dataclass(frozen=True)
class EvenTime(Repair):
    """Every trajectory's stamps spread evenly between its first and its last."""

    def apply(self, log: Log) -> Log:
        """With a uniform clock."""
        t = log.t.clone()
        for rows in log.slices():
            count = rows.stop - rows.start
            first, last = float(log.t[rows][0]), float(log.t[rows][-1])
            t[rows] = first + (last - first) / (count - 1) * torch.arange(count).to(t)
        return log.replace(t=t)

    def __str__(self) -> str:
        return "t: even steps between the first and the last stamp of each trajectory"


def _changed(log: Log, signals: Sequence[str], change: Callable[[Tensor], Tensor]) -> Log:
    there: dict[str, Float[Tensor, "T n"]] = log.signals
    return log.replace(**{s: change(there[s]) for s in signals if s in there})


def _factor(value: float) -> str:
    return "-" if value == -1.0 else f"{value:.6g} "
