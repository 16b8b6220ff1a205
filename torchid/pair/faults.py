"""Faults of a simulator's set-up, each by the signature that it leaves in the pair of logs.

Every test holds the simulator's log against the arm's: what both have is no fault. Those of the
servo's law and of gravity, friction and rotors are regressions on each side's own motion, so they
do not ask that both moved alike.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.optimize import linear_sum_assignment

from torchid.doctor.hypothesis import Hypothesis, Judge
from torchid.doctor.kind import check_kind, holds_no_gravity
from torchid.doctor.samples import samples
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.log.filtering import central_difference, low_passed
from torchid.log.model import Log
from torchid.log.sampling import resample
from torchid.pair.align import SAME_CLOCK, Both, correlations
from torchid.pair.record import Fault, FaultName, Side
from torchid.robot.model import Robot, joint_list
from torchid.typing import Tensor
from torchid.yaml_data import parsed_yaml

ALIKE = 0.9
"""Correlation of two motions from which they are one joint's."""

TURNED = 0.3
"""What is left of a torque, relative to it, below which the other one is the same turned round."""

FLAT = 0.7
"""Share of the samples near a limit that lie at it: of a smooth peak it is a half."""

BLURRED = 0.1
"""Noise over a limit from which a limit cannot be told."""

AT_LIMIT = 0.01
"""Share of the time at a limit from which a signal is clipped."""

BEYOND = 1.05
"""The other side's largest value over the limit from which the limit is one side's alone."""

STOPS = 2e-3
"""How exactly a joint stops at its limit [rad or m]: simulators' limits give way."""

HELD = 1.6
"""Periods of control, one over the other, from which they are different."""

LONGEST_HOLD = 0.2
"""A signal that does not change for longer is at rest [s]."""

SERVO_BAND = 20.0
"""In which servo's laws are fitted [Hz]."""

LAW = 0.95
"""Share of the torque's variance from which a servo is a law of position and velocity error."""

DEGREES = 180 / math.pi
UNITS = 1.25
"""Factor about 57.3 within which a ratio of gains is one of degrees to radians."""
GAINS = 1.5
"""Ratio of gains from which they are different."""

SOME, NONE = 0.7, 0.3
"""Coefficients of the model's gravity torque that mean that it is there, or is not."""

SURE = 5.0
"""Standard deviations from which a coefficient is there."""


_TEXTS: dict[str, dict[str, str]] = parsed_yaml(
    Path(__file__).with_name("faults.yaml").read_text(encoding="utf-8")
)


def fault_of(
    name: FaultName, joints: Sequence[int], side: Side, value: float, by: str = "", /, **words: Any
) -> Fault:
    """A fault as faults.yaml says it, with words and numbers in their places.

    Args:
        name, joints, side, value: as of a Fault.
        by: which of several ways to see it.
        words: of the texts, by name.
    """
    own = _TEXTS[f"{name}, {by}" if by else name]
    known = {"joints": joint_list(joints), "side": side, "value": value, **words}
    meaning, remedy = (own[text].format(**known) for text in ("meaning", "remedy"))
    unit = words.get("unit") or own["unit"]
    return Fault(name, tuple(joints), side, value, unit, meaning, remedy)


@dataclass(frozen=True)
class Mended:
    """The simulator's log with its joints in the arm's order and sense, and what was wrong."""

    log: Log
    both: list[Both]
    faults: list[Fault]


def joint_faults(simulated: Log, both: list[Both]) -> Mended:
    """Joints in another order, and signals turned round."""
    qs, qr = (torch.cat([getattr(b, s)["q"] for b in both]).numpy() for s in ("simulated", "real"))
    found: list[Fault] = []
    n = qs.shape[1]
    alike = correlations(qs, qr)
    _, theirs = linear_sum_assignment(-np.abs(alike).T)
    moved = [
        j
        for j in range(n)
        if theirs[j] != j and abs(alike[theirs[j], j]) > ALIKE and abs(alike[j, j]) < ALIKE
    ]
    order = list(range(n))
    if len(moved) > 1 and sorted(theirs[j] for j in moved) == moved:
        for j in moved:
            order[j] = int(theirs[j])
        says = ", ".join(f"{j + 1} moves as {order[j] + 1} of the simulator" for j in moved)
        found.append(fault_of("joint_order", moved, "simulator", float(len(moved)), says=says))
    # Signs, in the arm's order.
    turned = torch.ones(n, dtype=torch.float64)
    for j in range(n):
        if alike[order[j], j] < -ALIKE:
            turned[j] = -1
    opposite = torch.ones(n, dtype=torch.float64)
    if all("tau" in b.simulated for b in both):
        ts, tr = (torch.cat([_slow(b, s) for b in both]) for s in ("simulated", "real"))
        left = (tr + ts[:, order]).square().mean(0).sqrt() / tr.square().mean(0).sqrt().clamp(
            min=1e-12
        )
        opposite = torch.where(left < TURNED, -1.0, 1.0).double()
    wrong = [j for j in range(n) if turned[j] < 0 or opposite[j] < 0]
    if wrong:
        kinds = {
            ("position" if turned[j] < 0 else "", "torque" if opposite[j] < 0 else "")
            for j in wrong
        }
        what = " and ".join(dict.fromkeys(w for pair in kinds for w in pair if w))
        found.append(fault_of("sign", wrong, "simulator", -1.0, what=what))
    if not found:
        return Mended(simulated, both, [])
    signs = {"q": turned, "dq": turned, "tau": opposite}

    def mended(name: str, x: Tensor) -> Tensor:
        return x[:, order] * signs[name] if name in signs else x

    changed = {k: mended(k, x) for k, x in simulated.signals.items() if k in signs}
    both = [replace(b, simulated={k: mended(k, x) for k, x in b.simulated.items()}) for b in both]
    return Mended(simulated.replace(**changed), both, found)


def _slow(both: Both, side: str) -> Tensor:
    """Torque (T, n) below the servo's band."""
    x = getattr(both, side)["tau"]
    rate = 1 / both.dt
    return low_passed(x.T, rate, min(SERVO_BAND, 0.2 * rate)).T


def clock_faults(both: Sequence[Both]) -> list[Fault]:
    """A clock that runs at another rate."""
    rate = float(np.median([b.clock.rate for b in both]))
    if abs(rate - 1) < SAME_CLOCK:
        return []
    return [fault_of("time_step", (), "simulator", rate)]


def clipping_faults(both: Sequence[Both]) -> list[Fault]:
    """Signals that stop at a limit which the other side goes beyond."""
    found: list[tuple[Side, int, float, str, str]] = []
    for name, what, unit, exact in (
        ("u", "command", "rad", 1e-6),
        ("q", "position", "rad", STOPS),
        ("tau", "torque", "N m", 1e-4),
    ):
        if any(name not in b.simulated for b in both):
            continue
        s, r = (torch.cat([getattr(b, k)[name] for b in both]) for k in ("simulated", "real"))
        sides: tuple[tuple[Side, Tensor, Tensor], ...] = (("simulator", s, r), ("arm", r, s))
        for side, own, other in sides:
            for j in range(own.shape[1]):
                limit = _limit(own[:, j], other[:, j], exact, name == "q")
                if limit is not None and name == "q" and not _pushed(both, side, j, limit):
                    continue
                if limit is not None:
                    found.append((side, j, limit, what, unit))
    out = []
    for side, what, unit in dict.fromkeys((f[0], f[3], f[4]) for f in found):
        these = [f for f in found if (f[0], f[3]) == (side, what)]
        words = {"what": what, "unit": unit, "levels": ", ".join(f"{f[2]:.4g}" for f in these)}
        out.append(fault_of("clipped", [f[1] for f in these], side, these[0][2], **words))
    return out


def _pushed(both: Sequence[Both], side: str, j: int, limit: float) -> bool:
    """Whether a joint is commanded far beyond a position that it stops at: a joint that friction
    holds where it turns stops there, too."""
    signals = [b.simulated if side == "simulator" else b.real for b in both]
    if any("u" not in x for x in signals):
        return False
    u, q = (torch.cat([x[name][:, j] for x in signals]) for name in ("u", "q"))
    at = (q - limit).abs() < STOPS
    if not bool(at.any()) or bool(at.all()):
        return False
    usual = float((u - q)[~at].abs().median())
    return float((u - q)[at].abs().quantile(0.9)) > max(5 * usual, 10 * STOPS)


def _limit(own: Tensor, other: Tensor, exact: float, absolute: bool) -> float | None:
    """The limit at which a signal (T,) stops; None if at none."""
    for sign in (1.0, -1.0):
        x, y = sign * own, sign * other
        # Noise of one sample, from second differences.
        noise = float((x[2:] - 2 * x[1:-1] + x[:-2]).abs().median()) / 0.6745 / 6**0.5
        level = float(x.max())
        size = 1.0 if absolute else max(abs(level), 1e-12)
        tolerance = exact * size + 6 * noise
        at, near = x >= level - tolerance, x >= level - 4 * tolerance
        # A plateau as blurred as that may be friction, and tells of no limit.
        if not absolute and (level <= 0 or 6 * noise > BLURRED * level):
            continue
        if float(at.double().mean()) < AT_LIMIT or at.sum() < FLAT * near.sum():
            continue
        # The level of a plateau with noise is its middle.
        plateau = float(x[at].median())
        beyond = (BEYOND - 1) * (
            float(own.max() - own.min()) if absolute else abs(plateau)
        ) + tolerance
        if float(y.max()) > plateau + beyond and float((y - x)[at].abs().median()) > tolerance:
            return sign * plateau
    return None


def held_control(simulated: Log, real: Log, rate: float) -> list[Fault]:
    """Commands or torques that change more seldom on one side."""
    steps = [1 / float(np.median(log.rates)) for log in (simulated, real)]
    steps[0] /= rate
    for name, what in (("u", "commands"), ("tau", "torques")):
        if name not in simulated.signals or name not in real.signals:
            continue
        periods = [_period(simulated, name), _period(real, name)]
        periods[0] /= rate
        longest = max(*steps, min(periods))
        k = int(np.argmax(periods))
        if periods[k] < HELD * longest:
            continue
        if name == "tau" and _peaked((real, simulated)[k], name, periods[k]):
            continue
        side: Side = "simulator" if k == 0 else "arm"
        other = 1e3 * max(periods[1 - k], steps[1 - k])
        return [fault_of("held_control", (), side, 1e3 * periods[k], what=what, other=other)]
    return []


def _period(log: Log, name: str) -> float:
    """Mean time between changes of a signal [s], without the time at rest."""
    total, changes = 0.0, 0
    for one in log.trajectories():
        x, t = one.signals[name], one.t
        changed = torch.cat(
            [torch.tensor([0]), 1 + (x.diff(dim=0) != 0).any(1).nonzero().flatten()]
        )
        gaps = t[changed].diff()
        moving = gaps < LONGEST_HOLD
        total += float(gaps[moving].sum())
        changes += int(moving.sum())
    return total / changes if changes else 0.0


def _peaked(log: Log, name: str, period: float) -> bool:
    """Whether a noisy signal steps with a period too, or is sampled too seldom to tell."""
    for one in log.trajectories():
        x, t = one.signals[name], one.t
        bins = min(8, int(period / float(t.diff().median())))
        if bins < 3:
            return True
        jumps = (x.diff(dim=0).square() / x.diff(dim=0).square().mean(0).clamp(min=1e-300)).mean(1)
        place = ((t[1:] - t[0]) / period % 1 * bins).long().clamp(max=bins - 1)
        mean = torch.stack([jumps[place == b].mean() for b in range(bins)])
        error = jumps.std() * (bins / len(jumps)) ** 0.5
        if float((mean.max() - jumps.mean()) / error) > SURE:
            return True
    return False


@dataclass(frozen=True)
class Law:
    """A servo's torque on one joint, kp (u - q) - kd dq + feed gravity + constant.

    Attributes:
        kp, kd: [N m/rad; N m s/rad].
        feed: share of the model's gravity torque; nan without a model.
        r2: share of the torque's variance.
        damping: share of the torque that kd makes.
        gravity: share of the torque that the model's gravity would make.
    """

    kp: float
    kd: float
    feed: float
    r2: float
    damping: float
    gravity: float


def servo_laws(log: Log, robot: Robot | None) -> list[Law] | None:
    """The law of every joint's servo, by least squares; None without commands or torques."""
    if log.u is None or log.tau is None:
        return None
    rows: list[list[Tensor]] = []
    for one in resample(log).trajectories():
        assert one.u is not None
        assert one.tau is not None
        rate = one.rates[0]
        band = min(SERVO_BAND, 0.2 * rate)
        gravity = torch.zeros_like(one.q)
        if robot is not None and robot.parameters is not None:
            zero = torch.zeros_like(one.q)
            gravity = inverse_dynamics(replace(robot, effects=()), one.q, zero, zero)
        signals = (one.tau, one.u - one.q, central_difference(one.q.T, rate).T, gravity)
        edge = int(3 * rate / band)
        rows.append([low_passed(x.T, rate, band).T[edge:-edge] for x in signals])
    tau, error, dq, gravity = (torch.cat(list(x)) for x in zip(*rows, strict=True))
    out = []
    for j in range(log.n):
        y = tau[:, j]
        with_gravity = float(gravity[:, j].std()) > 1e-3 * float(y.std())
        columns = [error[:, j], -dq[:, j], torch.ones_like(y)]
        columns += [gravity[:, j]] if with_gravity else []
        a = torch.stack(columns, 1)
        scale = a.norm(dim=0).clamp(min=1e-300)
        x = torch.linalg.lstsq(a / scale, y.unsqueeze(1), driver="gelsd").solution[:, 0] / scale
        whole = float((y - y.mean()).square().sum())
        left = float((y - a @ x).square().sum())
        size = max(float(y.std()), 1e-300)
        out.append(
            Law(
                float(x[0]),
                float(x[1]),
                float(x[3]) if with_gravity else math.nan,
                1 - left / max(whole, 1e-300),
                abs(float(x[1])) * float(dq[:, j].std()) / size,
                float(gravity[:, j].std()) / size,
            )
        )
    return out


def servo_faults(simulated: Sequence[Law], real: Sequence[Law]) -> list[Fault]:
    """Gains in other units, gains that differ, and gravity that one servo adds."""
    found: list[Fault] = []
    both = [
        j
        for j, (s, r) in enumerate(zip(simulated, real, strict=True))
        if min(s.r2, r.r2) > LAW and min(s.kp, r.kp) > 0
    ]
    ratios = {j: simulated[j].kp / real[j].kp for j in both}
    # Damping of joints on which it is a part of the torque on the arm.
    damped = {
        j: simulated[j].kd / real[j].kd
        for j in both
        if min(real[j].kd, simulated[j].kd) > 0 and max(real[j].damping, simulated[j].damping) > 0.1
    }
    for name, values in (("stiffness", ratios), ("damping", damped)):
        for wrong, words in (
            (DEGREES, "N m/rad as N m/degree"),
            (1 / DEGREES, "N m/degree as N m/rad"),
        ):
            off = [j for j, x in values.items() if abs(math.log(x / wrong)) < math.log(UNITS)]
            if off and len(off) > 0.5 * len(values):
                middle = float(np.median([values[j] for j in off]))
                known: dict[str, Any] = {"name": name, "degrees": DEGREES, "words": words}
                found.append(fault_of("gain_units", off, "simulator", middle, **known))
    if not found:
        off = [j for j, x in ratios.items() if abs(math.log(x)) > math.log(GAINS)]
        if off:
            said = ", ".join(f"{ratios[j]:.3g}" for j in off)
            found.append(fault_of("servo_gain", off, "simulator", ratios[off[0]], said=said))
    seen = [
        j
        for j in both
        if min(simulated[j].gravity, real[j].gravity) > 0.3
        and math.isfinite(simulated[j].feed + real[j].feed)
    ]
    pairs: tuple[tuple[Side, Sequence[Law], Sequence[Law]], ...]
    pairs = (("simulator", simulated, real), ("arm", real, simulated))
    for side, own, other in pairs:
        adds = [j for j in seen if own[j].feed > SOME and other[j].feed < NONE]
        if adds and len(adds) > 0.5 * len(seen):
            value = float(np.median([own[j].feed for j in adds]))
            found.append(fault_of("gravity_compensation", adds, side, value))
    return found


def gravity_faults(robot: Robot, simulated: Log, real: Log) -> list[Fault]:
    """Gravity that one side's torque holds and the other's does not, by the doctor's judgement of
    each log alone."""
    light: dict[Side, tuple[int, ...]]
    light = {"simulator": _weightless(robot, simulated), "arm": _weightless(robot, real)}
    return [
        fault_of("gravity_compensation", joints, side, 0.0, "by torque")
        for side, joints in light.items()
        if joints and not all(light.values())
    ]


def _weightless(robot: Robot, log: Log) -> tuple[int, ...]:
    """Joints that gravity would show in, of a torque that holds none; none of any other."""
    rows = samples(log)
    if isinstance(rows, str):
        return ()
    found = check_kind(Judge(robot, rows), Hypothesis.literal(robot))
    return found.joints if found is not None and holds_no_gravity(found) else ()
