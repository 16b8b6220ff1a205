"""What scripts on folds of motions have in common: whole motions are left out, and errors as a row of
a table."""

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import torch
from torch import Tensor

from torchid.log.model import Log
from torchid.log.readers import read_log
from torchid.position.checked import folds_of
from torchid.robot.library import load_robot
from torchid.robot.model import Robot

HEADS = ("model", "windows", "all rows, joint by joint [mrad]", "mean", "each", "mean of each",
         "median of each", "CPU s a fold")  # fmt: skip

Model = Callable[[Log, float | None], Tensor]
"""Positions (T, n) along a motion, in windows of so many seconds or whole (None)."""


def read_folds(robot: str, logs: Sequence[Path], folds: int) -> tuple[Robot, list[Log], list[int]]:
    """The robot, its motions, and the fold of each."""
    parts = list(read_log(list(logs)).trajectories())
    return load_robot(robot), parts, folds_of(len(parts), folds).tolist()


def row(
    name: str, seconds: float | None, squares: Sequence[Tensor], busy: float, each: str = "motions"
) -> tuple[str, ...]:
    """Of the table: RMS of all rows, joint by joint, and over motions.

    Args:
        name: of what is judged.
        seconds: of windows; None: whole motions.
        squares: errors (T, n) of each motion or window [rad^2].
        busy: CPU time a fold [s].
        each: what `squares` are of.
    """
    together = 1e3 * torch.cat(list(squares)).mean(0).sqrt()
    rms = 1e3 * torch.stack([s.mean(0).sqrt() for s in squares]).mean(1)
    numbers = together.mean(), rms.mean(), rms.median()
    mean, own, middle = (f"{float(x):.2f}" for x in numbers)
    joints = " ".join(f"{v:.1f}" for v in together.tolist())
    window = "whole" if seconds is None else f"{seconds:g} s"
    return name, window, joints, mean, each, own, middle, f"{busy:.0f}"


def judged(
    models: Mapping[str, Callable[[Log], Model]],
    parts: Sequence[Log],
    folds: Sequence[int],
    only: Sequence[int] = (),
) -> list[tuple[str, ...]]:
    """Rows of models, each fitted to the motions of all folds but one and judged on that one's.

    Args:
        models: by name, what makes one of a log.
        parts, folds: motions, and the fold of each.
        only: these folds alone, where there are any.
    """
    rows, taken = [], only or sorted(set(folds))
    for name, fit in models.items():
        squares: dict[float | None, list[Tensor]] = {None: [], 2.0: []}
        busy = time.process_time()
        for fold in taken:
            both = [
                [p for p, f in zip(parts, folds, strict=True) if (f == fold) == k] for k in (0, 1)
            ]
            model = fit(Log.concatenate(both[0]))
            for seconds, own in squares.items():
                own += [(model(part, seconds) - part.q).square() for part in both[1]]
        busy = (time.process_time() - busy) / len(taken)
        rows += [row(name, seconds, own, busy) for seconds, own in squares.items()]
        print(*rows[-2], *rows[-1], sep="  ", flush=True)
    return rows
