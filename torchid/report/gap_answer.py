"""The answer of a diagnosis in one table: what it costs which joint, why, and what to do."""

import re
from collections.abc import Sequence

from torchid.gap.diagnosis import INERTIA_REMEDY, Diagnosis, Finding, unit_of
from torchid.report import gap_words as words
from torchid.report.table import Cell, Table, listed, percent, torque_unit, unit_words

BAR = 8
"""Characters of the longest bar."""

MOST = 0.5
"""Share of the joints from which on an effect has one row for all of them."""


def answer_table(diagnosis: Diagnosis) -> Table:
    """A row a joint, the one that costs most first: the gap before and after, the noise, and its
    causes in the order of what they close. What most joints have, and what no single joint has, is
    a row of its own."""
    d, far = diagnosis, diagnosis.how_far
    before, after = far.rms_before.tolist(), far.rms_after.tolist()
    longest = max(before, default=0.0)
    shared, local = _parted(d)
    rows: list[Sequence[Cell]] = [
        ("all", "", "", "", "", _cause(same, d), _sure(same), _action(same[0].effect.remedy))
        for same in shared
    ]  # fmt: skip
    if d.parametric:
        links = sorted({j + 1 for p in d.parametric for j in p.links})
        what = f"inertia of link {listed(map(str, links))}" if links else "base parameters"
        sure = [p.how_sure for p in d.parametric if p.how_sure is not None]
        rows.append(
            ("all", "", "", "", "", what, _probability(min(sure, default=None)),
             _action(INERTIA_REMEDY))
        )  # fmt: skip
    for gap in sorted(d.joints, key=lambda g: -before[g.joint]):
        j = gap.joint
        noise = " - ".join(dict.fromkeys(f"{x:.2g}" for x in gap.noise_floor_rms))
        numbers = (f"{before[j]:.3g}", f"{after[j]:.3g}", noise)
        own = local.get(j, [])
        parts = [(_cause([f], d), _sure([f]), _action(f.effect.remedy)) for f in own]
        first, *rest = parts or [("-", "", "")]
        rows.append((str(j + 1), *numbers, _bar(before[j], after[j], longest), *first))
        rows += [("", "", "", "", "", *part) for part in rest]
    unit = torque_unit(d.robot)
    return Table(
        f"the answer: RMS of what the model lacks [{unit}], below {d.band:g} Hz",
        ("joint", "before", "after", "noise", "", "cause (value ± std)", "sure", "what to do"),
        rows,
        names=("joint", "", "cause (value ± std)", "what to do"),
        words=("cause (value ± std)", "what to do"),
        note="Bars: what is left, and what the causes close.",
    )


def _parted(d: Diagnosis) -> tuple[list[list[Finding]], dict[int, list[Finding]]]:
    """Findings with a row of their own, one name each, and those of single joints."""
    names = dict.fromkeys(f.effect.name for f in sorted(d.findings, key=lambda f: -f.share))
    shared: list[list[Finding]] = []
    local: dict[int, list[Finding]] = {}
    for name in names:
        same = [f for f in d.findings if f.effect.name == name]
        of_one = [f for f in same if len(f.effect.joints) == 1]
        if len(of_one) > max(1.0, MOST * d.robot.n):
            shared.append(sorted(of_one, key=lambda f: f.located))
        else:
            for f in of_one:
                local.setdefault(f.effect.joints[0], []).append(f)
        shared += [[f] for f in same if len(f.effect.joints) != 1]
    for some in local.values():
        some.sort(key=lambda f: -f.share)
    return shared, local


def _cause(same: Sequence[Finding], d: Diagnosis) -> str:
    """`Coulomb friction 0.602 ± 0.006 N m`, of several joints one value after the other; and what
    the data cannot tell it from."""
    name = words.effect_words(same[0].effect.name)
    others = list(dict.fromkeys(words.effect_words(x) for f in same for x in f.ambiguous_with))
    end = f", or {listed(others, 'or')}" if others else ""
    if len(same) > 1:
        coefficient = same[0].effect.coefficients[0]
        at = [f.located[0] for f in same]
        unit = unit_words(unit_of(coefficient.unit, at, d.robot))
        values = ", ".join(f"{f.values[0]:.3g}" for f in same)
        place = "" if len(at) == d.robot.n else f" on joints {listed(str(j + 1) for j in at)}"
        return f"{name}{place}: {coefficient.name} = {values} {unit}{end}"
    (f,) = same
    if f.changed:
        return f"{name} changed: {'; '.join(map(words.change_words, f.changed))}{end}"
    # Of a load the mass, of others what the data determine.
    texts = [x.removeprefix(f"{name.split()[-1]} = ") for x in words.coefficients(f, d.robot)]
    known = [x for x, v, std in zip(texts, f.values, f.std, strict=True) if not std >= abs(v)]
    told = ", ".join(known[:1] if f.effect.inertial else known[:3])
    return f"{name} {told}".rstrip() + end


def _sure(same: Sequence[Finding]) -> str:
    known = [f.how_sure for f in same if f.how_sure is not None]
    return _probability(min(known, default=None))


def _probability(value: float | None) -> str:
    return "-" if value is None else "> 99 %" if value > 0.99 else percent(value)


def _action(remedy: str) -> str:
    """The first clause of a remedy."""
    return re.split(r"[,;:(]", remedy, maxsplit=1)[0].strip().rstrip(".")


def _bar(before: float, after: float, longest: float) -> str:
    """`██░░░░░░`: what is left, and what is closed, on one scale."""
    whole = round(BAR * before / longest) if longest > 0 else 0
    left = min(whole, round(BAR * after / longest) if longest > 0 else 0)
    return "█" * left + "░" * (whole - left)
