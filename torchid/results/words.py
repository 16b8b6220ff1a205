"""Numbers, names and lists as every sentence and table has them."""

import math
from collections.abc import Iterable, Mapping

BRANCHES = {
    "friction": "friction",
    "inertia": "inertia or load",
    "transmission": "transmission",
    "sensing": "sensing or actuation",
    "surroundings": "surroundings",
}
"""Branches of the tree of causes (`torchid.effects.base.Branch`)."""

LINK, PAYLOAD = "link_inertia", "payload"
"""Names of causes that are bodies, of which sentences say less or in another way."""

_PROPER = {"coulomb": "Coulomb", "stribeck": "Stribeck"}


def effect_words(name: str) -> str:
    """`coulomb_friction` as `Coulomb friction`; `encoder_offset 3` and `link_inertia 3` as `encoder
    offset on joint 3` and `inertia of link 3`."""
    effect, _, number = name.partition(" ")
    if number and effect == LINK:
        return f"inertia of link {number}"
    words = " ".join(_PROPER.get(word, word) for word in effect.split("_"))
    return f"{words} on joint {number}" if number else words


def regime_words(name: str) -> str:
    """`at_limit` as `at limit`."""
    return name.replace("_", " ")


def joints_words(joints: Iterable[int]) -> str:
    """`joint 2`, `joints 2, 3 and 5`, or `the arm` for none.

    Args:
        joints: from 0.
    """
    numbers = [str(j + 1) for j in joints]
    if not numbers:
        return "the arm"
    return f"joint{'s' if len(numbers) > 1 else ''} {listed(numbers)}"


def number_list(joints: Iterable[int], nothing: str = "") -> str:
    """`2, 3`, of joints from 0."""
    return ", ".join(str(j + 1) for j in joints) or nothing


def joints_or_arm(joints: Iterable[int]) -> str:
    """`2, 3`, or that it is the whole arm's."""
    return number_list(joints, "the arm")


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


def digits(value: float, most: int = 3) -> str:
    """A number of so many digits at most, without an exponent where that can be read: `2870`."""
    return f"{float(f'{value:.{most}g}'):zg}"


def unit_words(unit: str) -> str:
    """`kg m^2` as `kg m²`; `N m, N` of joints of both kinds as `N m and N`."""
    both = unit.replace("N m, N", "N m and N")
    return both.replace("^2", "²").replace("^3", "³")


def unit_behind(unit: str) -> str:
    """A unit behind a number, none of a plain number (`1`)."""
    return "" if unit == "1" else unit_words(unit)


def span(ends: Iterable[float], most: int = 3, to: str = " to ") -> str:
    """`0.1 to 0.2`; one number where both read the same; `>= 0.1` where the upper end is NaN."""
    low, high = ends
    if high != high:
        return f">= {digits(low, most)}" if low == low else "unknown"
    return to.join(dict.fromkeys(digits(x, most) for x in (low, high)))


def within(value: float, ends: tuple[float, float], unit: str) -> str:
    """`39 [35.1, 42.9] rad/s²`; the value alone where there is no interval."""
    low, high = ends
    both = "" if math.isnan(low) else f" [{digits(low)}, {digits(high)}]"
    return f"{digits(value)}{both} {unit_behind(unit)}".rstrip()


def percent(value: float) -> str:
    """A fraction in percent; with a decimal where it would be taken for none or all."""
    if not math.isfinite(value):
        return "-"
    if 1 - 5e-4 < value < 1:
        return "> 99.9 %"
    near = min(abs(value), abs(1 - value))
    return f"{100 * value:.1f} %" if 5e-4 <= near < 5e-3 else f"{100 * value:z.0f} %"


def sure(value: float | None) -> str:
    """A probability: `> 99 %`, or a dash where there is none."""
    if value is None or math.isnan(value):
        return "-"
    return "> 99 %" if value > 0.99 else f"{100 * value:.0f} %"


def interval(ends: tuple[float, float]) -> str:
    """An interval of fractions, in percent: `[90, 95]`."""
    low, high = (percent(x).removesuffix(" %") for x in ends)
    return f"[{low}, {high}]"


def short(name: str, length: int) -> str:
    """A name cut to `length` characters."""
    return name if len(name) <= length else name[: length - 1] + "…"


def joint_labels(names: Iterable[str]) -> list[str]:
    """Joints by number, and by name where that says more: `2 shoulder_lift`."""
    plain = ("", "joint_{}", "joint {}", "joint{}")
    return [
        f"{k}" if name in [p.format(k) for p in plain] else f"{k} {name.removesuffix('_joint')}"
        for k, name in enumerate(names, start=1)
    ]


def count(k: int, what: str, many: str = "") -> str:
    """1 set, 2 sets."""
    return f"{k} {what if k == 1 else many or what + 's'}"


def listed(
    words: Iterable[str], last: str = "and", nothing: str = "", most: int | None = None
) -> str:
    """`a, b and c`, or `a, b and 3 more` where there are more than `most`."""
    every = list(words) or [nothing]
    more = 0 if most is None else len(every) - most
    *first, end = [*every[:most], f"{more} more"] if more > 0 else every
    return f"{', '.join(first)} {last} {end}" if first else end


def value_words(value: object, digits: str = ".6g") -> str:
    """A setting, or an entry of a result, as people write it."""
    if isinstance(value, Mapping):
        every = (f"{str(k).replace('_', ' ')} {value_words(v, digits)}" for k, v in value.items())
        return ", ".join(every) or "none"
    if isinstance(value, list | tuple):
        return ", ".join(value_words(v, digits) for v in value) or "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:{digits}}"
    return "none" if value is None else str(value)
