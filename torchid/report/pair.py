"""A simulator's log against the arm's, for people."""

from dataclasses import replace
from functools import partial

from torchid.effects.servo import PARAMETERS
from torchid.pair.pair import PairDiagnosis
from torchid.pair.record import OneSided, ServoDifference, WherePair
from torchid.report import diagnosis
from torchid.report.cautions import caution_section
from torchid.report.gap_figures import CLEAR, excess_words
from torchid.report.table import Origin, Page, Report, Section, Table, table_of
from torchid.results.words import (
    joints_words,
    listed,
    unit_behind,
)

_MOST_REGIMES = 3
_WORDS = {p.name: p.words for p in PARAMETERS}
"""Of servos' parameters: a noun, and what a smaller and a larger value is called."""
_UNCOUNTED = ("viscous friction", "dry friction", "extra friction at rest")


def verdict(pair: PairDiagnosis) -> str:
    """The answer in plain words."""
    servos = _servos(pair)
    if pair.faults:
        first, *others = pair.faults
        also = [f.fault.replace("_", " ") for f in others]
        then = f" Then: {listed(also)}." if also else ""
        return " ".join(
            filter(None, (f"The set-ups differ: {first.meaning}. {first.remedy}{then}", servos))
        )
    # Causes with numbers of a servo are in the sentences about servos.
    which = [one for one in pair.which if not (pair.servos and {*one.parameters} <= {*_WORDS})]
    phrases = [_more(one) + (f" at {joints_words(one.at)}" if one.at else "") for one in which[:3]]
    if phrases:
        more = f", and {len(which) - 3} more" if len(which) > 3 else ""
        whole = f"No fault of the set-up is seen; what differs: {'; '.join(phrases)}{more}."
        return f"{whole} {servos}" if len(which) < len(pair.which) else whole
    if servos:
        return servos
    if pair.record.which is None:
        return "No fault of the set-up is seen."
    return "Nothing: set-ups and effects of simulator and arm agree within what these logs show."


def _servos(pair: PairDiagnosis) -> str:
    """How the real servos differ from the simulated ones, one sentence a joint."""
    if not pair.servos:
        return ""
    out = []
    for joint in dict.fromkeys(one.joint for one in pair.servos):
        differences = [_difference(s) for s in pair.servos if s.joint == joint and s.differs]
        if differences:
            out.append(f"The real servo of joint {joint + 1} has {listed(differences)}.")
    if not out and pair.of_arm is not None and pair.of_arm.answer.status != "no_gap":
        return "The arm does not move as the simulator's servos do; no cause of that is sure."
    if not out:
        return "The servos of simulator and arm agree within what these logs show."
    return " ".join(out)


def _difference(one: ServoDifference) -> str:
    """`a lower gain (8.1 instead of 17 N m/rad)`, by the real side."""
    noun, less, more = _WORDS[one.parameter]
    noun += " per gain" if one.per_kp else ""
    unit = unit_behind(one.unit)
    real, simulated = (f"{x:.3g} {unit}".rstrip() for x in (one.real, one.simulated))
    if one.simulated_ci95 is None:
        return f"{_article(noun)} ({real}) that the simulated one lacks"
    if one.real_ci95 is None:
        return f"no {noun} ({simulated} in the simulator)"
    word = more if one.real > one.simulated else less
    phrase = f"{word} {noun}"
    phrase = phrase if word in ("less", "more") else _article(phrase)
    return f"{phrase} ({one.real:.3g} instead of {simulated})"


def _article(noun: str) -> str:
    return noun if noun in _UNCOUNTED else f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


def _more(one: OneSided) -> str:
    """`Coulomb friction that only the arm has`."""
    who = {"arm": "the arm", "simulator": "the simulator"}[one.more]
    return f"{one.name} that only {who} has" if one.only else f"{one.name}, of which {who} has more"


def report_of_pair(pair: PairDiagnosis) -> Report:
    """All that there is to see of a pair."""
    return Report(
        verdict=verdict(pair),
        parts=tables(pair),
        warnings=pair.record.warnings,
        page=partial(page, pair),
    )


def page(pair: PairDiagnosis, origin: Origin) -> Page:
    """The page of a pair: where both differ, and below it the diagnosis of the arm beside the
    simulator, where effects were sought."""
    sections = (
        Section("Simulator and arm", tables(pair), folded=False),
        caution_section(pair.record.warnings),
    )
    title, answer = "Simulator beside arm", verdict(pair)
    if pair.of_arm is None:
        return Page(title, answer, (), origin, sections=sections)
    whole = diagnosis.page(pair.of_arm, origin)
    return replace(whole, title=title, verdict=answer, sections=(*sections, *whole.sections))


def tables(pair: PairDiagnosis) -> list[Table | None]:
    """Where torque and motion differ, faults, effects."""
    record = pair.record
    return [
        None
        if record.torque is None
        else _where(record.torque, "where: torque of the arm less the simulator's [N m; N]"),
        _where(record.position, "where: motion of the arm less the simulator's [rad; m]"),
        table_of(
            "set-up, in the order in which to mend it", record.faults, "fault where meaning remedy"
        ),
        table_of(
            "effects: simulator -> arm",
            record.which or (),
            "name at more only numbers share how_sure ambiguous_with",
        ),
        table_of(
            "in both logs, and not in the robot's file", record.both, "name at numbers how_sure"
        ),
        table_of(
            "servos, from commands and positions [95 %]",
            record.servos or (),
            "joint number simulator arm differs",
        ),
    ]


def _where(where: WherePair, title: str) -> Table:
    """Joints, and the regimes that hold more than their share."""
    said = []
    for one in where.joints:
        clear = [r for r in where.regimes if r.joint == one.joint and r.p < CLEAR and r.excess > 0]
        clear.sort(key=lambda r: -r.excess)
        said.append(", ".join(map(excess_words, clear[:_MOST_REGIMES])) or "-")
    regimes = f"holds more than its share (excess [95 %], p < {CLEAR:g})"
    return table_of(title, where.joints, beside={regimes: said})
