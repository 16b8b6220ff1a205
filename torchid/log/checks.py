"""Is this log what the identification takes it for: finite, in order, in SI units, this robot's?

What cannot be used raises LogError; what is merely odd comes back as warnings.
"""

import math
import re
from collections.abc import Iterator, Sequence

import numpy as np
import torch

from torchid.errors import LogError
from torchid.log.base_motion import COORDINATES, POSITION, QUATERNION
from torchid.log.columns import PREFIXES, columns_of, sensorless
from torchid.log.model import Log
from torchid.log.movement import Agreement
from torchid.log.stamps import check_increasing, place_of
from torchid.log.units import STEPS
from torchid.statistics.robust import column_quantile
from torchid.typing import Float, Tensor

NO_TORQUE = 1e-9  # what is below is no torque: zero, or what a driver leaves there [N m, N or A]
STILL = 1e-4  # a joint whose position varies less does not move [rad or m]
SLOW_STEP_S = 0.5  # no arm's dynamics are logged with longer steps
FOLLOWS = 0.95  # correlation above which dq is the velocity, up to its unit
FAR = 4.0 * math.pi  # an angle beyond may be in degrees, if the joint does not turn on [rad]
DEGREES = 180.0 / math.pi
MILLIMETRES = 1000.0
RPM = 30.0 / math.pi
TIME_UNITS = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}


def check_log(
    log: Log,
    *,
    n: int,
    robot_name: str,
    position_limits: Float[Tensor, "n 2"] | None = None,
    prismatic: Sequence[bool] = (),
    standing: bool = False,
    moving_base: bool = False,
    force: bool = False,
) -> tuple[str, ...]:
    """Refuse a log that cannot be what it should be; return what is odd about the others.

    Args:
        log: as it was read, before any resampling.
        n: number of joints of the robot.
        robot_name: for the messages.
        position_limits: (n, 2) lower and upper [rad or m]; not finite where unknown.
        prismatic: n times whether the joint slides; empty: none does.
        standing: whether a log in which nothing moves may be of use.
        moving_base: whether the first six coordinates are those of a base that moves.
        force: whether units that look wrong are said, and not refused.

    Returns:
        Warnings, one sentence each: joints that never move or have no torque, or those of another
        joint, dq that is not the derivative of q.

    Raises:
        LogError: another number of joints, NaN or infinity, time that does not increase or is not
            in seconds, positions or velocities in degrees, no motion, no torque at all.
    """
    slides = tuple(prismatic) or (False,) * n
    if len(slides) != n or (position_limits is not None and position_limits.shape != (n, 2)):
        raise ValueError(f"prismatic and position_limits must have {n} entries")
    check_joints(log, robot_name, n, moving_base)
    check_finite(log)
    check_increasing(log)
    first = COORDINATES if moving_base else 0
    forced = []
    try:
        _check_units(log, position_limits, slides, first)
    except LogError as error:
        if not force:
            raise
        forced = [f"{error.problem} It is taken as it is all the same."]
    extent = log.q.amax(0) - log.q.amin(0)
    if float(extent.max()) < STILL and not standing:
        raise LogError(
            f"{log.label}: no joint moves.",
            got=f"positions that vary by {float(extent.max()):.1g} at most",
            expected="a motion, which alone shows masses and friction",
        )
    return (
        *forced,
        *_turning_on(log, position_limits, slides, first),
        *position_jumps(log),
        *_spans(log),
        *[
            f"joint {k + 1} never moves (q{k + 1} varies by {float(extent[k]):.1g}): "
            "its parameters cannot be identified from this log."
            for k in range(log.n)
            if float(extent[k]) < STILL and k >= first
        ],
        *_copied(log),
        *_no_torque(log, first),
        *([] if forced else _velocity_warnings(log)),
    )


def _check_units(log: Log, limits: Tensor | None, slides: Sequence[bool], first: int) -> None:
    """Refuse positions, time and velocities in other units."""
    _check_position_units(log, limits, slides, first)
    # Refuse time in milli-, micro- or nanoseconds, or counted in samples.
    step = max(steps.median for steps in log.steps)
    clear = [a for a in log.agreements if a.correlation > FOLLOWS]
    for factor, unit in TIME_UNITS.items():
        if clear and all(near(a.ratio, factor) for a in clear):
            k, ratio = clear[0].joint + 1, clear[0].ratio
            why = f"looks like {unit}: dq{k} is {ratio:.4g} times the derivative of q{k}"
            refuse_time(log, why, step)
    if step > SLOW_STEP_S and not any(0.5 < a.ratio < 2.0 for a in clear):
        why = "and dq disagrees" if clear else "too long for a robot"
        refuse_time(log, f"does not look like seconds: its median step is {step:g}, {why}", step)
    _check_velocity_unit(log, slides)


def check_finite(log: Log, *, commands: bool = True) -> None:
    """Refuse a log with empty cells, NaN or infinity in its columns; those of commands count only
    where asked for, for a command that is not there was not sent."""
    log = log if commands or log.u is None else log.replace(u=None)
    bad = {name: ~np.isfinite(column) for name, column in columns_of(log).items()}
    wrong = {name: mask for name, mask in bad.items() if mask.any()}
    if not wrong:
        return
    name, mask = next(iter(wrong.items()))
    first = int(mask.argmax())
    more = f", and {len(wrong) - 1} more columns have some" if len(wrong) > 1 else ""
    way_out = "cut out those rows; resampling bridges the gap or splits the trajectory there"
    # What never has a number was not recorded.
    empty = [key for key, mask in wrong.items() if mask.all()]
    for prefix in dict.fromkeys(re.sub(r"\d+$", "", key) for key in empty):
        own = [key for key in empty if re.fullmatch(rf"{prefix}\d*", key)]
        if len(own) < log.n and (said := sensorless(own)):
            way_out = said
        elif prefix in ("dq", "ddq", "tau", "i"):
            way_out = f'leave them out: `columns="{prefix}=none"`'
    raise LogError(
        f"{log.label}: column {name} has {int(mask.sum())} values that are empty, NaN or "
        f"infinite, the first in {place_of(log, first)}{more}.",
        got=", ".join(f"{key}: {int(m.sum())}" for key, m in list(wrong.items())[:10]),
        expected="a number in every row",
        hint=way_out,
    )


def _check_position_units(
    log: Log, limits: Tensor | None, slides: Sequence[bool], first: int
) -> None:
    for k, slide in enumerate(slides):
        if k < first:  # a base may go anywhere
            continue
        low, high = float(log.q[:, k].min()), float(log.q[:, k].max())
        own = None if limits is None else limits[k]
        limit = largest_slide(own) if slide else largest_angle(own)
        reached = max(-low, high)
        if reached <= limit:
            continue
        # The unit that brings it back into what the joint can do.
        units = {1e3: "millimetres", 1e6: "micrometres"} if slide else {DEGREES: "degrees"}
        per = next((x for x in units if reached / x <= limit), None)
        unit, how = "metres" if slide else "radians", "slide" if slide else "turn"
        ways = {1e3: "divide {} by 1000", 1e6: "divide {} by 1e6", DEGREES: _in_degrees(log)}
        others = " nor ".join(units.values())
        raise LogError(
            f"{log.label}: q{k + 1} looks like {units[per]}."
            if per is not None
            else f"{log.label}: q{k + 1} is in neither {unit} nor {others}.",
            got=f"{low:.4g} to {high:.4g}",
            expected=f"{unit}, at most {limit:.3g} for this {'prismatic ' if slide else ''}joint",
            hint=f"{ways[per].format(f'q{k + 1}')}; if the joint does {how} that far, say so in "
            "the robot's position limits"
            if per is not None
            else f"is q{k + 1} in steps of an encoder? `columns=...` takes a factor",
        )


def _spans(log: Log) -> Iterator[str]:
    """Trajectories that last much longer than their rows: a stamp that is damaged, or a pause."""
    parts = zip(log.names, log.slices(), log.duration, log.steps, strict=True)
    for name, rows, span, steps in parts:
        count = rows.stop - rows.start
        own = steps.median * (count - 1)
        # 10.0: times as long as its rows take: no span of theirs
        if span > 10.0 * own:
            yield (
                f"'{name}' lasts {span:.4g} s, and its {count} rows {own:.4g} s at their usual "
                f"step: a stamp may be damaged after row {int(log.t[rows].diff().argmax()) + 1}."
            )


def _turning_on(log: Log, limits: Tensor | None, slides: Sequence[bool], first: int) -> list[str]:
    """Joints without limits that reach far: of motors, or in degrees."""
    reach = log.q.abs().amax(0).tolist()
    far = [
        k
        for k, slide in enumerate(slides)
        if k >= first and not slide and reach[k] > FAR
        and math.isinf(largest_angle(None if limits is None else limits[k]))
    ]  # fmt: skip
    if not far:
        return []
    names = ", ".join(f"q{k + 1}" for k in far)
    return [
        f"{log.label}: {names} up to {max(reach[k] for k in far):.4g}, without limits: taken for "
        f"radians of what turns on. Of degrees: {_in_degrees(log).format()}"
    ]


def check_joints(log: Log, robot_name: str, n: int, moving_base: bool = False) -> None:
    """Refuse a log of another number of joints than a robot's n."""
    if log.n == n:
        return
    hint = None
    if moving_base and log.n == n - COORDINATES:
        raise LogError(
            f"{log.label} does not hold the motion of the base, which moves.",
            got=f"{log.n} joints",
            expected=f"{log.n} joints, and the base's pose: {', '.join(POSITION + QUATERNION)}",
            hint="for a base that is held: `base='fixed'`",
        )
    if not moving_base and log.n == n + COORDINATES:
        hint = "does it hold the motion of the base? Then `base='moving'`"
    elif log.n > n:
        own = ",".join(f"{PREFIXES[s]}={PREFIXES[s]}{{1..{n}}}" for s in log.signals)
        hint = f'the first {n} joints alone: `columns="{own}"`, where its columns are q1..'
    else:
        hint = "joints that were not logged are held (`lock=...`), or left out (`tip=...`)"
    raise LogError(
        f"{log.label} has another number of joints than robot '{robot_name}'.",
        got=f"{log.n} (q1..q{log.n})",
        expected=f"{n} (q1..q{n})",
        hint=hint,
    )


def _in_degrees(log: Log) -> str:
    """How a log in degrees is read: its positions, and velocities that go with them."""
    own = [f"{key}={key}{{{{j}}}} deg" for key in ("q", "ql", "u") if key in log.signals]
    if any(near(a.ratio, 1.0) for a in log.agreements):
        own.append("dq=dq{{j}} deg/s")
    return f'read it with `columns="{",".join(own)}"`, where its columns are q1..'


def largest_angle(limits: Tensor | None) -> float:
    """The largest |q| of a revolute joint that is taken for radians: what its file says. One
    without limits turns on, as motors do."""
    if limits is None or not torch.isfinite(limits).all():
        return math.inf
    return max(2.0 * math.pi, 2.0 * float(limits.abs().max()))


def largest_slide(limits: Tensor | None) -> float:
    """The largest |q| of a prismatic joint that is taken for metres."""
    if limits is None or torch.isnan(limits).any():
        return 10.0
    return max(1.0, 10.0 * float(limits.abs().max()))


def dead_velocities(log: Log) -> list[int]:
    """Joints (from 0) that move while their dq never changes."""
    if log.dq is None:
        return []
    moves = log.q.amax(0) - log.q.amin(0) > log.least_way
    return (moves & (log.dq.amax(0) == log.dq.amin(0))).nonzero().flatten().tolist()


def refuse_time(log: Log, why: str, step: float) -> None:
    """Refuse time that is in another unit than seconds."""
    raise LogError(
        f"{log.label}: t {why}.",
        got=f"a median step of {step:g}, t from {float(log.t[0]):g} to {float(log.t[-1]):g}",
        expected="seconds",
        hint=f'read it with `columns="t=t {unit}"`, where its column is t'
        if (unit := next((u for most, u in STEPS.items() if step < most), ""))
        else "convert t to seconds, or dq to the unit of q per second",
    )


def _check_velocity_unit(log: Log, slides: Sequence[bool]) -> None:
    for a in log.agreements:
        column = f"dq{a.joint + 1}"
        if a.correlation < -FOLLOWS:
            raise LogError(
                f"{log.label}: {column} has the opposite sign of the change of q{a.joint + 1}.",
                got=f"correlation {a.correlation:.3f}",
                expected="velocities in the direction of the positions",
            )
        if slides[a.joint] or a.correlation < FOLLOWS:
            continue
        q, ratio = f"q{a.joint + 1}", a.ratio
        if near(ratio, DEGREES):
            named, looks, unit = column, "degrees per second", "rad/s"
            got = f"{ratio:.1f} times the derivative of {q}"
        elif near(ratio, 1.0 / DEGREES):
            named, looks, unit = q, "degrees", "rad"
            got = f"{column} is 1/{1.0 / ratio:.1f} of its derivative"
        else:
            continue
        raise LogError(
            f"{log.label}: the units of {named} look like {looks}.",
            got=got,
            expected=unit,
            hint=f"multiply {named} by pi/180",
        )


def named_ratio(ratio: float) -> tuple[float, str | None]:
    """The exact ratio of a known unit, if this is one."""
    for factor, name in ((DEGREES, "deg/s"), (RPM, "rpm"), (1e3, "mrad/s"), (1.0, "rad/s")):
        if near(ratio, factor):
            return factor, name
    return ratio, None


def own_units(log: Log) -> dict[int, float]:
    """Joints whose q, and command, are in a unit of their own such as a fraction of a range, by
    the measured velocities: radians (or metres) per unit. Velocities that are in a known unit, or
    in another one on all joints alike, say nothing of q."""
    following = [a for a in log.agreements if a.correlation > FOLLOWS]
    # The least-squares slope: velocities late or coarse make the ratio too large.
    slopes = {a.joint: a.ratio * a.correlation for a in following}
    # 0.2: a measured velocity that differs from the rate of q by more tells q's unit
    odd = {
        a.joint: slopes[a.joint]
        for a in following
        if abs(slopes[a.joint] - 1) > 0.2 and named_ratio(a.ratio)[1] is None
    }
    if 1 < len(odd) == len(slopes) and near(max(odd.values()), min(odd.values())):
        return {}
    return odd


def near(ratio: float, factor: float) -> bool:
    """Whether a measured ratio is this factor, within 7 %."""
    return 0.93 < ratio / factor < 1.07


def position_jumps(log: Log) -> list[str]:
    """Steps of a position that no motion makes: an angle wrapped at +-pi, or two runs in one."""
    jumps = []
    for part in log.trajectories():
        if part.samples < 20:
            continue
        dt = part.t.diff()
        for j in range(part.n):
            step = part.q[:, j].diff().abs()
            speed = step / dt
            # A sample is enough, and torch.quantile takes no more than 16 million numbers.
            usual = column_quantile(speed[:: max(1, len(dt) // 100_000), None], 0.99)[0]
            # 0.05: a step of a position below this is never called a jump [rad or m]
            jump = (step > 0.05) & (speed > 10 * usual)
            if not bool(jump.any()):
                continue
            k = int(jump.to(torch.uint8).argmax())
            jumps.append(
                f"{part.names[0]}: q{j + 1} jumps by {float(step[k]):.3g} within one step at "
                f"t = {float(part.t[k]):.4g} s: unwrap the angle, or number the runs in a column "
                "traj"
            )
    return jumps


def _copied(log: Log) -> list[str]:
    """Joints that hold another joint's numbers: no two sensors measure the same in every sample."""
    copies = []
    measured = ("tau", log.tau) if log.tau is not None else ("i", log.current)
    for name, signal in (("q", log.q), measured):
        if signal is None:
            continue
        for k in range(log.n):
            own = signal[:, k]
            same = (
                j
                for j in range(k)
                if torch.equal(signal[:100, j], own[:100]) and torch.equal(signal[:, j], own)
            )
            first = next(same, None)
            if first is not None and bool((own != own[0]).any()):
                copies.append(
                    f"{name}{k + 1} is the same as {name}{first + 1} in every row: was a column "
                    "copied?"
                )
    return copies


def _no_torque(log: Log, first: int) -> list[str]:
    signal, name = (log.tau, "tau") if log.tau is not None else (log.current, "i")
    if signal is None:
        return []
    zero = signal.abs().amax(0) < NO_TORQUE
    if zero.all():
        raise LogError(
            f"{log.label}: all torques are zero.",
            got=f"0 in {name}1..{name}{log.n}" if log.n > 1 else f"0 in {name}1",
            expected="measured torques or currents",
            hint=f'there is no torque here: with commands u1.. `columns="{name}=none"`',
        )
    return [
        f"joint {k + 1} has no torque: {name}{k + 1} is zero throughout."
        for k in range(first, log.n)
        if bool(zero[k])
    ]


def _velocity_warnings(log: Log) -> list[str]:
    """What is odd about dq, the joints for which it is odd in the same way in one sentence."""
    agreement = log.agreements
    warnings = [f"dq{k + 1} never changes, while q{k + 1} does." for k in dead_velocities(log)]
    scaled = [a for a in agreement if a.correlation >= FOLLOWS and not 0.5 < a.ratio < 2.0]
    if scaled:
        low, high = min(a.ratio for a in scaled), max(a.ratio for a in scaled)
        size = f"{low:.3g}" if high < 1.01 * low else f"{low:.3g} to {high:.3g}"
        if len(scaled) == len(agreement) and high < 1.05 * low:
            raise LogError(
                f"{log.label}: every measured velocity is {size} times the derivative of its "
                "position: the time stamps, or the units of dq, are wrong by that factor.",
                got=f"dq = {size} x d(q)/dt",
                expected="dq = d(q)/dt",
                hint="mend the column t, or the dq columns",
            )
        warnings.append(
            f"{_list(scaled)} {size} times the derivative of q: "
            "the time stamps, or the units of dq, are wrong by that factor."
        )
    other = [a for a in agreement if abs(a.correlation) < FOLLOWS]
    if other:
        worst = min(a.correlation for a in other)
        warnings.append(
            f"{_list(other)} not the derivative of q (the correlation of its integral with q is "
            f"down to {worst:.2f})."
        )
    return [f"{log.label}: {warning}" for warning in warnings]


def _list(records: Sequence[Agreement]) -> str:
    names = ", ".join(f"dq{a.joint + 1}" for a in records)
    return f"{names} {'is' if len(records) == 1 else 'are'}"
