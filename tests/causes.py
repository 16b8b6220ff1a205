"""Causes by hand."""

from typing import Any

from torchid.results.cause import Error, Size


def numbers(*sizes: Size) -> dict[str, Any]:
    """Fields of a cause with these numbers, the first the main one."""
    return {
        "parameters": {s.name: s.value for s in sizes},
        "std": {s.name: s.std for s in sizes},
        "unit": {s.name: s.unit for s in sizes},
        "file": {s.name: s.was for s in sizes if s.was is not None},
        "main": sizes[0].name,
    }


def errors(before: float, after: float, unit: str = "N m", **judged: Any) -> dict[str, Error]:
    """Fields of an answer: errors of motions left out in turn, if nothing else is said."""
    judged = {"how": "left out in turn"} | judged
    return {
        "before": Error(value=before, unit=unit, **judged),
        "after": Error(value=after, unit=unit, **judged),
    }
