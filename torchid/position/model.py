"""A robot with its servos, as one file too, and what it says about a log."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
import yaml
from msgspec import UNSET, UnsetType

from torchid.errors import TorchidError
from torchid.files import atomic_write
from torchid.inputs import LogLike, RobotLike, as_log, as_robot
from torchid.log.checks import check_joints
from torchid.log.model import Log
from torchid.log.readers import each_log
from torchid.position.data import RATE_S, STILL, WINDOW_S, tracks_of
from torchid.results.record import Part, Record, Result, Rows
from torchid.robot.model import Robot
from torchid.robot.writer import robot_yaml
from torchid.robot.yaml_file import read_yaml
from torchid.robot.yaml_values import parsed_yaml
from torchid.simulation.replay import replayed
from torchid.simulation.servo import INDEX, NAMES, Servos
from torchid.simulation.servo_loop import Tracks, Windows, windows_of
from torchid.tensors import as_tensor
from torchid.typing import Bool, Float, Tensor

KEY, RATIOS = "servos", "ratios_to_kp_alone"
SAME_RATE = 0.01
"""Sampling intervals that differ by no more are one [1]."""


@dataclass(frozen=True, eq=False)
class ServoArm:
    """A robot with its position servos: what moves when it is commanded.

    Attributes:
        robot: with inertial parameters.
        servos: one set.
        scale: (n,) radians (m) of the model per unit of the logs, 1 but where a log has a joint in
            another unit.
        std: (n, K) standard deviations of the servos' values, of logarithms where they are searched
            so; NaN of what is not known; None where nothing is.
        unanchored: joints (from 0) whose torques are right in their ratios to kp alone: neither a
            load nor a gain that is known tells their scale.

    >>> import torchid
    >>> arm = ServoArm.of(torchid.load_robot("3r"), kp=260.0, damping=22.0, armature=0.8)
    >>> arm.servos.of("kp").tolist()
    [260.0, 260.0, 260.0]
    """

    robot: Robot
    servos: Servos
    scale: Float[Tensor, " n"]
    std: Float[Tensor, "n K"] | None = None
    unanchored: tuple[int, ...] = ()

    def __repr__(self) -> str:
        return f"ServoArm('{self.robot.name}')"

    @classmethod
    def of(
        cls, robot: RobotLike, **values: float | Sequence[float] | np.ndarray | Tensor
    ) -> "ServoArm":
        """An arm with these servos.

        Args:
            robot: with inertial parameters.
            values: of `torchid.simulation.servo.PARAMETERS` by name, as kp [N m/rad]: one of all
                joints, or n; those that are not given have no effect.

        Raises:
            TorchidError: no such parameter, or not a number for every joint.
        """
        robot = as_robot(robot)
        servos = Servos.neutral(robot.n)
        for name, value in values.items():
            if name not in NAMES:
                raise TorchidError("a servo has no such parameter.", got=name, available=NAMES)
            each = as_tensor(value, name)
            if each.shape not in ((), (robot.n,)) or bool(each.isnan().any()):
                raise TorchidError(
                    f"values of '{name}' do not fit the joints.",
                    got=value,
                    expected=f"a number, or {robot.n}",
                )
            servos.joint[:, INDEX[name]] = each
        return cls(robot, servos, torch.ones(robot.n, dtype=torch.float64))

    @classmethod
    def read(cls, path: str | Path) -> "ServoArm":
        """A robot's yaml with servos, as `write` and `torchid gap --save-model` make it.

        Raises:
            TorchidError: the file has no servos, or servos of another robot.
            RobotError: it is no robot's yaml.
        """
        path = Path(path)
        if path.suffix.lower() not in (".yaml", ".yml"):
            raise TorchidError(
                f"'{path}' has no servos.", expected="a .yaml that `torchid gap --save-model` wrote"
            )
        robot, data = read_yaml(path), parsed_yaml(path).get(KEY)
        if not isinstance(data, dict):
            raise TorchidError(
                f"'{path}' has no servos.",
                expected=f"a block `{KEY}`, as `torchid gap --save-model` writes it",
            )
        scale = data.get("log_scale", [1.0] * robot.n)
        servos, std = Servos.from_record(data, robot.n, str(path)), None
        if isinstance(data.get("std"), list) and len(data["std"]) == robot.n:
            rows = [[float(one.get(name, math.nan)) for name in NAMES] for one in data["std"]]
            std = torch.tensor(rows, dtype=torch.float64)
        if not isinstance(scale, list) or len(scale) != robot.n or not all(s > 0 for s in scale):
            raise TorchidError(
                f"'{path}': log_scale is wrong.", got=scale, expected=f"{robot.n} > 0"
            )
        free = data.get(RATIOS, [])
        if not isinstance(free, list) or not set(free) <= set(range(1, robot.n + 1)):
            raise TorchidError(f"'{path}': {RATIOS} is wrong.", got=free, expected="joints, from 1")
        scale = torch.tensor(scale, dtype=torch.float64)
        return cls(robot, servos, scale, std, tuple(j - 1 for j in free))

    @classmethod
    def of_file(cls, name: str | Path) -> "ServoArm | None":
        """The same of whatever names a robot; None where that has no servos of a fit."""
        path = Path(name)
        if path.suffix.lower() not in (".yaml", ".yml") or not path.is_file():
            return None
        return cls.read(path) if isinstance(parsed_yaml(path).get(KEY), dict) else None

    @property
    def yaml(self) -> str:
        """What `write` writes."""
        block = {**self.servos.record(), "log_scale": self.scale.tolist()}
        if self.unanchored:
            block[RATIOS] = [j + 1 for j in self.unanchored]
        if self.std is not None:
            rows = (zip(NAMES, row, strict=True) for row in self.std.tolist())
            block["std"] = [{k: v for k, v in row if math.isfinite(v)} for row in rows]
        return robot_yaml(self.robot) + yaml.safe_dump({KEY: block}, sort_keys=False, width=200)

    def write(self, path: str | Path) -> None:
        """The robot's yaml with its servos, whole or not at all.

        Args:
            path: the file, *.yaml.

        Raises:
            TorchidError: the file cannot be written.
        """
        with atomic_write(Path(path)) as file:
            file.write(self.yaml)


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
    """

    robot: str
    measured: tuple[Log, ...]
    simulated: tuple[Log, ...]
    windows: float | None
    files: tuple[str, ...]

    def __repr__(self) -> str:
        return f"Replay('{self.robot}', {float(self.error.mean()):.2f} mrad)"

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
    """Where the arm would have gone with the commands of logs.

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
    return Replay(robot.name, runs, simulated, windows, tuple(log.source for log in runs))


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


def accuracy(arm: ServoArm, log: Log, moving: Bool[Tensor, " n"]) -> tuple[float, float]:
    """RMS position error, mean of the joints that move [mrad of the log's unit]: whole motions from
    their measured start, and windows of 2 s.

    Raises:
        LogError, TorchidError: as `replay`.
    """
    whole, short = (
        float(replay(arm, log, windows=seconds).error[:, moving].mean())
        for seconds in (None, WINDOW_S)
    )
    return whole, short


def _velocities(q: Tensor, tracks: Tracks, windows: Windows) -> Tensor:
    """(W, n) velocities at starts, from what was measured until then; at rest where a motion
    begins [rad/s]."""
    back = max(1, round(RATE_S / tracks.dt))
    before = torch.maximum(windows.start - back, tracks.first[windows.motion])
    seconds = (windows.start - before).clamp(min=1)[:, None] * tracks.dt
    dq = (q[windows.start] - q[before]) / seconds
    return torch.where(dq.abs() < STILL, 0.0, dq)
