"""Positions and velocities: units, jumps, which velocity belongs to which position, standstill."""

import math
from collections.abc import Sequence

import numpy as np
import torch
from scipy.optimize import linear_sum_assignment

from torchid.doctor.check import Check, fix_text, joint_list
from torchid.doctor.repair import (
    MOTION,
    DropSignal,
    Reorder,
    Repair,
    Scale,
    ScaleTime,
    Unwrap,
)
from torchid.log.checks import (
    DEGREES,
    FOLLOWS,
    MOVING,
    STILL,
    largest_angle,
    near,
    position_jumps,
    velocity_agreement,
)
from torchid.log.filtering import ZeroPhaseFilter, central_difference
from torchid.log.model import Log
from torchid.log.sampling import resample, sampling_rate
from torchid.robot.model import JointType, Robot
from torchid.typing import Tensor

RPM = 30.0 / math.pi
COUNTS = 100.0
"""Positions beyond this [rad] that are whole numbers are encoder counts."""
LATE_S = 0.015
"""Lag of dq behind the derivative of q that is worth mending [s], and"""
LATE_SHARE = 0.05
"""... the share of dq that it, or anything else, makes wrong."""
IDLE = 0.5
"""Share of the log in which nothing may move."""
_BAND_HZ = 10.0


def check_position_unit(robot: Robot, log: Log) -> Check:
    """Degrees or encoder counts in place of radians."""
    ratio = {a.joint: a.ratio for a in velocity_agreement(log) if a.correlation > FOLLOWS}
    factors, evidence = [1.0] * robot.n, []
    unknown = []
    for k, kind in enumerate(robot.joint_types):
        if kind is JointType.PRISMATIC:
            continue
        q = log.q[:, k]
        low, high = float(q.min()), float(q.max())
        limits = robot.limits.position
        far = max(-low, high) > largest_angle(None if limits is None else limits[k])
        degrees = k in ratio and near(ratio[k], 1.0 / DEGREES)
        if not (far or degrees):
            continue
        if bool((q == q.round()).all()) and max(-low, high) > COUNTS:
            scale = _counts(ratio.get(k))
            if scale is None:
                unknown.append(k)
            else:
                factors[k] = scale
            evidence.append(f"q{k + 1} {low:g} to {high:g}, whole numbers: encoder counts")
        else:
            factors[k] = 1.0 / DEGREES
            why = f", dq{k + 1} is 1/{1 / ratio[k]:.1f} of its derivative" if degrees else ""
            evidence.append(f"q{k + 1} {low:.4g} to {high:.4g}: degrees{why}")
    factors = _same_for_all(factors, log, evidence)
    return _position_check(factors, unknown, evidence, log, ratio)


def _counts(ratio: float | None) -> float | None:
    """Radians per count from dq in rad/s; a power of two per turn where that is near."""
    if ratio is None or ratio > 0.05:
        return None
    turn = 2.0 * math.pi / ratio
    power = 2.0 ** round(math.log2(turn))
    return 2.0 * math.pi / (power if near(turn, power) else round(turn))


def _same_for_all(factors: list[float], log: Log, evidence: list[str]) -> list[float]:
    """Where most joints are in degrees, the others are too: they only stayed near zero."""
    in_degrees = sum(f == 1.0 / DEGREES for f in factors)
    if in_degrees == 0 or in_degrees == len(factors):
        return factors
    clear = [a.joint for a in velocity_agreement(log) if near(a.ratio, 1.0)]
    return [
        1.0 / DEGREES if f == 1.0 and (2 * in_degrees >= len(factors)) and k not in clear else f
        for k, f in enumerate(factors)
    ]


def _position_check(
    factors: list[float], unknown: list[int], evidence: list[str], log: Log, ratio: dict[int, float]
) -> Check:
    if not evidence:
        size = float(log.q.abs().max())
        return Check("position unit", "fine", f"rad (or m): |q| up to {size:.3g}", estimate=1.0)
    joints = tuple(k for k, f in enumerate(factors) if f != 1.0 or k in unknown)
    # A dq in the unit of q has the same fault; one in rad/s has not.
    also = tuple(near(ratio.get(k, 0.0), 1.0) for k in range(log.n))
    repairs: list[Repair] = []
    if any(f != 1.0 for f in factors):
        repairs.append(Scale(("q",), tuple(factors)))
        moved = tuple(f if both else 1.0 for f, both in zip(factors, also, strict=True))
        if log.dq is not None and any(f != 1.0 for f in moved):
            repairs.append(Scale(("dq",), moved))
    fix = fix_text(repairs)
    if unknown:
        fix = (fix + "; " if fix else "") + (
            f"say how many counts make a turn in {joint_list(unknown)}: q = 2 pi / counts"
        )
    return Check(
        "position unit",
        "wrong",
        "; ".join(evidence[:3]) + (f"; and {len(evidence) - 3} more" if len(evidence) > 3 else ""),
        joints=joints,
        estimate=tuple(1.0 / factors[k] for k in joints),
        unit="per rad",
        fix=fix,
        repairs=tuple(repairs),
    )


def check_jumps(robot: Robot, log: Log) -> Check:
    """Angles wrapped at a whole turn, or other steps that no motion makes."""
    found = position_jumps(log)
    if not found:
        return Check("position jumps", "fine", "no jumps")
    joints = []
    for k in range(log.n):
        mended = Unwrap((k,)).apply(log)
        if not torch.equal(mended.q, log.q) and robot.joint_types[k] is JointType.REVOLUTE:
            joints.append(k)
    repairs = (Unwrap(tuple(joints)),) if joints else ()
    mended = repairs[0].apply(log) if repairs else log
    still_there = position_jumps(mended)
    fix = fix_text(repairs) if repairs else ""
    if still_there:
        fix = (fix + "; " if fix else "") + "number the runs in a column traj"
    return Check(
        "position jumps",
        "wrong" if repairs else "doubtful",
        "; ".join(found[:3]),
        joints=tuple(joints),
        fix=fix,
        repairs=repairs,
    )


def check_velocity(log: Log) -> Check:
    """Is dq the derivative of q: of this joint, with this sign, size and timing?"""
    if log.dq is None:
        return Check("velocity", "fine", "no dq in the log: the derivative of q is used")
    repairs: list[Repair] = []
    said: list[str] = []
    joints: list[int] = []
    log = _reorder(log, repairs, said, joints)
    factors = _velocity_factors(log, said, joints)
    if isinstance(factors, float):
        return _wrong_rate(factors)
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
        return Check("velocity", "fine", text, estimate=lag, unit="s")
    return Check(
        "velocity",
        "wrong" if joints and not (len(said) == 1 and share > LATE_SHARE) else "doubtful",
        "; ".join(said),
        joints=tuple(joints),
        estimate=lag if unusable else tuple(1.0 / factors[k] for k in joints),
        unit="s" if unusable else "ratio",
        fix=fix_text(repairs),
        repairs=tuple(repairs),
    )


def _reorder(log: Log, repairs: list[Repair], said: list[str], joints: list[int]) -> Log:
    """Velocity columns back to the positions whose derivative they are."""
    matrix = _correlations(log)
    moving = ~torch.isnan(matrix).all(1)
    usable = torch.nan_to_num(matrix.abs(), nan=0.0)
    _, order = linear_sum_assignment(-usable.numpy())
    order = [int(j) for j in order]
    wrong = [
        k
        for k, j in enumerate(order)
        if j != k and bool(moving[k]) and usable[k, j] > FOLLOWS and usable[k, k] < 0.9 * FOLLOWS
    ]
    if not wrong:
        return log
    # Only a permutation of the joints that are clearly exchanged among themselves.
    if sorted(wrong) != sorted(order[k] for k in wrong):
        return log
    full = tuple(order[k] if k in wrong else k for k in range(log.n))
    said += [
        f"dq{order[k] + 1} is the derivative of q{k + 1} (correlation {usable[k, order[k]]:.3f}; "
        f"of dq{k + 1}: {float(torch.nan_to_num(matrix[k, k])):.2f})"
        for k in wrong
    ]
    joints += wrong
    repairs.append(Reorder(("dq",), full))
    return repairs[-1].apply(log)


def _correlations(log: Log) -> Tensor:
    """Of each position with the integral of each velocity (n, n); NaN where nothing moves."""
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
    matrix[extent < MOVING] = torch.nan
    return matrix


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
            factors[a.joint] = sign / _named_ratio(a.ratio)[0] if scaled else sign
    if not odd:
        return factors
    ratios = [a.ratio for a in odd]
    alike = len(odd) == len(records) and max(ratios) < 1.05 * min(ratios)
    if alike and _named_ratio(ratios[0])[1] is None and all(a.correlation > 0 for a in odd):
        return float(np.median(ratios))
    for a in odd:
        _ratio, name = _named_ratio(a.ratio)
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


def _named_ratio(ratio: float) -> tuple[float, str | None]:
    """The exact ratio of a known unit, if this is one."""
    for factor, name in ((DEGREES, "deg/s"), (RPM, "rpm"), (1e3, "mrad/s"), (1.0, "rad/s")):
        if near(ratio, factor):
            return factor, name
    return ratio, None


def _wrong_rate(ratio: float) -> Check:
    plain = float(f"{ratio:.2g}")
    ratio = plain if abs(ratio / plain - 1.0) < 5e-3 else ratio
    repair = ScaleTime(1.0 / ratio)
    return Check(
        "velocity",
        "wrong",
        f"every dq is {ratio:.4g} times the derivative of its q, which is no unit: the time stamps "
        "run at another rate than the samples were taken at (or dq is scaled)",
        estimate=ratio,
        unit="ratio",
        fix=f"{repair} (or scale dq by {1 / ratio:.4g}, if the stamps are right)",
        repairs=(repair,),
    )


def velocity_lag(log: Log) -> tuple[float, float, tuple[int, ...]]:
    """Lag [s] of dq behind the derivative of q (the median over joints), the largest share of a
    moving joint's dq that is wrong, and the joints in which it is more than 5 %."""
    even = resample(log)
    assert even.dq is not None
    sums = []
    for part, rate in zip(even.trajectories(), sampling_rate(even), strict=True):
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
    active = size > 1e-3 * size.max()
    if not bool(active.any()) or float(size.max()) == 0.0:
        return 0.0, 0.0, ()
    lag = float((numerator / denominator)[active].median())
    share = torch.where(active, (gap / size.clamp(min=1e-300)).sqrt(), 0.0)
    return lag, float(share.max()), tuple((share > LATE_SHARE).nonzero().flatten().tolist())


def check_standstill(log: Log) -> Check:
    """Joints that never move, and time in which nothing does."""
    extent = log.q.amax(0) - log.q.amin(0)
    still = tuple(int(k) for k in (extent < STILL).nonzero().flatten())
    speed = torch.cat([p.q.diff(dim=0) / p.t.diff()[:, None] for p in log.trajectories()]).abs()
    fast = torch.quantile(speed[:: max(1, len(speed) // 100_000)], 0.95, dim=0)
    idle = float((speed < 0.02 * fast.clamp(min=1e-9)).all(1).double().mean())
    text = f"{100 * idle:.0f} % of the time nothing moves"
    if still:
        return Check(
            "standstill",
            "doubtful",
            f"{joint_list(still)} never move{'s' if len(still) == 1 else ''} (q varies by less "
            f"than {STILL:g}): parameters of their own cannot be identified",
            joints=still,
            estimate=tuple(float(extent[k]) for k in still),
            unit="rad",
            fix="add a log in which they move",
        )
    if idle > IDLE:
        return Check(
            "standstill", "doubtful", text, estimate=idle, fix="cut the pauses, or --rows moving"
        )
    return Check("standstill", "fine", text, estimate=idle)


def moves(log: Log) -> Sequence[bool]:
    """Whether each joint moves."""
    return ((log.q.amax(0) - log.q.amin(0)) > MOVING).tolist()


__all__ = [
    "MOTION",
    "check_jumps",
    "check_position_unit",
    "check_standstill",
    "check_velocity",
    "moves",
    "velocity_lag",
]
