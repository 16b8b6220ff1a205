"""The servos of both sides, side by side: what commands and positions say where no torque is.

Each side's log is diagnosed alone, so neither clock nor rate of one touches the other. Parameters
that are part of either answer are compared on the scale on which they are searched: logarithms of
what is positive. Where the motions, or a robot without masses, leave a common factor of all torques
open, torques are compared as shares of kp.
"""

import math
from collections.abc import Sequence

import torch

from torchid.log.model import Log
from torchid.pair.record import ServoDifference
from torchid.position.diagnose import diagnose_positions
from torchid.position.diagnosis import PositionDiagnosis
from torchid.position.judge import value_interval
from torchid.robot.model import Robot
from torchid.simulation.servo import INDEX, PARAMETERS, TORQUES, ServoParameter
from torchid.statistics.proportion import HALF_95

LEAST = 0.05
"""Relative difference from which a parameter differs."""

PER_KP = {"N m": "rad", "N m s/rad": "s", "N m/(rad s)": "1/s", "kg m^2": "s^2"}
"""Units of torques as shares of kp."""

SLIGHT = {"rad": 1e-3, "s": 1e-3, "1/s": 1e-2, "s^2": 1e-5}
"""Shares of kp, and times, below which a parameter moves no joint that anyone would see."""


def servos_of(
    robot: Robot, simulated: Log, real: Log
) -> tuple[tuple[ServoDifference, ...], tuple[str, ...]]:
    """What the servos are on either side, with sentences for the user.

    Raises:
        LogError: a log that `diagnose_positions` cannot use.
    """
    sides = [diagnose_positions(robot, log) for log in (simulated, real)]
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
        rows += _joint(sides, j, ratio)
    loads = [any(f.effect == "payload" for f in side.findings) for side in sides]
    if loads[0] != loads[1]:
        whose, other = ("arm", "simulator") if loads[1] else ("simulator", "arm")
        warnings.append(f"the {whose}'s motions show a load that the {other}'s do not show")
    return tuple(rows), tuple(warnings)


def _joint(sides: Sequence[PositionDiagnosis], j: int, ratio: bool) -> list[ServoDifference]:
    """Parameters of one joint that either side's answer has."""
    found = [_Side(side, j) for side in sides]
    out = []
    for p in PARAMETERS:
        if not any(p.name in side.names for side in found) or (ratio and p.name == "kp"):
            continue
        shared = ratio and p.name in TORQUES
        unit = PER_KP[p.unit] if shared else p.unit
        ends = [side.value(p, shared) for side in found]
        (a, own_a), (b, own_b) = ends
        intervals = [
            None if std is None else value_interval(p.name, value, std) for value, std in ends
        ]
        if own_a is not None and own_b is not None:
            differs = _differ(p, a, b, math.hypot(own_a, own_b))
            least = SLIGHT.get(unit if shared else PER_KP.get(p.unit, p.unit), 0.0)
            gain = 1.0 if shared or p.unit not in PER_KP else min(side.gain for side in found)
            differs &= max(abs(a), abs(b)) >= least * gain
        else:
            # An effect that one side has alone was searched on both.
            differs = any(p.name in side.named for side in found)
        out.append(
            ServoDifference(
                j, p.name, unit, shared, a, intervals[0], b, intervals[1], bool(differs)
            )
        )
    return out


class _Side:
    """One side's answer about one joint."""

    def __init__(self, found: PositionDiagnosis, j: int) -> None:
        self.values = found.servos.joint[j]
        self.names, self.covariance = found.known[j]
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


def _differ(p: ServoParameter, a: float, b: float, std: float) -> bool:
    """Whether the difference's 95 % interval excludes zero, and the difference is no trifle."""
    if p.kind == "log":
        away, least = abs(math.log(b / a)), math.log1p(LEAST)
    else:
        away, least = abs(b - a), LEAST * max(abs(a), abs(b))
    return away > HALF_95 * std and away >= least
