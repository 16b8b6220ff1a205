"""Logs of known motions, for the tests of torchid.log."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchid.errors import LogError
from torchid.log.model import Log
from torchid.log.readers import read_log


def motion(t: np.ndarray, n: int = 2) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, velocity and acceleration (T, n) of a smooth motion."""
    w = 2.0 * np.pi * np.array([0.2, 0.5, 1.1])
    a, p = np.array([0.8, 0.3, 0.05]), np.arange(n)[:, None]
    phase = w * t[:, None, None] + p
    return (
        (a * np.sin(phase)).sum(-1),
        (a * w * np.cos(phase)).sum(-1),
        (-a * w * w * np.sin(phase)).sum(-1),
    )


def log_at(t: np.ndarray, n: int = 2, **changes: Any) -> Log:
    """A log of `motion` with all signals, at times t."""
    q, dq, ddq = (torch.from_numpy(x) for x in motion(t, n))
    fields: dict[str, Any] = {
        "t": torch.from_numpy(t),
        "q": q,
        "dq": dq,
        "ddq": ddq,
        "tau": 3.0 * ddq + torch.sin(q),
        "current": ddq,
        "source": "example.csv",
        "names": ("example",),
    }
    return Log(**(fields | changes))


def uniform(n: int = 2, samples: int = 501, step: float = 0.01, **changes: Any) -> Log:
    return log_at(step * np.arange(samples), n).replace(**changes)


def snapshot(log: Log) -> list[torch.Tensor]:
    """Copies of all tensors, to see later whether they were altered."""
    return [x.clone() for x in (log.t, log.trajectory, *log.signals.values())]


def same(log: Log, copies: list[torch.Tensor]) -> bool:
    now = (log.t, log.trajectory, *log.signals.values())
    return all(torch.equal(a, b) for a, b in zip(now, copies, strict=True))


def is_uniform(log: Log) -> bool:
    """Whether the stamps of every trajectory are within 1e-3 of a step of a uniform grid."""
    for rows in log.slices():
        t = log.t[rows].numpy()
        if len(t) < 2 or not t[-1] > t[0]:
            return False
        step = (t[-1] - t[0]) / (len(t) - 1)
        if not np.abs((t - t[0]) / step - np.arange(len(t))).max() <= 1e-3:
            return False
    return True


def proposed(path: Path, joints: Sequence[str] = ()) -> str | None:
    """The mapping that is proposed for a table, with what in it is guessed; one that names leave no
    choice about is taken at once, and said."""
    try:
        log = read_log(path, joints=tuple(joints))
    except LogError as error:
        return error.hint
    (said,) = [w for w in log.warnings if "is read by the names of its columns" in w]
    mapping = said.partition("its columns: ")[2]
    assert torch.equal(log.q, read_log(path, columns=mapping).q)
    return f'perhaps `columns="{mapping}"`'
