"""MODEL.rows.npz: the motion and torque that a model was made from, so that a later log can be held
against them.

Signals are low-passed and have twice the rate of the fit's samples, in single precision; of a long
log stretches that are spread over all of it. The model's yaml names the file and its SHA-256.
"""

import hashlib
import io
import math
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch

from torchid.design.segments import Samples, Segment
from torchid.effects.motion import Motion
from torchid.errors import RobotError
from torchid.files import add_input, atomic_write, rows_file
from torchid.log.filtering import low_passed
from torchid.results.words import listed
from torchid.robot.model import Robot
from torchid.robot.writer import write_robot

T = TypeVar("T")

STRETCH = 30.0
"""Length of what is taken of a longer log at a time [s]: a whole trajectory, or a part of one."""

MOST = 20_000
"""Rows of a file at most."""

FINER = 2
"""Rate of the rows over that of the fit's samples [1]."""

PASSED = 0.4
"""Frequency up to which rows hold a signal, over their rate [1]."""

SIGNALS = ("q", "dq", "ddq", "tau", "age")
"""Of a file, (R, n) each; `age` where the log has it."""

_DAMAGED = (
    OSError, EOFError, ValueError, TypeError, LookupError, ArithmeticError, NotImplementedError,
    MemoryError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What reading an archive raises that is cut short, or holds something else."""


@dataclass(frozen=True, eq=False)
class LogRows:
    """A log's motion and torque at a rate that its fit needs.

    Attributes:
        names: of the trajectories, or of the stretches taken of them.
        joints: names of the robot's n joints.
        rate: [Hz].
        cutoff: of the fit [Hz].
        lengths: (S,) rows of each trajectory.
        starts: (S,) its first instant [s].
        moving: (S, n) speed above which joints move [rad/s; m/s].
        own_velocity: whether velocities were measured on their own.
        signals: (R, n) of `SIGNALS`, single precision, trajectory by trajectory.

    Raises:
        ValueError: these are no rows of a log.
    """

    names: tuple[str, ...]
    joints: tuple[str, ...]
    rate: float
    cutoff: float
    lengths: tuple[int, ...]
    starts: tuple[float, ...]
    moving: np.ndarray
    own_velocity: bool
    signals: Mapping[str, np.ndarray]

    def __post_init__(self) -> None:
        for problem in self._problems():
            raise ValueError(problem)

    def _problems(self) -> Iterator[str]:
        """What no log's rows have."""
        count, n = len(self.names), len(self.joints)
        shapes = dict.fromkeys(self.signals, (sum(self.lengths), n)) | {"moving": (count, n)}
        missing = [name for name in SIGNALS[:4] if name not in self.signals]
        if missing:
            yield f"there is no {', '.join(missing)}"
        for name, shape in shapes.items():
            x = self.moving if name == "moving" else self.signals[name]
            if x.shape != shape:
                yield f"{name} has the shape {x.shape}, and not {shape}"
            if x.dtype.kind != "f" or not np.isfinite(x).all():
                yield f"{name} holds something else than finite numbers"
        if not 0 < self.cutoff < self.rate < math.inf:
            yield f"a cut-off of {self.cutoff:g} Hz and a rate of {self.rate:g} Hz"
        if not len(self.lengths) == len(self.starts) == count or min(self.lengths, default=0) < 4:
            yield f"{count} trajectories of {list(self.lengths)} rows"
        # A trajectory's last row is before the next one's first.
        ends = [
            a + (rows - 1) / self.rate for a, rows in zip(self.starts, self.lengths, strict=True)
        ]
        if not all(
            end < start for end, start in zip(ends, [*self.starts[1:], math.inf], strict=True)
        ):
            yield f"time goes back: trajectories begin at {list(self.starts)} s"

    @property
    def source(self) -> str:
        """The log, in words."""
        return source_of(self.names)

    def write(self, path: Path) -> str:
        """Into a file, whose SHA-256 is returned.

        Raises:
            TorchidError: the file cannot be written.
        """
        held: dict[str, Any] = {name: getattr(self, name) for name in _HELD}
        content = io.BytesIO()
        np.savez_compressed(content, allow_pickle=False, **held, **self.signals)
        with atomic_write(path, "wb") as file:
            file.write(content.getvalue())
        return hashlib.sha256(content.getvalue()).hexdigest()

    @classmethod
    def read(cls, path: Path, sha256: str, robot: Robot) -> "LogRows":
        """From the file that a model's yaml names.

        Raises:
            RobotError: it is another file than the model was written with, cannot be read, is
                damaged, or of other joints.
        """
        hint = (
            "the earlier log itself, `before=...`; on the command line `--no-rows` does without one"
        )
        try:
            content = path.read_bytes()
            found = hashlib.sha256(content).hexdigest()
            if found != sha256:
                raise RobotError(
                    f"'{path}' is not the file that the model was written with.",
                    got=f"SHA-256 {found[:12]}..", expected=f"{sha256[:12]}..", hint=hint,
                )  # fmt: skip
            if not zipfile.is_zipfile(io.BytesIO(content)):
                raise ValueError("no archive of arrays")
            with np.load(io.BytesIO(content)) as held:
                rows = cls(
                    tuple(map(str, held["names"])),
                    tuple(map(str, held["joints"])),
                    float(held["rate"]),
                    float(held["cutoff"]),
                    tuple(map(int, held["lengths"])),
                    tuple(map(float, held["starts"])),
                    held["moving"],
                    bool(held["own_velocity"]),
                    {name: held[name] for name in SIGNALS if name in held},
                )
        except _DAMAGED as error:
            raise RobotError(
                f"'{path}', the log that the model was made from, is damaged.",
                got=str(error).partition("\n")[0] or type(error).__name__,
                expected=f"rows of {', '.join(SIGNALS[:4])} of {robot.n} joints",
                hint=hint,
            ) from error
        if rows.joints != robot.joint_names:
            raise RobotError(
                f"'{path}' is of other joints.",
                got=list(rows.joints), expected=robot.joint_names, hint=hint,
            )  # fmt: skip
        return rows


_HELD = ("names", "joints", "rate", "cutoff", "lengths", "starts", "moving", "own_velocity")


def kept(samples: Samples, robot: Robot) -> LogRows:
    """Of the log whose samples were fitted."""
    step = max(1, samples.step // FINER)
    rate = samples.rate / step
    parts = stretches([s.length // step for s in samples.segments], round(STRETCH * rate))
    signals: dict[str, list[np.ndarray]] = {}
    for k, rows in parts:
        segment = samples.segments[k]
        for name in SIGNALS:
            x = segment.tau if name == "tau" else getattr(segment.motion, name)
            if x is None:
                continue
            if name != "age" and step > 1:
                x = low_passed(x.T, samples.rate, PASSED * rate).T
            thin = x[rows.start * step : rows.stop * step : step].numpy()
            signals.setdefault(name, []).append(thin.astype(np.float32))
    own = [samples.segments[k] for k, _ in parts]
    of_all = {k: np.concatenate(x) for k, x in signals.items() if len(x) == len(parts)}
    return LogRows(
        names=tuple(s.name for s in own),
        joints=robot.joint_names,
        rate=rate,
        cutoff=samples.cutoff,
        lengths=tuple(r.stop - r.start for _, r in parts),
        starts=tuple(s.start + r.start / rate for s, (_, r) in zip(own, parts, strict=True)),
        moving=np.stack([np.broadcast_to(np.asarray(s.moving), (robot.n,)) for s in own]),
        own_velocity=all(s.own_velocity for s in own),
        signals=of_all,
    )


def trajectories(rows: LogRows) -> tuple[Segment, ...]:
    """What was kept, as trajectories to be fitted."""
    ends = np.cumsum([0, *rows.lengths])
    out = []
    for k, (a, b) in enumerate(pairwise(ends)):
        x = {n: torch.from_numpy(v[a:b].astype(float)) for n, v in rows.signals.items()}
        tau, t = x.pop("tau"), rows.starts[k] + torch.arange(b - a).double() / rows.rate
        moving = torch.from_numpy(rows.moving[k].astype(float))
        motion = Motion(**x, t=t)
        name, band = rows.names[k], PASSED * rows.rate
        out.append(Segment(name, rows.rate, band, motion, tau, rows.own_velocity, moving=moving))
    return tuple(out)


def source_of(names: Sequence[str]) -> str:
    """A log by the files of its trajectories: `monday`, `run1 and 2 more`."""
    return listed(dict.fromkeys(name.partition("[")[0] for name in names), most=1)


def rows_of(robot: Robot) -> LogRows | str | None:
    """The log that a model was made from, where its file is there; that it is missing, in a
    sentence; None of a model that names none.

    Raises:
        RobotError: as `LogRows.read`.
    """
    named = None if robot.knowledge is None else robot.knowledge.log
    if named is None:
        return None
    path = Path(robot.source).with_name(Path(named[0]).name)
    if not path.is_file():
        return (
            f"Caution: '{path}', the log that the model was made from, is not there: what has "
            "changed since is judged by the model's covariance alone. `before=...` gives the log."
        )
    add_input(path)
    return LogRows.read(path, named[1], robot)


def write_with_rows(robot: Robot, rows: LogRows | None, path: Path) -> None:
    """Write a robot as a .yaml, and the log that it was made from beside it.

    Raises:
        TorchidError: a file cannot be written.
    """
    if rows is not None and robot.knowledge is not None:
        beside = rows_file(path)
        known = replace(robot.knowledge, log=(beside.name, rows.write(beside)))
        robot = replace(robot, knowledge=known)
    write_robot(robot, path)


def stretches(lengths: list[int], longest: int) -> list[tuple[int, slice]]:
    """Rows of trajectories that are kept, with the number of each one's trajectory: all, or
    stretches that are evenly spread.

    Args:
        lengths: of the trajectories.
        longest: stretch.
    """
    out: list[tuple[int, slice]] = []
    every = sum(lengths) <= MOST
    for k, length in enumerate(lengths):
        count = 1 if every else max(1, math.ceil(length / longest))
        ends = [length * i // count for i in range(count + 1)]
        out += [(k, slice(a, b)) for a, b in pairwise(ends)]
    if every:
        return out
    return spread_out(out, MOST, sum(lengths))


def spread_out(some: Sequence[T], kept: float, total: float) -> list[T]:
    """As many of some as `kept` is of `total`, one at least, evenly spread over all of them."""
    count = max(1, int(len(some) * kept / total))
    return [some[int((k + 0.5) * len(some) / count)] for k in range(count)]
