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
    out = []
    for log in logs:
        if log.n != robot.n:
            raise LogError(
                f"{log.label} has another number of joints than robot '{robot.name}'.",
                got=f"{log.n} (q1..q{log.n})",
                expected=f"{robot.n} (q1..q{robot.n})",
            )
        tracks = tracks_of(log, scale)
        windows = windows_of(tracks, windows_s)
        q = log.q * scale
        start = _velocities(q, tracks, windows)
        found = replayed(robot, servos, tracks, windows, q[windows.start], start)
        plain = log.replace(**dict.fromkeys([s for s in log.signals if s != "q"]))
        out.append(plain.replace(q=found / scale, u=log.u))
    return out


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
