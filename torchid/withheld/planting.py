"""Known effects on top of a real log: from which size on are they found?"""

from dataclasses import dataclass

import torch

from torchid.design.motion import measurements
from torchid.effects.base import JointEffect, Motion
from torchid.effects.registry import KINDS, Valued, effect_kind, model_torque, nominal_effects
from torchid.errors import TorchidError
from torchid.gap.diagnose import diagnose
from torchid.gap.diagnosis import Diagnosis
from torchid.gap.settings import GapSettings
from torchid.log.filtering import ZeroPhaseFilter
from torchid.log.model import Log
from torchid.log.sampling import resample
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor

LEVELS = (1.0, 2.0, 5.0, 10.0)
"""Sizes planted, in units of the noise of the joint's torque."""

FIRST_LEVEL = 1
"""Number of the level tried first; the search goes down where it is named, else up."""

BAND = 20.0
"""Of the motion along which effects are planted [Hz]."""


@dataclass(frozen=True)
class Planted:
    """A known effect on top of a real log.

    Attributes:
        effect: its name.
        joint: from 0.
        level: its RMS below BAND, in units of the joint's noise.
        coefficients: by name.
        named, in_set, status: as Withheld's.
    """

    effect: str
    joint: int
    level: float
    coefficients: dict[str, float]
    named: bool
    in_set: bool
    status: str


@dataclass(frozen=True)
class Bed:
    """Where an effect is planted: the corrected model, the untouched log, and the joint's noise."""

    robot: Robot
    log: Log
    settings: GapSettings
    kind: type[JointEffect]
    joint: int
    noise: float


def plantable(name: str) -> type[JointEffect]:
    """The effect of this name, which must be one of a joint's own motion.

    Raises:
        TorchidError: it is not.
    """
    kind = effect_kind(name)
    if not issubclass(kind, JointEffect):
        raise TorchidError(
            "only effects of one joint's motion can be planted in a log.",
            got=name,
            available=[n for n, k in KINDS.items() if issubclass(k, JointEffect)],
        )
    return kind


def named(found: Diagnosis, name: str, place: tuple[int, ...]) -> bool:
    """Whether an effect was named at its place."""
    return any((f.effect.name, f.located) == (name, place) for f in found.findings)


def in_set(found: Diagnosis, name: str, place: tuple[int, ...]) -> bool:
    """Named, or among what a finding at its place, or of the whole arm, cannot be told from."""
    said = [({f.effect.name, *f.ambiguous_with}, f.located) for f in found.findings]
    said += [(set(p.ambiguous_with), p.links) for p in found.parametric]
    return any(name in names and (not place or not at or at == place) for names, at in said)


def smallest_found(bed: Bed) -> list[Planted]:
    """The smallest level that is named, and what was tried on the way to it."""
    torch.set_num_threads(1)
    tried: list[Planted] = []
    k = FIRST_LEVEL
    while 0 <= k < len(LEVELS):
        tried.append(_one_level(bed, LEVELS[k]))
        down = tried[0].in_set
        if tried[-1].in_set is not down:
            break
        k += -1 if down else 1
    return sorted(tried, key=lambda p: p.level)


def _one_level(bed: Bed, level: float) -> Planted:
    effect, values, log = _on_top(bed, level)
    found = diagnose(bed.robot, log, settings=bed.settings)
    names = [c.name for c in effect.coefficients]
    return Planted(
        effect.name,
        bed.joint,
        level,
        dict(zip(names, values, strict=True)),
        named(found, effect.name, (bed.joint,)),
        in_set(found, effect.name, (bed.joint,)),
        found.status,
    )


def _on_top(bed: Bed, level: float) -> tuple[JointEffect, list[float], Log]:
    """The log with an effect's torque added, each coefficient's part of the same RMS."""
    even = resample(bed.log)
    effect = bed.kind(bed.joint)
    parts = list(even.trajectories())
    columns = [_columns(effect, bed.robot, part) for part in parts]
    size = torch.cat([low for _, low in columns]).square().mean(0).sqrt()
    values = torch.where(size > 0, 1 / size.clamp(min=1e-300), torch.zeros_like(size))
    together = torch.cat([low for _, low in columns]) @ values
    values = values * (level * bed.noise / together.square().mean().sqrt().clamp(min=1e-300))
    grown = []
    for part, (full, _) in zip(parts, columns, strict=True):
        assert part.tau is not None
        tau = part.tau.clone()
        tau[:, bed.joint] += full @ values
        grown.append(part.replace(tau=tau))
    return effect, values.tolist(), Log.concatenate(grown)


def _columns(
    effect: JointEffect, robot: Robot, part: Log
) -> tuple[Float[Tensor, "T C"], Float[Tensor, "T C"]]:
    """An effect's columns on its own joint along one trajectory, and the same below BAND."""
    (m,) = measurements(part, BAND)
    t = part.t - part.t[0]
    motion: Motion = m.motion._replace(t=t)
    effects: list[Valued] = nominal_effects(robot)
    motion = motion._replace(torque=model_torque(robot, effects, motion))
    full = effect.torque_columns(motion, robot)[:, effect.joint]
    return full, ZeroPhaseFilter(m.rate, BAND).apply(full.T).T
