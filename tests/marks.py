"""Marks of parametrised tests."""

from collections.abc import Iterable
from typing import Any

import pytest

_MARKS = (None, pytest.mark.slow, pytest.mark.nightly)


def some(values: Iterable[Any], slow: int, quick: int = 0, *, several: bool = False) -> list[Any]:
    """Parameters of a test: the first values are quick, the next ones slow, all others nightly.

    Args:
        values: one a test.
        slow, quick: how many of them.
        several: whether a value is a tuple of several arguments.
    """
    params = []
    for k, value in enumerate(values):
        mark = _MARKS[(k >= quick) + (k >= quick + slow)]
        given = value if several else (value,)
        params.append(pytest.param(*given, marks=mark) if mark else value)
    return params


def quick_first(values: Iterable[Any], quick: int, *, several: bool = False) -> list[Any]:
    """Parameters of a test: the first values are quick, all others slow; see `some`."""
    values = list(values)
    return some(values, len(values), quick, several=several)
