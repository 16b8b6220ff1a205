"""The calibration of a diagnosis on one's own log."""

from collections import Counter
from collections.abc import Sequence

from torchid.report.table import Report, Table
from torchid.results.words import count
from torchid.statistics.criteria import SET_MASS
from torchid.withheld.planted import OUTSIDE, Calibration, Planted


def report_of_calibration(calibration: Calibration) -> Report:
    """What would be named on this log, were it there."""
    return Report(verdict=calibration_headline(calibration), parts=[calibration_table(calibration)])


def calibration_headline(calibration: Calibration) -> str:
    """How often causes are named, and what is of no library gets a sure name, in one sentence."""
    inside = [p for p in calibration.planted if p.effect != OUTSIDE]
    outside = [p for p in calibration.planted if p.effect == OUTSIDE]
    right, also = (sum(x) for x in ((p.named for p in inside), (p.in_set for p in inside)))
    text = (
        f"Of {count(len(inside), 'cause')} {calibration.times:g} times as large as the remaining "
        f"error, {right} {'was' if right == 1 else 'were'} named, {also} with those in a set"
    )
    sure = sum((p.how_sure or 0.0) >= SET_MASS for p in outside)
    return f"{text}; of {len(outside)} that no library has, {sure} got a sure name."


def calibration_table(calibration: Calibration) -> Table:
    """Kind by kind: how often it was named, and what was named in its place."""
    kinds: dict[str, list[Planted]] = {}
    for one in calibration.planted:
        kinds.setdefault(one.effect, []).append(one)
    rows = []
    for kind, same in kinds.items():
        instead = Counter(f.effect for p in same for f in p.named_instead)
        others = ", ".join(f"{name} ({k})" for name, k in instead.most_common(3))
        counts = [sum(x) for x in zip(*((p.named, p.in_set, p.branch) for p in same), strict=True)]
        cells = ["-"] * 3 if kind == OUTSIDE else [f"{k} of {len(same)}" for k in counts]
        where = _joints(sorted({p.joint for p in same}))
        rows.append((kind, where, *cells, others))
    heads = ("planted", "joints", "named", "in a set", "its branch", "named beside or instead")
    return Table("Causes planted in the error that remains", heads, rows, "pppppp")


def _joints(joints: Sequence[int]) -> str:
    return " ".join(str(j + 1) for j in joints) or "arm"
