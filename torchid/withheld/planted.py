"""How often the diagnosis would name a cause on one's own log: causes of a known size, planted in
what an answer leaves.

The corrected model is the simulator, and its log, whose gap is then what no cause explains, has one
cause more each time: an effect of the library, or a law of none. What is named beyond what is named
without it is right or wrong, and nobody has to know the arm.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import cycle, islice, product

import numpy as np
import torch
from msgspec import UNSET, UnsetType

from torchid import __version__
from torchid.design.columns import on_joint
from torchid.design.segments import Segment
from torchid.effects.base import JointEffect, Motion
from torchid.effects.registry import KINDS, model_torque, nominal_effects
from torchid.errors import TorchidError
from torchid.gap.data import prepare
from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.gap.settings import GapSettings
from torchid.gap.torque import diagnose_torque
from torchid.inputs import LogLike, as_log
from torchid.log.filtering import ZeroPhaseFilter
from torchid.log.model import Log
from torchid.parallel.workers import Progress, each
from torchid.results.cause import LINK, Cause
from torchid.results.record import Joint, Part, Real, Record, Result, Rows
from torchid.results.words import number_list
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor

USUAL = tuple(name for name, kind in KINDS.items() if kind.usual)
"""Effects that are planted beside those that the answer names, and what stands in their sets."""

OUTSIDE = "outside the library"
"""A smooth law of position and speed that no effect has."""


TIMES = 2.0
"""Size of a cause, over what the answer leaves on its joint [1]."""


@dataclass(frozen=True)
class Bed:
    """Where causes are planted: the corrected model as the simulator, and its log."""

    robot: Robot
    log: Log
    settings: GapSettings


@dataclass(frozen=True)
class Planting:
    """A cause to be planted.

    Attributes:
        name: of the effect, or `OUTSIDE`.
        joint: counted from 0.
        torque: added (T, n) on the grid of each segment [N m; N].
        size: its RMS on the joint [N m; N].
    """

    name: str
    joint: int
    torque: tuple[Float[Tensor, "T n"], ...]
    size: float


class FoundThere(Part, frozen=True):
    """An effect that was named, and where."""

    effect: str
    joints: tuple[Joint, ...]

    def __str__(self) -> str:
        return f"{self.effect} {number_list(self.joints)}".strip()


class Planted(Part, frozen=True):
    """A cause that was planted, and what was named.

    Attributes:
        effect: its name, or `outside the library`.
        joint: where.
        size: its RMS [N m; N].
        named: whether it was named there.
        in_set: whether it, or something that it cannot be told from, was.
        branch: whether a cause of its branch was named there.
        how_sure: of the surest cause that is named beyond what is named without it; None of none.
        named_instead: other causes that are named beyond those.
    """

    effect: str
    joint: Joint
    size: Real
    named: bool
    in_set: bool
    branch: bool
    how_sure: float | None
    named_instead: tuple[FoundThere, ...]


class CalibrationRecord(Record, frozen=True, kw_only=True, tag="torchid.gap.calibration/1"):
    """A calibration as its JSON has it; see Calibration."""

    version: str
    robot: str
    times: float
    planted: tuple[Planted, ...]
    seed: int | UnsetType = UNSET

    @property
    def table(self) -> Rows[Planted]:
        """What was planted."""
        return Rows(self.planted)


@dataclass(frozen=True)
class Calibration(Result):
    """How often an answer named causes that were planted, and what it named.

    Attributes:
        diagnosis: of the log as it is.
        times: size of each cause over what the answer leaves on its joint [1].
        planted: what became of each.
    """

    diagnosis: TorqueDiagnosis
    times: float
    planted: tuple[Planted, ...]

    def __repr__(self) -> str:
        inside = [p for p in self.planted if p.effect != OUTSIDE]
        right = sum(p.named for p in inside)
        return f"Calibration('{self.diagnosis.robot.name}', {right} of {len(inside)} named)"

    @cached_property
    def record(self) -> CalibrationRecord:
        """As the JSON has it."""
        return CalibrationRecord.of(self, version=__version__, robot=self.diagnosis.robot.name)


def calibrate(
    diagnosis: TorqueDiagnosis,
    log: LogLike,
    *,
    count: int = 30,
    times: float = TIMES,
    jobs: int = 1,
    progress: Progress | None = None,
) -> Calibration:
    """Plant causes in what a diagnosis leaves of its log, and diagnose each.

    Args:
        diagnosis: of the log.
        log: with torques.
        count: causes to plant: those that the answer names and what stands in their sets first, on
            the joints that leave most.
        times: size of each, over what the answer leaves on its joint [1].
        jobs: processes.
        progress: called with (stage, done, total).

    Raises:
        TorchidError: a floating base, less than one cause, or a diagnosis of the gap alone.

    >>> import torchid
    >>> robot = torchid.load_robot("3r")
    >>> motion = torchid.excite(robot, seed=1, duration=10.0, restarts=1, iterations=0).log()
    >>> friction = {"effect": "viscous_friction", "joint": 2, "Fv": 0.5}
    >>> log = torchid.simulate(robot, motion, effects=[friction])
    >>> few = torchid.GapSettings(effects=("viscous_friction", "joint_spring"))
    >>> found = torchid.diagnose(robot, log, settings=few)
    >>> [(p.effect, p.joint + 1) for p in torchid.calibrate(found, log, count=1).planted]
    [('viscous_friction', 2)]
    """
    log = as_log(log, diagnosis.robot)
    diagnosis.corrected.require_fixed_base("the calibration")
    if count < 1:
        raise TorchidError("a calibration plants causes.", got=count, expected="1 or more")
    again = replace(diagnosis.settings, background=(), parameters="auto")
    # Of an arm that is seen for the first time nobody knows how sure its numbers are.
    model = replace(diagnosis.corrected, knowledge=None)
    bed = Bed(model, log, replace(again, held_out_fraction=0.0))
    before = diagnose_torque(bed.robot, log, settings=bed.settings, force=True)
    segments = prepare(bed.robot, log, None).segments
    plantings = list(islice(_plantings(diagnosis, bed, segments, times), count))
    judge = partial(_planted, bed, before, [s.rate for s in segments])
    planted = each(judge, plantings, jobs, "planting causes", progress)
    return Calibration(diagnosis, times, tuple(planted))


def _plantings(
    diagnosis: TorqueDiagnosis, bed: Bed, segments: Sequence[Segment], times: float
) -> Iterator[Planting]:
    """Causes, the most wanted first, without end unless no joint moves."""
    motions = [_with_load(bed.robot, s.motion) for s in segments]
    named_causes = [f for f in diagnosis.which if f.effect != LINK]
    names = [f.effect for f in named_causes]
    names += [name.partition(" ")[0] for f in named_causes for name in f.ambiguous_with]
    names = [n for n in dict.fromkeys((*names, *USUAL)) if _can_be_planted(n, motions[0])]
    # A joint that leaves nothing moves not, or has no torque.
    after = diagnosis.how_far.rms_after.nan_to_num()
    joints = [j for j in after.argsort(descending=True).tolist() if float(after[j]) > 0]
    g = torch.Generator().manual_seed(bed.settings.seed)
    filters = [ZeroPhaseFilter(s.rate, min(diagnosis.band, 0.4 * s.rate)) for s in segments]
    for k, (joint, name) in enumerate(cycle(product(joints, names))):
        # 5: every sixth cause is of no library
        inside = [(joint, name)] if k % 5 else [(joint, name), (joint, OUTSIDE)]
        for where, kind in inside:
            shape = (
                _law_of_none(motions, where, g)
                if kind == OUTSIDE
                else _shape(bed, motions, kind, where, g)
            )
            seen = torch.cat([f.apply(x) for f, x in zip(filters, shape, strict=True)])
            size = times * float(after[where])
            scale = size / max(float(seen.square().mean().sqrt()), 1e-300)
            torque = [on_joint(scale * x[None], where, len(after))[0].T for x in shape]
            yield Planting(kind, where, tuple(torque), size)


def _with_load(robot: Robot, motion: Motion) -> Motion:
    """A measured motion with the torque of the model along it."""
    motion = motion._replace(direction=None, age=torch.zeros_like(motion.q))
    return motion._replace(torque=model_torque(robot, nominal_effects(robot), motion))


def _can_be_planted(name: str, motion: Motion) -> bool:
    """Whether an effect is one of a joint, needs no sensor that is not there, and is no event."""
    kind = KINDS[name]
    joint = issubclass(kind, JointEffect) and not (kind.event or kind.at_ends)
    return joint and all(getattr(motion, need, None) is not None for need in kind.needs)


def _shape(
    bed: Bed, motions: Sequence[Motion], name: str, joint: int, g: torch.Generator
) -> list[Float[Tensor, " T"]]:
    """Torque of a joint's effect of any size, each of its coefficients with about as much."""
    kind = KINDS[name]
    assert issubclass(kind, JointEffect)
    # 8.0: of the motions of which shapes are drawn [Hz]
    grid = kind.grid(motions, joint, 8.0)
    drawn = grid[int(torch.randint(len(grid), (1,), generator=g))].tolist()
    effect = kind(joint, **dict(zip((s.name for s in kind.shapes), drawn, strict=True)))
    columns = [effect.torque_columns(m, bed.robot)[:, joint] for m in motions]
    length = torch.cat(columns).square().mean(0).sqrt()
    share = torch.rand(len(length), generator=g, dtype=length.dtype) + 0.5
    values = torch.where(length > 1e-9 * length.max(), share / length.clamp(min=1e-300), 0.0)
    return [x @ values for x in columns]


def _law_of_none(
    motions: Sequence[Motion], joint: int, g: torch.Generator
) -> list[Float[Tensor, " T"]]:
    """A sum of waves over the joint's position, its speed, and the speed of another joint."""
    n = motions[0].q.shape[1]
    other = (joint + 1 + int(torch.randint(max(n - 1, 1), (1,), generator=g))) % n
    every = [torch.stack([m.q[:, joint], m.dq[:, joint], m.dq[:, other]], 1) for m in motions]
    mean, std = torch.cat(every).mean(0), torch.cat(every).std(0).clamp(min=1e-9)
    # Waves that such a law is the sum of; their numbers are drawn
    waves = 12
    ways = torch.randn(waves, 3, generator=g, dtype=mean.dtype)
    phase, size = torch.rand(2, waves, generator=g, dtype=mean.dtype)
    return [
        torch.cos((x - mean) / std @ ways.T + 2 * math.pi * phase) @ (size - 0.5) for x in every
    ]


def _planted(
    bed: Bed, before: TorqueDiagnosis, rates: Sequence[float], planting: Planting
) -> Planted:
    torch.set_num_threads(1)
    log = with_torque(bed.log, rates, planting.torque)
    diagnosis_after = diagnose_torque(bed.robot, log, settings=bed.settings, force=True)
    there = {(f.effect, f.at) for f in before.which}
    effects = [f for f in diagnosis_after.which if f.effect != LINK]
    new = [f for f in effects if (f.effect, f.at) not in there]
    name, place = planting.name, (planting.joint,)
    inside = name != OUTSIDE
    return Planted(
        effect=name,
        joint=planting.joint,
        size=planting.size,
        named=inside and named(diagnosis_after, name, place),
        in_set=inside and in_set(diagnosis_after, name, place),
        branch=inside and any(_alike(f, KINDS[name].branch, place) for f in effects),
        how_sure=max((f.probabilities[f.effect] for f in new if not f.one_of_a_set), default=None),
        named_instead=tuple(
            FoundThere(f.effect, f.at) for f in new if (f.effect, f.at) != (name, place)
        ),
    )


def named(diagnosis: TorqueDiagnosis, name: str, place: tuple[int, ...]) -> bool:
    """Whether an effect was named at its place."""
    return any((f.effect, f.at) == (name, place) for f in diagnosis.which)


def in_set(diagnosis: TorqueDiagnosis, name: str, place: tuple[int, ...]) -> bool:
    """Named, or among what a finding at its place, or of the whole arm, cannot be told from."""
    said = [({f.effect, *f.ambiguous_with} - {LINK}, f.at) for f in diagnosis.causes]
    return any(name in names and (not place or not at or at == place) for names, at in said)


def _alike(finding: Cause, branch: str, place: tuple[int, ...]) -> bool:
    return KINDS[finding.effect].branch == branch and finding.at == place


def with_torque(log: Log, rates: Sequence[float], added: Sequence[Float[Tensor, "T n"]]) -> Log:
    """A log with torques added at its own stamps, given on a grid of each trajectory.

    Args:
        log: with torques.
        rates: of the grids [Hz], which begin with the trajectories.
        added: torques on them [N m; N].
    """
    assert log.tau is not None
    tau = log.tau.clone()
    for rows, rate, torque in zip(log.slices(), rates, added, strict=True):
        t = (log.t[rows] - log.t[rows][0]).numpy()
        grid = np.arange(len(torque)) / rate
        columns = [np.interp(t, grid, x) for x in torque.T.numpy()]
        tau[rows] += torch.from_numpy(np.stack(columns, 1))
    return log.replace(tau=tau)
