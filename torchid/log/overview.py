"""What a log is seen as: sampling, signals, ranges, units, and what is odd about it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from torchid.errors import LogError
from torchid.json_data import plain
from torchid.log.assemble import unused_columns
from torchid.log.base_motion import COORDINATES
from torchid.log.channels import OddChannel, odd_channels
from torchid.log.checks import check_log
from torchid.log.columns import JOINT_SIGNALS, PREFIXES
from torchid.log.model import Log, finite_range
from torchid.log.readers import open_logs
from torchid.log.stamps import ROUNDING, SMALL_GAP
from torchid.log.table import Request, Table
from torchid.log.units import unit_factor
from torchid.typing import Float, Tensor

_UNITS = {
    "t": "s",
    "q": "rad or m",
    "dq": "rad/s or m/s",
    "ddq": "rad/s² or m/s²",
    "tau": "N m or N",
    "current": "A",
    "ql": "rad or m",
    "u": "rad or m",
}


@dataclass(frozen=True)
class Timing:
    """The time stamps of one trajectory.

    Attributes:
        name: of the trajectory.
        samples: number of them.
        start: first time stamp [s].
        duration: from first to last [s].
        rate: of the mean step other than gaps [Hz]; None where that is not positive.
        jitter: standard deviation of the steps other than gaps [s]; 0 where it is rounding.
        gaps: number of steps longer than three median steps.
        longest: step [s].
        backwards: number of steps that are zero or negative.
    """

    name: str
    samples: int
    start: float
    duration: float
    rate: float | None
    jitter: float
    gaps: int
    longest: float
    backwards: int


@dataclass(frozen=True)
class Overview:
    """What files were read as.

    Attributes:
        log: as read, nothing changed.
        tables: one a file.
        joints: their names, "" where no file and no robot tells.
        sources: where each signal is from, in the file's words.
        timing: one a trajectory.
        units: that each signal is taken to be in.
        ranges: (n, 2) smallest and largest finite value by signal; NaN where there is none.
        unused: columns of the first file that were not taken.
        odd: columns that look wrong by themselves.
        problem: why the identification would refuse the log, or None.
        warnings: of reading, and of `check_log`.
    """

    log: Log
    tables: tuple[Table | None, ...]
    joints: tuple[str, ...]
    sources: dict[str, str]
    timing: tuple[Timing, ...]
    units: dict[str, str]
    ranges: dict[str, Float[Tensor, "n 2"]]
    unused: tuple[str, ...]
    odd: tuple[OddChannel, ...]
    problem: str | None
    warnings: tuple[str, ...]


def look_at(
    paths: Sequence[Path],
    request: Request,
    *,
    robot_name: str | None = None,
    position_limits: Float[Tensor, "n 2"] | None = None,
    effort: Float[Tensor, " n"] | None = None,
    prismatic: Sequence[bool] = (),
    moving_base: bool = False,
) -> Overview:
    """Read logs and say what is in them.

    Args:
        paths: as for `read_log`.
        request: mapping, topic, names of the robot's joints.
        robot_name: of the robot they are checked for; without it they are checked as far as that
            goes.
        position_limits, prismatic, moving_base: as for `check_log`.
        effort: largest torque (n,) of each joint [N m; N]; None where it is not known.

    Raises:
        LogError: the files cannot be read.
    """
    opened = open_logs(paths, request)
    log = Log.concatenate([one for _, one in opened])
    tables = tuple(table for table, _ in opened)
    n = len(request.joints) + COORDINATES * moving_base if request.joints else log.n
    problem: str | None = None
    warnings: tuple[str, ...] = ()
    try:
        warnings = check_log(
            log,
            n=n,
            robot_name=robot_name or "of this log",
            position_limits=position_limits,
            prismatic=prismatic,
            moving_base=moving_base,
        )
    except LogError as error:
        problem = str(error)
    # Of revolute joints or prismatic ones; both where the robot has both or is not known.
    alike, which = robot_name is not None and len(set(prismatic)) <= 1, -1 if any(prismatic) else 0
    joints = request.joints or next((t.joints for t in tables if t is not None and t.joints), ())
    odd = tuple(odd_channels(log, effort if effort is not None and len(effort) == log.n else None))
    return Overview(
        log=log,
        tables=tables,
        joints=joints if len(joints) == log.n else (),
        sources=_sources(log, tables[0], request),
        timing=tuple(_timing(log, k) for k in range(log.trajectory_count)),
        units={name: unit.split(" or ")[which] if alike else unit for name, unit in _UNITS.items()},
        ranges={name: finite_range(signal) for name, signal in log.signals.items()},
        # A bag and a dataset list every joint on its own again.
        unused=()
        if tables[0] is None or tables[0].origins
        else tuple(unused_columns(tables[0], request.columns)),
        odd=odd,
        problem=problem,
        warnings=tuple(dict.fromkeys((*log.warnings, *warnings, *map(str, odd)))),
    )


def overview_record(seen: Overview) -> dict[str, Any]:
    """The schema torchid.log/1."""
    log = seen.log
    return {
        "schema": "torchid.log/1",
        "files": [
            {"path": str(t.path), "format": t.kind, "topic": t.topic, "columns": t.described}
            for t in seen.tables
            if t is not None
        ],
        "joints": log.n,
        "joint_names": list(seen.joints) or None,
        "samples": log.samples,
        "trajectories": [plain(vars(timing)) for timing in seen.timing],
        "signals": [
            {
                "signal": name,
                "source": seen.sources[name],
                "unit": seen.units[name],
                "range": plain(values),
            }
            for name, values in seen.ranges.items()
        ],
        "absent": [name for name in JOINT_SIGNALS if name not in log.signals],
        "unused": list(seen.unused),
        "problem": seen.problem,
        "warnings": list(seen.warnings),
    }


def _sources(log: Log, table: Table | None, request: Request) -> dict[str, str]:
    """By signal: the columns of the file, with the unit and factor they were given."""
    mapped = request.columns.sources if request.columns else {}
    origins: dict[str, str] = {}
    for name in ("t", *log.signals):
        key = PREFIXES.get(name, name)
        source = mapped.get(key)
        if source is not None:
            if source.rate is not None:
                origins[name] = f"{source.rate:g} Hz"
            else:
                scale = unit_factor(key, source.unit) or 1.0
                factors = [f"{factor / scale:.6g}" for factor in source.factors]
                unit = f", in {source.unit}" if source.unit else ""
                added = ", ".join(f"{offset:+.6g}" for offset in source.offsets)
                origins[name] = (
                    ", ".join(source.columns)
                    + ("" if source.offsets == (0.0,) else f" {added}")
                    + unit
                    + ("" if set(factors) == {"1"} else f", x {', '.join(factors)}")
                )
        elif table is not None and table.origins.get(key):
            origins[name] = table.origins[key]
        elif table is not None and key in table.columns:
            origins[name] = key
        else:
            origins[name] = f"{key}1" if log.n == 1 else f"{key}1..{key}{log.n}"
    return origins


def _timing(log: Log, k: int) -> Timing:
    t = log.t[log.slices()[k]]
    steps = t.diff()
    if len(steps) == 0:
        return Timing(log.names[k], len(t), float(t[0]), 0.0, None, 0.0, 0, 0.0, 0)
    median = float(steps.median())
    gap = steps > SMALL_GAP * median
    usual = steps[~gap]
    jitter = float(usual.std(correction=0)) if len(usual) else 0.0
    # Stamps far from zero are rounded.
    rounding = max(ROUNDING * median, float(np.spacing(float(t.abs().max()))))
    return Timing(
        name=log.names[k],
        samples=len(t),
        start=float(t[0]),
        duration=float(t[-1] - t[0]),
        rate=1.0 / float(usual.mean()) if median > 0 else None,
        jitter=0.0 if jitter < rounding else jitter,
        gaps=int(gap.sum()) if median > 0 else 0,
        longest=float(steps.max()),
        backwards=int((steps <= 0).sum()),
    )
