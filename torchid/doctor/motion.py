"""Positions: units, whole turns, standstill."""

import math
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import torch

from torchid.doctor.check import Check, Choice, judged, said, with_choices
from torchid.doctor.repair import PLACES, Repair, Scale, Shift, Unwrap
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
from torchid.typing import Tensor

COUNTS = 100.0
"""Positions beyond this [rad] that are whole numbers are encoder counts."""
IDLE = 0.5
"""Share of the log in which nothing may move."""
_TURN = 2.0 * math.pi
_RPM = 2.0 * math.pi / 60.0
_REGISTERS = (
    (4096.0, 0.229 * _RPM, "0.229 rpm (Dynamixel X, P)"),
    (4096.0, 0.114 * _RPM, "0.114 rpm (Dynamixel MX)"),
    (1228.8, 0.111 * _RPM, "0.111 rpm (Dynamixel AX, RX: 1024 counts are 300 degrees)"),
    (4096.0, 0.732 * _RPM, "0.732 rpm (Feetech HLS)"),
    (4096.0, 2.0 * math.pi / 4096.0, "counts a second (Feetech STS)"),
    (36000.0, math.pi / 180.0, "degrees a second (RMD: a count is 0.01 degrees)"),
)
"""Counts a turn, rad/s a count of velocity, and whose registers they are (makers' manuals)."""
_COUNTS = (3600.0, 36000.0, 360000.0)
"""Counts a turn besides powers of two: parts of degrees."""
_ALIKE = 0.03
"""Deviation of a measured ratio of velocity and position from what registers make."""
_BEYOND = 0.2
"""Angle beyond a limit from which on a position is not the joint's [rad]."""
_MIDDLES = {math.pi: "zero at half a turn", math.radians(150.0): "zero at 150 degrees"}
"""Middles of the range that a counter has, a turn or 300 degrees."""
_OWN_UNIT = (
    "say what they are: q=q{j} *[1/GEAR,..] +[ZERO,..] of motors before their gears (tau times "
    "GEAR), q=q{j} rev/COUNTS of counts"
)
_FULL = 100.5
"""Positions in percent of a range are below."""


def check_position_unit(robot: Robot, log: Log, fixes: Collection[str] = ()) -> Check:
    """Degrees or encoder counts in place of radians, and velocities in units of their servos."""
    ratio = {a.joint: a.ratio for a in velocity_agreement(log) if a.correlation > FOLLOWS}
    servo = _servo(log, ratio)
    units = [_unit_of(robot, log, k, ratio.get(k), servo) for k in range(robot.n)]
    factors, rates = [u.factor or 1.0 for u in units], [u.rate for u in units]
    unknown = [k for k, u in enumerate(units) if u.factor is None]
    evidence = [u.evidence for u in units if u.evidence]
    # Where most joints are in one unit, the others are too: they only stayed near zero, or still.
    rotary = [k for k, kind in enumerate(robot.joint_types) if kind is not JointType.PRISMATIC]
    clear = [a.joint for a in velocity_agreement(log) if near(a.ratio, 1.0)]
    for unit, rate in {(factors[k], rates[k]) for k in rotary} - {(1.0, 1.0)}:
        alike = sum((factors[k], rates[k]) == (unit, rate) for k in rotary)
        if len(rotary) <= 2 * alike < 2 * len(rotary):
            for k in rotary:
                if (factors[k], rates[k]) == (1.0, 1.0) and k not in clear:
                    factors[k], rates[k] = unit, rate
    if not evidence:
        size = float(log.q.abs().max())
        return judged("position unit", "fine", f"rad (or m): |q| up to {size:.3g}", estimate=1.0)
    joints = tuple(k for k, f in enumerate(factors) if f != 1.0 or k in unknown)
    # A dq in the unit of q has the same fault; one in rad/s has not.
    also = tuple(near(ratio.get(k, 0.0), 1.0) for k in range(log.n))
    repairs: list[Repair] = []
    if any(f != 1.0 for f in factors):
        repairs.append(Scale(tuple(s for s in PLACES if s in log.signals), tuple(factors)))
        moved = tuple(
            r if r != 1.0 else f if both else 1.0
            for f, r, both in zip(factors, rates, also, strict=True)
        )
        if log.dq is not None and any(f != 1.0 for f in moved):
            repairs.append(Scale(("dq",), moved))
    if (percent := _percent(robot, log, factors, ratio)) is not None:
        text = "positions leave the limits in degrees, and are all within 100: percent of a range"
        check = judged("position unit", "wrong", text, joints)
        choices = [percent, Choice.by("degrees", *repairs)]
        return with_choices(check, choices, fixes)
    odd = _no_degrees(robot, log, factors, ratio)
    if odd is not None:
        text, possible = odd
        check = judged("position unit", "wrong", text, joints)
        own = Choice("unit of its own", _OWN_UNIT)
        choices = [Choice.by("degrees", *repairs), own] if possible else [own]
        return with_choices(check, choices, fixes)
    ask = f"say how many counts make a turn in {joint_list(unknown)}: q=q{{j}} rev/COUNTS -ZERO"
    return judged(
        "position unit",
        "wrong",
        "; ".join(evidence[:3]) + (f"; and {len(evidence) - 3} more" if len(evidence) > 3 else ""),
        joints=joints,
        estimate=tuple(1.0 / factors[k] for k in joints),
        unit="per rad" if all(k in rotary for k in joints) else "per rad, per m",
        fix=ask if unknown else None,
    ).mended_by(*repairs)


class _Unit(NamedTuple):
    """Of one joint: radians (metres) in a unit of q, None where counts are of an unknown part of a
    turn; rad/s in a unit of dq that has one of its own; and why."""

    factor: float | None = 1.0
    rate: float = 1.0
    evidence: str = ""


def _unit_of(
    robot: Robot, log: Log, k: int, ratio: float | None, servo: tuple[float, float, str] | None
) -> _Unit:
    """The unit of a joint's positions.

    Args:
        robot, log, k: joint k (from 0) of the two.
        ratio: of dq to the derivative of q; None where it is not measured.
        servo: whose registers all velocities fit; None for none's.
    """
    q, limits = log.q[:, k], robot.limits.position
    low, high = float(q.min()), float(q.max())
    reached, own = max(-low, high), None if limits is None else limits[k]
    name, span = f"q{k + 1}", f"{low:.4g} to {high:.4g}"
    if robot.joint_types[k] is JointType.PRISMATIC:
        if not (reached > largest_slide(own) or (ratio and near(ratio, 1.0 / MILLIMETRES))):
            return _Unit()
        return _Unit(1.0 / MILLIMETRES, evidence=f"{name} {span}: millimetres")
    degrees = ratio is not None and near(ratio, 1.0 / DEGREES)
    whole = bool((q == q.round()).all()) and reached > COUNTS
    # A turn or two off the limits they are radians all the same; without limits they turn on.
    far = whole
    if own is not None and bool(torch.isfinite(own).all()):
        far = reached > largest_angle(own) and _turned_back(own, low, high)[1] > _BEYOND
    if not (far or degrees):
        return _Unit()
    if not whole:
        why = f", d{name} is 1/{1 / ratio:.1f} of its derivative" if ratio and degrees else ""
        return _Unit(1.0 / DEGREES, evidence=f"{name} {span}: degrees{why}")
    counts = f"{name} {low:g} to {high:g}, whole numbers: encoder counts"
    if servo is not None:
        return _Unit(*servo[:2], f"{counts}, and dq in units of {servo[2]}")
    if ratio is None or ratio > 0.05:
        return _Unit(None, evidence=counts)
    # Radians per count from dq in rad/s; a power of two per turn where that is near.
    turn = 2.0 * math.pi / ratio
    usual = (2.0 ** round(math.log2(turn)), *_COUNTS)
    per_turn = next((x for x in usual if near(turn, x)), round(turn))
    return _Unit(2.0 * math.pi / per_turn, evidence=counts)


def _percent(
    robot: Robot, log: Log, factors: Sequence[float], ratio: Mapping[int, float]
) -> Choice | None:
    """Positions as percent of each joint's range, from -100 to 100, where degrees leave the limits
    and measured velocities do not contradict; None where they are not such."""
    limits, degree = robot.limits.position, math.radians(1.0)
    if (
        limits is None
        or not bool(torch.isfinite(limits).all())
        or set(factors) != {1.0 / DEGREES}
        or float(log.q.abs().max()) > _FULL
        or any(not near(r, 1.0) for r in ratio.values())
    ):
        return None
    low, high = (log.q.amin(0) * degree).tolist(), (log.q.amax(0) * degree).tolist()
    if all(
        _turned_back(own, a, b)[1] < _BEYOND for own, a, b in zip(limits, low, high, strict=True)
    ):
        return None
    half, middle = (limits[:, 1] - limits[:, 0]) / 200.0, limits.mean(1)
    signals = tuple(s for s in (*PLACES, "dq") if s in log.signals)
    places = tuple(s for s in signals if s != "dq")
    return Choice.by(
        "percent of range",
        Scale(signals, tuple(half.tolist())),
        Shift(places, tuple(middle.tolist())),
    )


def _no_degrees(
    robot: Robot, log: Log, factors: Sequence[float], ratio: Mapping[int, float]
) -> tuple[str, bool] | None:
    """What speaks against degrees, and whether another zero would still make them such: positions
    that leave their limits as degrees, where no velocity says that they are; None for nothing."""
    limits = robot.limits.position
    found, possible = [], True
    for k, factor in enumerate(factors):
        if limits is None or factor != 1.0 / DEGREES or near(ratio.get(k, 0.0), factor):
            continue
        low, high = float(log.q[:, k].min()) * factor, float(log.q[:, k].max()) * factor
        if _turned_back(limits[k], low, high)[1] > _BEYOND:
            found.append(
                f"q{k + 1} {low:.3g} to {high:.3g} rad, limits {float(limits[k, 0]):.3g} to "
                f"{float(limits[k, 1]):.3g}"
            )
            possible &= high - low < float(limits[k, 1] - limits[k, 0]) + 2 * _BEYOND
    if not found:
        return None
    text = "positions are beyond what is taken for radians, and as degrees leave the limits: "
    return f"{text}{'; '.join(found[:3])}: another unit, or the motors' side of gears?", possible


def _beyond(limits: Tensor, low: float, high: float) -> float:
    """How far positions from low to high leave their limits (2,) [rad]."""
    return max(float(limits[0]) - low, high - float(limits[1]), 0.0)


def _turned_back(limits: Tensor, low: float, high: float) -> tuple[float, float]:
    """The whole turns, two at most, that bring positions nearest to their limits (2,), and how far
    they leave them then [rad]."""
    turns = [_TURN * t for t in (0, -1, 1, -2, 2)]
    best = min(turns, key=lambda x: _beyond(limits, low + x, high + x))
    return best, _beyond(limits, low + best, high + best)


def _servo(log: Log, ratio: Mapping[int, float]) -> tuple[float, float, str] | None:
    """Radians a count of q and rad/s a count of dq, and the servo's name, where every velocity is
    the one multiple of its position's derivative that a servo's registers make."""
    if not ratio or log.dq is None or not bool((log.dq == log.dq.round()).all()):
        return None
    for counts, speed, name in _REGISTERS:
        expected = 2.0 * math.pi / counts / speed
        if all(abs(r / expected - 1.0) < _ALIKE for r in ratio.values()):
            return 2.0 * math.pi / counts, speed, name
    return None


def check_zeros(robot: Robot, log: Log, fixes: Collection[str] = ()) -> Check:
    """Positions beyond the limits that whole turns bring back, or half a turn (or 150 degrees) in
    all joints: the zero of counters that begin at the middle of their range."""
    limits = robot.limits.position
    turning = [k for k, kind in enumerate(robot.joint_types) if kind is JointType.REVOLUTE]
    ranges = {
        k: limits[k] for k in turning if limits is not None and torch.isfinite(limits[k]).all()
        and float(limits[k, 1] - limits[k, 0]) < 2.0 * _TURN
    }  # fmt: skip
    low, high = log.q.amin(0).tolist(), log.q.amax(0).tolist()
    out = [k for k, own in ranges.items() if _beyond(own, low[k], high[k]) > _BEYOND]
    if not out:
        return said("zero of positions", "fine")

    def moved_by(common: float) -> tuple[float, ...] | None:
        """An offset of all joints, and whole turns; None where it leaves one beyond its limits."""
        offsets = [0.0] * log.n
        for k in turning:
            offsets[k] = common
            if k in ranges:
                turns, beyond = _turned_back(ranges[k], low[k] + common, high[k] + common)
                if common and beyond > _BEYOND:
                    # A counter may run the other way: its sign is another question.
                    turns, beyond = _turned_back(ranges[k], -high[k] - common, -low[k] - common)
                    turns = -turns
                if beyond > _BEYOND:
                    return None
                # Without an offset, what is within its limits stays.
                offsets[k] += turns if common or k in out else 0.0
        return tuple(offsets)

    options = {"whole turns": moved_by(0.0)}
    if options["whole turns"] is None:
        for middle, name in _MIDDLES.items():
            options[name] = moved_by(-middle)
    places = tuple(s for s in PLACES if s in log.signals)
    choices = [Choice.by(n, Shift(places, x)) for n, x in options.items() if x is not None]
    evidence = "; ".join(
        f"q{k + 1} {low[k]:.3g} to {high[k]:.3g}"
        f", limits {float(ranges[k][0]):.3g} to {float(ranges[k][1]):.3g}"
        for k in out[:3]
    )
    if choices:
        joints = tuple(k for k, x in enumerate(options[choices[0].name] or ()) if x)
        check = said("zero of positions", "wrong", joints=joints, evidence=evidence)
        return with_choices(check, choices, fixes)
    mirrored = all(_beyond(ranges[k], -high[k], -low[k]) < _BEYOND for k in out)
    verdict = "doubtful mirrored" if mirrored else "doubtful"
    return said("zero of positions", verdict, joints=out, evidence=evidence)


def check_jumps(robot: Robot, log: Log) -> Check:
    """Angles wrapped at a whole turn, or other steps that no motion makes."""
    # Angles within one turn that step by a whole one, however often.
    step = torch.cat([part.q.diff(dim=0).abs() for part in log.trajectories()])
    extent = log.q.amax(0) - log.q.amin(0)
    largest = step.amax(0)
    turn = _turn(extent, largest)
    found = [
        *[
            f"q{k + 1} steps by a whole turn {int((step[:, k] > 0.9 * turn).sum())} times"
            for k, kind in enumerate(robot.joint_types)
            if kind is JointType.REVOLUTE
            and float(extent[k]) < 1.01 * turn
            and float(largest[k]) > 0.9 * turn
        ],
        *position_jumps(log),
    ]
    if not found:
        return said("position jumps", "fine")
    joints = []
    for k in range(log.n):
        mended = Unwrap((k,), turn).apply(log)
        if not torch.equal(mended.q, log.q) and robot.joint_types[k] is JointType.REVOLUTE:
            joints.append(k)
    repairs = (Unwrap(tuple(joints), turn),) if joints else ()
    mended = repairs[0].apply(log) if repairs else log
    return judged(
        "position jumps",
        "wrong" if repairs else "doubtful",
        "; ".join(found[:3]),
        joints=tuple(joints),
        fix="number the runs in a column traj" if position_jumps(mended) else None,
    ).mended_by(*repairs)


def _turn(extent: Tensor, step: Tensor) -> float:
    """What a whole turn is in the unit of the positions: nearly the largest extent of a joint, and
    nearly its largest step (n,), where angles are wrapped."""
    wrapped = (step > 0.9 * extent) & (extent > 0)
    for turn in (_TURN, 360.0, 3600.0, 36000.0, *(2.0**k for k in range(9, 25))):
        if bool((wrapped & (extent <= 1.01 * turn) & (step > 0.9 * turn)).any()):
            return turn
    return _TURN


def check_standstill(log: Log) -> Check:
    """Joints that never move, and time in which nothing does."""
    extent = log.q.amax(0) - log.q.amin(0)
    still = tuple(int(k) for k in (extent < STILL).nonzero().flatten())
    speed = torch.cat([p.q.diff(dim=0) / p.t.diff()[:, None] for p in log.trajectories()]).abs()
    fast = column_quantile(speed[:: max(1, len(speed) // 100_000)], 0.95)
    idle = float((speed < 0.02 * fast.clamp(min=1e-9)).all(1).double().mean())
    if still:
        extents = tuple(float(extent[k]) for k in still)
        words = {"s": "s" * (len(still) == 1), "still": STILL}
        return said("standstill", "doubtful", joints=still, estimate=extents, **words)
    verdict = "doubtful idle" if idle > IDLE else "fine"
    return said("standstill", verdict, estimate=idle, percent=100 * idle)
