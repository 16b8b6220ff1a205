"""A simulated fleet: units of one type whose friction differs from unit to unit and from day to
day, and a few in which one coefficient is plainly another."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from torchid.excitation.synthetic import HonestNoise, simulate
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.fleet.manifest import FleetLog
from torchid.log.readers import write_log
from torchid.robot.model import Robot

COEFFICIENTS = {"viscous_friction": "Fv", "coulomb_friction": "Fc", "torque_offset": "F0"}


@dataclass(frozen=True)
class Plan:
    """How a fleet is drawn.

    Attributes:
        units, sessions: how many.
        seconds, rate: of each log [s, Hz].
        between, daily: spread of each coefficient of friction over units, and over the days of a
            unit, as shares of it.
        odd: unit -> (name of a coefficient, e.g. Fv2; by how much it is more).
        noise: share of each joint's torque.
        colour: of the noise [Hz].
        seed: of everything.
    """

    units: int = 6
    sessions: int = 2
    seconds: float = 12.0
    rate: float = 100.0
    between: float = 0.1
    daily: float = 0.03
    odd: Mapping[int, tuple[str, float]] | None = None
    noise: float = 0.01
    colour: float | None = 5.0
    seed: int = 0


def unit_name(k: int) -> str:
    return f"arm-{k:03d}"


def session_name(s: int) -> str:
    """In the order of time as numbers, not as letters."""
    return f"day-{s + 6}"


def with_friction(robot: Robot, values: Mapping[str, float]) -> Robot:
    """The robot whose coefficients of these names (Fv1, ...) have these values."""
    effects = []
    for record in robot.effects:
        name = COEFFICIENTS[record["effect"]]
        known = values.get(f"{name}{record['joint']}", record[name])
        effects.append({**record, name: known})
    return replace(robot, effects=tuple(effects))


def typical(robot: Robot) -> dict[str, float]:
    """The robot's coefficients by name."""
    out = {}
    for record in robot.effects:
        name = COEFFICIENTS[record["effect"]]
        out[f"{name}{record['joint']}"] = record[name]
    return out


def make(robot: Robot, plan: Plan, folder: Path, *, first: int = 0) -> list[FleetLog]:
    """Write the logs folder/UNIT/SESSION.parquet; a unit depends on the seed and its number."""
    nominal, out = typical(robot), []
    for k in range(first, plan.units):
        g = torch.Generator().manual_seed(1000 * plan.seed + k)
        drawn = torch.randn(len(nominal), 1 + plan.sessions, generator=g, dtype=torch.float64)
        for s in range(plan.sessions):
            own = {
                name: value * (1 + plan.between * float(x[0]) + plan.daily * float(x[1 + s]))
                for (name, value), x in zip(nominal.items(), drawn, strict=True)
            }
            if k in (plan.odd or {}):
                name, more = (plan.odd or {})[k]
                own[name] += more
            arm = with_friction(robot, own)
            seed = 100_000 * plan.seed + 100 * k + s
            motion = random_trajectory(robot, seed, fill=True, duration=plan.seconds)
            noise = HonestNoise(torque_relative=plan.noise, colour_hz=plan.colour)
            log = simulate(arm, trajectory_log(motion, plan.rate), noise=noise, seed=seed)
            path = folder / unit_name(k) / f"{session_name(s)}.parquet"
            path.parent.mkdir(parents=True, exist_ok=True)
            write_log(log, path)
            out.append(FleetLog(unit_name(k), session_name(s), str(path)))
    return out
