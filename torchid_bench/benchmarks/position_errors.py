"""What scripts on folds of motions have in common: whole motions are left out, and what is printed
of their errors."""

import argparse
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

from torchid.log.model import Log
from torchid.log.readers import read_log
from torchid.position.checked import folds_of
from torchid.robot.library import load_robot
from torchid.robot.model import Robot


def fold_parser(about: str | None) -> argparse.ArgumentParser:
    """A parser of a robot, logs and how many folds."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("robot")
    parser.add_argument("logs", nargs="+", type=Path)
    parser.add_argument("--folds", type=int, default=5)
    return parser


def read_folds(given: argparse.Namespace) -> tuple[Robot, list[Log], list[int]]:
    """The robot, its motions, and the fold of each; on one thread."""
    torch.set_num_threads(1)
    robot, log = load_robot(given.robot), read_log(given.logs)
    parts = list(log.trajectories())
    return robot, parts, folds_of(len(parts), given.folds).tolist()


def print_errors(
    name: str, seconds: float | None, squares: Sequence[Tensor], busy: float, *, each: str
) -> None:
    """One line: RMS of all rows, joint by joint, and over motions.

    Args:
        name: of what is judged.
        seconds: of windows; None: whole motions.
        squares: errors (T, n) of each motion or window [rad^2].
        busy: CPU time a fold [s].
        each: what `squares` are of.
    """
    together = 1e3 * torch.cat(list(squares)).mean(0).sqrt()
    rms = 1e3 * torch.stack([s.mean(0).sqrt() for s in squares]).mean(1)
    row = " ".join(f"{v:6.1f}" for v in together.tolist())
    print(
        f"{name:18s}{'whole' if seconds is None else f'{seconds:g} s':6s} all rows {row}  mean "
        f"{float(together.mean()):5.2f}  {each}: mean {float(rms.mean()):5.2f}, median "
        f"{float(rms.median()):5.2f} mrad  ({busy:.0f} s of a core a fold)",
        flush=True,
    )
