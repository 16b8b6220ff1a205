"""A simulator's log against the arm's, for people."""

import math
from collections.abc import Mapping

from torchid.pair.pair import PairDiagnosis
from torchid.pair.record import Fault, OneSided, WherePair
from torchid.report.gap_words import CLEAR, excess_words
from torchid.report.table import Shown, Table, filled
from torchid.results.words import effect_words, joints_words, listed, measure, percent

_MOST_REGIMES = 3


def verdict(found: PairDiagnosis) -> str:
    """The answer in plain words."""
    if found.faults:
        first, *others = found.faults
        also = [f.fault.replace("_", " ") for f in others]
        then = f" Then: {listed(also)}." if also else ""
        return f"The set-ups differ: {first.meaning}. {first.remedy}{then}"
    if found.which:
        said = [f"{_more(one)} at {joints_words(one.joints)}" for one in found.which[:3]]
        more = f", and {len(found.which) - 3} more" if len(found.which) > 3 else ""
        return f"The set-ups agree; what differs: {'; '.join(said)}{more}."
    if found.record.which is None:
        return "No fault of the set-up is seen."
    return "Nothing: set-ups and effects of simulator and arm agree within what these logs show."


def _more(one: OneSided) -> str:
    """`Coulomb friction that only the arm has`."""
    who = {"arm": "the arm", "simulator": "the simulator"}[one.more]
    name = effect_words(one.effect)
    return f"{name} that only {who} has" if one.only else f"{name}, of which {who} has more"


def shown(found: PairDiagnosis) -> Shown:
    """All that there is to see of a pair."""
    return Shown(verdict=verdict(found), parts=tables(found), warnings=found.record.warnings)


def tables(found: PairDiagnosis) -> list[Table]:
    """Where torque and motion differ, faults, effects."""
    record = found.record
    faults = [(f.fault.replace("_", " "), _place(f), f.meaning, f.remedy) for f in record.faults]
    effects = [
        (
            _more(one), joints_words(one.joints), _sizes(one.simulator, {}, one.unit),
            _sizes(one.arm, one.std, one.unit), percent(one.share),
            ", ".join(map(effect_words, one.ambiguous_with)) or "-",
        )
        for one in record.which or ()
    ]  # fmt: skip
    columns = ("fault", "where", "what was seen", "what to do")
    headings = ("effect", "where", "simulator", "arm", "share", "cannot be told from")
    words = [heading for heading in headings if heading != "share"]
    return filled(
        None if record.torque is None else _where(record.torque, "torque", "N m"),
        _where(record.position, "motion", "mrad"),
        Table("set-up, in the order in which to mend it", columns, faults, words=columns),
        Table("effects: simulator -> arm", headings, effects, words=words),
    )


def _place(fault: Fault) -> str:
    """`simulator, joint 2`."""
    words = [fault.side or "", joints_words(fault.joints) if fault.joints else ""]
    return ", ".join(filter(None, words))


def _sizes(values: Mapping[str, float], std: Mapping[str, float], unit: Mapping[str, str]) -> str:
    return "\n".join(
        f"{name} = {measure(x, std.get(name), '' if unit.get(name) == '1' else unit.get(name, ''))}"
        for name, x in values.items()
    )


def _where(where: WherePair, what: str, unit: str) -> Table:
    """Joints, and the regimes that hold more than their share."""
    scale = 1e3 if unit == "mrad" else 1.0
    rows = []
    for one in where.joints:
        own = [r for r in where.regimes if r.joint == one.joint and r.p < CLEAR and r.excess > 0]
        own.sort(key=lambda r: -r.excess)
        noise = "-" if math.isnan(one.noise) else f"{scale * one.noise:.2g}"
        rows.append(
            (
                str(one.joint + 1), f"{scale * one.rms:.3g}", noise, f"{one.relative_percent:.3g}",
                ", ".join(map(excess_words, own[:_MOST_REGIMES])) or "-",
            )
        )  # fmt: skip
    regimes = f"holds more than its share (excess [95 %], p < {CLEAR:g})"
    return Table(
        f"where: {what} of the arm less the simulator's [{unit}]",
        ("joint", "RMS", "noise", "of the arm's [%]", regimes),
        rows,
        words=(regimes,),
    )
