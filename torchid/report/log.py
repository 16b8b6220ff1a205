"""What a log is seen as, in tables."""

from collections.abc import Sequence

from rich.markup import escape
from rich.table import Table

from torchid.gap.data.repeated import Repeat
from torchid.log.model import JOINT_SIGNALS
from torchid.log.overview import Overview
from torchid.log.ros import Topic
from torchid.report.identification import compact

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
    return [_signals(seen), _ranges(seen), _trajectories(seen)]


def topics_table(topics: Sequence[Topic], read: str | None) -> Table:
    """The topics of a bag."""
    table = compact("topics")
    for heading in ("", "topic", "type", "messages", "with", "joints"):
        table.add_column(heading)
    for topic in topics:
        mark = "read" if topic.name == read else ""
        joints = ", ".join(topic.joints)
        kind, signals = topic.type.replace("/msg/", "/"), ", ".join(topic.signals)
        cells = (kind, str(topic.messages), signals, escape(joints))
        table.add_row(mark, escape(topic.name), *cells)
    return table


def repeats_table(repeats: Sequence[Repeat]) -> Table | None:
    """Motions made more than once: what differs between them is noise."""
    if not repeats:
        return None
    table = compact("repeated motion: what differs between the two is noise")
    for heading in ("trajectory", "from [s]", "again in", "from [s]", "for [s]"):
        table.add_column(escape(heading))
    for r in repeats[:_SHOWN]:
        numbers = [f"{x:.2f}" for x in (r.start_first, r.start_second, r.duration)]
        table.add_row(escape(r.first), numbers[0], escape(r.second), numbers[1], numbers[2])
    return table


def _signals(seen: Overview) -> Table:
    table = compact("signals")
    for heading in ("", "from", "taken as"):
        table.add_column(heading)
    table.add_row("t", escape(seen.sources["t"]), seen.units["t"])
    for name in JOINT_SIGNALS:
        if name in seen.log.signals:
            table.add_row(name, escape(seen.sources[name]), seen.units[name])
        elif _CONSEQUENCES[name]:
            table.add_row(name, "[dim]absent[/]", f"[dim]{_CONSEQUENCES[name]}[/]")
    return table


def _ranges(seen: Overview) -> Table:
    table = compact("smallest to largest")
    table.add_column("joint")
    for name in seen.ranges:
        table.add_column(escape(f"{name} [{seen.units[name]}]"), justify="right")
    for j in range(seen.log.n):
        label = f"{j + 1} {seen.joints[j]}" if seen.joints else str(j + 1)
        cells = (_interval(*values[j].tolist()) for values in seen.ranges.values())
        table.add_row(escape(label), *cells)
    return table


def _interval(low: float, high: float) -> str:
    return "-" if low != low else f"{low:.4g} .. {high:.4g}"


def _trajectories(seen: Overview) -> Table:
    table = compact("trajectories")
    headings = (
        "",
        "samples",
        "from [s]",
        "for [s]",
        "rate [Hz]",
        "jitter [ms]",
        "gaps",
        "longest step [ms]",
    )
    for heading in headings:
        table.add_column(escape(heading), justify="left" if not heading else "right")
    for t in seen.timing[:_SHOWN]:
        rate = "-" if t.rate is None else f"{t.rate:.5g}"
        gaps = str(t.gaps) + (f" [red]({t.backwards} steps back)[/]" if t.backwards else "")
        numbers = (f"{t.start:.6g}", f"{t.duration:.5g}", rate, f"{1e3 * t.jitter:.3g}", gaps)
        table.add_row(escape(t.name), str(t.samples), *numbers, f"{1e3 * t.longest:.4g}")
    if len(seen.timing) > _SHOWN:
        table.add_row(f"and {len(seen.timing) - _SHOWN} more")
    return table
