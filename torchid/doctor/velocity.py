"""Is dq the derivative of q: of this joint, with this sign, size and timing?"""

import math
from collections.abc import Sequence

import numpy as np
import torch
from scipy.optimize import linear_sum_assignment

from torchid.doctor.case import Case
from torchid.doctor.check import Check, Choice, judged, with_choices, worded_check
from torchid.doctor.repair import (
    Differentiate,
    DropSignal,
    Repair,
    ScaleTime,
    reordered,
    scaled,
)
from torchid.log.checks import (
    DEGREES,
    FOLLOWS,
    dead_velocities,
    named_ratio,
    own_units,
)
from torchid.log.filtering import central_difference, lateness
from torchid.log.model import Log
from torchid.robot.model import joint_list
from torchid.statistics.criteria import LATE_VELOCITY_S

LATE_SHARE = 0.05
"""Share of dq that a lag makes wrong from which on it is worth mending, and"""
OTHER_SHARE = 0.3
"""... that anything else does."""


def check_velocity(case: Case) -> Check:
    """Is dq the derivative of q: of this joint, with this sign, size and timing?"""
    log = case.log
    if log.dq is None:
        return judged("velocity", "fine", "no dq in the log: the derivative of q is used")
    if case.counts:
        text = "positions are in counts or another unit that is not known"
        return judged("velocity", "cannot tell", text)
    # What is wrong, in which joints, and what mends it; each of the log as mended before.
    words: list[str] = []
    repairs: list[Repair] = []
    joints: list[int] = dead_velocities(log)
    if joints:
        words += [f"dq{k + 1} is {float(log.dq[0, k]):.3g} in every row: dead" for k in joints]
        repairs.append(Differentiate(tuple(joints)))
        log = repairs[-1].apply(log)
    order, exchanged = _exchanged(log)
    if exchanged:
        words += exchanged.values()
        joints += exchanged
        repairs.append(reordered(("dq",), order))
        log = repairs[-1].apply(log)
    factors, scales = _velocity_factors(log)
    if isinstance(factors, float):
        return with_choices(*_wrong_rate(factors, log.n), case.fixes)
    words += scales.values()
    joints += scales
    if set(factors) != {1.0}:
        repairs.append(scaled(("dq",), factors))
        log = repairs[-1].apply(log)
    lag, share, worst = velocity_lag(log)
    late = share > LATE_SHARE and abs(lag) > LATE_VELOCITY_S
    if late:
        words.append(
            f"dq {'lags behind' if lag > 0 else 'leads'} the derivative of q by "
            f"{1e3 * abs(lag):.3g} ms, which makes it wrong by {100 * share:.2g} % (filtered, or "
            "from another clock)"
        )
        joints = joints or list(worst)
    elif share > OTHER_SHARE:
        words.append(
            f"dq differs from the derivative of q by {100 * share:.3g} % in {joint_list(worst)}"
        )
        joints = sorted({*joints, *worst})
    if not words:
        text = f"dq follows the derivative of q within {100 * share:.2g} %, lag {1e3 * lag:.2g} ms"
        return judged("velocity", "fine", text, estimate=lag, unit="s")
    if late or share > OTHER_SHARE:
        repairs.append(DropSignal("dq"))
    # dq over the derivative of q in these joints, if that is what is wrong.
    odd = any(factors[k] != 1.0 for k in joints)
    ratios = tuple(1.0 / factors[k] for k in joints) if odd else None
    sure = joints and not (len(words) == 1 and share > LATE_SHARE)
    return judged(
        "velocity",
        "wrong" if sure else "doubtful",
        "; ".join(words),
        joints=tuple(joints),
        estimate=lag if late else ratios,
        unit="s" if late else "ratio",
    ).mended_by(*repairs)


def _exchanged(log: Log) -> tuple[tuple[int, ...], dict[int, str]]:
    """The order in which velocity columns are those of the positions, and in words of which joints
    they are exchanged."""
    assert log.dq is not None
    moved, positions = [], []
    for rows in log.slices():
        q, area = log.q[rows], torch.zeros_like(log.q[rows])
        area[1:] = torch.cumulative_trapezoid(log.dq[rows], log.t[rows, None], dim=0)
        moved.append(area - area.mean(0))
        positions.append(q - q.mean(0))
    # Correlation of each position with the integral of each velocity (n, n).
    a, q = (x / x.norm(dim=0).clamp(min=1e-300) for x in map(torch.cat, (moved, positions)))
    matrix = q.T @ a
    extent = log.q.amax(0) - log.q.amin(0)
    alike = torch.where(extent[:, None] < log.least_way[:, None], 0.0, matrix.abs())
    best = linear_sum_assignment(-alike.numpy())[1].tolist()
    # 0.9: correlation of q with the integral of another joint's dq from which the two are taken for
    # one
    wrong = {
        k: f"dq{j + 1} is the derivative of q{k + 1} (correlation {alike[k, j]:.3f}; of dq{k + 1}: "
        f"{float(matrix[k, k]):.2f})"
        for k, j in enumerate(best)
        if j != k and float(alike[k, j]) > max(0.9, float(alike[k, k]) + 0.1)
    }
    # Only a permutation of the joints that are clearly exchanged among themselves.
    if sorted(wrong) != sorted(best[k] for k in wrong):
        return tuple(range(log.n)), {}
    return tuple(best[k] if k in wrong else k for k in range(log.n)), wrong


def _velocity_factors(log: Log) -> tuple[list[float] | float, dict[int, str]]:
    """What dq must be multiplied by, a joint, and in words of which joints; one number where the
    clock may be wrong instead."""
    records, factors = log.agreements, [1.0] * log.n
    odd = [
        a
        for a in records
        if abs(a.correlation) >= FOLLOWS and (a.correlation < 0 or not 0.8 < a.ratio < 1.25)
    ]
    words = {}
    for a in odd:
        (ratio, name), sign = named_ratio(a.ratio), math.copysign(1.0, a.correlation)
        factors[a.joint] = sign if 0.8 < a.ratio < 1.25 else sign / ratio
        unit, minus = f", {name}" if name else "", "-" if sign < 0 else ""
        words[a.joint] = f"dq{a.joint + 1} is {minus}{a.ratio:.4g} times the derivative{unit}"
    ratios = [a.ratio for a in odd]
    if odd and len(odd) == len(records) and max(ratios) < 1.05 * min(ratios):
        if named_ratio(ratios[0])[1] is None and all(a.correlation > 0 for a in odd):
            return float(np.median(ratios)), {}
        # Joints that stand still share the unit of all the others.
        for k in set(range(log.n)) - set(words):
            factors[k] = abs(factors[odd[0].joint])
    return factors, words


def _wrong_rate(ratio: float, n: int) -> tuple[Check, list[Choice]]:
    """The clock, or the unit of all velocities: kinematics cannot tell."""
    plain = float(f"{ratio:.2g}")
    ratio = plain if abs(ratio / plain - 1.0) < 5e-3 else ratio
    choices = [
        Choice.by("time scale", ScaleTime(1.0 / ratio)),
        Choice.by("velocity scale", scaled(("dq",), (1.0 / ratio,) * n)),
    ]
    return worded_check("velocity", "wrong rate", estimate=ratio, ratio=ratio), choices


def velocity_lag(log: Log) -> tuple[float, float, tuple[int, ...]]:
    """Lag [s] of dq behind the derivative of q (the median over joints), the largest share of a
    moving joint's dq that is wrong, and the joints in which it is at least half as large."""
    even = log.even
    sums = []
    for part, rate in zip(even.trajectories(), even.rates, strict=True):
        assert part.dq is not None
        slope = central_difference(part.q.T, rate)
        # 10.0: band in which both are compared [Hz]
        sums.append(lateness(slope, part.dq.T, rate, min(10.0, 0.3 * rate)))
    numerator, denominator, size, gap = torch.stack(sums).sum(0)
    extent = even.q.amax(0) - even.q.amin(0)
    active = (size > 1e-3 * size.max()) & (extent > even.least_way)
    if not bool(active.any()) or float(size.max()) == 0.0:
        return 0.0, 0.0, ()
    lag = float((numerator / denominator)[active].median())
    share = torch.where(active, (gap / size.clamp(min=1e-300)).sqrt(), 0.0)
    worst = (share > max(LATE_SHARE, 0.5 * float(share.max()))).nonzero().flatten()
    return lag, float(share.max()), tuple(worst.tolist())


_COMMAND_UNITS = {
    "degrees": DEGREES,
    "milliradians": 1e3,
    "counts of an encoder, 4096 a turn": 4096 / (2 * math.pi),
}
"""What one radian is in units that commands are sent in."""


def check_command_unit(case: Case) -> Sequence[Check]:
    """Commands in another unit than the positions, on most joints that move; of logs with torque
    nobody reads them."""
    log = case.log
    if log.u is None or (case.torque is not None and bool(case.torque.any())):
        return ()
    spread = [
        torch.cat([x[rows] - x[rows].mean(0) for rows in log.slices()]).square().mean(0).sqrt()
        for x in (log.u, log.q)
    ]
    # What varies by less, as a standard deviation within motions, does not move [rad]
    stirs = 0.01
    moves = (spread[0] > stirs) & (spread[1] > stirs)
    ratio = float((spread[0] / spread[1])[moves].median()) if bool(moves.any()) else 1.0
    # Factor within which a ratio is that of two units; none of them are nearer to each other
    near_unit = 1.5
    for unit, factor in _COMMAND_UNITS.items():
        for what, key, other, value in (
            ("commands", "u", "q", ratio),
            ("positions", "q", "u", 1 / ratio),
        ):
            if factor / near_unit < value < factor * near_unit:
                words = what, other, value
                check = worded_check(
                    "command unit", "wrong", *words, estimate=value, key=key, in_unit=unit
                )
                return [check.mended_by(scaled((key,), (1 / factor,) * log.n))]
    return [worded_check("command unit", "fine")]


def check_commands(case: Case) -> Sequence[Check]:
    """Lag of every joint behind its command, and how much of the command it makes."""
    log = case.log
    if log.u is None:
        return ()
    step = float(np.median([steps.median for steps in log.steps]))
    # 0.02: a command that varies by less moves nothing [rad or m]
    joints = (log.u.amax(0) - log.u.amin(0) > 0.02).nonzero().flatten().tolist()
    if not joints or not step > 0:
        return [judged("commands", "cannot tell", "no command moves a joint")]
    follow = {k: _follow(log, log.u[:, k].numpy(), k, step) for k in joints}
    late = ", ".join(f"joint {k + 1} {1e3 * lag:.0f} ms" for k, (lag, _) in follow.items())
    # 0.1: a joint whose motion per command differs from 1 by more is in another unit, or held back
    odd = {k: gain for k, (_, gain) in follow.items() if abs(gain - 1) > 0.1}
    evidence = f"positions follow the commands late by {late}"
    if odd:
        shares = ", ".join(f"{gain:.2f}" for gain in odd.values())
        make = f"makes {shares} of its" if len(odd) == 1 else f"make {shares} of their"
        evidence += f"; {joint_list(list(odd))} {make} command"
    lags = tuple(lag for lag, _ in follow.values())
    verdict = "doubtful" if odd else "fine"
    return [worded_check("commands", verdict, joints=joints, estimate=lags, text=evidence)]


def _follow(log: Log, u: np.ndarray, k: int, step: float) -> tuple[float, float]:
    """The delay at which the command (T,) fits joint k best, and the slope there, in motions."""
    best = math.inf, 0.0, 0.0
    parts = [(u[rows], log.q[rows, k].numpy()) for rows in log.slices()]
    # 0.5: longest lag that is looked for [s]
    for shift in range(round(0.5 / step) + 1):
        long = [(x - x.mean(), q - q.mean()) for x, q in parts if len(x) > shift + 1]
        us = np.concatenate([x[: len(x) - shift] for x, _ in long])
        qs = np.concatenate([q[shift:] for _, q in long])
        slope = float(us @ qs) / max(float(us @ us), 1e-300)
        left = float(np.square(qs - slope * us).mean())
        if left < best[0]:
            best = left, shift * step, slope
    return best[1], best[2]


def check_channel_units(case: Case) -> Sequence[Check]:
    """Positions whose measured velocities are in another unit: a fraction of a range."""
    log = case.log
    if log.u is None:
        return ()
    if log.dq is None:
        return [judged("channel units", "cannot tell", "no velocity is measured to compare with")]
    odd = own_units(log)
    if not odd:
        return [judged("channel units", "fine", "no q and u are in a unit of their own")]
    text = ", ".join(
        f"dq{k + 1} is {factor:.3g} times the rate of q{k + 1}" for k, factor in odd.items()
    )
    factors = [odd.get(k, 1.0) for k in range(log.n)]
    check = worded_check(
        "channel units", "doubtful", joints=tuple(odd), estimate=tuple(odd.values()), text=text
    )
    return [check.mended_by(scaled(("q", "u"), factors))]
