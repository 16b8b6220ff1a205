"""Positions: units, whole turns, standstill."""

import math

import torch

from torchid.doctor.check import Check
from torchid.doctor.repair import Repair, Scale, Unwrap
from torchid.log.checks import (
    DEGREES,
    FOLLOWS,
    MILLIMETRES,
    STILL,
    largest_angle,
    largest_slide,
    near,
    position_jumps,
    velocity_agreement,
)
from torchid.log.model import Log
from torchid.robot.model import JointType, Robot, joint_list
from torchid.statistics.robust import column_quantile

COUNTS = 100.0
"""Positions beyond this [rad] that are whole numbers are encoder counts."""
IDLE = 0.5
"""Share of the log in which nothing may move."""


def check_position_unit(robot: Robot, log: Log) -> Check:
    """Degrees or encoder counts in place of radians."""
    ratio = {a.joint: a.ratio for a in velocity_agreement(log) if a.correlation > FOLLOWS}
    factors = [1.0] * robot.n
    evidence: list[str] = []
    unknown: list[int] = []
    for k, kind in enumerate(robot.joint_types):
        q = log.q[:, k]
        low, high = float(q.min()), float(q.max())
        limits = robot.limits.position
        if kind is JointType.PRISMATIC:
            far = max(-low, high) > largest_slide(None if limits is None else limits[k])
            if far or (k in ratio and near(ratio[k], 1.0 / MILLIMETRES)):
                factors[k] = 1.0 / MILLIMETRES
                evidence.append(f"q{k + 1} {low:.4g} to {high:.4g}: millimetres")
            continue
        far = max(-low, high) > largest_angle(None if limits is None else limits[k])
        degrees = k in ratio and near(ratio[k], 1.0 / DEGREES)
        if not (far or degrees):
            continue
        if bool((q == q.round()).all()) and max(-low, high) > COUNTS:
            # Radians per count from dq in rad/s; a power of two per turn where that is near.
            measured = ratio.get(k)
            if measured is None or measured > 0.05:
                unknown.append(k)
            else:
                turn = 2.0 * math.pi / measured
                power = 2.0 ** round(math.log2(turn))
                factors[k] = 2.0 * math.pi / (power if near(turn, power) else round(turn))
            evidence.append(f"q{k + 1} {low:g} to {high:g}, whole numbers: encoder counts")
        else:
            factors[k] = 1.0 / DEGREES
            why = f", dq{k + 1} is 1/{1 / ratio[k]:.1f} of its derivative" if degrees else ""
            evidence.append(f"q{k + 1} {low:.4g} to {high:.4g}: degrees{why}")
    # Where most joints are in degrees, the others are too: they only stayed near zero.
    rotary = [k for k, kind in enumerate(robot.joint_types) if kind is not JointType.PRISMATIC]
    in_degrees = sum(factors[k] == 1.0 / DEGREES for k in rotary)
    if len(rotary) <= 2 * in_degrees < 2 * len(rotary):
        clear = [a.joint for a in velocity_agreement(log) if near(a.ratio, 1.0)]
        for k in rotary:
            if factors[k] == 1.0 and k not in clear:
                factors[k] = 1.0 / DEGREES
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
    ask = f"say how many counts make a turn in {joint_list(unknown)}: q = 2 pi / counts"
    return Check(
        "position unit",
        "wrong",
        "; ".join(evidence[:3]) + (f"; and {len(evidence) - 3} more" if len(evidence) > 3 else ""),
        joints=joints,
        estimate=tuple(1.0 / factors[k] for k in joints),
        unit="per rad" if all(k in rotary for k in joints) else "per rad, per m",
        fix=ask if unknown else None,
    ).mended_by(*repairs)


def check_jumps(robot: Robot, log: Log) -> Check:
    """Angles wrapped at a whole turn, or other steps that no motion makes."""
    # Angles within one turn that step by a whole one, however often.
    turn = 2.0 * math.pi
    step = torch.cat([part.q.diff(dim=0).abs() for part in log.trajectories()])
    extent = log.q.amax(0) - log.q.amin(0)
    found = [
        *[
            f"q{k + 1} steps by a whole turn {int((step[:, k] > 0.9 * turn).sum())} times"
            for k, kind in enumerate(robot.joint_types)
            if kind is JointType.REVOLUTE
            and float(extent[k]) < 1.01 * turn
            and bool((step[:, k] > 0.9 * turn).any())
        ],
        *position_jumps(log),
    ]
    if not found:
        return Check("position jumps", "fine", "no jumps")
    joints = []
    for k in range(log.n):
        mended = Unwrap((k,)).apply(log)
        if not torch.equal(mended.q, log.q) and robot.joint_types[k] is JointType.REVOLUTE:
            joints.append(k)
    repairs = (Unwrap(tuple(joints)),) if joints else ()
    mended = repairs[0].apply(log) if repairs else log
    return Check(
        "position jumps",
        "wrong" if repairs else "doubtful",
        "; ".join(found[:3]),
        joints=tuple(joints),
        fix="number the runs in a column traj" if position_jumps(mended) else None,
    ).mended_by(*repairs)


def check_standstill(log: Log) -> Check:
    """Joints that never move, and time in which nothing does."""
    extent = log.q.amax(0) - log.q.amin(0)
    still = tuple(int(k) for k in (extent < STILL).nonzero().flatten())
    speed = torch.cat([p.q.diff(dim=0) / p.t.diff()[:, None] for p in log.trajectories()]).abs()
    fast = column_quantile(speed[:: max(1, len(speed) // 100_000)], 0.95)
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
            "standstill",
            "doubtful",
            text,
            estimate=idle,
            fix='cut the pauses, or fit moving rows only (`rows="moving"`, as identify does)',
        )
    return Check("standstill", "fine", text, estimate=idle)
