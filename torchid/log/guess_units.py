"""Units of a proposed mapping whose columns' names say none, from the ranges of their numbers."""

import math
from collections.abc import Collection, Sequence

import numpy as np

from torchid.errors import LogError
from torchid.log.mapping import ColumnMapping, Source
from torchid.log.sources import Piece, resolve, signal_of, time_of
from torchid.log.table import Table

STEPS = {0.15: "", 150.0: "ms", 150e3: "us", 150e6: "ns"}
"""Largest usual step of stamps in each unit: between 10 kHz and 7 Hz, they do not overlap."""
_TURNS = 4 * math.pi
"""Angles beyond two turns are more likely degrees."""
_COUNTS = 1000.0
"""Angles beyond this are neither."""
_MILLI = (4e3, 1e6)
"""Torques that most joints reach in mN m and, but for the largest robots, none does in N m; parts
in a thousand of a rated torque, as drives send them, are less."""


def guessed_units(mapping: ColumnMapping, table: Table, keys: Collection[str]) -> dict[str, str]:
    """Units of t, q, dq, tau and u by key, where the numbers are unlikely to be in ours.

    Args:
        mapping: of the table.
        keys: whose columns' names say no unit; of no others it is guessed.
    """
    try:
        return _guessed(mapping, table, keys)
    except LogError:  # what cannot be read has its own error when it is read in earnest
        return {}


def _guessed(mapping: ColumnMapping, table: Table, keys: Collection[str]) -> dict[str, str]:
    silent = {
        key: source
        for key, source in mapping.sources.items()
        if source is not None and key in keys and key in ("t", "q", "dq", "tau", "u")
    }
    pieces = {key: resolve(key, source, table) for key, source in silent.items()}
    arrays = table.read([piece.name for group in pieces.values() for piece in group])
    found: dict[str, str] = {}
    step = 1.0
    if "t" in silent:
        steps = np.diff(time_of(silent["t"], pieces["t"], arrays, table))
        if not len(steps):
            return {}
        step = float(np.median(steps))
        found["t"] = next((unit for most, unit in STEPS.items() if abs(step) < most), "")
        step *= {"": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[found["t"]]

    def values(key: str, source: Source, parts: Sequence[Piece]) -> np.ndarray:
        rows = max(max(arrays[piece.name].shape) for piece in parts)
        return signal_of(key, source, parts, arrays, rows, table)

    if "q" in silent:
        q = values("q", silent["q"], pieces["q"])
        if _TURNS < np.abs(q).max(initial=0.0) < _COUNTS:
            found["q"] = "deg"
            if "dq" in silent and _follows(q, values("dq", silent["dq"], pieces["dq"]), step):
                found["dq"] = "deg/s"
    if "u" in silent:
        u = np.nan_to_num(values("u", silent["u"], pieces["u"]))
        if _TURNS < np.abs(u).max(initial=0.0) < _COUNTS:
            found["u"] = "deg"
    if "tau" in silent:
        tau = values("tau", silent["tau"], pieces["tau"])
        size = np.where(np.isfinite(tau), np.abs(tau), 0.0)
        if len(tau) and _MILLI[0] < np.median(np.quantile(size, 0.99, axis=0)) < _MILLI[1]:
            found["tau"] = "mNm"
    return {key: unit for key, unit in found.items() if unit}


def _follows(q: np.ndarray, dq: np.ndarray, step: float) -> bool:
    """Whether dq is the derivative of q in the same angles, rather than in radians."""
    if not 0 < step < math.inf or dq.shape != q.shape or len(q) < 2:
        return False
    own = float(np.abs(np.diff(q, axis=0)).mean()) / step
    return float(np.abs(dq).mean()) > own * math.sqrt(math.pi / 180)
