"""Numbers and names from outside, as tables, pictures and pages show them."""

import math
import unicodedata


def printable(text: str) -> str:
    """A text without what XML and UTF-8 cannot hold: control characters, and bytes of a file's
    name that are no text."""
    return "".join(
        c if c in "\n\t" or unicodedata.category(c) not in ("Cc", "Cs", "Cn") else "\ufffd"
        for c in text
    )


def percent(value: float) -> str:
    """A fraction in percent; with a decimal where it would be taken for none or all."""
    if not math.isfinite(value):
        return "-"
    near = min(abs(value), abs(1 - value))
    return f"{100 * value:.1f} %" if 5e-4 <= near < 5e-3 else f"{100 * value:.0f} %"


def interval(ends: tuple[float, float]) -> str:
    """Of fractions, in percent: `[90, 95]`."""
    low, high = (percent(x).removesuffix(" %") for x in ends)
    return f"[{low}, {high}]"
