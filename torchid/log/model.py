"""What was measured: time, positions and, where known, velocities, accelerations, torques and
what was commanded.

A Log is frozen and its methods return new ones. What the doctor, every fit and a diagnosis ask of
its samples (`rates`, `steps`, `even`, `least_way`, `moving_speed`, `noise_density`, `agreements`)
is computed when first asked for, and once, as long as the log is handed on as it is.

Several trajectories live in one Log, one after the other; time may start again in each of them, so
no signal may be differentiated, filtered or interpolated across the border between two.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from html import escape
from importlib import import_module
from itertools import accumulate
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import torch

from torchid.errors import LogError
from torchid.log.columns import JOINT_SIGNALS
from torchid.log.movement import (
    Agreement,
    agreements_of,
    least_way_of,
    moving_speed_of,
    noise_density_of,
)
from torchid.log.stamps import Steps, rates_of, stamps_of
from torchid.notebooks import data_frame, html_table
from torchid.tensors import as_tensor
from torchid.typing import Bool, Float, Int, Tensor

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

OPTIONAL_SIGNALS = JOINT_SIGNALS[1:]


@dataclass(frozen=True, eq=False)
class Log:
    """Samples of a robot with n joints; all tensors float64. It may be made of arrays or lists.

    Attributes:
        t: (T,) time stamps [s], increasing within each trajectory.
        q: (T, n) joint positions [rad or m].
        dq: (T, n) measured joint velocities [rad/s or m/s], or None.
        ddq: (T, n) given joint accelerations [rad/s^2 or m/s^2], or None.
        tau: (T, n) joint torques [N m or N], or None.
        current: (T, n) motor currents [A], or None.
        ql: (T, n) positions that encoders on the links' side tell [rad or m], or None.
        u: (T, n) positions that were commanded [rad or m], or None.
        trajectory: (T,) trajectory of each sample, 0, 1, ... in consecutive runs (default: all 0).
        names: one name a trajectory.
        source: where the log came from.
        warnings: what the readers and the resampling noticed, one sentence each.
        servos: what the recorder says that its servos are, as `diagnose(servo=...)` takes it; empty
            where it says nothing.

    Raises:
        LogError: the sizes of the signals do not agree, or trajectories are not consecutive runs,
            or what is given are no numbers.

    >>> import torch
    >>> t = torch.arange(100, dtype=torch.float64) / 50
    >>> log = Log(t, q=torch.sin(t)[:, None].repeat(1, 3))
    >>> log.n, log.samples, log.trajectory_count
    (3, 100, 1)
    """

    t: Float[Tensor, " T"]
    q: Float[Tensor, "T n"]
    dq: Float[Tensor, "T n"] | None = None
    ddq: Float[Tensor, "T n"] | None = None
    tau: Float[Tensor, "T n"] | None = None
    current: Float[Tensor, "T n"] | None = None
    ql: Float[Tensor, "T n"] | None = None
    u: Float[Tensor, "T n"] | None = None
    trajectory: Int[Tensor, " T"] = field(default=cast(Tensor, None))
    names: tuple[str, ...] = ()
    source: str = ""
    warnings: tuple[str, ...] = ()
    servos: str = ""

    def __post_init__(self) -> None:
        for name in ("t", *JOINT_SIGNALS):
            if getattr(self, name) is not None:
                what = f"{self.label}: {name}"
                signal = as_tensor(getattr(self, name), what, LogError)
                self._set(name, signal.to(torch.float64))
        if self.trajectory is None:
            self._set("trajectory", torch.zeros_like(self.t, dtype=torch.int64))
        self._set("trajectory", self._numbers())
        self._check_sizes()
        # The number of trajectories, which must be numbered 0, 1, ... one after the other.
        steps = self.trajectory.diff()
        if self.trajectory[0] != 0 or ((steps != 0) & (steps != 1)).any():
            raise LogError(
                f"{self.label}: trajectories must be consecutive runs of samples.",
                got=torch.unique_consecutive(self.trajectory).tolist()[:20],
                expected="0, 1, 2, ...",
            )
        count = int(self.trajectory[-1]) + 1
        if not self.names:
            stem = self.source or "log"
            self._set(
                "names", (stem,) if count == 1 else tuple(f"{stem}[{k}]" for k in range(count))
            )
        if len(self.names) != count:
            raise LogError(
                f"{self.label}: one name a trajectory is needed.",
                got=len(self.names),
                expected=count,
            )

    def _set(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)

    def _numbers(self) -> Tensor:
        """The trajectories' numbers as they are, or of an array or a list."""
        if isinstance(self.trajectory, Tensor):
            return self.trajectory
        numbers = as_tensor(self.trajectory, f"{self.label}: trajectory", LogError)
        if (numbers != numbers.round()).any():
            raise LogError(f"{self.label}: trajectories are numbered 0, 1, 2, ...")
        return numbers.to(torch.int64)

    @property
    def label(self) -> str:
        """What to call it in a message."""
        return f"log '{self.source}'" if self.source else "log"

    def _check_sizes(self) -> None:
        if self.t.ndim != 1 or len(self.t) == 0:
            raise LogError(
                f"{self.label}: t must be a list of at least one time stamp.",
                got=f"shape {tuple(self.t.shape)}",
            )
        if self.q.ndim != 2 or self.q.shape[1] == 0:
            raise LogError(
                f"{self.label}: q must have one column a joint.",
                got=f"shape {tuple(self.q.shape)}",
                expected="(samples, joints)",
            )
        size = (len(self.t), self.q.shape[1])
        for name in JOINT_SIGNALS:
            signal = getattr(self, name)
            if signal is not None and tuple(signal.shape) != size:
                raise LogError(
                    f"{self.label}: {name} has another size than t and q.",
                    got=tuple(signal.shape),
                    expected=size,
                )
        if tuple(self.trajectory.shape) != size[:1]:
            raise LogError(
                f"{self.label}: one trajectory number a sample is needed.",
                got=tuple(self.trajectory.shape),
                expected=size[:1],
            )

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.q.shape[1]

    def __repr__(self) -> str:
        joints = "1 joint" if self.n == 1 else f"{self.n} joints"
        runs = "" if len(self.names) == 1 else f"{len(self.names)} trajectories of "
        return (
            f"Log({runs}{joints}, {self.samples} samples of {', '.join(self.signals)}, "
            f"{sum(self.duration):.4g} s at {self._shown_rates[0]:.4g} Hz)"
        )

    @cached_property
    def rates(self) -> tuple[float, ...]:
        """Samples a second of each trajectory [Hz], from its median step.

        Raises:
            LogError: a trajectory has one sample only, or its time does not increase.
        """
        return rates_of(self)

    @cached_property
    def steps(self) -> tuple[Steps, ...]:
        """How even the time stamps of each trajectory are.

        Raises:
            LogError: as `rates`.
        """
        return tuple(Steps.of(t) for t in stamps_of(self))

    @property
    def even(self) -> "Log":
        """The log on a uniform grid, see `torchid.log.sampling.resampled`.

        Raises:
            LogError: as `rates`, or every piece between two gaps is too short.
        """
        return self._resampled[0]

    @property
    def even_runs(self) -> tuple[int, ...]:
        """Which trajectory each one of `even` is a part of, from 0."""
        return self._resampled[1]

    @cached_property
    def _resampled(self) -> tuple["Log", tuple[int, ...]]:
        from torchid.log.sampling import resampled

        return resampled(self)

    @cached_property
    def least_way(self) -> Float[Tensor, " n"]:
        """How much each joint (n,) varies at least where it moves [rad or m]."""
        return least_way_of(self)

    @cached_property
    def moving_speed(self) -> Float[Tensor, " n"]:
        """Speed (n,) above which each joint moves, of a log on a uniform grid [rad/s or m/s]."""
        return moving_speed_of(self)

    @cached_property
    def noise_density(self) -> Float[Tensor, " n"]:
        """Density (n,) of the positions' white noise, on a uniform grid [rad^2/Hz or m^2/Hz]."""
        return noise_density_of(self)

    @cached_property
    def agreements(self) -> tuple[Agreement, ...]:
        """How dq relates to the change of q: one record a joint that moves; empty without dq."""
        return tuple(agreements_of(self))

    def __getstate__(self) -> dict[str, Any]:
        """What is sent to other processes: the samples, without what was computed of them."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @property
    def _shown_rates(self) -> tuple[float, ...]:
        """Rates to be printed: nan where a log is refused for its time."""
        try:
            return self.rates
        except LogError:
            return (math.nan,) * len(self.names)

    def _repr_html_(self) -> str:
        """In a notebook: a row a trajectory, and the range of each signal of each joint."""
        joints = range(1, self.n + 1)
        runs = [
            (name, rows.stop - rows.start, f"{seconds:.4g}", f"{self._shown_rates[k]:.4g}")
            for k, (name, rows, seconds) in enumerate(
                zip(self.names, self.slices(), self.duration, strict=True)
            )
        ]
        ranges = [
            (name, *(f"{low:.3g} .. {high:.3g}" for low, high in finite_range(x).tolist()))
            for name, x in self.signals.items()
        ]
        return (
            f"<p>{escape(repr(self))}</p>"
            + html_table(("trajectory", "samples", "seconds", "rate [Hz]"), runs)
            + html_table(("range", *(f"joint {j}" for j in joints)), ranges)
        )

    def to_frame(self) -> "DataFrame":
        """A pandas DataFrame: t, q1.., and what else there is, as `write_log` names columns.

        Raises:
            MissingExtraError: pandas is not installed.
        """
        from torchid.log.columns import columns_of

        return data_frame()(columns_of(self))

    def plot(self) -> "Figure":
        """A matplotlib figure of position (with the command), velocity and torque of each joint."""
        figure: Figure = import_module("torchid").draw(self)
        return figure

    @property
    def samples(self) -> int:
        """Number of samples of all trajectories together."""
        return len(self.t)

    @property
    def trajectory_count(self) -> int:
        """Number of trajectories."""
        return len(self.names)

    @property
    def duration(self) -> tuple[float, ...]:
        """Seconds from the first to the last sample of each trajectory."""
        return tuple(float(self.t[s.stop - 1] - self.t[s.start]) for s in self.slices())

    @property
    def signals(self) -> dict[str, Float[Tensor, "T n"]]:
        """The joint signals that are there, by name: q and any of dq, ddq, tau, current, ql, u."""
        signals = {name: getattr(self, name) for name in JOINT_SIGNALS}
        return {name: signal for name, signal in signals.items() if signal is not None}

    def slices(self) -> list[slice]:
        """The rows of each trajectory."""
        ends = torch.bincount(self.trajectory).cumsum(0).tolist()
        return [slice(a, b) for a, b in zip([0, *ends[:-1]], ends, strict=True)]

    def trajectories(self) -> list["Log"]:
        """One Log a trajectory. The warnings stay with each of them."""
        return [self.select(rows) for rows in self.slices()]

    def select(self, rows: Bool[Tensor, " T"] | np.ndarray | Sequence[bool] | slice) -> "Log":
        """The samples that a mask (T,) or a slice picks, trajectories numbered anew.

        A trajectory that loses all its samples disappears, with its name.

        Raises:
            LogError: no sample is left, or the mask has the wrong size.
        """
        if not isinstance(rows, slice):
            # As it is: a list of row numbers must not pass for a mask.
            rows = torch.as_tensor(rows, device=self.t.device)
        if isinstance(rows, Tensor) and (
            rows.dtype != torch.bool or rows.shape != self.trajectory.shape
        ):
            raise LogError(
                f"{self.label}: a selection is a mask with one value a sample.",
                got=f"{rows.dtype} of shape {tuple(rows.shape)}",
                expected=f"torch.bool of shape ({self.samples},)",
            )
        if isinstance(rows, Tensor) and bool(rows.any()):
            # A run of samples is a view of them, and no copy of a long log.
            first, last = int(rows.int().argmax()), len(rows) - int(rows.flip(0).int().argmax())
            rows = slice(first, last) if int(rows.sum()) == last - first else rows
        ids = self.trajectory[rows]
        signals: dict[str, Any] = {name: signal[rows] for name, signal in self.signals.items()}
        if len(ids) == 0:
            raise LogError(
                f"{self.label}: the selection leaves no sample.",
                got=str(rows) if isinstance(rows, slice) else "a mask that is false everywhere",
            )
        if ids[0] == 0 == ids[-1]:  # as they are, and no copy
            kept, renumbered = ids[:1], ids
        else:
            kept, renumbered = torch.unique_consecutive(ids, return_inverse=True)
        return replace(
            self,
            t=self.t[rows],
            **signals,
            trajectory=renumbered,
            names=tuple(self.names[k] for k in kept.tolist()),
        )

    def split(self, fraction: float, gap_s: float = 0.0) -> tuple["Log", "Log"]:
        """The first `fraction` of every trajectory's time, and the rest without `gap_s` seconds.

        The gap keeps what a filter smears across the border out of the second part.

        Raises:
            LogError: `fraction` is not between 0 and 1, `gap_s` is negative, or a trajectory is
                too short to leave two samples on either side.
        """
        if not 0.0 < fraction < 1.0:
            raise LogError(
                "a log is split at a fraction of its time.", got=fraction, expected="0..1"
            )
        if not gap_s >= 0.0:
            raise LogError("the gap of a split is a time in seconds.", got=gap_s, expected=">= 0")
        first = torch.zeros(self.samples, dtype=torch.bool, device=self.t.device)
        rest = first.clone()
        for name, rows in zip(self.names, self.slices(), strict=True):
            t = self.t[rows]
            border = t[0] + fraction * (t[-1] - t[0])
            first[rows] = t <= border
            rest[rows] = t > border + gap_s
            if first[rows].sum() < 2 or rest[rows].sum() < 2:
                raise LogError(
                    f"trajectory '{name}' is too short to be split.",
                    got=f"{float(t[-1] - t[0]):.3g} s, {len(t)} samples",
                    expected=f"two samples on either side of {fraction:g} of it, {gap_s:g} s apart",
                )
        return self.select(first), self.select(rest)

    def with_torque(self, gain: Float[Tensor, " n"] | np.ndarray | Sequence[float]) -> "Log":
        """This log with tau = current * gain.

        Args:
            gain: (n,) drive gains [N m/A or N/A].

        Raises:
            LogError: there is no current, or the number of gains is not the number of joints.
        """
        if self.current is None:
            raise LogError(
                f"{self.label} has no motor currents to turn into torque.",
                expected=f"columns i1..i{self.n}",
                available=list(self.signals),
            )
        gain = as_tensor(gain, "drive gains", LogError).to(self.current)
        if tuple(gain.shape) != (self.n,):
            raise LogError(
                f"{self.label}: one drive gain a joint is needed.",
                got=tuple(gain.shape),
                expected=(self.n,),
            )
        return replace(self, tau=self.current * gain)

    def replace(self, **changes: Any) -> "Log":
        """This log with other fields."""
        return replace(self, **changes)

    @classmethod
    def concatenate(cls, logs: Sequence["Log"]) -> "Log":
        """All trajectories of all logs, in order.

        Accelerations and link-side positions that only some logs have are left out, with a warning.

        Raises:
            LogError: no logs, different numbers of joints, or only some have dq, tau, current or u.
        """
        if not logs:
            raise LogError("there are no logs to put together.", got=0, expected="at least one")
        if len(logs) == 1:
            return logs[0]
        first = logs[0]
        for other in logs[1:]:
            if other.n != logs[0].n:
                raise LogError(
                    "logs with different numbers of joints do not go together.",
                    got=f"{other.n} in {other.label}",
                    expected=f"{logs[0].n} as in {logs[0].label}",
                )
        signals: dict[str, Any] = dict.fromkeys(OPTIONAL_SIGNALS)
        warnings = [warning for log in logs for warning in log.warnings]
        for name in OPTIONAL_SIGNALS:
            having = [log for log in logs if getattr(log, name) is not None]
            if len(having) == len(logs):
                signals[name] = torch.cat([getattr(log, name) for log in logs])
            elif having and name in ("ddq", "ql"):
                warnings.append(f"{name} is left out: not all logs have it.")
            elif having:
                lacking = next(log for log in logs if getattr(log, name) is None)
                raise LogError(
                    f"some logs have {name} and others do not.",
                    got=f"{name} in {having[0].label}, none in {lacking.label}",
                    expected=f"{name} in all of them, or in none",
                    hint="read them one by one",
                )
        offsets = accumulate((log.trajectory_count for log in logs[:-1]), initial=0)
        return replace(
            first,
            t=torch.cat([log.t for log in logs]),
            q=torch.cat([log.q for log in logs]),
            **signals,
            trajectory=torch.cat(
                [log.trajectory + k for log, k in zip(logs, offsets, strict=True)]
            ),
            names=tuple(name for log in logs for name in log.names),
            source=", ".join(dict.fromkeys(log.source for log in logs if log.source)),
            warnings=tuple(dict.fromkeys(warnings)),
            servos=first.servos if {log.servos for log in logs} == {first.servos} else "",
        )


def finite_range(signal: Float[Tensor, "T n"]) -> Float[Tensor, "n 2"]:
    """Smallest and largest finite value of each joint (n, 2); nan where there is none."""
    # Joint by joint: a copy of the whole signal may be half a gigabyte.
    columns = [column[column.isfinite()] for column in signal.unbind(1)]
    none = signal.new_tensor([torch.nan, torch.nan])
    return torch.stack([torch.stack(c.aminmax()) if len(c) else none for c in columns])
