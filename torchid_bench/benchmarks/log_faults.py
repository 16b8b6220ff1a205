"""Faults planted in a log, and what the doctor should say about each."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch

from torchid.doctor.check import Check
from torchid.log.model import Log
from torchid.robot.model import JointType, Robot

MOTION = ("q", "dq", "ddq")
DEGREES = 180.0 / math.pi


@dataclass(frozen=True)
class Planted:
    """A log with a fault (or a robot described with one) and the answer.

    Attributes:
        names: checks that may name it.
        joints: from 0, that must be named; None where any answer will do.
        estimate: what the check should measure, and the relative tolerance; None to pass it over.
    """

    robot: Robot
    log: Log
    names: tuple[str, ...]
    joints: tuple[int, ...] | None = None
    estimate: float | None = None
    tolerance: float = 0.1

    def found(self, checks: tuple[Check, ...]) -> bool:
        """Whether a check that may name the fault does, on the right joints."""
        return any(self._names(c) for c in checks if c.verdict in ("wrong", "doubtful"))

    def on_top_of(self, size: float) -> "Planted":
        """The fault planted in a log that has some of it already."""
        assert self.estimate is not None
        whole = self.estimate + size
        return replace(self, estimate=whole, tolerance=self.tolerance * abs(self.estimate / whole))

    def chooses(self, check: Check) -> bool:
        """Whether it is among what a check leaves to choose."""
        joints = ",".join(str(k + 1) for k in self.joints or ())
        parts = [c.name.rpartition(" ") for c in check.choices]
        return any(own == joints and kind in name for kind, _, own in parts for name in self.names)

    def _names(self, check: Check) -> bool:
        if self.chooses(check):
            return True
        if check.name not in self.names:
            return False
        if self.joints is not None and set(check.joints) != set(self.joints):
            return False
        if self.estimate is None:
            return True
        values = check.estimate if isinstance(check.estimate, tuple) else (check.estimate,)
        return all(
            v is not None and abs(v - self.estimate) <= self.tolerance * abs(self.estimate)
            for v in values
        )


Fault = Callable[[Robot, Log, np.random.Generator], Planted | None]


def scaled(log: Log, signals: tuple[str, ...], factors: torch.Tensor | float) -> Log:
    return log.replace(**{s: x * factors for s, x in log.signals.items() if s in signals})


def moved(log: Log, signals: tuple[str, ...], order: list[int]) -> Log:
    return log.replace(**{s: x[:, order] for s, x in log.signals.items() if s in signals})


def _revolute(robot: Robot) -> torch.Tensor:
    return torch.tensor([k is JointType.REVOLUTE for k in robot.joint_types], dtype=torch.float64)


def _turned(robot: Robot, factor: float) -> torch.Tensor:
    return torch.where(_revolute(robot) > 0, factor, 1.0).double()


def _all(robot: Robot) -> tuple[int, ...]:
    return tuple(range(robot.n))


def _joint(robot: Robot, rng: np.random.Generator) -> int:
    return int(rng.integers(robot.n))


def scaling(
    signals: tuple[str, ...], factor: float, *names: str, estimate: float | None = None,
    tolerance: float = 0.1, every: bool = False,
) -> Fault:  # fmt: skip
    """Signals in another unit; `every` joint must be named then."""

    def fault(robot, log, rng):
        if signals == ("dq",) and log.dq is None:
            return None
        joints = _all(robot) if every else None
        return Planted(robot, scaled(log, signals, factor), names, joints, estimate, tolerance)

    return fault


def degrees(signals: tuple[str, ...]) -> Fault:
    """Positions of turning joints in degrees; alone where they move by more than noise."""

    def fault(robot, log, rng):
        small = signals == ("q",) and float(log.q.abs().max()) < 0.3
        if small or not _revolute(robot).any():
            return None
        names = "position unit", "position unit, by torque"
        return Planted(robot, scaled(log, signals, _turned(robot, DEGREES)), names)

    return fault


def of_a_joint(
    signals: tuple[str, ...], factor: float, *names: str, estimate: float | None = None
) -> Fault:
    """Signals of one joint times a factor."""

    def fault(robot, log, rng):
        alone = "gain of a joint" in names and robot.n < 2
        if alone or (signals == ("dq",) and log.dq is None):
            return None
        j = _joint(robot, rng)
        factors = torch.ones(robot.n).double()
        factors[j] = factor
        return Planted(robot, scaled(log, signals, factors), names, (j,), estimate)

    return fault


def exchanged(signals: tuple[str, ...], name: str) -> Fault:
    """Signals of two joints in the place of each other."""

    def fault(robot, log, rng):
        if robot.n < 2 or (signals == ("dq",) and log.dq is None):
            return None
        i, j = sorted(rng.choice(robot.n, 2, replace=False).tolist())
        order = list(range(robot.n))
        order[i], order[j] = j, i
        return Planted(robot, moved(log, signals, order), (name,), (i, j))

    return fault


def time_in(factor: float, name: str = "time unit", tolerance: float = 0.1) -> Fault:
    """Time in another unit, or too slow where velocities tell."""

    def fault(robot, log, rng):
        if name == "velocity" and log.dq is None:
            return None
        return Planted(robot, log.replace(t=log.t * factor), (name,), None, factor, tolerance)

    return fault


def late(signals: tuple[str, ...], seconds: float, name: str, tolerance: float) -> Fault:
    """Signals that are logged so much later."""

    def fault(robot, log, rng):
        if signals == ("dq",) and log.dq is None:
            return None
        return Planted(robot, shifted(log, signals, seconds), (name,), None, seconds, tolerance)

    return fault


def q_counts(robot, log, rng):
    if log.dq is None or not _revolute(robot).all():
        return None
    counts = 2**17 / (2 * math.pi)
    turned = log.replace(q=(log.q * counts).round())
    return Planted(robot, turned, ("position unit",), _all(robot), counts, 1e-3)


def dq_filtered(robot, log, rng):
    """A first-order low-pass of 60 ms."""
    if log.dq is None:
        return None
    parts = []
    for part in log.trajectories():
        out = part.dq.clone()
        step = part.t.diff()
        for k in range(1, part.samples):
            share = 1 - math.exp(-float(step[k - 1]) / 0.06)
            out[k] = out[k - 1] + share * (part.dq[k] - out[k - 1])
        parts.append(out)
    return Planted(robot, log.replace(dq=torch.cat(parts)), ("velocity",))


def tau_shuffled(robot, log, rng):
    if robot.n < 4:
        return None
    order = rng.permutation(robot.n).tolist()
    if sum(k != j for k, j in enumerate(order)) < 3:
        return None
    return Planted(robot, moved(log, ("tau",), order), ("joint order",))


def reversed_order(robot, log, rng):
    if robot.n < 3:
        return None
    log = moved(log, (*MOTION, "tau"), list(reversed(range(robot.n))))
    joints = tuple(k for k in range(robot.n) if k != robot.n - 1 - k)
    return Planted(robot, log, ("joint order",), joints)


def mounted(turn: Callable[[torch.Tensor], torch.Tensor]) -> Fault:
    """The robot's file with gravity in another direction."""
    return lambda robot, log, rng: Planted(
        replace(robot, gravity=turn(robot.gravity)), log, ("gravity",)
    )


def tilted(gravity: torch.Tensor) -> torch.Tensor:
    """As a base sees it that is 15 degrees out of level."""
    c, s = math.cos(math.radians(15.0)), math.sin(math.radians(15.0))
    return torch.tensor([[1.0, 0, 0], [0, c, -s], [0, s, c]], dtype=torch.float64) @ gravity


def shifted(log: Log, signals: tuple[str, ...], late: float) -> Log:
    parts = []
    for part in log.trajectories():
        t = part.t.numpy()

        def at(x: torch.Tensor, t: np.ndarray = t) -> torch.Tensor:
            return torch.from_numpy(np.stack([np.interp(t - late, t, c) for c in x.T.numpy()], 1))

        parts.append(part.replace(**{s: at(x) for s, x in part.signals.items() if s in signals}))
    return Log.concatenate(parts)


def clock_repeated(robot, log, rng):
    t = log.t.clone()
    for k in rng.choice(log.samples - 2, 5, replace=False) + 1:
        t[k] = t[k - 1]
    return Planted(robot, log.replace(t=t), ("clock",))


def clock_back(robot, log, rng):
    t = log.t.clone()
    t[log.samples // 2 :] -= 3.0
    return Planted(robot, log.replace(t=t), ("clock",))


def clock_jump(robot, log, rng):
    t = log.t.clone()
    t[_moving_row(log) + 1 :] += 30.0
    return Planted(robot, log.replace(t=t), ("clock",))


def _moving_row(log: Log) -> int:
    """The row about the middle at which some joint moves fastest."""
    middle = slice(log.samples // 3, 2 * log.samples // 3)
    return middle.start + int(log.q[middle].diff(dim=0).abs().sum(1).argmax())


def stamps_rounded(robot, log, rng):
    step = float(log.t.diff().median())
    unit = 3.3 * step
    return Planted(robot, log.replace(t=(log.t / unit).floor() * unit), ("clock", "stamps"))


def stamps_jitter(robot, log, rng):
    """Stamps given by a logger that comes up to 0.8 steps late."""
    step = log.t.diff().median()
    late = torch.from_numpy(rng.uniform(0, 0.8, log.samples)) * step
    return Planted(robot, log.replace(t=log.t + late), ("stamps",))


def dropouts(robot, log, rng):
    keep = torch.ones(log.samples, dtype=torch.bool)
    length = max(5, log.samples // 200)
    for k in rng.choice(np.arange(length, log.samples - 2 * length, 2 * length), 10, replace=False):
        keep[k : k + length] = False
    return Planted(robot, log.select(keep), ("dropouts",))


def held(robot, log, rng):
    source = torch.arange(log.samples)
    again = torch.from_numpy(rng.random(log.samples) < 0.35)
    again[0] = False
    for k in again.nonzero().flatten().tolist():
        source[k] = source[k - 1]
    return Planted(
        robot, log.replace(**{s: x[source] for s, x in log.signals.items()}), ("held samples",)
    )


def values_missing(robot, log, rng):
    q = log.q.clone()
    q[log.samples // 3, 0] = math.nan
    return Planted(robot, log.replace(q=q), ("values",))


def wrapped(robot, log, rng):
    extent = log.q.amax(0) - log.q.amin(0)
    j = int((extent * _revolute(robot)).argmax())
    if float(extent[j]) < 0.5 or robot.joint_types[j] is JointType.PRISMATIC:
        return None
    q = log.q.clone()
    middle = float(q[:, j].median())
    # The wrap lies in the middle of the motion, and the joint's range about it.
    q[:, j] = torch.remainder(q[:, j] - middle, 2 * math.pi) - math.pi
    if robot.limits.position is not None:
        limits = robot.limits.position.clone()
        limits[j] -= middle + math.pi
        robot = robot.with_limits(position=limits)
    return Planted(robot, log.replace(q=q), ("position jumps", "zero of positions"), (j,))


def clipped(robot, log, rng):
    j = _joint(robot, rng)
    tau = log.tau.clone()
    level = float(torch.quantile(tau[:: max(1, log.samples // 10000), j], 0.93))
    tau[:, j] = tau[:, j].clamp(max=level)
    return Planted(robot, log.replace(tau=tau), ("saturation",), (j,))


def coarse(robot, log, rng):
    j = _joint(robot, rng)
    tau = log.tau.clone()
    unit = 0.3 * float(tau[:, j].std())
    tau[:, j] = (tau[:, j] / unit).round() * unit
    return Planted(robot, log.replace(tau=tau), ("resolution",), (j,))


def torque_zero(robot, log, rng):
    j = _joint(robot, rng)
    tau = log.tau.clone()
    tau[:, j] = 0.0
    return Planted(robot, log.replace(tau=tau), ("torque columns",), (j,))


def stands_still(robot, log, rng):
    j = _joint(robot, rng)
    signals = {s: x.clone() for s, x in log.signals.items() if s in MOTION}
    for s, x in signals.items():
        x[:, j] = x[0, j] if s == "q" else 0.0
    return Planted(robot, log.replace(**signals), ("standstill",), (j,))


FAULTS: dict[str, Fault] = {
    "q in degrees": degrees(("q",)),
    "q and dq in degrees": degrees(MOTION),
    "q in encoder counts": q_counts,
    "dq in deg/s": scaling(
        ("dq",), DEGREES, "velocity", estimate=DEGREES, tolerance=0.01, every=True
    ),
    "dq in rpm": scaling(
        ("dq",), 30 / math.pi, "velocity", estimate=9.5493, tolerance=0.01, every=True
    ),
    "dq of a joint negated": of_a_joint(("dq",), -1.0, "velocity", estimate=-1.0),
    "dq of two joints exchanged": exchanged(("dq",), "velocity"),
    "dq 60 ms late": late(("dq",), 0.06, "velocity", 0.15),
    "dq low-passed, 60 ms": dq_filtered,
    "tau in mN m": scaling(("tau",), 1e3, "torque unit"),
    "t in ms": time_in(1e3),
    "t in us": time_in(1e6),
    "t in ns": time_in(1e9),
    "t 2.5 times too slow": time_in(2.5, "velocity", 0.02),
    "tau negated": scaling(("tau",), -1.0, "torque sign", every=True),
    "tau of a joint negated": of_a_joint(("tau",), -1.0, "torque sign"),
    "q of a joint negated": of_a_joint(MOTION, -1.0, "position sign"),
    "q of two joints exchanged": exchanged(MOTION, "joint order"),
    "tau of two joints exchanged": exchanged(("tau",), "joint order"),
    "tau columns shuffled": tau_shuffled,
    "tip to base": reversed_order,
    **{
        f"tau of a joint x {factor:g}": of_a_joint(
            ("tau",), factor, "gain of a joint", "torque against nominal"
        )
        for factor in (0.1, 3.0, 100.0)
    },
    "mounted on the ceiling": mounted(torch.neg),
    "mounted on a wall": mounted(lambda g: g[[2, 0, 1]]),
    "tilted by 15 deg": mounted(tilted),
    "tau 25 ms late": late(("tau",), 0.025, "lag", 0.4),
    "tau 60 ms late": late(("tau",), 0.06, "lag", 0.4),
    "tau 60 ms early": late(("tau",), -0.06, "lag", 0.4),
    "repeated stamps": clock_repeated,
    "clock set back": clock_back,
    "clock jumps ahead": clock_jump,
    "stamps rounded": stamps_rounded,
    "stamps late at random": stamps_jitter,
    "dropouts": dropouts,
    "held samples": held,
    "NaN": values_missing,
    "angle wrapped": wrapped,
    "tau clipped": clipped,
    "tau in coarse steps": coarse,
    "tau of a joint zero": torque_zero,
    "a joint stands still": stands_still,
}
