"""How wide to randomise servos: draws from what a diagnosis of commands and positions leaves open.

The numbers of one joint's servo have a covariance (motions as blocks, no less than noise allows and
no more than was expected beforehand), of logarithms where they are positive: gains, frictions and
inertias that only a load could tell apart move together in the draws.
"""

import math
from dataclasses import replace

import msgspec
import torch
from msgspec import UNSET

from torchid.effects.servo import INDEX, PARAMETERS
from torchid.errors import TorchidError
from torchid.export.randomisation import Randomisation, normal_points, range_row, sobol_points
from torchid.export.record import RangeRow
from torchid.position.fit import absolute, from_absolute
from torchid.position.record import PositionRecord
from torchid.robot.model import Robot
from torchid.simulation.servo import Servos


def randomise_positions(
    found: PositionRecord,
    level: float,
    robot: Robot | None,
    draws: int,
    seed: int,
) -> Randomisation:
    """Draws of the servos of a diagnosis of commands and positions, and the range of each number.

    Args:
        found: a diagnosis (`torchid.load("gap.json")`, or `diagnosis.record`).
        level: share of the draws in each range.
        robot: whose joints are named; numbers stand for them if None.
        draws: how many.
        seed: of the draws.

    Raises:
        TorchidError: a diagnosis of an older version, which has no covariance; a robot with another
            number of joints.
    """
    if found.known is UNSET:
        raise TorchidError(
            "the diagnosis holds no covariance of what it found, as older versions wrote it.",
            hint="`torchid gap ... --json gap.json` with this version",
        )
    n = len(found.servos.joints)
    if robot is not None and robot.n != n:
        raise TorchidError(
            "the diagnosis is of another arm.",
            got=f"'{robot.name}', {robot.n} joints",
            expected=f"{n} joints",
        )
    names = robot.joint_names if robot is not None else tuple(f"joint {j + 1}" for j in range(n))
    servos = Servos.from_record(msgspec.to_builtins(found.servos), n, found.robot)
    centre, warnings = absolute(servos), []
    moved = centre.repeat(draws, 1, 1)
    width = sum(len(one.names) for one in found.known)
    z = normal_points(sobol_points(draws, max(1, width), seed))
    for one in found.known:
        sizes, axes = torch.linalg.eigh(one.covariance.double())
        root = axes * sizes.clamp(min=0).sqrt()
        at = [INDEX[name] for name in one.names]
        moved[:, one.joint, at] += z[:, : len(at)] @ root.T
        z = z[:, len(at) :]
    plane = servos.plane.expand(draws, -1)
    drawn = replace(servos, joint=from_absolute(moved), plane=plane)
    for j, row in enumerate(found.where.joints):
        if row.ratio_only:
            warnings.append(
                f"{names[j]}: only ratios of torques are known; draws hold as wide a common factor "
                "as the log leaves open"
            )
    ranges = _ranges(drawn, servos, found, names, level)
    return Randomisation(
        found.robot, level, drawn, ranges, robot, tuple(names), warnings=tuple(warnings)
    )


def _ranges(
    drawn: Servos, servos: Servos, found: PositionRecord, names: tuple[str, ...], level: float
) -> tuple[RangeRow, ...]:
    """Of all numbers that the log told, joint by joint."""
    out = []
    assert found.known is not UNSET
    for one in found.known:
        for k, name in enumerate(one.names):
            p, values = PARAMETERS[INDEX[name]], drawn.of(name)[:, one.joint]
            std = float(one.covariance[k, k]) ** 0.5
            size = f"{std:.2g} {p.unit}".removesuffix(" 1")
            if p.kind == "log":
                size = f"a factor of {math.exp(std):.3g}"
            centre = float(servos.of(name)[one.joint])
            why = f"{p.meaning}; one standard deviation is {size} by the log."
            out.append(range_row(name, names[one.joint], p.unit, values, level, centre, why))
    return tuple(out)
