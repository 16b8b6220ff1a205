"""The same diagnosis, told what is there and where: how far the gap could be closed at most.

It needs the keys, so it belongs to scoring. Folds, shapes and coefficients are found as ever; only
the candidates are those that were planted, on their joints, and are accepted at any level.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from torchid.effects.registry import KINDS
from torchid.gap.settings import GapSettings

LEVEL = 0.5
"""At which the oracle accepts what it is told."""

LINK = "link_inertia"


def told(key: Mapping[str, Any], settings: GapSettings) -> GapSettings | None:
    """Settings of the diagnosis that is told the key; None where the library lacks a cause, or
    there is none."""
    planted = key["effects"]
    if not planted or any(effect["name"] not in KINDS for effect in planted):
        return None
    names = tuple(dict.fromkeys(effect["name"] for effect in planted))
    only = [(e["name"], joint) for e in planted for joint in _places(e)]
    return replace(
        settings,
        effects=names,
        parameters="auto" if LINK in names else "trusted",
        alpha=LEVEL,
        max_effects=len(planted),
        only=tuple(only),
    )


def _places(effect: Mapping[str, Any]) -> list[int | None]:
    """Joints from 0; None for the whole arm."""
    return [int(j) - 1 for j in effect["joints"]] or [None]


def closed_by(answers: Mapping[str, Mapping[str, Any]]) -> dict[str, float | None]:
    """Closed shares, by case."""
    out = {}
    for case, answer in answers.items():
        value = (answer.get("how_far") or {}).get("closed")
        out[case] = None if value is None else float(value)
    return out
