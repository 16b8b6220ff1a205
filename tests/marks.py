"""Marks of parametrised tests."""

from collections.abc import Iterable
from typing import Any

import pytest


def some(values: Iterable[Any], slow: int) -> list[Any]:
    """The values as parameters: the first of them are slow tests, all others run nightly."""
    marks = (pytest.mark.slow, pytest.mark.calibration)
    return [pytest.param(value, marks=marks[k >= slow]) for k, value in enumerate(values)]
