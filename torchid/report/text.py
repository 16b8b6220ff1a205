"""Numbers and names as tables, pictures and pages show them."""

import math
import unicodedata
from collections.abc import Iterable

from torchid.robot.model import JointType, Robot


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


def short(name: str, length: int) -> str:
    """A name cut to `length` characters."""
    return name if len(name) <= length else name[: length - 1] + "…"


def listed(words: Iterable[str], last: str = "and", nothing: str = "") -> str:
    """`a, b and c`."""
    *first, end = list(words) or [nothing]
    return f"{', '.join(first)} {last} {end}" if first else end


def joint_unit(robot: Robot, joint: int) -> str:
    """Unit of the torque of a joint (from 0)."""
    return "N" if robot.joint_types[joint] is JointType.PRISMATIC else "N m"


def torque_unit(robot: Robot, both: str = "N m, N") -> str:
    """Unit of the torques of all joints together; `both` where the joints differ."""
    units = {joint_unit(robot, j) for j in range(robot.n)}
    return units.pop() if len(units) == 1 else both
