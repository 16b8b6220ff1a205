"""A log and a motion for people: what it is seen as, and its figure."""

from collections.abc import Sequence
from typing import Any

import torch
from rich.text import Text

from torchid.design.repeats import Repeat
from torchid.log.channels import OddChannel
from torchid.log.columns import JOINT_SIGNALS
from torchid.log.model import Log
from torchid.log.overview import Overview
from torchid.log.ros import Topic, topics_of
from torchid.report.colours import BLUE, ORANGE, RED
from torchid.report.panels import Figure, finish, joint_rows, thin
from torchid.report.table import Cell, Report, Table, plain_table, table_of
from torchid.results.words import count
from torchid.robot.model import JointType, Robot

SIGNALS = (("position", "q"), ("velocity", "dq"), ("acceleration", "ddq"))
"""Names of the signals of a motion, and their fields."""
SMALL: dict[str, Any] = {"color": RED, "fontsize": 7}
"""Of what is written into a panel."""
_SHOWN = 40
_CONSEQUENCES = {
    "dq": "differentiated from q",
    "ddq": "differentiated",
    "tau": "needed to identify, unless there is current and a drive gain",
}


def report_of_log(seen: Overview, repeats: Sequence[Repeat]) -> Report:
    """All that there is to see of a log, but why it cannot be used.

    Args:
        seen: of the log.
        repeats: of its motion.
    """
    unused = f"not used: {', '.join(seen.unused[:_SHOWN])}" if seen.unused else ""
    return Report(
        verdict=headline(seen),
        parts=[
            *(
                topics_table(topics_of(table.path), table.topic)
                for table in seen.tables
                if table is not None and table.topic is not None
            ),
            *log_tables(seen),
            repeats_table(repeats),
            unused,
        ],
        warnings=seen.warnings,
    )


def headline(seen: Overview) -> str:
    """One sentence: what the log is."""
    log, seconds = seen.log, sum(t.duration for t in seen.timing)
    kinds = list(dict.fromkeys(t.kind for t in seen.tables if t is not None))
    trajectories = count(log.trajectory_count, "trajectory", "trajectories")
    rates = sorted({f"{t.rate:.4g}" for t in seen.timing if t.rate is not None}, key=float)
    at = f", {' to '.join(dict.fromkeys((rates[0], rates[-1])))} Hz" if rates else ""
    return (
        f"{', '.join(kinds) or 'log'}: {count(log.n, 'joint')}, {trajectories}, {seconds:.4g} s, "
        f"{log.samples} samples{at}"
    )


def log_tables(seen: Overview) -> list[Table]:
    """Signals, their ranges joint by joint, and trajectories."""
    signals: list[tuple[Cell, ...]] = [("t", seen.sources["t"], seen.units["t"])]
    for name in JOINT_SIGNALS:
        if name in seen.log.signals:
            signals.append((name, seen.sources[name], seen.units[name]))
        elif name in _CONSEQUENCES:
            signals.append((name, Text("absent", "dim"), Text(_CONSEQUENCES[name], "dim")))
    ranges = []
    for j in range(seen.log.n):
        ends = (values[j].tolist() for values in seen.ranges.values())
        cells = ("-" if low != low else f"{low:.4g} .. {high:.4g}" for low, high in ends)
        ranges.append((f"{j + 1} {seen.joints[j]}" if seen.joints else str(j + 1), *cells))
    units = [f"{name} [{seen.units[name]}]" for name in seen.ranges]
    return [
        Table("signals", ("", "from", "taken as"), signals, "ppp"),
        Table("smallest to largest", ("joint", *units), ranges, "p"),
        plain_table("trajectories [s; Hz]", [vars(t) for t in seen.timing], most=_SHOWN),
    ]


def trajectory_figure(robot: Robot, motion: Log, title: str) -> Figure:
    """Position, velocity and acceleration per joint, limits in red.

    Args:
        robot: whose limits are drawn.
        motion: one trajectory.
        title: of the figure.
    """
    t = thin(motion.t - motion.t[0])
    kinds = set(robot.joint_types)
    length = "m" if kinds == {JointType.PRISMATIC} else "rad"
    # Where the joints differ, no unit holds for all.
    units = [""] * 3 if len(kinds) > 1 else [f" [{length}{per}]" for per in ("", "/s", "/s²")]
    headings = [name + unit for (name, _), unit in zip(SIGNALS, units, strict=True)]
    figure, grid = joint_rows(robot.n, headings, (11, 1.0 + 1.25 * robot.n))
    for column, (name, signal) in zip(grid.T, SIGNALS, strict=True):
        planned = getattr(motion, signal)
        limits = getattr(robot.limits, name)
        for j, axes in enumerate(column):
            if planned is not None:
                axes.plot(t, thin(planned[:, j]), color=BLUE, linewidth=1.1)
            if limits is not None and bool(torch.isfinite(limits[j]).all()):
                for bound in limits[j].tolist():
                    axes.axhline(bound, color=RED, linewidth=0.9)
    return finish(figure, title)


def signals_figure(log: Log, odd: Sequence[OddChannel] = ()) -> Figure:
    """Position with its command, velocity and torque (or current) of each joint, as far as they
    were measured; trajectories one after the other.

    Args:
        log: of which.
        odd: columns that look wrong, in red with the reason.
    """
    effort = "tau" if log.tau is not None or log.current is None else "current"
    columns = [
        (name, field)
        for name, field in (
            ("position [rad or m]", "q"),
            ("velocity [1/s]", "dq"),
            (effort, effort),
        )
        if getattr(log, field) is not None
    ]
    reasons = {(o.signal, j): o.why for o in reversed(odd) for j in o.joints}
    starts = torch.tensor([0.0, *log.duration]).cumsum(0).tolist()
    figure, grid = joint_rows(log.n, [name for name, _ in columns], (11, 1.0 + 1.25 * log.n))
    for start, run in zip(starts, log.trajectories(), strict=False):
        t = thin(run.t - run.t[0]) + start
        for column, (_, field) in zip(grid.T, columns, strict=True):
            for j, axes in enumerate(column):
                colour = RED if (field, j) in reasons else BLUE
                axes.plot(t, thin(getattr(run, field)[:, j]), color=colour, label="measured")
                if field == "q" and run.u is not None:
                    axes.plot(t, thin(run.u[:, j]), color=ORANGE, linewidth=0.8, label="commanded")
                axes.axvline(start, color="0.8", linewidth=0.6)
    shown = [field for _, field in columns]
    for (field, j), why in reasons.items():
        if field in shown:
            axes = grid[j, shown.index(field)]
            behind = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1}
            axes.text(0.01, 0.95, why, **SMALL, va="top", bbox=behind, transform=axes.transAxes)
    return finish(figure, log.source, *(grid[:1, 0] if log.u is not None else ()))


def topics_table(topics: Sequence[Topic], read: str | None) -> Table:
    """The topics of a bag."""
    rows = [{"topic": one.name, **vars(one), "read": one.name == read} for one in topics]
    return plain_table("topics", [{k: x for k, x in row.items() if k != "name"} for row in rows])


def repeats_table(repeats: Sequence[Repeat]) -> Table:
    """Motions made more than once: what differs between them is noise."""
    title = "repeated motion: what differs between the two is noise"
    return table_of(title, repeats, most=_SHOWN)
