"""Repairs of the clock: units, steps, runs. A log is never altered."""

from dataclasses import dataclass

import torch

from torchid.doctor.repair import Repair
from torchid.log.model import Log


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
            step[mine] = usual
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
