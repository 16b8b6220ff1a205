"""Time stamps and rows: does the clock run on, evenly, in seconds, and is every row a new one?"""

from typing import Any

import numpy as np
import torch

from torchid.doctor.check import Check, judged, said
from torchid.doctor.repair import (
    Bridge,
    DropRows,
    EvenTime,
    RejoinTime,
    Repair,
    ScaleTime,
    SplitRuns,
    repaired,
)
from torchid.errors import LogError
from torchid.log.checks import FOLLOWS, SLOW_STEP_S, TIME_UNITS, near, velocity_agreement
from torchid.log.columns import PREFIXES
from torchid.log.model import Log
from torchid.log.sampling import LONG_GAP_S, LONG_GAP_STEPS, SMALL_GAP, time_steps
from torchid.statistics.robust import column_quantile
from torchid.typing import Bool, Tensor

HELD = 0.1
"""Share of the moving rows that may repeat the one before; fewer are lost in any filter."""
DROPPED = 0.01
"""Share of the samples that may be missing in gaps."""
USUAL_STEPS = 3.0
"""A step of the clock across which no joint moves further than this many usual steps is a jump of
the clock, not a gap in the log."""
SMOOTHER = 3.0
"""Stamps are taken for wrong when positions are this many times smoother over even ones."""
LONG = 2.0
"""Medians that the longest usual steps may last."""
UNEVEN = 0.1
"""Steps that spread by less than this share of the median are even."""


def check_values(log: Log) -> Check:
    """Empty, NaN or infinite values.

    Raises:
        LogError: a column has nothing else.
    """
    bad = ~torch.isfinite(log.t)
    counts = {}
    for name, signal in log.signals.items():
        wrong = ~torch.isfinite(signal)
        if not bool(wrong.any()):
            continue
        if empty := wrong.all(0).nonzero().flatten().tolist():
            columns = ", ".join(f"{PREFIXES[name]}{k + 1}" for k in empty)
            raise LogError(
                f"log '{log.source}': no row has a number in {columns}.",
                got="empty, NaN or infinite throughout, as drivers write what they do not measure",
                expected=f"measured values, or no {PREFIXES[name]} columns",
                hint=f'leave them out: `columns="{PREFIXES[name]}=none"`' if name != "q" else None,
            )
        bad |= wrong.any(1)
        counts[name] = int(wrong.sum())
    rows = bad.nonzero().flatten().tolist()
    if not rows:
        return said("values", "fine")
    found = ", ".join(f"{count} in {name}" for name, count in counts.items()) or "in t"
    counted: dict[str, Any] = {"rows": len(rows), "samples": log.samples, "found": found}
    check = said("values", "wrong", estimate=len(rows) / log.samples, **counted)
    return check.mended_by(DropRows(tuple(rows), "NaN or infinite"))


def check_clock(log: Log) -> Check:
    """Stamps that repeat, go back, or jump while the arm does not."""
    repeated, back, jumped, runs = [], [], [], []
    for rows in log.slices():
        t, q = log.t[rows].numpy(), log.q[rows].numpy()
        step = np.diff(t)
        if not (step > 0).any():
            return said("clock", "wrong never")
        median = np.median(step[step > 0])
        offset = rows.start
        # Steps back across which some joint goes further than in its usual steps: a new run.
        behind = np.flatnonzero(step < 0)
        moved, usual = _steps(q, behind)
        far = moved > USUAL_STEPS * usual + 1e-3 * np.ptp(q, 0).max()
        restarts = behind[far.any(1)]
        runs += (restarts + offset + 1).tolist()
        back += (np.setdiff1d(behind, restarts) + offset).tolist()
        repeated += (np.flatnonzero(step == 0) + offset).tolist()
        # Long steps of the clock across which the positions make a usual step only.
        long = np.flatnonzero(step > LONG_GAP_STEPS * median)
        moved, usual = _steps(q, long)
        moving = usual > 1e-3 * np.ptp(q, 0).max() / len(q)
        further = (moved > USUAL_STEPS * usual) & moving
        jumped += (long[moving.any(1) & ~further.any(1)] + offset).tolist()
    if not (repeated or back or jumped or runs):
        return judged("clock", "fine", f"{log.samples} stamps increase")
    found = [
        f"{len(kind)} {what}"
        for kind, what in (
            (repeated, "repeated stamps"),
            (back, "steps back"),
            (runs, "steps back to a new run, elsewhere"),
            (jumped, "jumps ahead while the arm does not move further than in one step"),
        )
        if kind
    ]
    first = min(repeated + back + jumped + [k - 1 for k in runs])
    split = (SplitRuns(tuple(runs)),) if runs else ()
    now = repaired(log, split)
    rest = _clock_repairs(now, repeated, back + jumped) if repeated or back or jumped else ()
    count = float(len(repeated) + len(back) + len(jumped) + len(runs))
    place = {"row": first + 1, "t": float(log.t[first])}
    check = said("clock", "wrong", estimate=count, found=", ".join(found), **place)
    return check.mended_by(*split, *rest)


def _steps(q: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Step of each joint (R, n) after these rows, and the median of the ten before and after."""
    moved = np.abs(np.diff(q, axis=0))
    around = [np.r_[max(0, k - 10) : k, k + 1 : min(len(moved), k + 11)] for k in rows]
    usual = [np.median(moved[near_by], 0) for near_by in around]
    return moved[rows], np.array(usual).reshape(-1, q.shape[1])


def _clock_repairs(log: Log, repeated: list[int], broken: list[int]) -> tuple[Repair, ...]:
    same = [k for k in repeated if bool((log.q[k + 1] == log.q[k]).all())]
    others = sorted({*broken, *repeated} - set(same))
    if len(repeated) > 0.02 * log.samples and 2 * len(same) < len(repeated):
        # Stamps coarser than the sampling: the rows are in order, and evenly taken.
        return (*((RejoinTime(tuple(broken)),) if broken else ()), EvenTime())
    repairs: list[Repair] = []
    if others:
        repairs.append(RejoinTime(tuple(others)))
    if same:
        repairs.append(DropRows(tuple(k + 1 for k in same), "the row before, once more"))
    return tuple(repairs)


def check_time_unit(log: Log) -> Check:
    """Is t in seconds? By velocities where there are any, by the size of its step otherwise."""
    step = max(s.median for s in time_steps(log))
    clear = [a for a in velocity_agreement(log) if a.correlation > FOLLOWS]
    for factor, unit in TIME_UNITS.items():
        if clear and all(near(a.ratio, factor) for a in clear):
            return _time_in(unit, factor, f"dq is {factor:g} times the derivative of q", step)
    if step <= SLOW_STEP_S or any(0.5 < a.ratio < 2.0 for a in clear):
        return judged(
            "time unit", "fine", f"seconds: median step {1e3 * step:.4g} ms", estimate=1.0
        )
    for factor, unit in TIME_UNITS.items():
        if 1e-4 <= step / factor <= SLOW_STEP_S:
            why = "dq disagrees" if clear else "no arm is sampled so slowly"
            return _time_in(unit, factor, why, step)
    return judged("time unit", "doubtful", f"a median step of {step:g} is no arm's", estimate=None)


def _time_in(unit: str, factor: float, why: str, step: float) -> Check:
    check = said("time unit", "wrong", estimate=factor, unit=unit, step=step, why=why)
    return check.mended_by(ScaleTime(1.0 / factor))


def check_dropouts(log: Log) -> Check:
    """Samples that are missing, as gaps between stamps."""
    missing, gaps, longest, total = 0.0, 0, 0.0, 0.0
    for rows in log.slices():
        step = log.t[rows].diff().numpy()
        median = float(np.median(step))
        long = step[step > SMALL_GAP * median]
        missing += float((long / median - 1).sum())
        total += float(step.sum()) / median
        gaps += len(long)
        longest = max(longest, float(step.max()))
    share = missing / total
    text = (
        f"{gaps} gap{'s' * (gaps != 1)} of more than 3 steps, "
        f"{100 * share:.2g} % of the samples missing"
    )
    if share < DROPPED and longest < LONG_GAP_S:
        return judged("dropouts", "fine", text if gaps else "no gaps", estimate=share)
    return said("dropouts", "doubtful", estimate=share, text=text, longest=1e3 * longest)


def check_held(log: Log) -> Check:
    """Rows that repeat the one before while the arm moves."""
    held = {name: _held(log, name) for name in ("q", "dq", "tau", "current") if name in log.signals}
    # Whether some joint is in motion around each step: what five samples either way cover.
    q = log.q
    wide = torch.zeros(log.samples - 1, dtype=torch.bool)
    reach = min(5, (log.samples - 1) // 2)
    span = (q[2 * reach :] - q[: -2 * reach]).abs()
    speed = span / max(1, 2 * reach)
    fast = column_quantile(speed[:: max(1, len(speed) // 100_000)], 0.9)
    active = (speed > 0.2 * fast) & (fast > 0)
    wide[reach : reach + len(active) - 1] = active.any(1)[:-1]
    same = log.trajectory.diff() == 0
    moving = wide & same
    usable = max(1, int(moving.sum()))
    shares = {name: float((mask & moving).sum()) / usable for name, mask in held.items()}
    text = ", ".join(f"{name} {100 * share:.2g} %" for name, share in shares.items())
    whole = torch.stack(list(held.values())).all(0)
    rows = (whole & moving).nonzero().flatten() + 1
    if len(rows) / usable > HELD:
        share = len(rows) / usable
        check = said("held samples", "wrong", estimate=share, percent=100 * len(rows) / usable)
        return check.mended_by(Bridge(tuple(rows.tolist())))
    late = [name for name, share in shares.items() if share > 2 * HELD]
    if late:
        most, names = max(shares.values()), " and ".join(late)
        return said("held samples", "doubtful", estimate=most, text=text, late=names)
    return said("held samples", "fine", estimate=0.0, text=text)


def _held(log: Log, name: str) -> Bool[Tensor, " steps"]:
    """Whether row k + 1 repeats row k in every joint of a signal."""
    signal = log.signals[name]
    live = (signal != signal[0]).any(0)
    if not live.any():
        return torch.zeros(log.samples - 1, dtype=torch.bool)
    return (signal.diff(dim=0)[:, live] == 0).all(1)


def check_stamps(log: Log) -> Check:
    """Are uneven stamps real? Positions are smooth over the time at which they were taken."""
    steps = time_steps(log)
    text = "; ".join(dict.fromkeys(str(s) for s in steps[:3]))
    parts, share = log.trajectories(), 0.0
    for part in parts:
        step = np.diff(part.t.numpy())
        inner = step[step < SMALL_GAP * np.median(step)]
        share = max(share, float(inner.std() / np.median(step)) if len(inner) else 0.0)
    if share < UNEVEN:
        return judged("stamps", "fine", text, estimate=share)
    worst = max(_roughness_ratio(part.t.numpy(), part.q.numpy()) for part in parts)
    if worst < SMOOTHER:
        long = max(_usual_longest(part.t.numpy()) for part in parts)
        if long < LONG:
            return judged("stamps", "fine", text, estimate=share)
        return said("stamps", "doubtful", estimate=long, long=long, text=text)
    known: dict[str, Any] = {"percent": 100 * share, "worst": worst, "text": text}
    return said("stamps", "wrong", estimate=worst, **known).mended_by(EvenTime())


def _usual_longest(t: np.ndarray) -> float:
    """The step, in medians, that a tenth of the time lies in longer ones than; gaps left out."""
    step = np.sort(np.diff(t))
    inner = step[step < LONG_GAP_STEPS * np.median(step)]
    return float(inner[np.searchsorted(inner.cumsum(), 0.9 * inner.sum())] / np.median(step))


def _roughness_ratio(t: np.ndarray, q: np.ndarray) -> float:
    """How badly a cubic through four neighbours predicts a position, over the given stamps and
    over even ones: their ratio, the median over joints."""
    if len(t) < 50:
        return 1.0
    step = np.diff(t)
    windows = np.lib.stride_tricks.sliding_window_view(step, 4)
    clean = (windows < SMALL_GAP * np.median(step)).all(1)
    even = np.arange(len(t), dtype=float)
    ends = np.ptp(q, 0)
    moving = ends > 0.1 * ends.max()
    if not moving.any() or clean.sum() < 20:
        return 1.0
    errors = [_cubic_error(x, q[:, moving])[clean] for x in (t, even)]
    rms = [np.sqrt((e**2).mean(0)) for e in errors]
    return float(np.median(rms[0] / np.maximum(rms[1], 1e-12)))


def _cubic_error(t: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Each position minus the cubic through its two neighbours on either side (Lagrange)."""
    offsets = (0, 1, 3, 4)
    middle = t[2:-2]
    nodes = [t[k : len(t) - 4 + k] for k in offsets]
    error = q[2:-2].copy()
    for a, k in enumerate(offsets):
        weight = np.ones_like(middle)
        for b in range(4):
            if b != a:
                weight *= (middle - nodes[b]) / (nodes[a] - nodes[b])
        error -= weight[:, None] * q[k : len(t) - 4 + k]
    return error
