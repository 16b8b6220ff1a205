"""The servos of both sides, side by side: what commands and positions say where no torque is.

Each side's log is diagnosed alone, so neither clock nor rate of one touches the other. Parameters
that are part of either answer are compared on the scale on which they are searched: logarithms of
what is positive. Where the motions, or a robot without masses, leave a common factor of all torques
open, torques are compared as shares of kp.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import torch

from torchid.effects.servo import INDEX, PARAMETERS, PER_KP, TORQUES, ServoParameter
from torchid.log.model import Log
from torchid.pair.record import ServoDifference
from torchid.position.data import WINDOW_S
from torchid.position.diagnose import WORTHWHILE, diagnose_positions
from torchid.position.diagnosis import PositionDiagnosis
from torchid.position.fit import errors
from torchid.position.judge import value_interval
from torchid.position.problem import MOST_WINDOWS, some_of
from torchid.robot.model import Robot
from torchid.simulation.servo_loop import windows_of
from torchid.statistics.proportion import HALF_95
from torchid.typing import Bool, Tensor


def servos_of(
    robot: Robot, simulated: Log, real: Log
) -> tuple[tuple[ServoDifference, ...], tuple[str, ...]]:
    """What the servos are on either side, with sentences for the user.

    Raises:
        LogError: a log that `diagnose_positions` cannot use.
    """
    sides = [diagnose_positions(robot, log, trusted=True) for log in (simulated, real)]
    needed = _needed(*sides)
    rows: list[ServoDifference] = []
    warnings = list(dict.fromkeys(w for side in sides for w in side.warnings))
    for j in range(robot.n):
        if any(bool(side.still[j]) for side in sides):
            continue
        ratio = any(bool(side.ratio_only[j]) for side in sides)
        if ratio:
            warnings.append(
                f"joint {j + 1}: the motions leave a common factor of all torques open, so torques "
                "are compared as shares of the gain kp"
            )
        rows += _joint(sides, j, ratio, needed[j])
    loads = [any(f.effect == "payload" for f in side.findings) for side in sides]
    if loads[0] != loads[1]:
        whose, other = ("arm", "simulator") if loads[1] else ("simulator", "arm")
        warnings.append(f"the {whose}'s motions show a load that the {other}'s do not show")
    return tuple(rows), tuple(warnings)


def _needed(simulated: PositionDiagnosis, real: PositionDiagnosis) -> Bool[Tensor, "n K"]:
    """The few parameters of each joint that make the real servo move as the simulated one does.

    One after the other, the parameter whose simulated value brings the real servo's motion nearest
    to the simulated servo's takes that value, until what is left of the distance is no more than
    could be seen. What follows from an inaccurate common factor of all
    torques moves nothing, and is not taken.
    """
    data, other = real.data, simulated.servos.joint
    now, k, n = real.servos.joint.clone(), len(PARAMETERS), real.servos.n
    windows = some_of(windows_of(data.tracks, WINDOW_S), MOST_WINDOWS)
    taken = torch.zeros(n, k, dtype=torch.bool)
    for _ in range(k):
        # The simulated servo, the real one, and the real one with each parameter of the other.
        sets = now.repeat(2 + k, 1, 1)
        sets[0] = other
        for p in range(k):
            sets[2 + p, :, p] = other[:, p]
        plane = real.servos.plane.repeat(2 + k, 1)
        error = errors(data, replace(real.servos, joint=sets, plane=plane), windows)
        apart = (error - error[..., :1]).square() * windows.weight[:, None, None]
        square = apart.sum((0, 1)) / windows.rows
        best, which = square[:, 2:].min(1)
        better = square[:, 1] > data.slight**2
        better &= square[:, 1] - best > WORTHWHILE * square[:, 1]
        if not bool(better.any()):
            break
        joints = better.nonzero().flatten()
        now[joints, which[joints]] = other[joints, which[joints]]
        taken[joints, which[joints]] = True
    return taken


def _joint(
    sides: Sequence[PositionDiagnosis], j: int, ratio: bool, needed: Bool[Tensor, " K"]
) -> list[ServoDifference]:
    """Parameters of one joint that either side's answer has. One differs that is needed
    to make one servo move as the other, and whose intervals do not hold the same value; one that a
    single side has was searched on both."""
    found = [_Side(side, j) for side in sides]
    out = []
    for p in PARAMETERS:
        if not any(p.name in side.names for side in found) or (ratio and p.name == "kp"):
            continue
        shared = ratio and p.name in TORQUES
        (a, own_a), (b, own_b) = (side.value(p, shared) for side in found)
        interval_a, interval_b = (
            None if std is None else value_interval(p.name, value, std)
            for value, std in ((a, own_a), (b, own_b))
        )
        if own_a is None or own_b is None:
            differs = any(p.name in side.named for side in found)
        else:
            # Where the 95 % interval of the difference excludes zero.
            apart = abs(math.log(b / a) if p.kind == "log" else b - a)
            differs = apart > HALF_95 * math.hypot(own_a, own_b)
        out.append(
            ServoDifference(
                j, p.name, PER_KP[p.unit] if shared else p.unit, shared, a, interval_a, b,
                interval_b, differs and bool(needed[INDEX[p.name]]),
            )
        )  # fmt: skip
    return out


class _Side:
    """One side's answer about one joint."""

    def __init__(self, found: PositionDiagnosis, j: int) -> None:
        self.values = found.servos.joint[j]
        self.names, self.covariance = found.known[j].names, found.known[j].covariance
        self.gain = float(found.servos.of("kp")[j])
        self.named = {s.name for f in found.findings if f.joint == j + 1 for s in f.sizes}

    def value(self, p: ServoParameter, shared: bool) -> tuple[float, float | None]:
        """A value, or its share of kp, with its standard deviation, of a logarithm where it is
        positive; no deviation where the side does not have the parameter."""
        value = float(self.values[INDEX[p.name]])
        if shared:
            value /= self.gain
        if p.name not in self.names:
            return value, None
        combination = torch.zeros(len(self.names), dtype=torch.float64)
        combination[self.names.index(p.name)] = 1.0
        if shared and p.kind == "log":
            combination[self.names.index("kp")] = -1.0
        elif shared:
            combination /= self.gain
            combination[self.names.index("kp")] = -value
        return value, math.sqrt(max(float(combination @ self.covariance @ combination), 0.0))
