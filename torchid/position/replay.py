"""Where an arm with servos goes with the commands of logs."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import torch
from msgspec import UNSET, UnsetType

from torchid.errors import TorchidError
from torchid.inputs import LogLike, as_log
from torchid.log.checks import check_joints
from torchid.log.model import Log
from torchid.log.readers import each_log
from torchid.position.data import RATE_S, STILL, WINDOW_S, tracks_of
from torchid.position.model import ServoArm
from torchid.position.record import Accuracy
from torchid.results.record import Part, Record, Result, Rows
from torchid.robot.model import error_unit
from torchid.simulation.replay import replayed
from torchid.simulation.servo_loop import Tracks, Windows, windows_of
from torchid.typing import Bool, Float, Tensor

SAME_RATE = 0.01
"""Sampling intervals that differ by no more are one [1]."""


class ReplayedLog(Part, frozen=True, kw_only=True):
    """RMS errors of one log, joint by joint [mrad of its unit]."""

    file: str
    error_mrad: Float[Tensor, " n"]


class ReplayRecord(Record, frozen=True, kw_only=True, tag="torchid.replay/1"):
    """A replay as its JSON has it; see Replay."""

    robot: str
    windows_s: float | None
    logs: tuple[ReplayedLog, ...]
    seed: int | UnsetType = UNSET

    @property
    def table(self) -> Rows[ReplayedLog]:
        """The logs."""
        return Rows(self.logs)


@dataclass(frozen=True, eq=False)
class Replay(Result):
    """Where servos would have gone with the commands of logs.

    Attributes:
        robot: its name.
        measured: the logs as given.
        simulated: the same with simulated q and commanded u alone, in the logs' units.
        windows: after how many seconds it began again at the measured position; None if only where
            a motion begins.
        files: what the logs are called.
        unit: of errors, that of thousandths of the log's own unit.
    """

    robot: str
    measured: tuple[Log, ...]
    simulated: tuple[Log, ...]
    windows: float | None
    files: tuple[str, ...]
    unit: str = "mrad"

    def __repr__(self) -> str:
        return f"Replay('{self.robot}', {float(self.error.mean()):.2f} {self.unit})"

    @cached_property
    def error(self) -> Float[Tensor, "logs n"]:
        """RMS position errors of each log and joint [mrad of the log's unit]."""
        both = zip(self.measured, self.simulated, strict=True)
        return torch.stack([1e3 * (far.q - log.q).square().mean(0).sqrt() for log, far in both])

    @cached_property
    def record(self) -> ReplayRecord:
        """As the JSON has it."""
        errors = zip(self.files, self.error, strict=True)
        return ReplayRecord(
            robot=self.robot,
            windows_s=self.windows,
            logs=tuple(ReplayedLog(file=file, error_mrad=error) for file, error in errors),
        )


def replay(arm: ServoArm | str | Path, logs: LogLike, *, windows: float | None = None) -> Replay:
    """Where the arm would have gone with the commands of logs: on the CPU, in float64, and not
    differentiable.

    Args:
        arm: the model: `corrected` of a diagnosis of positions, or the file that it was written to.
        logs: t, u and q; every motion begins at its measured start.
        windows: begin again at the measured position every so many seconds; never if None.

    Returns:
        The simulated logs, with their errors.

    Raises:
        LogError: other joints than the robot's, no commands, or uneven sampling.
        TorchidError: the arm runs away, or windows that are no time.

    >>> import numpy as np, torchid
    >>> arm = ServoArm.of(torchid.load_robot("3r"), kp=260.0, damping=22.0, armature=0.8)
    >>> t = 0.02 * np.arange(100)
    >>> u = 0.3 * np.sin(np.outer(t, [1.0, 2.0, 3.0]))  # commands [rad]
    >>> far = replay(arm, torchid.Log(t, q=u, u=u))
    >>> far.simulated[0].q.shape, bool((far.error < 150).all())
    (torch.Size([100, 3]), True)
    """
    arm = ServoArm.read(arm) if isinstance(arm, str | Path) else arm
    runs = tuple(as_log(log, arm.robot) for log in each_log(logs))
    robot, scale = arm.robot, arm.scale
    if windows is not None and not windows > 0:
        raise TorchidError("windows is a time.", got=windows, expected="> 0 s")
    for log in runs:
        check_joints(log, robot.name, robot.n)
    tracks = [tracks_of(log, scale) for log in runs]
    # Logs of one rate are simulated side by side.
    out: dict[int, Log] = {}
    waiting = list(range(len(runs)))
    while waiting:
        rate = tracks[waiting[0]].dt
        alike = [k for k in waiting if abs(tracks[k].dt - rate) <= SAME_RATE * rate]
        waiting = [k for k in waiting if k not in alike]
        together = _side_by_side([tracks[k] for k in alike])
        found = _replayed(arm, [runs[k] for k in alike], together, windows)
        for k, q in zip(alike, found, strict=True):
            plain = runs[k].replace(**dict.fromkeys([s for s in runs[k].signals if s != "q"]))
            out[k] = plain.replace(q=q / scale, u=runs[k].u)
    simulated = tuple(out[k] for k in range(len(runs)))
    files = tuple(log.source for log in runs)
    return Replay(robot.name, runs, simulated, windows, files, error_unit(robot))


def _replayed(
    arm: ServoArm, logs: Sequence[Log], tracks: Tracks, seconds: float | None
) -> Sequence[Tensor]:
    """Simulated positions (T, n) of each of some logs of one rate [rad]."""
    windows = windows_of(tracks, seconds)
    q = torch.cat([log.q for log in logs]) * arm.scale
    start = _velocities(q, tracks, windows)
    begun = q[windows.start], start
    found = replayed(arm.robot, arm.servos, tracks, windows, *begun, measured=q)
    return found.split([log.samples for log in logs])


def _side_by_side(tracks: Sequence[Tracks]) -> Tracks:
    """The motions of several logs as one set of tracks."""
    before = torch.tensor([0, *(len(t.u) for t in tracks[:-1])]).cumsum(0)
    return Tracks(
        torch.cat([t.u for t in tracks]),
        torch.cat([t.first + k for t, k in zip(tracks, before, strict=True)]),
        torch.cat([t.last + k for t, k in zip(tracks, before, strict=True)]),
        sum(t.dt for t in tracks) / len(tracks),
    )


def accuracy(arm: ServoArm, log: Log, moving: Bool[Tensor, " n"]) -> Accuracy:
    """RMS position errors of the joints that move [mrad of the log's unit]: whole motions from
    their measured start, and windows of 2 s.

    Raises:
        LogError, TorchidError: as `replay`.
    """
    errors = (replay(arm, log, windows=seconds).error.mean(0) for seconds in (None, WINDOW_S))
    return Accuracy.of_joints(*(x.masked_fill(~moving, torch.nan) for x in errors))


def _velocities(q: Tensor, tracks: Tracks, windows: Windows) -> Tensor:
    """(W, n) velocities at starts, from what was measured until then; at rest where a motion
    begins [rad/s]."""
    back = max(1, round(RATE_S / tracks.dt))
    before = torch.maximum(windows.start - back, tracks.first[windows.motion])
    seconds = (windows.start - before).clamp(min=1)[:, None] * tracks.dt
    dq = (q[windows.start] - q[before]) / seconds
    return torch.where(dq.abs() < STILL, 0.0, dq)
