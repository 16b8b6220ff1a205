"""Is dq the derivative of q: of this joint, with this sign, size and timing?"""

import math
from collections.abc import Collection

import numpy as np
import torch
from scipy.optimize import linear_sum_assignment

from torchid.doctor.check import Check, Choice, judged, said, with_choices
from torchid.doctor.repair import Differentiate, DropSignal, Reorder, Repair, Scale, ScaleTime
from torchid.log.checks import (
    FOLLOWS,
    dead_velocities,
    least_way,
    named_ratio,
    own_units,
    velocity_agreement,
)
from torchid.log.filtering import ZeroPhaseFilter, central_difference
from torchid.log.model import Log
from torchid.log.sampling import resample
from torchid.robot.model import joint_list

LATE_S = 0.015
"""Lag of dq behind the derivative of q that is worth mending [s], and"""
LATE_SHARE = 0.05
"""... the share of dq that it, or anything else, makes wrong."""
_CLOSE = 0.9
"""Correlation of q with the integral of another joint's dq from which the two are taken for one."""
_BAND_HZ = 10.0


def check_velocity(log: Log, fixes: Collection[str] = (), *, counts: bool = False) -> Check:
    """Is dq the derivative of q: of this joint, with this sign, size and timing?

    Args:
        log: with positions in rad or m, or in unknown counts.
        fixes: names of the choices to take.
        counts: whether they are counts: then no ratio says anything of the clock, nor of dq.
    """
    if log.dq is None:
        return judged("velocity", "fine", "no dq in the log: the derivative of q is used")
    repairs: list[Repair] = []
    said: list[str] = []
    joints: list[int] = dead_velocities(log)
    if joints:
        said += [f"dq{k + 1} is {float(log.dq[0, k]):.3g} in every row: dead" for k in joints]
        repairs.append(Differentiate(tuple(joints)))
        log = repairs[-1].apply(log)
    log = _reorder(log, repairs, said, joints)
    factors = _velocity_factors(log, said, joints)
    if counts:
        text = "positions are in counts or another unit that is not known"
        return judged("velocity", "cannot tell", text)
    if isinstance(factors, float):
        return with_choices(*_wrong_rate(factors, log.n), fixes)
    if any(f != 1.0 for f in factors):
        repairs.append(Scale(("dq",), tuple(factors)))
        log = repairs[-1].apply(log)
    lag, share, worst = velocity_lag(log)
    text = f"dq follows the derivative of q within {100 * share:.2g} %, lag {1e3 * lag:.2g} ms"
    unusable = share > LATE_SHARE and abs(lag) > LATE_S
    if unusable:
        word = "lags behind" if lag > 0 else "leads"
        said.append(
            f"dq {word} the derivative of q by {1e3 * abs(lag):.3g} ms, which makes it wrong by "
            f"{100 * share:.2g} % (filtered, or from another clock)"
        )
        repairs.append(DropSignal("dq"))
        joints = joints or list(worst)
    elif share > 0.3:
        said.append(
            f"dq differs from the derivative of q by {100 * share:.3g} % in {joint_list(worst)}"
        )
        repairs.append(DropSignal("dq"))
        joints = sorted({*joints, *worst})
    if not said:
        return judged("velocity", "fine", text, estimate=lag, unit="s")
    # dq over the derivative of q in these joints, if that is what is wrong.
    scaled = any(factors[k] != 1.0 for k in joints)
    ratios = tuple(1.0 / factors[k] for k in joints) if scaled else None
    return judged(
        "velocity",
        "wrong" if joints and not (len(said) == 1 and share > LATE_SHARE) else "doubtful",
        "; ".join(said),
        joints=tuple(joints),
        estimate=lag if unusable else ratios,
        unit="s" if unusable else "ratio",
    ).mended_by(*repairs)


def _reorder(log: Log, repairs: list[Repair], said: list[str], joints: list[int]) -> Log:
    """Velocity columns back to the positions whose derivative they are."""
    # Correlation of each position with the integral of each velocity (n, n).
    assert log.dq is not None
    moved, positions = [], []
    for part in log.trajectories():
        assert part.dq is not None
        area = torch.zeros_like(part.q)
        area[1:] = torch.cumulative_trapezoid(part.dq, part.t[:, None], dim=0)
        moved.append(area - area.mean(0))
        positions.append(part.q - part.q.mean(0))
    a, q = torch.cat(moved), torch.cat(positions)
    extent = log.q.amax(0) - log.q.amin(0)
    a, q = a / a.norm(dim=0).clamp(min=1e-300), q / q.norm(dim=0).clamp(min=1e-300)
    matrix = q.T @ a
    usable = torch.where(extent[:, None] < least_way(log)[:, None], 0.0, matrix.abs())
    order = linear_sum_assignment(-usable.numpy())[1].tolist()
    wrong = [
        k
        for k, j in enumerate(order)
        if j != k and float(usable[k, j]) > max(_CLOSE, float(usable[k, k]) + 0.1)
    ]
    # Only a permutation of the joints that are clearly exchanged among themselves.
    if not wrong or sorted(wrong) != sorted(order[k] for k in wrong):
        return log
    full = tuple(order[k] if k in wrong else k for k in range(log.n))
    said += [
        f"dq{order[k] + 1} is the derivative of q{k + 1} (correlation {usable[k, order[k]]:.3f}; "
        f"of dq{k + 1}: {float(matrix[k, k]):.2f})"
        for k in wrong
    ]
    joints += wrong
    repairs.append(Reorder(("dq",), full))
    return repairs[-1].apply(log)


def _velocity_factors(log: Log, said: list[str], joints: list[int]) -> list[float] | float:
    """What dq must be multiplied by, a joint; one number where the clock is wrong instead."""
    records = velocity_agreement(log)
    factors = [1.0] * log.n
    odd = []
    for a in records:
        if abs(a.correlation) < FOLLOWS:
            continue
        sign = -1.0 if a.correlation < 0 else 1.0
        scaled = not 0.8 < a.ratio < 1.25
        if sign < 0 or scaled:
            odd.append(a)
            factors[a.joint] = sign / named_ratio(a.ratio)[0] if scaled else sign
    if not odd:
        return factors
    ratios = [a.ratio for a in odd]
    alike = len(odd) == len(records) and max(ratios) < 1.05 * min(ratios)
    if alike and named_ratio(ratios[0])[1] is None and all(a.correlation > 0 for a in odd):
        return float(np.median(ratios))
    for a in odd:
        _ratio, name = named_ratio(a.ratio)
        minus = "-" if a.correlation < 0 else ""
        unit = f", {name}" if name else ""
        said.append(f"dq{a.joint + 1} is {minus}{a.ratio:.4g} times the derivative{unit}")
        joints.append(a.joint)
    # Joints that stand still share the unit of all the others.
    if alike:
        rest = set(range(log.n)) - {a.joint for a in odd}
        for k in rest:
            factors[k] = abs(factors[odd[0].joint])
    return factors


def _wrong_rate(ratio: float, n: int) -> tuple[Check, list[Choice]]:
    """The clock, or the unit of all velocities: kinematics cannot tell."""
    plain = float(f"{ratio:.2g}")
    ratio = plain if abs(ratio / plain - 1.0) < 5e-3 else ratio
    choices = [
        Choice.by("time scale", ScaleTime(1.0 / ratio)),
        Choice.by("velocity scale", Scale(("dq",), (1.0 / ratio,) * n)),
    ]
    return said("velocity", "wrong rate", estimate=ratio, ratio=ratio), choices


def velocity_lag(log: Log) -> tuple[float, float, tuple[int, ...]]:
    """Lag [s] of dq behind the derivative of q (the median over joints), the largest share of a
    moving joint's dq that is wrong, and the joints in which it is at least half as large."""
    even = resample(log)
    assert even.dq is not None
    sums = []
    for part, rate in zip(even.trajectories(), even.rates, strict=True):
        assert part.dq is not None
        low = ZeroPhaseFilter(rate, min(_BAND_HZ, 0.3 * rate))
        reference = low.apply(central_difference(part.q.T, rate))
        signal = low.apply(part.dq.T)
        edge = min(round(rate / low.cutoff), part.samples // 4)
        middle = slice(edge, part.samples - edge)
        slope = central_difference(signal, rate)[:, middle]
        difference = (reference - signal)[:, middle]
        products = (difference * slope, slope**2, reference[:, middle] ** 2, difference**2)
        sums.append(torch.stack([x.sum(-1) for x in products]))
    numerator, denominator, size, gap = torch.stack(sums).sum(0)
    extent = even.q.amax(0) - even.q.amin(0)
    active = (size > 1e-3 * size.max()) & (extent > least_way(even))
    if not bool(active.any()) or float(size.max()) == 0.0:
        return 0.0, 0.0, ()
    lag = float((numerator / denominator)[active].median())
    share = torch.where(active, (gap / size.clamp(min=1e-300)).sqrt(), 0.0)
    worst = (share > max(LATE_SHARE, 0.5 * float(share.max()))).nonzero().flatten()
    return lag, float(share.max()), tuple(worst.tolist())


LATEST_S = 0.5
"""Longest lag that is looked for [s]."""
EVEN = 0.1
"""A joint whose motion per command differs from 1 by more is in another unit, or held back [1]."""
MOVES = 0.02
"""A command that varies by less moves nothing [rad or m]."""


def check_commands(log: Log) -> Check:
    """Lag of every joint behind its command, and how much of the command it makes."""
    assert log.u is not None
    step = float(torch.cat([log.t[rows].diff() for rows in log.slices()]).median())
    joints = [k for k in range(log.n) if float(log.u[:, k].max() - log.u[:, k].min()) > MOVES]
    if not joints or not step > 0:
        return judged("commands", "cannot tell", "no command moves a joint")
    lags, gains = zip(*(_follow(log, k, step) for k in joints), strict=True)
    late = ", ".join(
        f"joint {k + 1} {1e3 * lag:.0f} ms" for k, lag in zip(joints, lags, strict=True)
    )
    odd = [k for k, g in zip(joints, gains, strict=True) if abs(g - 1) > EVEN]
    evidence = f"positions follow the commands late by {late}"
    if odd:
        shares = ", ".join(f"{g:.2f}" for k, g in zip(joints, gains, strict=True) if k in odd)
        make = f"makes {shares} of its" if len(odd) == 1 else f"make {shares} of their"
        evidence += f"; {joint_list(odd)} {make} command"
    verdict = "doubtful" if odd else "fine"
    return said("commands", verdict, joints=joints, estimate=lags, text=evidence)


def _follow(log: Log, k: int, step: float) -> tuple[float, float]:
    """The delay at which the command fits a joint best, and the slope there, within motions."""
    best = math.inf, 0.0, 0.0
    for shift in range(round(LATEST_S / step) + 1):
        us, qs = [], []
        for rows in log.slices():
            u, q = log.u[rows, k].numpy(), log.q[rows, k].numpy()  # type: ignore[index]
            if len(u) > shift + 1:
                us.append(u[: len(u) - shift] - u.mean())
                qs.append(q[shift:] - q.mean())
        u, q = np.concatenate(us), np.concatenate(qs)
        slope = float(u @ q) / max(float(u @ u), 1e-300)
        left = float(np.square(q - slope * u).mean())
        if left < best[0]:
            best = left, shift * step, slope
    return best[1], best[2]


def check_channel_units(log: Log) -> Check:
    """Positions whose measured velocities are in another unit: a fraction of a range."""
    if log.dq is None:
        return judged("channel units", "cannot tell", "no velocity is measured to compare with")
    odd = own_units(log)
    if not odd:
        return judged("channel units", "fine", "no q and u are in a unit of their own")
    text = ", ".join(
        f"dq{k + 1} is {factor:.3g} times the rate of q{k + 1}" for k, factor in odd.items()
    )
    check = said(
        "channel units", "doubtful", joints=tuple(odd), estimate=tuple(odd.values()), text=text
    )
    return check.mended_by(Scale(("q", "u"), tuple(odd.get(k, 1.0) for k in range(log.n))))
