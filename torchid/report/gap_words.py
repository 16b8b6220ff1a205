"""A diagnosis in words."""

import math
from collections.abc import Iterable, Sequence

from torchid.gap.diagnosis import Diagnosis, Finding, Parametric
from torchid.gap.record import unit_of
from torchid.report.text import interval, percent
from torchid.robot.model import JointType, Robot

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


def listed(words: Sequence[str], last: str = "and") -> str:
    """`a, b and c`."""
    if len(words) < 2:
        return "".join(words)
    return f"{', '.join(words[:-1])} {last} {words[-1]}"


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
    if decimals < 0 or decimals > 6:
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


def shapes(finding: Finding, robot: Robot) -> list[str]:
    """Every shape parameter as `vs = 0.1 rad/s`."""
    located = finding.located or finding.joints
    pairs = zip(finding.effect.shapes, finding.effect.shape_values, strict=True)
    return [f"{s.name} = {v:.4g} {_shown(s.unit, located, robot)}".rstrip() for s, v in pairs]


def torque_unit(robot: Robot) -> str:
    """Of all joints together."""
    kinds = set(robot.joint_types)
    if kinds == {JointType.PRISMATIC}:
        return "N"
    return "N m" if kinds == {JointType.REVOLUTE} else "N m, N"


NONE_LEFT = 5e-3
"""Share of the gap that is unexplained, below which no share is told."""
UNCHANGED = 0.99
"""Share of a gap's RMS that is left, from which the gap is as it was."""


def verdict(diagnosis: Diagnosis) -> str:
    """The answer in plain words."""
    said = {
        "no_gap": _no_gap,
        "parametric_only": _parametric_only,
        "explained": _explained,
        "detected_unexplained": _unexplained,
        "not_testable": _not_testable,
    }[diagnosis.status]
    return said(diagnosis)


def finding_words(finding: Finding, robot: Robot) -> str:
    """`joint 2 has Coulomb friction that the model lacks (0.61 ± 0.02 N m)`."""
    place, name = joints_words(finding.located), with_article(finding.effect.name)
    inner = _inner([finding], robot)
    if _known(finding, robot):
        return f"the model's {effect_words(finding.effect.name)} of {place} is off{inner}"
    return f"{place} has {name} that the model lacks{inner}"


def group_words(findings: Sequence[Finding], robot: Robot) -> str:
    """One effect on several joints: `Coulomb friction on joints 1 and 2 (0.61 ± 0.02 N m, ...)`."""
    joints = [j for f in findings for j in f.located]
    name = with_article(findings[0].effect.name)
    place = f" on {joints_words(joints)}" if joints else ""
    return f"{name}{place}{_inner(findings, robot)}"


def with_article(name: str) -> str:
    """`a torque offset`, `Coulomb friction`."""
    words = effect_words(name)
    if not words.endswith(_COUNTED):
        return words
    return f"an {words}" if words[0] in "aeiou" else f"a {words}"


def _inner(findings: Sequence[Finding], robot: Robot) -> str:
    """Values, and what they cannot be told from, in brackets."""
    texts = [text for f in findings if (text := _short_values(f, robot))]
    parts = [", ".join(texts)] if texts and len(texts) <= _MOST_NAMED else []
    others = list(dict.fromkeys(effect_words(x) for f in findings for x in f.ambiguous_with))
    if others:
        parts.append(f"or {listed(others, 'or')}: these data cannot tell")
    return f" ({'; '.join(parts)})" if parts else ""


def _known(finding: Finding, robot: Robot) -> bool:
    """Whether the model has this effect at this place already."""
    places = [j + 1 for j in finding.located]
    return any(
        r.get("effect") == finding.effect.name and (not places or r.get("joint") in places)
        for r in robot.effects
    )


def _short_values(finding: Finding, robot: Robot) -> str:
    texts = coefficients(finding, robot)
    if len(texts) == 1:
        return texts[0].split(" = ")[1]
    return ", ".join(texts) if len(texts) <= _MOST_NAMED else ""


def _no_gap(d: Diagnosis) -> str:
    return (
        f"No gap: measured torque and the model of {d.robot.name} differ by no more than noise "
        f"({_rms(d, 'before')} RMS over all joints; noise {_floor(d)}).{_unseen(d)}"
    )


def _unseen(d: Diagnosis) -> str:
    """What `no gap` does not say."""
    count = len(d.not_testable)
    if not count:
        return ""
    joints = sorted({joint for x in d.not_testable for joint in x.joints})
    place = f", on {joints_words(joints)}" if joints else ""
    return (
        f" {count} effect{'s' if count > 1 else ''} could not have been seen in these data{place}."
    )


def _parametric_only(d: Diagnosis) -> str:
    return _sentence(
        f"{_inertia(d.parametric)}, and no other effect is needed; with corrected ones "
        f"{_shrinks(d)}"
    )


def _explained(d: Diagnosis) -> str:
    return _sentence(f"{_causes(d)}; with {_it(d)} {_shrinks(d)}")


def _unexplained(d: Diagnosis) -> str:
    if not d.findings and not d.parametric:
        return _sentence(
            f"There is a gap ({_rms(d, 'before')} RMS over all joints; noise {_floor(d)}) that no "
            f"effect of the library explains; it lies {_mostly(d)}"
        )
    if _unconfirmed(d):
        return _sentence(
            f"there is a gap, and the data fitted say {_causes(d)}; but on data that took no part "
            f"{_shrinks(d)}, so nothing is confirmed"
        )
    known = f"{_causes(d)}; with {_it(d)} {_shrinks(d)}"
    if d.budget.unexplained < NONE_LEFT:
        return _sentence(f"{known}; {_left_over(d)}, and it is no effect of the library")
    return _sentence(
        f"Part of the gap is unexplained ({percent(d.budget.unexplained)} of it); what is known: "
        f"{known}; what is left is no effect of the library"
    )


def _left_over(d: Diagnosis) -> str:
    """What is left where the arm as a whole is within its noise."""
    above = d.how_far.rms_after > d.floor.high
    joints = above.nonzero().flatten().tolist()
    place = f" on {joints_words(joints)}" if joints else ""
    return f"what is left{place} is more than noise"


def _unconfirmed(d: Diagnosis) -> bool:
    """Whether the causes that are named leave the held-out gap as it was."""
    far = d.how_far
    doubtful = far.closed_ci95 is None or far.closed_ci95[0] <= 0
    return doubtful and float(far.rms_after.norm()) > UNCHANGED * float(far.rms_before.norm())


def _not_testable(d: Diagnosis) -> str:
    why = d.not_testable[0].reason if d.not_testable else "they hold too little motion"
    return _sentence(f"These data cannot show what causes a gap: {why.rstrip('.')}")


def _causes(d: Diagnosis) -> str:
    """All causes, one effect on several joints together, the largest first."""
    names = list(dict.fromkeys(f.effect.name for f in sorted(d.findings, key=lambda f: -f.share)))
    by_joint = sorted(d.findings, key=lambda f: f.located)
    groups = [[f for f in by_joint if f.effect.name == name] for name in names]
    inertia = [_inertia(d.parametric)] if d.parametric else []
    if len(d.findings) == 1:
        return listed([finding_words(d.findings[0], d.robot), *inertia])
    texts = [group_words(g, d.robot) for g in groups[:_MOST_NAMED]]
    more = len(groups) - _MOST_NAMED
    if more > 0:
        texts.append(f"{more} smaller effect{'s' if more > 1 else ''}")
    lacks = [f"the model lacks {listed(texts)}"] if texts else []
    return ", and ".join([*lacks, *inertia]) or "nothing"


def _inertia(changed: Sequence[Parametric]) -> str:
    links = sorted({link for p in changed for link in p.links})
    if any(not p.links for p in changed) or not links:
        return "the model's inertial parameters are wrong on the whole"
    numbers = listed([str(link + 1) for link in links])
    return f"the inertial parameters of link{'s' if len(links) > 1 else ''} {numbers} are wrong"


def _it(d: Diagnosis) -> str:
    return "it" if len(d.findings) + len(d.parametric) == 1 else "them"


def _shrinks(d: Diagnosis) -> str:
    far = d.how_far
    if far.closed is None or far.closed_ci95 is None:
        return f"the gap goes from {_rms(d, 'before')} to {_rms(d, 'after')} RMS"
    if far.closed_ci95[0] <= 0:
        return (
            f"the gap goes from {_rms(d, 'before')} to {_rms(d, 'after')} RMS, which may be chance"
        )
    return f"the gap shrinks by {percent(far.closed)} {interval(far.closed_ci95)}"


def _mostly(d: Diagnosis) -> str:
    """Where most of the gap is."""
    worst = max(d.joints, key=lambda gap: gap.share, default=None)
    if worst is None:
        return "nowhere in particular"
    clear = [r for r in d.regimes if r.joint == worst.joint and r.p < CLEAR and r.excess > 0]
    text = f"on joint {worst.joint + 1} ({percent(worst.share)} of it)"
    if clear:
        text += f", {REGIMES[max(clear, key=lambda r: r.excess).regime]}"
    return text


def _rms(d: Diagnosis, when: str) -> str:
    rms = d.how_far.rms_before if when == "before" else d.how_far.rms_after
    return f"{float(rms.norm()):.3g} {torque_unit(d.robot)}"


def _floor(d: Diagnosis) -> str:
    return f"{float(d.floor.low.norm()):.3g} to {float(d.floor.high.norm()):.3g}"


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:] + "."
