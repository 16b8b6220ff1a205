"""Cautions for a reader: few, and of those that say the same of several logs or joints one."""

import re
from collections.abc import Iterable, Sequence

from torchid.report.table import Section
from torchid.results.answer import KINDS
from torchid.results.words import listed

MOST = 10
"""Cautions on a page."""
_NUMBER = re.compile(r"\d+(?:\.\d+)?")
_NAMED = re.compile(r"^(?P<name>(?:joint \d+|[\w.\-/ ]{1,60}?)): (?P<rest>.+)$", re.S)
_FEW = 3  # names that are all said


def cautions(warnings: Iterable[str], most: int = MOST) -> list[str]:
    """Warnings once each, those alike but for a name at their beginning and numbers as one, the
    first of each kind at its place.

    >>> cautions(["run1: steps of 9 ms", "run2: steps of 10 ms", "Caution: x"])
    ['run1 and run2: steps of 9 to 10 ms', 'Caution: x']
    """
    groups: dict[str, list[tuple[str, str]]] = {}
    for warning in dict.fromkeys(warnings):
        match = _NAMED.match(warning)
        kind = match is not None and match["name"].startswith(KINDS)
        name, rest = ("", warning) if match is None or kind else (match["name"], match["rest"])
        groups.setdefault((":" if name else "") + _NUMBER.sub("#", rest), []).append((name, rest))
    out = [_merged(same) for same in groups.values()]
    if len(out) <= most:
        return out
    rest = len(out) - most + 1
    return [*out[: most - 1], f"{rest} more are in the JSON (`warnings`)."]


def caution_section(warnings: Iterable[str]) -> Section:
    """The section of cautions; empty without warnings."""
    merged = cautions(warnings)
    return Section(f"Cautions ({len(merged)})", [merged] if merged else [])


def number_ranges(alike: Sequence[str], number: re.Pattern[str]) -> str:
    """One text of some that differ in their numbers alone: each from the least to the greatest."""
    spans = []
    for values in zip(*map(number.findall, alike), strict=True):
        low, high = min(values, key=float), max(values, key=float)
        spans.append(low if low == high else f"{low} to {high}")
    each = iter(spans)
    return number.sub(lambda _: next(each), alike[0])


def _merged(same: list[tuple[str, str]]) -> str:
    """One sentence of those alike."""
    text = number_ranges([rest for _, rest in same], _NUMBER)
    names = list(dict.fromkeys(name for name, _ in same if name))
    if not names:
        return text
    joints = [name.removeprefix("joint ") for name in names]
    if len(names) > 1 and all(name.startswith("joint ") for name in names):
        who = f"joints {listed(joints)}"
    elif len(names) > _FEW:
        who = f"{len(names)} logs ({listed(names, most=2)})"
    else:
        who = listed(names)
    return f"{who}: {text}"
