"""Positions: units, whole turns, standstill."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import torch

from torchid.doctor.case import Case
from torchid.doctor.check import Check, Choice, judged, with_choices, worded_check
from torchid.doctor.repair import PLACES, Map, MappedColumns, Repair, Unwrap, scaled, shifted
from torchid.log.checks import (
    DEGREES,
    MILLIMETRES,
    STILL,
    largest_angle,
    largest_slide,
    near,
    position_jumps,
)
from torchid.robot.model import JointType, joint_list
from torchid.statistics.criteria import BEYOND_LIMIT_RAD
from torchid.statistics.robust import column_quantile
from torchid.typing import Float, Tensor

COUNTS = 100.0
"""Positions beyond this [rad] that are whole numbers are encoder counts."""
_TURN = 2.0 * math.pi
_RPM = _TURN / 60.0
_REGISTERS = (
    (4096.0, 0.229 * _RPM, "0.229 rpm (Dynamixel X, P)"),
    (4096.0, 0.114 * _RPM, "0.114 rpm (Dynamixel MX)"),
    (1228.8, 0.111 * _RPM, "0.111 rpm (Dynamixel AX, RX: 1024 counts are 300 degrees)"),
    (4096.0, 0.732 * _RPM, "0.732 rpm (Feetech HLS)"),
    (4096.0, _TURN / 4096.0, "counts a second (Feetech STS)"),
    (36000.0, math.pi / 180.0, "degrees a second (RMD: a count is 0.01 degrees)"),
)
"""Counts a turn, rad/s a count of velocity, and whose registers they are (makers' manuals)."""
_PARTS_OF_DEGREES = (3600.0, 36000.0, 360000.0)
"""Counts a turn besides powers of two."""
_MIDDLES = {"zero at half a turn": math.pi, "zero at 150 degrees": math.radians(150.0)}
"""Middles of the range that a counter has, a turn or 300 degrees."""
_OWN_UNIT = (
    "say what they are: q=q{j} *[1/GEAR,..] +[ZERO,..] of motors before their gears (tau times "
    "GEAR), q=q{j} rev/COUNTS of counts"
)


@dataclass(frozen=True)
class _Unit:
    """The unit of one joint's q: radians (metres) in it, None where counts are of an unknown part
    of a turn; rad/s in a unit of dq that has one of its own; and why."""

    factor: float | None = 1.0
    rate: float = 1.0
    evidence: str = ""


@dataclass(frozen=True)
class _Units:
    """What the units of all joints are taken for.

    Attributes:
        case: of the log.
        factors, rates: (n,) as of `_Unit`.
    """

    case: Case
    factors: tuple[float, ...]
    rates: tuple[float, ...]

    @cached_property
    def repairs(self) -> tuple[Repair, ...]:
        """Repairs of positions and velocities: a dq in the unit of q has the same fault; one in
        rad/s has not."""
        signals, ratio = self.case.log.signals, _ratios(self.case)
        if set(self.factors) == {1.0}:
            return ()
        rates = tuple(
            f if rate == 1.0 and near(ratio.get(k, 0.0), 1.0) else rate
            for k, (f, rate) in enumerate(zip(self.factors, self.rates, strict=True))
        )
        moved = [scaled(("dq",), rates)] if "dq" in signals and set(rates) != {1.0} else []
        return scaled(tuple(s for s in PLACES if s in signals), self.factors), *moved

    def beyond(self) -> Iterator[tuple[int, float, float]]:
        """Joints that leave their limits in degrees where no velocity says that they are, and from
        where to where they go [rad]."""
        limits, ratio = self.case.robot.limits.position, _ratios(self.case)
        for k, factor in enumerate(self.factors):
            if limits is None or factor != 1.0 / DEGREES or near(ratio.get(k, 0.0), factor):
                continue
            low, high = (factor * float(x) for x in self.case.log.q[:, k].aminmax())
            if _turned_back(limits[k], low, high)[1] > BEYOND_LIMIT_RAD:
                yield k, low, high


def _ratios(case: Case) -> dict[int, float]:
    """dq over the derivative of q, by joint."""
    return {a.joint: a.ratio for a in case.followers}


def check_position_unit(case: Case) -> Check:
    """Degrees or encoder counts in place of radians, and velocities in units of their servos."""
    servo = _servo(case)
    by_joint = [_unit_of(case, k, servo) for k in range(case.robot.n)]
    evidence = [unit.evidence for unit in by_joint if unit.evidence]
    if not evidence:
        size = float(case.log.q.abs().max())
        return judged("position unit", "fine", f"rad (or m): |q| up to {size:.3g}", estimate=1.0)
    units = _most_alike(case, by_joint)
    unknown = [k for k, unit in enumerate(by_joint) if unit.factor is None]
    joints = tuple(k for k, f in enumerate(units.factors) if f != 1.0 or k in unknown)
    beyond = list(units.beyond())
    if choices := _no_degrees(units, beyond):
        text = "positions leave the limits in degrees, and are all within 100: percent of a range"
        if choices[0].name != "percent of range":
            limits = case.robot.limits.position
            assert limits is not None
            each = "; ".join(
                f"q{k + 1} {low:.3g} to {high:.3g} rad, limits {_span(limits[k])}"
                for k, low, high in beyond[:3]
            )
            text = (
                "positions are beyond what is taken for radians, and as degrees leave the limits: "
                f"{each}: another unit, or the motors' side of gears?"
            )
        check = judged("position unit", "wrong", text, joints)
        return with_choices(check, choices, case.fixes)
    more = f"; and {len(evidence) - 3} more" if len(evidence) > 3 else ""
    slides = any(case.robot.joint_types[k] is JointType.PRISMATIC for k in joints)
    ask = f"say how many counts make a turn in {joint_list(unknown)}: q=q{{j}} rev/COUNTS -ZERO"
    return judged(
        "position unit",
        "wrong",
        "; ".join(evidence[:3]) + more,
        joints=joints,
        estimate=tuple(1.0 / units.factors[k] for k in joints),
        unit="per rad, per m" if slides else "per rad",
        fix=ask if unknown else None,
    ).mended_by(*units.repairs)


def _most_alike(case: Case, units: Sequence[_Unit]) -> _Units:
    """The units of all joints. Where most are in one unit, the others are too, unless velocities
    say otherwise: they only stayed near zero, or still."""
    pairs = [(unit.factor or 1.0, unit.rate) for unit in units]
    rotary = [k for k, x in enumerate(case.robot.joint_types) if x is not JointType.PRISMATIC]
    clear = {a.joint for a in case.log.agreements if near(a.ratio, 1.0)}
    for most in {pairs[k] for k in rotary} - {(1.0, 1.0)}:
        if 2 * sum(pairs[k] == most for k in rotary) >= len(rotary):
            pairs = [
                most if k in rotary and k not in clear and pair == (1.0, 1.0) else pair
                for k, pair in enumerate(pairs)
            ]
    factors, rates = zip(*pairs, strict=True)
    return _Units(case, factors, rates)


def _unit_of(case: Case, k: int, servo: _Unit | None) -> _Unit:
    """The unit of joint k's positions (from 0).

    Args:
        case: of the log.
        k: which joint.
        servo: whose registers all velocities fit; None for none's.
    """
    q, ratio, limits = case.log.q[:, k], _ratios(case).get(k), case.robot.limits.position
    own = None if limits is None else limits[k]
    low, high = (float(x) for x in q.aminmax())
    reached, name = max(-low, high), f"q{k + 1}"
    if case.robot.joint_types[k] is JointType.PRISMATIC:
        if reached > largest_slide(own) or (ratio and near(ratio, 1.0 / MILLIMETRES)):
            return _Unit(1.0 / MILLIMETRES, 1.0, f"{name} {low:.4g} to {high:.4g}: millimetres")
        return _Unit()
    degrees = ratio is not None and near(ratio, 1.0 / DEGREES)
    whole = bool((q == q.round()).all()) and reached > COUNTS
    # A turn or two off the limits they are radians all the same; without limits they turn on.
    far = whole
    if own is not None and bool(torch.isfinite(own).all()):
        turned = _turned_back(own, low, high)[1]
        far = reached > largest_angle(own) and turned > BEYOND_LIMIT_RAD
    if not (far or degrees):
        return _Unit()
    if not whole:
        why = f", d{name} is 1/{1 / ratio:.1f} of its derivative" if ratio and degrees else ""
        return _Unit(1.0 / DEGREES, 1.0, f"{name} {low:.4g} to {high:.4g}: degrees{why}")
    counts = f"{name} {low:g} to {high:g}, whole numbers: encoder counts"
    if servo is not None:
        return _Unit(servo.factor, servo.rate, f"{counts}, and dq in units of {servo.evidence}")
    # 0.05: ratio of velocity and position from which on counts have velocities in a unit of their
    # own
    if ratio is None or ratio > 0.05:
        return _Unit(None, 1.0, counts)
    # Radians per count from dq in rad/s; a power of two per turn where that is near.
    turn = _TURN / ratio
    usual = (2.0 ** round(math.log2(turn)), *_PARTS_OF_DEGREES)
    return _Unit(_TURN / next((x for x in usual if near(turn, x)), round(turn)), 1.0, counts)


def _servo(case: Case) -> _Unit | None:
    """The unit of servos in whose registers every velocity is the one multiple of its position's
    derivative that it is."""
    dq, ratios = case.log.dq, _ratios(case).values()
    if not ratios or dq is None or not bool((dq == dq.round()).all()):
        return None
    for counts, speed, name in _REGISTERS:
        expected = _TURN / counts / speed
        # 0.03: deviation of a measured ratio of velocity and position from what registers make
        if all(abs(r / expected - 1.0) < 0.03 for r in ratios):
            return _Unit(_TURN / counts, speed, name)
    return None


def _no_degrees(units: _Units, beyond: Sequence[tuple[int, float, float]]) -> list[Choice]:
    """What positions may be besides degrees in which they leave their limits: percent of a range,
    or another unit, of which degrees with another zero are one where they would fit; empty where
    nothing speaks against degrees."""
    case, limits = units.case, units.case.robot.limits.position
    if limits is None or not beyond:
        return []
    degrees = Choice.by("degrees", *units.repairs)
    bounded = bool(torch.isfinite(limits).all()) and set(units.factors) == {1.0 / DEGREES}
    # 100.5: positions in percent of a range are below
    within = float(case.log.q.abs().max()) <= 100.5
    if bounded and within and all(near(r, 1.0) for r in _ratios(case).values()):
        # From -100 to 100 of each joint's range.
        half, middle = ((limits[:, 1] - limits[:, 0]) / 200.0).tolist(), limits.mean(1).tolist()
        signals = tuple(s for s in (*PLACES, "dq") if s in case.log.signals)
        percent = MappedColumns(signals, Map.of(case.log.n, factors=half, offsets=middle))
        return [Choice.by("percent of range", percent), degrees]
    wide = (
        high - low < float(limits[k, 1] - limits[k, 0]) + 2 * BEYOND_LIMIT_RAD
        for k, low, high in beyond
    )
    return [*([degrees] if all(wide) else []), Choice("unit of its own", _OWN_UNIT)]


def _span(limits: Tensor) -> str:
    return f"{float(limits[0]):.3g} to {float(limits[1]):.3g}"


def _beyond(limits: Tensor, low: float, high: float) -> float:
    """How far positions from low to high leave their limits (2,) [rad]."""
    return max(float(limits[0]) - low, high - float(limits[1]), 0.0)


def _turned_back(limits: Tensor, low: float, high: float) -> tuple[float, float]:
    """The whole turns, two at most, that bring positions nearest to their limits (2,), and how far
    they leave them then [rad]."""
    turns = [_TURN * t for t in (0, -1, 1, -2, 2)]
    best = min(turns, key=lambda x: _beyond(limits, low + x, high + x))
    return best, _beyond(limits, low + best, high + best)


def check_zeros(case: Case) -> Sequence[Check]:
    """Positions beyond the limits that whole turns bring back, or half a turn (or 150 degrees) in
    all joints: the zero of counters that begin at the middle of their range."""
    if case.counts:
        return ()
    limits = case.robot.limits.position
    ranges = {
        k: limits[k]
        for k in case.turning
        if limits is not None and float(limits[k, 1] - limits[k, 0]) < 2.0 * _TURN
    }
    low, high = case.log.q.amin(0).tolist(), case.log.q.amax(0).tolist()
    out = [k for k, own in ranges.items() if _beyond(own, low[k], high[k]) > BEYOND_LIMIT_RAD]
    if not out:
        return [worded_check("zero of positions", "fine")]
    # Whole turns of the joints that are out; where these do not do, one zero of all.
    options = {"whole turns": {k: _back(ranges[k], low[k], high[k]) for k in out}}
    if None in options["whole turns"].values():
        for name, middle in _MIDDLES.items():
            options[name] = {
                k: _off_middle(ranges.get(k), low[k], high[k], middle) for k in case.turning
            }
    places = tuple(s for s in PLACES if s in case.log.signals)
    choices: list[Choice] = []
    joints = tuple(out)
    for name, moved in options.items():
        offsets = [moved.get(k, 0.0) for k in range(case.log.n)]
        if None not in offsets:
            joints = joints if choices else tuple(k for k, x in enumerate(offsets) if x)
            choices.append(Choice.by(name, shifted(places, [x or 0.0 for x in offsets])))
    evidence = "; ".join(
        f"q{k + 1} {low[k]:.3g} to {high[k]:.3g}, limits {_span(ranges[k])}" for k in out[:3]
    )
    if choices:
        check = worded_check("zero of positions", "wrong", joints=joints, evidence=evidence)
        return [with_choices(check, choices, case.fixes)]
    mirrored = all(_beyond(ranges[k], -high[k], -low[k]) < BEYOND_LIMIT_RAD for k in out)
    verdict = "doubtful mirrored" if mirrored else "doubtful"
    return [worded_check("zero of positions", verdict, joints=out, evidence=evidence)]


def _back(limits: Tensor, low: float, high: float) -> float | None:
    """Whole turns that bring positions within their limits; None where none do."""
    turns, beyond = _turned_back(limits, low, high)
    return turns if beyond <= BEYOND_LIMIT_RAD else None


def _off_middle(limits: Tensor | None, low: float, high: float, middle: float) -> float | None:
    """The offset of a counter whose zero is at its middle, with whole turns where it has limits. It
    may run the other way: its sign is another question."""
    if limits is None:
        return -middle
    turns = _back(limits, low - middle, high - middle)
    if turns is None and (turns := _back(limits, middle - high, middle - low)) is not None:
        turns = -turns
    return None if turns is None else turns - middle


def check_jumps(case: Case) -> Check:
    """Angles wrapped at a whole turn, or other steps that no motion makes."""
    log = case.log
    # Angles within one turn that step by a whole one, however often.
    step = torch.cat([part.q.diff(dim=0).abs() for part in log.trajectories()])
    turn = _turn(case.extent, step.amax(0))
    whole = (step > 0.9 * turn).sum(0)
    jumps = [
        *(
            f"q{k + 1} steps by a whole turn {int(whole[k])} times"
            for k in case.turning
            if float(case.extent[k]) < 1.01 * turn and bool(whole[k])
        ),
        *position_jumps(log),
    ]
    if not jumps:
        return worded_check("position jumps", "fine")
    mended = Unwrap(tuple(case.turning), turn).apply(log)
    joints = tuple((mended.q != log.q).any(0).nonzero().flatten().tolist())
    return judged(
        "position jumps",
        "wrong" if joints else "doubtful",
        "; ".join(jumps[:3]),
        joints=joints,
        fix="number the runs in a column traj" if position_jumps(mended) else None,
    ).mended_by(*([Unwrap(joints, turn)] if joints else []))


def _turn(extent: Float[Tensor, " n"], step: Float[Tensor, " n"]) -> float:
    """What a whole turn is in the unit of the positions: nearly the largest extent of a joint, and
    nearly its largest step, where angles are wrapped."""
    wrapped = (step > 0.9 * extent) & (extent > 0)
    for turn in (_TURN, 360.0, 3600.0, 36000.0, *(2.0**k for k in range(9, 25))):
        if bool((wrapped & (extent <= 1.01 * turn) & (step > 0.9 * turn)).any()):
            return turn
    return _TURN


def check_standstill(case: Case) -> Check:
    """Joints that never move, and time in which nothing does."""
    still = (case.extent < STILL).nonzero().flatten().tolist()
    if still:
        extents, s = tuple(case.extent[still].tolist()), "s" * (len(still) == 1)
        return worded_check(
            "standstill", "doubtful", joints=still, estimate=extents, s=s, still=STILL
        )
    parts = case.log.trajectories()
    speed = torch.cat([p.q.diff(dim=0) / p.t.diff()[:, None] for p in parts]).abs()
    fast = column_quantile(speed[:: max(1, len(speed) // 100_000)], 0.95)
    idle = float((speed < 0.02 * fast.clamp(min=1e-9)).all(1).double().mean())
    # 0.5: share of the log in which nothing may move
    verdict = "doubtful idle" if idle > 0.5 else "fine"
    return worded_check("standstill", verdict, estimate=idle, percent=100 * idle)
