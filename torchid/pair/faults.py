"""The doctor on two logs: faults of a simulator's set-up, each by the signature that it leaves in
the pair of logs.

Every test holds the simulator's log against the arm's: what both have is no fault. Those of the
servo's law and of gravity, friction and rotors are regressions on each side's own motion, so they
do not ask that both moved alike.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.optimize import linear_sum_assignment

from torchid.doctor.hypothesis import Hypothesis, Judge
from torchid.doctor.kind import check_kind, holds_no_gravity
from torchid.doctor.repair import MappedColumns, reordered, repaired, scaled
from torchid.doctor.samples import samples
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.log.filtering import central_difference, low_passed
from torchid.log.model import Log
from torchid.pair.align import SAME_CLOCK, AlignedTrajectory, correlations
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
    texts = _TEXTS[f"{name}, {by}" if by else name]
    known = {"joints": joint_list(joints), "side": side, "value": value, **words}
    meaning, remedy = (texts[key].format(**known) for key in ("meaning", "remedy"))
    unit = words.get("unit") or texts["unit"]
    return Fault(name, tuple(joints), side, value, unit, meaning, remedy)


@dataclass(frozen=True, eq=False)
class PairCase:
    """Two logs, the simulator's as the tests before have mended it.

    Attributes:
        robot: the model, or None.
        simulated, real: the logs.
        both: their trajectories on one clock.
        faults: those before.
    """

    robot: Robot | None
    simulated: Log
    real: Log
    both: Sequence[AlignedTrajectory]
    faults: tuple[Fault, ...] = ()

    def whole(self, name: str) -> tuple[Tensor, Tensor] | None:
        """A signal (T, n) of all trajectories on either side; None where one does not have it."""
        if any(name not in b.simulated for b in self.both):
            return None
        return (
            torch.cat([b.simulated[name] for b in self.both]),
            torch.cat([b.real[name] for b in self.both]),
        )

    def has(self, name: FaultName) -> bool:
        """Whether a fault is there."""
        return any(f.fault == name for f in self.faults)

    def after(self, *faults: Fault, repairs: Sequence[MappedColumns] = ()) -> "PairCase":
        """With faults once more, one name once, and the simulator's log as they are mended."""
        known = {f.fault: f for f in reversed((*self.faults, *faults))}
        both = self.both
        for repair in repairs:
            both = [replace(b, simulated=repair.mapped(b.simulated)) for b in both]
        return replace(
            self, simulated=repaired(self.simulated, repairs), both=both,
            faults=tuple(known.values())[::-1],
        )  # fmt: skip


def joint_order(case: PairCase) -> PairCase:
    """Joints that move as other ones of the simulator."""
    both = case.whole("q")
    assert both is not None
    alike = np.abs(correlations(*(x.numpy() for x in both)))
    theirs = linear_sum_assignment(-alike.T)[1].tolist()
    moved = [
        j for j, k in enumerate(theirs) if k != j and alike[k, j] > ALIKE and alike[j, j] < ALIKE
    ]
    if len(moved) < 2 or sorted(theirs[j] for j in moved) != moved:
        return case
    order = [k if j in moved else j for j, k in enumerate(theirs)]
    says = ", ".join(f"{j + 1} moves as {order[j] + 1} of the simulator" for j in moved)
    fault = fault_of("joint_order", moved, "simulator", float(len(moved)), says=says)
    return case.after(fault, repairs=[reordered(_MEASURED, order)])


_MEASURED = ("q", "dq", "tau")


def joint_signs(case: PairCase) -> PairCase:
    """Motions that mirror each other, and torques that cancel."""
    both, torques = case.whole("q"), case.whole("tau")
    assert both is not None
    mirrored = correlations(*(x.numpy() for x in both)).diagonal() < -ALIKE
    negated = np.zeros_like(mirrored)
    if torques is not None:
        slow = [torch.cat([_slow(b, side) for b in case.both]) for side in ("simulated", "real")]
        left, size = (x.square().mean(0).sqrt() for x in (slow[0] + slow[1], slow[1]))
        negated = (left / size.clamp(min=1e-12) < TURNED).numpy()
    wrong = np.flatnonzero(mirrored | negated).tolist()
    if not wrong:
        return case
    kinds = ("position", mirrored), ("torque", negated)
    what = " and ".join(word for word, which in kinds if which.any())
    repairs = [
        scaled(signals, np.where(which, -1.0, 1.0).tolist())
        for signals, which in ((("q", "dq"), mirrored), (("tau",), negated))
    ]
    return case.after(fault_of("sign", wrong, "simulator", -1.0, what=what), repairs=repairs)


def _slow(both: AlignedTrajectory, side: str) -> Tensor:
    """Torque (T, n) below the servo's band."""
    x, rate = getattr(both, side)["tau"], 1 / both.dt
    return low_passed(x.T, rate, min(SERVO_BAND, 0.2 * rate)).T


def clock_rate(case: PairCase) -> PairCase:
    """A clock that runs at another rate."""
    rate = float(np.median([b.clock.rate for b in case.both]))
    if abs(rate - 1) < SAME_CLOCK:
        return case
    return case.after(fault_of("time_step", (), "simulator", rate))


_LIMITED = (
    ("u", "command", "rad", 1e-6),
    ("q", "position", "rad", STOPS),
    ("tau", "torque", "N m", 1e-4),
)
"""Signals that may stop at a limit, what they are called, their units, and how exactly they do."""


def clipping(case: PairCase) -> PairCase:
    """Signals that stop at a limit which the other side goes beyond."""
    found = []
    for name, what, unit, exact in _LIMITED:
        both = case.whole(name)
        for side, turn in _SIDES if both else ():
            assert both is not None
            mine, other = both[::turn]
            limits = {
                j: limit
                for j, (x, y) in enumerate(zip(mine.T, other.T, strict=True))
                if (limit := _limit(x, y, exact, name == "q")) is not None
                and (name != "q" or _pushed(case.both, side, j, limit))
            }
            if limits:
                levels = ", ".join(f"{x:.4g}" for x in limits.values())
                first, words = next(iter(limits.values())), {"what": what, "unit": unit}
                found.append(fault_of("clipped", [*limits], side, first, levels=levels, **words))
    return case.after(*found)


_SIDES: tuple[tuple[Side, int], ...] = (("simulator", 1), ("arm", -1))


def _pushed(both: Sequence[AlignedTrajectory], side: str, j: int, limit: float) -> bool:
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


def held_control(case: PairCase) -> PairCase:
    """Commands or torques that change more seldom on one side."""
    logs, rates = (case.simulated, case.real), (case.both[0].clock.rate, 1.0)
    steps = [1 / float(np.median(x.rates)) / rate for x, rate in zip(logs, rates, strict=True)]
    for name, what in (("u", "commands"), ("tau", "torques")):
        if any(name not in log.signals for log in logs):
            continue
        periods = [_period(log, name) / rate for log, rate in zip(logs, rates, strict=True)]
        k = int(np.argmax(periods))
        if periods[k] < HELD * max(*steps, min(periods)):
            continue
        if name == "tau" and _peaked(logs[1 - k], name, periods[k]):
            continue
        other = 1e3 * max(periods[1 - k], steps[1 - k])
        words = {"what": what, "other": other}
        return case.after(fault_of("held_control", (), _SIDES[k][0], 1e3 * periods[k], **words))
    return case


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
    rows = []
    for one in log.even.trajectories():
        assert one.u is not None
        assert one.tau is not None
        rate = one.rates[0]
        band = min(SERVO_BAND, 0.2 * rate)
        gravity = zero = torch.zeros_like(one.q)
        if robot is not None and robot.parameters is not None:
            gravity = inverse_dynamics(replace(robot, effects=()), one.q, zero, zero)
        signals = (one.tau, one.u - one.q, -central_difference(one.q.T, rate).T, gravity)
        edge = int(3 * rate / band)
        rows.append([low_passed(x.T, rate, band).T[edge:-edge] for x in signals])
    whole = (torch.cat(list(x)).T for x in zip(*rows, strict=True))
    return [_law(*columns) for columns in zip(*whole, strict=True)]


def _law(tau: Tensor, error: Tensor, slowing: Tensor, gravity: Tensor) -> Law:
    """Of one joint's samples (T,): torque, command less position, minus velocity, and the model's
    gravity torque."""
    size = max(float(tau.std()), 1e-300)
    shares = float(slowing.std()) / size, float(gravity.std()) / size
    weighed = shares[1] > 1e-3
    a = torch.stack([error, slowing, torch.ones_like(tau), *([gravity] if weighed else [])], 1)
    scale = a.norm(dim=0).clamp(min=1e-300)
    x = torch.linalg.lstsq(a / scale, tau.unsqueeze(1), driver="gelsd").solution[:, 0] / scale
    whole, left = (float(y.square().sum()) for y in (tau - tau.mean(), tau - a @ x))
    kp, kd, _, *feed = x.tolist()
    r2 = 1 - left / max(whole, 1e-300)
    return Law(kp, kd, feed[0] if feed else math.nan, r2, abs(kd) * shares[0], shares[1])


def servos(case: PairCase) -> PairCase:
    """Gains in other units, gains that differ, and gravity that one servo adds."""
    laws = [servo_laws(log, case.robot) for log in (case.simulated, case.real)]
    # With another clock nothing that has a derivative can be judged.
    if laws[0] is None or laws[1] is None or case.has("time_step"):
        return case
    both = {
        j: (s, r)
        for j, (s, r) in enumerate(zip(*laws, strict=True))
        if min(s.r2, r.r2) > LAW and min(s.kp, r.kp) > 0
    }
    stiffness = {j: s.kp / r.kp for j, (s, r) in both.items()}
    # Of joints on which damping is a part of the torque.
    damping = {
        j: s.kd / r.kd
        for j, (s, r) in both.items()
        if min(r.kd, s.kd) > 0 and max(r.damping, s.damping) > 0.1
    }
    found = [
        *_gain_units("stiffness", stiffness),
        *_gain_units("damping", damping),
        *_added_gravity(both),
    ]
    off = [j for j, x in stiffness.items() if abs(math.log(x)) > math.log(GAINS)]
    if off and not any(f.fault == "gain_units" for f in found):
        said = ", ".join(f"{stiffness[j]:.3g}" for j in off)
        found.insert(0, fault_of("servo_gain", off, "simulator", stiffness[off[0]], said=said))
    return case.after(*found)


def _gain_units(name: str, ratios: Mapping[int, float]) -> Iterator[Fault]:
    """Gains of most joints that are degrees off."""
    for wrong, words in (
        (DEGREES, "N m/rad as N m/degree"),
        (1 / DEGREES, "N m/degree as N m/rad"),
    ):
        off = [j for j, x in ratios.items() if abs(math.log(x / wrong)) < math.log(UNITS)]
        if len(off) > 0.5 * len(ratios):
            middle = float(np.median([ratios[j] for j in off]))
            known = {"name": name, "words": words}
            yield fault_of("gain_units", off, "simulator", middle, degrees=DEGREES, **known)


def _added_gravity(both: Mapping[int, tuple[Law, Law]]) -> Iterator[Fault]:
    """Gravity that one side's servo adds on most joints that carry some."""
    seen = {
        j: laws
        for j, laws in both.items()
        if min(law.gravity for law in laws) > 0.3 and math.isfinite(sum(law.feed for law in laws))
    }
    for side, turn in _SIDES:
        feeds = {j: tuple(law.feed for law in laws[::turn]) for j, laws in seen.items()}
        adds = [j for j, (own, other) in feeds.items() if own > SOME and other < NONE]
        if len(adds) > 0.5 * len(seen):
            value = float(np.median([feeds[j][0] for j in adds]))
            yield fault_of("gravity_compensation", adds, side, value)


def gravity(case: PairCase) -> PairCase:
    """Gravity that one side's torque holds and the other's does not, by the doctor's judgement of
    each log alone."""
    robot, torques = case.robot, case.whole("tau")
    if robot is None or robot.parameters is None or torques is None or case.has("time_step"):
        return case
    light = {"simulator": _weightless(robot, case.simulated), "arm": _weightless(robot, case.real)}
    found = [
        fault_of("gravity_compensation", light[side], side, 0.0, "by torque")
        for side, _ in _SIDES
        if light[side] and not all(light.values())
    ]
    return case.after(*found)


def _weightless(robot: Robot, log: Log) -> tuple[int, ...]:
    """Joints that gravity would show in, of a torque that holds none; none of any other."""
    rows = samples(log)
    if isinstance(rows, str):
        return ()
    found = check_kind(Judge(robot, rows), Hypothesis.literal(robot))
    return found.joints if found is not None and holds_no_gravity(found) else ()


SET_UP = (joint_order, joint_signs, clock_rate, clipping, held_control, servos, gravity)
"""The table of faults, in the order in which they are mended; each is looked for with those before
mended, but for a clock."""


def set_up_faults(
    robot: Robot | None, simulated: Log, real: Log, both: Sequence[AlignedTrajectory]
) -> tuple[Fault, ...]:
    """Faults of the set-up, in the order in which they are mended."""
    case = PairCase(robot, simulated, real, both)
    for look in SET_UP:
        case = look(case)
    return case.faults
