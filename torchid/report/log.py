"""What a log is seen as, in tables."""

from collections.abc import Sequence

from rich.text import Text

from torchid.design.repeats import Repeat
from torchid.log.model import JOINT_SIGNALS
from torchid.log.overview import Overview
from torchid.log.ros import Topic
from torchid.report.table import Cell, Table

_SHOWN = 40
_CONSEQUENCES = {
    "dq": "differentiated from q",
    "ddq": "differentiated",
    "tau": "needed to identify, unless there is current and a drive gain",
    "current": "",
}


def headline(seen: Overview) -> str:
    """One sentence: what the log is."""
    log, seconds = seen.log, sum(t.duration for t in seen.timing)
    kinds = list(dict.fromkeys(t.kind for t in seen.tables if t is not None))
    trajectories = (
        "1 trajectory" if log.trajectory_count == 1 else f"{log.trajectory_count} trajectories"
    )
    rates = sorted({f"{t.rate:.4g}" for t in seen.timing if t.rate is not None}, key=float)
    at = (
        f", {rates[0]} Hz"
        if len(rates) == 1
        else f", {rates[0]} to {rates[-1]} Hz"
        if rates
        else ""
    )
    return (
        f"{', '.join(kinds) or 'log'}: {log.n} joints, {trajectories}, {seconds:.4g} s, "
        f"{log.samples} samples{at}"
    )


def log_tables(seen: Overview) -> list[Table]:
    """Signals, their ranges joint by joint, and trajectories."""
    signals: list[tuple[Cell, ...]] = [("t", seen.sources["t"], seen.units["t"])]
    for name in JOINT_SIGNALS:
        if name in seen.log.signals:
            signals.append((name, seen.sources[name], seen.units[name]))
        elif _CONSEQUENCES[name]:
            signals.append((name, Text("absent", "dim"), Text(_CONSEQUENCES[name], "dim")))
    ranges = []
    for j in range(seen.log.n):
        ends = (values[j].tolist() for values in seen.ranges.values())
        cells = ("-" if low != low else f"{low:.4g} .. {high:.4g}" for low, high in ends)
        ranges.append((f"{j + 1} {seen.joints[j]}" if seen.joints else str(j + 1), *cells))
    units = [f"{name} [{seen.units[name]}]" for name in seen.ranges]
    trajectories: list[tuple[Cell, ...]] = []
    for t in seen.timing[:_SHOWN]:
        rate = "-" if t.rate is None else f"{t.rate:.5g}"
        back = Text(f" ({t.backwards} steps back)" if t.backwards else "", "red")
        times = (f"{t.start:.6g}", f"{t.duration:.5g}", rate, f"{1e3 * t.jitter:.3g}")
        gaps = Text.assemble(str(t.gaps), back)
        trajectories.append((t.name, str(t.samples), *times, gaps, f"{1e3 * t.longest:.4g}"))
    if len(seen.timing) > _SHOWN:
        trajectories.append((f"and {len(seen.timing) - _SHOWN} more",))
    headings = (
        "", "samples", "from [s]", "for [s]", "rate [Hz]", "jitter [ms]", "gaps",
        "longest step [ms]",
    )  # fmt: skip
    columns = ("", "from", "taken as")
    return [
        Table("signals", columns, signals, words=columns),
        Table("smallest to largest", ("joint", *units), ranges, words=("joint",)),
        Table("trajectories", headings, trajectories, words=("",)),
    ]


def topics_table(topics: Sequence[Topic], read: str | None) -> Table:
    """The topics of a bag."""
    rows = [
        (
            "read" if topic.name == read else "", topic.name, topic.type.replace("/msg/", "/"),
            str(topic.messages), ", ".join(topic.signals), ", ".join(topic.joints),
        )
        for topic in topics
    ]  # fmt: skip
    columns = ("", "topic", "type", "messages", "with", "joints")
    return Table("topics", columns, rows, words=columns)


def repeats_table(repeats: Sequence[Repeat]) -> Table:
    """Motions made more than once: what differs between them is noise."""
    rows = []
    for r in repeats[:_SHOWN]:
        first, second, seconds = (f"{x:.2f}" for x in (r.start_first, r.start_second, r.duration))
        rows.append((r.first, first, r.second, second, seconds))
    columns = ("trajectory", "from [s]", "again in", "from [s]", "for [s]")
    title = "repeated motion: what differs between the two is noise"
    return Table(title, columns, rows, words=columns)
