"""A diagnosis in words."""

import math
from collections.abc import Iterable, Sequence

from torchid.gap.diagnosis import Diagnosis, Finding, unit_of
from torchid.gap.record import KnownCoefficient, Parametric, RegimeGap, SmallEffect
from torchid.report.table import count, interval, listed, percent, torque_unit
from torchid.robot.model import Robot

REGIMES = {
    "velocity_reversal": "at velocity reversals",
    "low_speed": "at low speed",
    "high_speed": "at high speed",
    "high_acceleration": "at high acceleration",
    "gravity_load": "under gravity load",
    "position_periodic": "periodic in position",
    "high_frequency": "at high frequency",
    "slow_drift": "drifting slowly",
    "transient": "in transients",
}

CLEAR = 0.05
"""p below which a regime is said to hold more than its share."""

_PROPER = {"coulomb": "Coulomb", "stribeck": "Stribeck"}
_COUNTED = (
    "offset", "delay", "lag", "tilt", "error", "spring", "payload", "gain", "contact", "drift",
)  # fmt: skip
_MOST_NAMED = 3


def effect_words(name: str) -> str:
    """`coulomb_friction` as `Coulomb friction`."""
    return " ".join(_PROPER.get(word, word) for word in name.split("_"))


def regime_words(name: str) -> str:
    """`low_speed` as `low speed`."""
    return name.replace("_", " ")


def excess_words(one: RegimeGap) -> str:
    """`low speed 40 % [35, 45]`."""
    return f"{regime_words(one.regime)} {percent(one.excess)} {interval(one.ci95)}"


def clear_regimes(diagnosis: Diagnosis, joint: int) -> list[RegimeGap]:
    """What holds more than its share of a joint's gap beyond chance, the most first; nothing on a
    joint whose gap is below all noise."""
    gap = next(g for g in diagnosis.joints if g.joint == joint)
    if gap.gap_rms <= gap.noise_floor_rms[0]:
        return []
    # Against chance, and in other samples of the log's blocks as well.
    found = [r for r in diagnosis.regimes if r.joint == joint and r.p < CLEAR and r.ci95[0] > 0]
    return sorted(found, key=lambda r: -r.excess)


def joints_words(joints: Iterable[int]) -> str:
    """`joint 2`, `joints 2, 3 and 5`, or `the arm` for none."""
    numbers = [str(j + 1) for j in joints]
    if not numbers:
        return "the arm"
    return f"joint{'s' if len(numbers) > 1 else ''} {listed(numbers)}"


def measure(value: float, std: float | None, unit: str) -> str:
    """`0.61 ± 0.02 N m`: as many decimals as the standard deviation has one or two digits for."""
    if std is None or not math.isfinite(std) or std <= 0 or not math.isfinite(value):
        return f"{value:.4g} {unit}".rstrip()
    exponent = math.floor(math.log10(std))
    decimals = (1 if std / 10**exponent < 1.95 else 0) - exponent
    if -6 <= decimals < 0:
        return f"{round(value, decimals):.0f} ± {round(std, decimals):.0f} {unit}".rstrip()
    if abs(decimals) > 6:
        return f"{value:.4g} ± {std:.1g} {unit}".rstrip()
    return f"{value:.{decimals}f} ± {std:.{decimals}f} {unit}".rstrip()


def _shown(unit: str, joints: Iterable[int], robot: Robot) -> str:
    """A unit as people write it: none for plain numbers."""
    text = unit_of(unit, joints, robot)
    return "" if text == "1" else text


def coefficients(finding: Finding, robot: Robot) -> list[str]:
    """Every coefficient as `Fc = 0.61 ± 0.02 N m`."""
    located = finding.located or finding.joints
    spread = [*finding.std, *[None] * len(finding.values)]
    return [
        f"{c.name} = {measure(value, std, _shown(c.unit, located, robot))}"
        for c, value, std in zip(finding.effect.coefficients, finding.values, spread, strict=False)
    ]


def change_words(one: KnownCoefficient) -> str:
    """`9.1 ± 0.3 N m s/rad, was 4.0 ± 0.3`."""
    unit = "" if one.unit == "1" else one.unit
    before = measure(one.before, one.before_std, "")
    return f"{measure(one.after, one.after_std, unit)}, was {before}"


def corrects(finding: Finding, robot: Robot) -> bool:
    """Whether the model has this effect at this place already, so that values are changes of it."""
    joints = [j + 1 for j in finding.located]
    return any(
        r.get("effect") == finding.effect.name and (not joints or r.get("joint") in joints)
        for r in robot.effects
    )


def shapes(finding: Finding, robot: Robot) -> list[str]:
    """Every shape parameter as `vs = 0.1 rad/s`."""
    located = finding.located or finding.joints
    pairs = zip(finding.effect.shapes, finding.effect.shape_values, strict=True)
    return [f"{s.name} = {v:.4g} {_shown(s.unit, located, robot)}".rstrip() for s, v in pairs]


NONE_LEFT = 5e-3
"""Share of the gap that is unexplained, below which no share is told."""
UNCHANGED = 0.99
"""Share of a gap's RMS that is left, from which the gap is as it was."""


def verdict(diagnosis: Diagnosis) -> str:
    """The answer in plain words."""
    d, far = diagnosis, diagnosis.how_far
    unit = torque_unit(d.robot)
    before, after = (f"{float(x.norm()):.3g} {unit}" for x in (far.rms_before, far.rms_after))
    noise = f"{float(d.floor.low.norm()):.3g} to {float(d.floor.high.norm()):.3g}"
    shrinks = f"the gap goes from {before} to {after} RMS"
    if far.closed is not None and far.closed_ci95 is not None:
        shrinks = (
            f"{shrinks}, which may be chance"
            if far.closed_ci95[0] <= 0
            else f"the gap shrinks by {percent(far.closed)} {interval(far.closed_ci95)}"
        )
    if d.status == "no_gap":
        return (
            f"No gap: measured torque and the model of {d.robot.name} differ by no more than noise "
            f"({before} RMS over all joints; noise {noise}).{_unseen(d)}"
        )
    if d.status == "negligible":
        return (
            f"No gap worth a name: {before} RMS over all joints (noise {noise}); what is there is "
            f"small: {listed([small_words(e) for e in d.small[:_MOST_NAMED]])}."
        )
    hiding = [j for j in d.knowledge.joints if j.hides] if d.knowledge is not None else []
    if d.status == "not_testable" and hiding:
        sizes = ", ".join(f"joint {j.joint + 1} {j.added_rms:.3g} {unit}" for j in hiding)
        said = (
            f"No cause can be told from what the model left open of itself ({sizes} RMS), which "
            "this log now determines; a cause of that size may be hidden there"
        )
    elif d.status == "not_testable":
        why = d.not_testable[0].reason if d.not_testable else "they hold too little motion"
        said = f"These data cannot show what causes a gap: {why.rstrip('.')}"
    elif d.status == "parametric_only":
        said = (
            f"{_inertia(d.parametric)}, and no other effect is needed; with corrected ones "
            f"{shrinks}"
        )
    elif d.status == "explained":
        said = _known_causes(d, shrinks)
    elif not d.findings and not d.parametric:
        said = (
            f"There is a gap ({before} RMS over all joints; noise {noise}) that no effect of the "
            f"library explains; it lies {_mostly(d)}"
        )
    elif _unconfirmed(d):
        said = (
            f"there is a gap, and the data fitted say {_causes(d)}; but on data that took no part "
            f"{shrinks}, so nothing is confirmed"
        )
    elif d.budget.unexplained < NONE_LEFT:
        # The arm as a whole is within its noise; some joints are not.
        joints = (far.rms_after > d.floor.high).nonzero().flatten().tolist()
        place = f" on {joints_words(joints)}" if joints else ""
        said = (
            f"{_known_causes(d, shrinks)}; what is left{place} is more than noise, and it is no "
            "effect of the library"
        )
    else:
        said = (
            f"Part of the gap is unexplained ({percent(d.budget.unexplained)} of it); what is "
            f"known: {_known_causes(d, shrinks)}; what is left is no effect of the library"
        )
    return said[0].upper() + said[1:] + "."


def small_words(one: SmallEffect) -> str:
    """`viscous friction of joint 2 (0.03 N m)`."""
    place = f" of {joints_words(one.joints)}" if one.joints else ""
    return f"{effect_words(one.effect)}{place} ({one.closes_rms:.2g} RMS)"


def with_article(name: str) -> str:
    """`a torque offset`, `Coulomb friction`."""
    words = effect_words(name)
    if not words.endswith(_COUNTED):
        return words
    return f"an {words}" if words[0] in "aeiou" else f"a {words}"


def _inner(findings: Sequence[Finding], robot: Robot) -> str:
    """Values, and what they cannot be told from, in brackets."""
    texts = []
    for f in findings:
        values = coefficients(f, robot)
        if f.changed:
            texts += [change_words(c) for c in f.changed]
        elif len(values) == 1:
            texts.append(values[0].split(" = ")[1])
        elif 1 < len(values) <= _MOST_NAMED:
            texts.append(", ".join(values))
    parts = [", ".join(texts)] if texts and len(texts) <= _MOST_NAMED else []
    others = list(dict.fromkeys(effect_words(x) for f in findings for x in f.ambiguous_with))
    if others:
        parts.append(f"or {listed(others, 'or')}: these data cannot tell")
    return f" ({'; '.join(parts)})" if parts else ""


def _unseen(d: Diagnosis) -> str:
    """What `no gap` does not say."""
    if not d.not_testable:
        return ""
    joints = sorted({joint for x in d.not_testable for joint in x.joints})
    place = f", on {joints_words(joints)}" if joints else ""
    effects = count(len(d.not_testable), "effect")
    return f" {effects} could not have been seen in these data{place}."


def _unconfirmed(d: Diagnosis) -> bool:
    """Whether the causes that are named leave the held-out gap as it was."""
    far = d.how_far
    doubtful = far.closed_ci95 is None or far.closed_ci95[0] <= 0
    return doubtful and float(far.rms_after.norm()) > UNCHANGED * float(far.rms_before.norm())


def _known_causes(d: Diagnosis, shrinks: str) -> str:
    them = "it" if len(d.findings) + len(d.parametric) == 1 else "them"
    return f"{_causes(d)}; with {them} {shrinks}"


def _causes(d: Diagnosis) -> str:
    """All causes, one effect on several joints together, the largest first."""
    inertia = [_inertia(d.parametric)] if d.parametric else []
    if len(d.findings) == 1:
        f = d.findings[0]
        place, inner = joints_words(f.located), _inner([f], d.robot)
        if f.changed:
            return listed(
                [f"{effect_words(f.effect.name)} of {place} has changed{inner}", *inertia]
            )
        return listed(
            [
                f"the model's {effect_words(f.effect.name)} of {place} is off{inner}"
                if corrects(f, d.robot)
                else f"{place} has {with_article(f.effect.name)} that the model lacks{inner}",
                *inertia,
            ]
        )
    # Each name once, new ones apart from those that have changed.
    by_share = sorted(d.findings, key=lambda f: -f.share)
    groups = list(dict.fromkeys((f.effect.name, bool(f.changed)) for f in by_share))
    new, moved = list[str](), list[str]()
    for name, changed in groups[:_MOST_NAMED]:
        same = [f for f in d.findings if (f.effect.name, bool(f.changed)) == (name, changed)]
        same.sort(key=lambda f: f.located)
        joints = [j for f in same for j in f.located]
        every = len(set(joints)) == d.robot.n > 1 and len(same) > 1
        place = " on all joints" if every else f" on {joints_words(joints)}" if joints else ""
        text = f"{effect_words(name) if changed else with_article(name)}{place}"
        (moved if changed else new).append(text + _inner(same, d.robot))
    more = len(groups) - _MOST_NAMED
    if more > 0:
        new.append(count(more, "smaller effect"))
    said = [f"the model lacks {listed(new)}"] if new else []
    if moved:
        said.append(f"{listed(moved)} {'has' if len(moved) == 1 else 'have'} changed")
    return ", and ".join([*said, *inertia]) or "nothing"


def _inertia(changed: Sequence[Parametric]) -> str:
    links = sorted({link for p in changed for link in p.links})
    if any(not p.links for p in changed) or not links:
        return "the model's inertial parameters are wrong on the whole"
    numbers = listed([str(link + 1) for link in links])
    return f"the inertial parameters of link{'s' if len(links) > 1 else ''} {numbers} are wrong"


def _mostly(d: Diagnosis) -> str:
    """Where most of the gap is."""
    worst = max(d.joints, key=lambda gap: gap.share, default=None)
    if worst is None:
        return "nowhere in particular"
    clear = clear_regimes(d, worst.joint)
    text = f"on joint {worst.joint + 1} ({percent(worst.share)} of it)"
    if clear:
        text += f", {REGIMES[clear[0].regime]}"
    return text
