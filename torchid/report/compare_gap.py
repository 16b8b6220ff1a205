"""A comparison of gap diagnoses for people."""

from torchid.compare.diagnoses import ALPHA, GapComparison, Named, Shared
from torchid.report.compare import torque_sentence, torque_tables
from torchid.report.table import Table


def verdict(result: GapComparison) -> str:
    """Which effects all diagnoses share, in sentences."""
    everywhere = [s for s in result.shared if s.everywhere]
    elsewhere = [s for s in result.shared if not s.everywhere]
    out = [f"{len(result.labels)} diagnoses of {result.robot}:"]
    if not result.shared:
        return out[0] + " none names an effect."
    if everywhere:
        out.append("all name " + ", ".join(_name(s) for s in everywhere) + ".")
    else:
        out.append("no effect is named in all.")
    if elsewhere:
        some = []
        for s in elsewhere:
            hidden = sum(state == "not_testable" for state in s.states)
            lost = sum(state == "not_found" for state in s.states)
            why = [f"{lost} did not find it"] * bool(lost)
            why += [f"{hidden} could not test it"] * bool(hidden)
            some.append(f"{_name(s)} ({'; '.join(why)})")
        out.append("Only some name " + ", ".join(some) + ".")
    changed = [c for s in result.shared for c in s.coefficients if c.p_holm < ALPHA]
    known = sum(len(s.coefficients) for s in result.shared)
    if known:
        words = f"{known - len(changed)} agree, {len(changed)} do not"
        out.append(f"Of the coefficients named twice or more, {words} (5 %, Holm).")
    if result.torque is not None:
        out.append(
            torque_sentence(result.torque, result.labels).replace("models", "corrected models")
        )
    return " ".join(out)


def _name(s: Shared) -> str:
    names = " or ".join(s.effects)
    if not s.place:
        return names
    word = "link" if s.effects == ("link_inertia",) else "joint"
    return f"{names} on {word} {', '.join(str(j) for j in s.place)}"


def tables(result: GapComparison) -> list[Table]:
    """Diagnoses, effects with coefficients, torque."""
    labels = []
    for label, status, closed in zip(result.labels, result.statuses, result.closed, strict=True):
        share = "" if closed is None else f", {100 * closed:.0f} % closed"
        labels.append(f"{label}\n{status}{share}")
    rows: list[list[str]] = []
    for s in result.shared:
        rows.append([_name(s), "", *(_state(s, k) for k in range(len(s.states))), "", ""])
        for c in s.coefficients:
            cells = [
                "" if value is None else f"{value:.4g} ± {std:.2g}{_unit(c.unit)}"
                for value, std in zip(c.values, c.std, strict=True)
            ]
            rows.append(["", c.name, *cells, f"{c.scatter.birge:.2f}", f"{c.p_holm:.2g}"])
        # Coefficients that no other diagnosis gives with a standard deviation, then shapes.
        alike = [c.name for c in s.coefficients]
        named = [n for n in s.named if n is not None]
        for name in dict.fromkeys(k for n in named for k in n.values if k not in alike):
            rows.append(["", name, *(_size(n, name) for n in s.named), "", ""])
        for shape in dict.fromkeys(k for n in named for k in n.shapes):
            cells = [
                "" if n is None or shape not in n.shapes else f"{n.shapes[shape]:.4g}"
                for n in s.named
            ]
            rows.append(["", shape, *cells, "", ""])
        rows.append([])
    columns = ("effect", "", *labels, "scatter", "p (Holm)")
    effects = Table("effects (coefficient ± std)", columns, rows, words=("effect", ""))
    return [effects, *torque_tables(result.torque, result.labels)]


def _state(s: Shared, k: int) -> str:
    entry, smallest = s.named[k], s.smallest[k]
    if entry is not None:
        also = f" (or {', '.join(entry.also)})" if entry.also else ""
        return ("named" if len(s.effects) == 1 else entry.effect) + also
    if s.states[k] == "not_testable":
        return "not testable" + ("" if smallest is None else f" below {smallest:.2g}")
    return "not found"


def _size(n: Named | None, name: str) -> str:
    if n is None or name not in n.values:
        return ""
    std = f" ± {n.std[name]:.2g}" if name in n.std else ""
    return f"{n.values[name]:.4g}{std}{_unit(n.units.get(name, '1'))}"


def _unit(unit: str) -> str:
    return "" if unit == "1" else f" {unit}"
