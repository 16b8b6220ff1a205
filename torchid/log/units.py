"""Units that a log's columns may be in, and how much of ours one of them is."""

import math
import re

_ANGLES = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "rev": 2 * math.pi}
_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6}
_POSITIONS = _ANGLES | _LENGTHS

UNITS: dict[str, dict[str, float]] = {
    "t": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "q": _POSITIONS,
    "dq": {f"{u}/s": k for u, k in _POSITIONS.items()} | {"rpm": 2 * math.pi / 60},
    "ddq": {f"{u}/s^2": k for u, k in _POSITIONS.items()},
    "tau": {"Nm": 1.0, "mNm": 1e-3, "Ncm": 1e-2, "kNm": 1e3, "N": 1.0, "mN": 1e-3, "kN": 1e3},
    "i": {"A": 1.0, "mA": 1e-3},
    "ql": _POSITIONS,
    "u": _POSITIONS,
    "traj": {},
}
"""Of each kind of column, the first unit is ours (a prismatic joint's are m and N)."""
UNITS["ext"] = UNITS["tau"]

STEPS = {0.15: "", 150.0: "ms", 150e3: "us", 150e6: "ns"}
"""Largest usual step of stamps in each unit: between 10 kHz and 7 Hz, they do not overlap."""

_ALIASES = {
    "sec": "s",
    "µs": "us",
    "μs": "us",
    "µm": "um",
    "°": "deg",
    "turn": "rev",
    "degrees": "deg",
    "Grad": "deg",  # German; nobody logs the 400 gradians of a turn
    "radians": "rad",
}


def unit_factor(kind: str, unit: str) -> float | None:
    """How much of our unit one of `unit` is; None for a unit this kind of column cannot have.

    Args:
        kind: a key of `UNITS`, with the number of a joint or without.
        unit: as people write it: `deg/s`, `N m`, `mN.m`, `rad/s2`, `µs`.
    """
    plain = re.sub(r"[\s.·()\[\]]", "", unit).replace("²", "2")
    for alias, name in _ALIASES.items():
        plain = re.sub(rf"^{alias}(?=$|/)", name, plain)
    plain = re.sub(r"/s(ec)?2$", "/s^2", re.sub(r"/sec$", "/s", plain))
    plain = re.sub(r"^(1|U|tr|rev|r)/min$", "rpm", plain)
    return UNITS[kind.rstrip("0123456789")].get(plain)
