"""Repairs as the option `--columns`, with which every command reads the log mended."""

import math
from collections.abc import Collection, Sequence
from pathlib import Path

from torchid.doctor.repair import PLACES, DropSignal, Map, MappedColumns, Repair, ScaleTime
from torchid.log.columns import PREFIXES
from torchid.log.readers import open_log
from torchid.log.table import Request
from torchid.log.units import UNITS


def flag_for(repairs: Sequence[Repair], n: int, files: Sequence[Path]) -> str | None:
    """`columns_option` for logs that are read without it."""
    if not repairs:
        return None
    tables = [open_log(file, Request())[0] for file in files]
    own = [set() if table is None else set(table.columns) for table in tables]
    return columns_option(repairs, n, set.intersection(*own))


def columns_option(repairs: Sequence[Repair], n: int, columns: Collection[str]) -> str | None:
    """What `--columns` must be for all repairs that it can say, in order; None where there are
    none.

    Args:
        repairs: of an examination.
        n: number of joints.
        columns: that the file has; of signals that it has not in columns of our names (q1, q2, ..)
            nothing is said.
    """
    entries = [
        _entry(key, repairs, signal, n)
        for signal, key in PREFIXES.items()
        if all(f"{key}{k + 1}" in columns for k in range(n))
    ]
    factor = math.prod(r.factor for r in repairs if isinstance(r, ScaleTime))
    if factor != 1.0 and "t" in columns:
        entries.append(f"t=t{_factor('t', [factor])}")
    return ",".join(e for e in entries if e) or None


def _entry(key: str, repairs: Sequence[Repair], signal: str, n: int) -> str:
    """The entry of `--columns` that mends one signal: joint k is factor (column + offset)."""
    if any(isinstance(r, DropSignal) and r.signal == signal for r in repairs):
        return f"{key}=none"
    made = Map.of(n)
    for repair in repairs:
        if isinstance(repair, MappedColumns) and signal in repair.signals:
            made = made.then(repair.map)
    offsets = [x / f for x, f in zip(made.offsets, made.factors, strict=True)]
    ordered = made.order == tuple(range(n))
    sums = {k: _sum(key, made, k, j, c) for k, j, c in made.coupled}
    if None in sums.values() or len(sums) < len(made.coupled):
        return ""
    ordered &= not sums
    listed = [sums.get(k) or f"{key}{j + 1}" for k, j in enumerate(made.order)]
    source, change = (
        f"{key}{{j}}" if ordered else f"[{','.join(listed)}]",
        _factor(key, made.factors),
    )
    changed = change + (_offset(offsets) if signal in PLACES else "")
    return f"{key}={source}{changed}" if changed or not ordered else ""


def _sum(key: str, made: Map, k: int, j: int, c: float) -> str | None:
    """`q3-q2`: column k with that which is added to it; None where it is another multiple of it."""
    share = c * made.factors[j] / made.factors[k]
    if abs(share) != 1.0 or made.offsets[j]:
        return None
    return f"{key}{made.order[k] + 1}{'+' if share > 0 else '-'}{key}{made.order[j] + 1}"


def _offset(offsets: Sequence[float]) -> str:
    if not any(offsets):
        return ""
    # What is a whole number of counts, or of degrees, to rounding is one.
    plain = [f"{round(x, 9) + 0.0:.17g}" for x in offsets]
    if len(set(plain)) > 1:
        return " +[" + ",".join(plain) + "]"
    return f" {'' if plain[0].startswith('-') else '+'}{plain[0]}"


def _factor(key: str, factors: Sequence[float]) -> str:
    """A unit where there is one, else the numbers in full."""
    if any(f != factors[0] for f in factors):
        return " *[" + ",".join(f"{f:.17g}" for f in factors) + "]"
    if factors[0] == 1.0:
        return ""
    for unit, factor in UNITS[key].items():
        # 1e-12: rounding of a factor that is a unit's
        if abs(factors[0] / factor - 1.0) < 1e-12:
            return f" {unit}"
    return f" *{factors[0]:.17g}"
