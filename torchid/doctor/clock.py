"""Time stamps and rows: does the clock run on, evenly, in seconds, and is every row a new one?"""

from typing import Any

import numpy as np
import torch

from torchid.doctor.case import Case
from torchid.doctor.check import Check, worded_check
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
from torchid.log.checks import SLOW_STEP_S, TIME_UNITS, near
from torchid.log.columns import PREFIXES
from torchid.log.model import Log
from torchid.log.sampling import LONG_GAP_S, LONG_GAP_STEPS
from torchid.log.stamps import SMALL_GAP, roughness_ratio
from torchid.statistics.robust import column_quantile
from torchid.typing import Bool, Tensor

LONG = 2.0
"""Medians that the longest usual steps may last."""


def check_values(case: Case) -> Check:
    """Empty, NaN or infinite values.

    Raises:
        LogError: a column has nothing else.
    """
    log, counts = case.log, []
    bad = ~torch.isfinite(log.t)
    for name, signal in log.signals.items():
        wrong, key = ~torch.isfinite(signal), PREFIXES[name]
        if empty := wrong.all(0).nonzero().flatten().tolist():
            columns = ", ".join(f"{key}{k + 1}" for k in empty)
            raise LogError(
                f"log '{log.source}': no row has a number in {columns}.",
                got="empty, NaN or infinite throughout, as drivers write what they do not measure",
                expected=f"measured values, or no {key} columns",
                hint=f'leave them out: `columns="{key}=none"`' if name != "q" else None,
            )
        bad |= wrong.any(1)
        counts += [f"{int(wrong.sum())} in {name}"] if bool(wrong.any()) else []
    rows = bad.nonzero().flatten().tolist()
    if not rows:
        return worded_check("values", "fine")
    check = worded_check(
        "values", "wrong", estimate=len(rows) / log.samples, rows=len(rows), samples=log.samples,
        found=", ".join(counts) or "in t",
    )  # fmt: skip
    return check.mended_by(DropRows(tuple(rows), "NaN or infinite"))


_WHAT = (
    "repeated stamps",
    "steps back",
    "steps back to a new run, elsewhere",
    "jumps ahead while the arm does not move further than in one step",
)


def check_clock(case: Case) -> Check:
    """Stamps that repeat, go back, or jump while the arm does not."""
    log = case.log
    faults: tuple[list[int], ...] = ([], [], [], [])
    repeated, back, runs, jumped = faults
    # A step of the clock across which no joint moves further than this many usual steps is a jump
    # of the clock, not a gap in the log
    usual_steps = 3.0
    for rows in log.slices():
        q, step = log.q[rows].numpy(), np.diff(log.t[rows].numpy())
        if not (step > 0).any():
            return worded_check("clock", "wrong never")
        # Steps back across which some joint goes further than in its usual steps: a new run.
        behind = np.flatnonzero(step < 0)
        moved, usual = _steps(q, behind)
        new = (moved > usual_steps * usual + 1e-3 * np.ptp(q, 0).max()).any(1)
        # Long steps of the clock across which the positions make a usual step only.
        long = np.flatnonzero(step > LONG_GAP_STEPS * np.median(step[step > 0]))
        moved, usual = _steps(q, long)
        moving = usual > 1e-3 * np.ptp(q, 0).max() / len(q)
        stood = moving.any(1) & ~((moved > usual_steps * usual) & moving).any(1)
        places = np.flatnonzero(step == 0), behind[~new], behind[new], long[stood]
        for steps, own in zip(faults, places, strict=True):
            steps.extend((own + rows.start).tolist())
    if not any(faults):
        return worded_check("clock", "fine", text=f"{log.samples} stamps increase")
    counted = [f"{len(steps)} {what}" for steps, what in zip(faults, _WHAT, strict=True) if steps]
    first = min(min(steps) for steps in faults if steps)
    check = worded_check(
        "clock", "wrong", estimate=float(sum(map(len, faults))), found=", ".join(counted),
        row=first + 1, t=float(log.t[first]),
    )  # fmt: skip
    split = (SplitRuns(tuple(k + 1 for k in runs)),) if runs else ()
    return check.mended_by(*split, *_clock_repairs(repaired(log, split), repeated, back + jumped))


def _steps(q: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Step of each joint (R, n) after these rows, and the median of the ten before and after."""
    moved = np.abs(np.diff(q, axis=0))
    around = [np.r_[max(0, k - 10) : k, k + 1 : min(len(moved), k + 11)] for k in rows]
    usual = [np.median(moved[near_by], 0) for near_by in around]
    return moved[rows], np.array(usual).reshape(-1, q.shape[1])


def _clock_repairs(log: Log, repeated: list[int], broken: list[int]) -> list[Repair]:
    same = [k for k in repeated if bool((log.q[k + 1] == log.q[k]).all())]
    # 0.02: share of the stamps that repeat from which on they are coarser than the sampling
    if len(repeated) > 0.02 * log.samples and 2 * len(same) < len(repeated):
        # Stamps coarser than the sampling: the rows are in order, and evenly taken.
        return [*([RejoinTime(tuple(broken))] if broken else []), EvenTime()]
    repairs: list[Repair] = []
    if others := sorted({*broken, *repeated} - set(same)):
        repairs.append(RejoinTime(tuple(others)))
    if same:
        repairs.append(DropRows(tuple(k + 1 for k in same), "the row before, once more"))
    return repairs


def check_time_unit(case: Case) -> Check:
    """Is t in seconds? By velocities where there are any, by the size of its step otherwise."""
    step, ratios = max(s.median for s in case.log.steps), [a.ratio for a in case.followers]
    why = "dq is {0:g} times the derivative of q"
    factor = next((f for f in TIME_UNITS if ratios and all(near(r, f) for r in ratios)), None)
    if factor is None:
        if step <= SLOW_STEP_S or any(0.5 < r < 2.0 for r in ratios):
            text = f"seconds: median step {1e3 * step:.4g} ms"
            return worded_check("time unit", "fine", estimate=1.0, text=text)
        why = "dq disagrees" if ratios else "no arm is sampled so slowly"
        factor = next((f for f in TIME_UNITS if 1e-4 <= step / f <= SLOW_STEP_S), None)
    if factor is None:
        return worded_check("time unit", "doubtful", text=f"a median step of {step:g} is no arm's")
    words: dict[str, Any] = {"unit": TIME_UNITS[factor], "step": step, "why": why.format(factor)}
    check = worded_check("time unit", "wrong", estimate=factor, **words)
    return check.mended_by(ScaleTime(1.0 / factor))


def check_dropouts(case: Case) -> Check:
    """Samples that are missing, as gaps between stamps."""
    steps = [case.log.t[rows].diff().numpy() for rows in case.log.slices()]
    relative = np.concatenate([step / np.median(step) for step in steps])
    gaps, longest = relative[relative > SMALL_GAP], max(float(step.max()) for step in steps)
    share = float((gaps - 1).sum() / relative.sum())
    text = (
        f"{len(gaps)} gap{'s' * (len(gaps) != 1)} of more than 3 steps, {100 * share:.2g} % of the "
        "samples missing"
    )
    # 0.01: share of the samples that may be missing in gaps
    if share < 0.01 and longest < LONG_GAP_S:
        return worded_check(
            "dropouts", "fine", estimate=share, text=text if len(gaps) else "no gaps"
        )
    return worded_check("dropouts", "doubtful", estimate=share, text=text, longest=1e3 * longest)


def check_held(case: Case) -> Check:
    """Rows that repeat the one before while the arm moves."""
    log = case.log
    held = {name: _held(x) for name, x in log.signals.items() if name in _MEASURED}
    # Whether some joint is in motion around each step: what five samples either way cover.
    wide = torch.zeros(log.samples - 1, dtype=torch.bool)
    reach = min(5, (log.samples - 1) // 2)
    speed = (log.q[2 * reach :] - log.q[: -2 * reach]).abs() / max(1, 2 * reach)
    fast = column_quantile(speed[:: max(1, len(speed) // 100_000)], 0.9)
    active = (speed > 0.2 * fast) & (fast > 0)
    wide[reach : reach + len(active) - 1] = active.any(1)[:-1]
    moving = wide & (log.trajectory.diff() == 0)
    usable = max(1, int(moving.sum()))
    shares = {name: float((mask & moving).sum()) / usable for name, mask in held.items()}
    text = ", ".join(f"{name} {100 * share:.2g} %" for name, share in shares.items())
    rows = (torch.stack(list(held.values())).all(0) & moving).nonzero().flatten() + 1
    share = len(rows) / usable
    # Share of the moving rows that may repeat the one before; fewer are lost in any filter
    held_share = 0.1
    if share > held_share:
        check = worded_check("held samples", "wrong", estimate=share, percent=100 * share)
        return check.mended_by(Bridge(tuple(rows.tolist())))
    late = " and ".join(name for name, share in shares.items() if share > 2 * held_share)
    if late:
        most = max(shares.values())
        return worded_check("held samples", "doubtful", estimate=most, text=text, late=late)
    return worded_check("held samples", "fine", estimate=0.0, text=text)


_MEASURED = ("q", "dq", "tau", "current")


def _held(signal: Tensor) -> Bool[Tensor, " steps"]:
    """Whether row k + 1 repeats row k in every joint of a signal that ever changes."""
    live = (signal != signal[0]).any(0)
    same = (signal.diff(dim=0)[:, live] == 0).all(1)
    return same if bool(live.any()) else torch.zeros_like(same)


def check_stamps(case: Case) -> Check:
    """Are uneven stamps real? Positions are smooth over the time at which they were taken."""
    text = "; ".join(dict.fromkeys(str(s) for s in case.log.steps[:3]))
    parts = [(part.t.numpy(), part.q.numpy()) for part in case.log.trajectories()]
    share = max(_spread(np.diff(t)) for t, _ in parts)
    # 0.1: steps that spread by less than this share of the median are even
    if share < 0.1:
        return worded_check("stamps", "fine", estimate=share, text=text)
    worst = max(roughness_ratio(t, np.arange(float(len(t))), q) for t, q in parts)
    # 3.0: stamps are taken for wrong when positions are this many times smoother over even ones
    if worst >= 3.0:
        known: dict[str, Any] = {"percent": 100 * share, "worst": worst, "text": text}
        return worded_check("stamps", "wrong", estimate=worst, **known).mended_by(EvenTime())
    long = max(_usual_longest(np.diff(t)) for t, _ in parts)
    if long < LONG:
        return worded_check("stamps", "fine", estimate=share, text=text)
    return worded_check("stamps", "doubtful", estimate=long, long=long, text=text)


def _spread(step: np.ndarray) -> float:
    """Standard deviation of the steps without gaps, over their median."""
    inner = step[step < SMALL_GAP * np.median(step)]
    return float(inner.std() / np.median(step)) if len(inner) else 0.0


def _usual_longest(step: np.ndarray) -> float:
    """The step, in medians, that a tenth of the time lies in longer ones than; gaps left out."""
    inner = np.sort(step[step < LONG_GAP_STEPS * np.median(step)])
    return float(inner[np.searchsorted(inner.cumsum(), 0.9 * inner.sum())] / np.median(step))
