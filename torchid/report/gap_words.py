"""Words of a diagnosis of torques."""

from torchid.gap.record import FoundEffect, GapRecord, KnownCoefficient, RegimeGap
from torchid.results.words import interval, measure, percent, regime_words, unit_behind
from torchid.robot.model import Robot

CLEAR = 0.05
"""p below which a regime is said to hold more than its share."""


def excess_words(one: RegimeGap) -> str:
    """`low speed 40 % [35, 45]`."""
    return f"{regime_words(one.regime)} {percent(one.excess)} {interval(one.ci95)}"


def clear_regimes(record: GapRecord, joint: int) -> list[RegimeGap]:
    """What holds more than its share of a joint's gap beyond chance, the most first; nothing on a
    joint whose gap is below all noise."""
    gap = next(g for g in record.where.joints if g.joint == joint)
    if gap.gap_rms <= gap.noise_floor_rms[0]:
        return []
    # Against chance, and in other samples of the log's blocks as well.
    regimes = record.where.regimes
    found = [r for r in regimes if r.joint == joint and r.p < CLEAR and r.ci95[0] > 0]
    return sorted(found, key=lambda r: -r.excess)


def coefficients(found: FoundEffect) -> list[str]:
    """Every coefficient as `Fc = 0.61 ± 0.02 N m`."""
    return [
        f"{name} = {measure(value, std, unit_behind(found.unit[name]))}"
        for name, std in found.std.items()
        if isinstance(value := found.parameters[name], int | float)
    ]


def shapes(found: FoundEffect) -> list[str]:
    """Every shape parameter as `vs = 0.1 rad/s`."""
    return [
        f"{name} = {value:.4g} {unit_behind(found.unit[name])}".rstrip()
        for name in found.shape
        if isinstance(value := found.parameters[name], int | float)
    ]


def change_words(one: KnownCoefficient) -> str:
    """`9.1 ± 0.3 N m s/rad, was 4.0 ± 0.3`."""
    before = measure(one.before, one.before_std, "")
    return f"{measure(one.after, one.after_std, unit_behind(one.unit))}, was {before}"


def corrects(found: FoundEffect, robot: Robot) -> bool:
    """Whether the model has this effect at this place already, so that values are changes of it."""
    joints = [j + 1 for j in found.located]
    return any(
        r.get("effect") == found.effect and (not joints or r.get("joint") in joints)
        for r in robot.effects
    )
