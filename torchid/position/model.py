"""A robot with its servos as one file, and what it says about a log."""

from collections.abc import Sequence
from pathlib import Path

import torch
import yaml
from torch import Tensor

from torchid.errors import LogError, TorchidError
from torchid.files import atomic_write
from torchid.log.model import Log
from torchid.position.data import STILL, tracks_of
from torchid.robot.model import Robot
from torchid.robot.writer import robot_yaml
from torchid.robot.yaml_file import read_yaml
from torchid.robot.yaml_values import parsed_yaml
from torchid.simulation.replay import replayed
from torchid.simulation.servo import Servos
from torchid.simulation.servo_loop import Tracks, Windows, windows_of
from torchid.typing import Float

KEY = "servos"
SAME_RATE = 0.01
"""Sampling intervals that differ by no more are one [1]."""
_BEFORE = 4
"""Samples before a start from which its velocity is told [1]."""


def write_model(robot: Robot, servos: Servos, scale: Float[Tensor, " n"], path: str | Path) -> None:
    """Write a robot's yaml with its servos, which `torchid simulate --replay` reads.

    Args:
        robot: as it is.
        servos: one set.
        scale: (n,) radians of the model per unit of the logs.
        path: the file, *.yaml.

    Raises:
        TorchidError: the file cannot be written.
    """
    block = {KEY: {**servos.record(), "log_scale": scale.tolist()}}
    text = robot_yaml(robot) + yaml.safe_dump(block, sort_keys=False, width=200)
    with atomic_write(Path(path)) as file:
        file.write(text)


def read_model(path: str | Path) -> tuple[Robot, Servos, Float[Tensor, " n"]]:
    """A robot, its servos and the scale of its logs, as `write_model` writes them.

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
    servos = Servos.from_record(
        {key: value for key, value in data.items() if key != "log_scale"}, robot.n, str(path)
    )
    if not isinstance(scale, list) or len(scale) != robot.n or not all(s > 0 for s in scale):
        raise TorchidError(f"'{path}': log_scale is wrong.", got=scale, expected=f"{robot.n} > 0")
    return robot, servos, torch.tensor(scale, dtype=torch.float64)


def replay(
    robot: Robot,
    servos: Servos,
    scale: Float[Tensor, " n"],
    logs: Sequence[Log],
    windows_s: float | None = None,
) -> list[Log]:
    """Where the arm would have gone with the commands of logs.

    Args:
        robot, servos, scale: the model.
        logs: with q and u; every motion begins at its measured start.
        windows_s: begin again at the measured position every so many seconds.

    Returns:
        The logs with simulated q and commanded u alone, in their own units.

    Raises:
        LogError: other joints than the robot's, no commands, or uneven sampling.
        TorchidError: the arm runs away.
    """
    for log in logs:
        if log.n != robot.n:
            raise LogError(
                f"{log.label} has another number of joints than robot '{robot.name}'.",
                got=f"{log.n} (q1..q{log.n})",
                expected=f"{robot.n} (q1..q{robot.n})",
            )
    tracks = [tracks_of(log, scale) for log in logs]
    # Logs of one rate are simulated side by side.
    out: list[Log | None] = [None] * len(logs)
    waiting = list(range(len(logs)))
    while waiting:
        rate = tracks[waiting[0]].dt
        alike = [k for k in waiting if abs(tracks[k].dt - rate) <= SAME_RATE * rate]
        waiting = [k for k in waiting if k not in alike]
        together = _side_by_side([tracks[k] for k in alike])
        found = _replayed(robot, servos, scale, [logs[k] for k in alike], together, windows_s)
        for k, q in zip(alike, found, strict=True):
            plain = logs[k].replace(**dict.fromkeys([s for s in logs[k].signals if s != "q"]))
            out[k] = plain.replace(q=q / scale, u=logs[k].u)
    return [log for log in out if log is not None]


def _replayed(
    robot: Robot,
    servos: Servos,
    scale: Tensor,
    logs: Sequence[Log],
    tracks: Tracks,
    windows_s: float | None,
) -> Sequence[Tensor]:
    """Simulated positions (T, n) of each of some logs of one rate [rad]."""
    windows = windows_of(tracks, windows_s)
    q = torch.cat([log.q for log in logs]) * scale
    start = _velocities(q, tracks, windows)
    found = replayed(robot, servos, tracks, windows, q[windows.start], start)
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


def accuracy(
    robot: Robot, servos: Servos, scale: Float[Tensor, " n"], log: Log
) -> tuple[float, float]:
    """RMS position error, mean of the joints [mrad of the log's unit]: whole motions from their
    measured start, and windows of 2 s.

    Raises:
        LogError, TorchidError: as `replay`.
    """
    out = []
    for seconds in (None, 2.0):
        (found,) = replay(robot, servos, scale, [log], seconds)
        out.append(1e3 * float((found.q - log.q).square().mean(0).sqrt().mean()))
    return out[0], out[1]


def _velocities(q: Tensor, tracks: Tracks, windows: Windows) -> Tensor:
    """(W, n) velocities at starts, from what was measured until then; at rest where a motion
    begins [rad/s]."""
    before = torch.maximum(windows.start - _BEFORE, tracks.first[windows.motion])
    seconds = (windows.start - before).clamp(min=1)[:, None] * tracks.dt
    dq = (q[windows.start] - q[before]) / seconds
    return torch.where(dq.abs() < STILL, 0.0, dq)
