"""Numbers as text that reads back as the same float64."""

from torch import Tensor


def number(value: float | Tensor) -> str:
    """One number, with the digits that give the same float64; no minus before a zero."""
    return repr(float(value) + 0.0)
