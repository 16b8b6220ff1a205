"""The diagnosis checked on one's own arm: accepted effects withheld, known ones planted.

Nobody knows what a real arm hides. But an effect that was accepted on a part of its logs can be
taken out of the corrected model again: on logs that took no part so far, the diagnosis should find
it once more and close with it what it is known to close. And a known effect added to the real
torque, with its real noise and its real other gaps, tells what would be seen on this robot, in this
log.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import torch
from msgspec import UNSET, UnsetType, field, structs

from torchid import __version__
from torchid.design.columns import Columns, Model
from torchid.design.motion import measurements
from torchid.effects.base import JointEffect, Motion
from torchid.effects.registry import (
    EVENTS,
    KINDS,
    effect_kind,
    model_torque,
    nominal_effects,
)
from torchid.errors import LogError, TorchidError
from torchid.gap.data import prepare
from torchid.gap.diagnosis import Finding, TorqueDiagnosis
from torchid.gap.noise.floor import stuck
from torchid.gap.record import GapRecord
from torchid.gap.settings import GapSettings
from torchid.gap.torque import diagnose_torque
from torchid.gap.validate.closing import closing
from torchid.gap.validate.traces import traces
from torchid.identification.identify import prepared
from torchid.inputs import LogLike, RobotLike, as_log, as_robot
from torchid.log.filtering import ZeroPhaseFilter
from torchid.log.model import Log
from torchid.log.sampling import resample
from torchid.parallel.workers import Progress, each
from torchid.results.record import Joint, Part, Record, Result, Rows
from torchid.robot.model import Robot
from torchid.withheld.settings import PLANTED

LEVELS = (1.0, 2.0, 5.0, 10.0)
"""Sizes planted, in units of the noise of the joint's torque."""

FIRST_LEVEL = 1
"""Number of the level tried first; the search goes down where it is named, else up."""

BAND = 20.0
"""Of the motion along which effects are planted [Hz]."""


class Planted(Part, frozen=True):
    """A known effect on top of a real log.

    Attributes:
        effect: its name.
        joint: from 0.
        level: its RMS below BAND, in units of the joint's noise.
        coefficients: by name.
        named, in_set, status: as Withheld's.
    """

    effect: str
    joint: Joint
    level: float = field(name="size_over_noise")
    coefficients: dict[str, float]
    named: bool
    in_set: bool
    status: str


@dataclass(frozen=True)
class Bed:
    """Where effects are hidden: the corrected model as the simulator, and the untouched log."""

    robot: Robot
    log: Log
    settings: GapSettings


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


def named(found: TorqueDiagnosis, name: str, place: tuple[int, ...]) -> bool:
    """Whether an effect was named at its place."""
    return any((f.effect.name, f.located) == (name, place) for f in found.findings)


def in_set(found: TorqueDiagnosis, name: str, place: tuple[int, ...]) -> bool:
    """Named, or among what a finding at its place, or of the whole arm, cannot be told from."""
    said = [({f.effect.name, *f.ambiguous_with}, f.located) for f in found.findings]
    said += [(set(p.ambiguous_with), p.links) for p in found.parametric]
    return any(name in names and (not place or not at or at == place) for names, at in said)


def smallest_found(bed: Bed, planted: tuple[JointEffect, float]) -> list[Planted]:
    """The smallest level that is named, and what was tried on the way to it.

    Args:
        bed: where.
        planted: the effect, and the noise of its joint's torque.
    """
    torch.set_num_threads(1)
    tried: list[Planted] = []
    k = FIRST_LEVEL
    while 0 <= k < len(LEVELS):
        tried.append(_one_level(bed, *planted, LEVELS[k]))
        down = tried[0].in_set
        if tried[-1].in_set is not down:
            break
        k += -1 if down else 1
    return sorted(tried, key=lambda p: p.level)


def _one_level(bed: Bed, effect: JointEffect, noise: float, level: float) -> Planted:
    values, log = _on_top(bed, effect, level * noise)
    found = diagnose_torque(bed.robot, log, settings=bed.settings)
    at = effect.name, (effect.joint,)
    coefficients = {c.name: v for c, v in zip(effect.coefficients, values, strict=True)}
    said = named(found, *at), in_set(found, *at), found.status
    return Planted(effect.name, effect.joint, level, coefficients, *said)


def _on_top(bed: Bed, effect: JointEffect, size: float) -> tuple[list[float], Log]:
    """The log with an effect's torque added, of an RMS below BAND to which each coefficient's part
    adds the same."""
    parts = list(resample(bed.log).trajectories())
    effects = nominal_effects(bed.robot)
    # The effect's columns on its own joint along each trajectory, and the same below BAND.
    columns, low = [], []
    for part in parts:
        (m,) = measurements(part, BAND)
        motion: Motion = m.whole._replace(t=part.t - part.t[0])
        motion = motion._replace(torque=model_torque(bed.robot, effects, motion))
        columns.append(effect.torque_columns(motion, bed.robot)[:, effect.joint])
        low.append(ZeroPhaseFilter(m.rate, BAND).apply(columns[-1].T).T)
    rms = torch.cat(low).square().mean(0).sqrt()
    values = torch.where(rms > 0, 1 / rms.clamp(min=1e-300), torch.zeros_like(rms))
    together = torch.cat(low) @ values
    values = values * (size / together.square().mean().sqrt().clamp(min=1e-300))
    grown = []
    for part, full in zip(parts, columns, strict=True):
        assert part.tau is not None
        tau = part.tau.clone()
        tau[:, effect.joint] += full @ values
        grown.append(part.replace(tau=tau))
    return values.tolist(), Log.concatenate(grown)


AS_MUCH = 0.9
"""Share of what an effect is known to close that must be closed once more."""


class FoundThere(Part, frozen=True):
    """An effect that was named, and where."""

    effect: str
    joints: tuple[Joint, ...]


class Withheld(Part, frozen=True):
    """An accepted effect, taken out of the corrected model, on untouched data.

    Attributes:
        effect: its name.
        joints: from 0; none where it belongs to the whole arm.
        named: whether it was named at its place.
        in_set: whether it, or something that it cannot be told from, was.
        found: all that was named.
        known: share of the closable gap that it closes on these data, as fitted on the others; None
            where there is no gap without it.
        closed, closed_ci95: share that the diagnosis closed.
        status: of the diagnosis.
        as_much: whether the gap shrank as much as it is known to; None where there was none.
    """

    effect: str
    joints: tuple[Joint, ...]
    named: bool
    in_set: bool
    found: tuple[FoundThere, ...]
    known: float | None = field(name="known_closed")
    closed: float | None
    closed_ci95: tuple[float, float] | None
    status: str
    as_much: bool | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        enough = self.closed is not None and self.closed >= AS_MUCH * (self.known or 0.0)
        structs.force_setattr(self, "as_much", None if self.known is None else enough)


class OwnRecord(Record, frozen=True, kw_only=True, tag="torchid.withheld.own/1"):
    """A check on one's own arm as its JSON has it; see OwnCheck."""

    version: str
    robot: str
    untouched: tuple[str, ...]
    whole: bool = field(name="untouched_are_whole_trajectories")
    withheld: tuple[Withheld, ...]
    planted: tuple[Planted, ...]
    first: GapRecord = field(name="diagnosis")
    seed: int | UnsetType = UNSET

    @property
    def table(self) -> Rows[Withheld]:
        """What was withheld."""
        return Rows(self.withheld)


@dataclass(frozen=True)
class OwnCheck(Result):
    """All of it.

    Attributes:
        first: the diagnosis on the first part of the logs.
        untouched: names of the trajectories that took no part in it.
        whole: whether these are trajectories of their own, not the ends of the same ones.
        withheld, planted: what became of both.
    """

    first: TorqueDiagnosis
    untouched: tuple[str, ...]
    whole: bool
    withheld: tuple[Withheld, ...]
    planted: tuple[Planted, ...]

    def __repr__(self) -> str:
        named = sum(w.named for w in self.withheld)
        name = self.first.robot.name
        return f"OwnCheck('{name}', {named} of {len(self.withheld)} withheld effects named again)"

    @cached_property
    def record(self) -> OwnRecord:
        """As the JSON has it."""
        return OwnRecord.of(
            self,
            version=__version__,
            robot=self.first.robot.name,
            first=self.first.record,
        )


def withheld_own(
    robot: RobotLike,
    log: LogLike,
    *,
    untouched: LogLike | None = None,
    settings: GapSettings | None = None,
    plant: Sequence[str] = PLANTED,
    joints: Sequence[int] | None = None,
    jobs: int = 1,
    progress: Progress | None = None,
) -> OwnCheck:
    """The diagnosis checked on one's own arm: every accepted effect withheld once, and known ones
    planted.

    Every effect that is accepted on the log is taken out of the corrected model and sought again on
    untouched data. Then known effects are added to the measured torque there, to see from which
    size on they are found.

    Args:
        robot: as for `diagnose`.
        log: trajectories of the real arm.
        untouched: other ones; if None the second half of every trajectory is kept apart.
        settings: of all diagnoses; rollouts are left out.
        plant: names of effects of one joint.
        joints: where they are planted, from 0; everywhere if None.
        jobs: processes.
        progress: called with (stage, done, total).

    Raises:
        LogError: logs that cannot be used.
        TorchidError: an effect that does not act on one joint, or a joint that is not there.

    >>> import torchid
    >>> robot = torchid.load_robot("3r")
    >>> motions = [torchid.excite(robot, seed=k, duration=10.0, restarts=1, iterations=0).log()
    ...            for k in (1, 2)]
    >>> friction = {"effect": "viscous_friction", "joint": 2, "Fv": 0.5}
    >>> first, other = (torchid.simulate(robot, m, effects=[friction]) for m in motions)
    >>> settings = GapSettings(effects=("viscous_friction", "coulomb_friction"))
    >>> found = withheld_own(robot, first, untouched=other, settings=settings, plant=())
    >>> [(w.effect, w.joints, w.named, w.as_much) for w in found.withheld]
    [('viscous_friction', (1,), True, True)]
    """
    robot = as_robot(robot)
    log = as_log(log, robot)
    untouched = None if untouched is None else as_log(untouched, robot)
    robot.require_fixed_base("the check by planted effects")
    kinds = [plantable(name) for name in plant]
    places = list(range(robot.n) if joints is None else joints)
    wrong = [j + 1 for j in places if not 0 <= j < robot.n]
    if wrong:
        raise TorchidError(
            f"robot '{robot.name}' has no such joint.", got=wrong, expected=f"1..{robot.n}"
        )
    settings = replace(settings or GapSettings(), rollout=False, held_out_fraction=0.0)
    whole = untouched is not None
    if untouched is None:
        log, untouched = log.split(0.5)
    if untouched.tau is None:
        raise LogError("the untouched log has no torque.", got=list(untouched.signals))
    prepared(untouched, robot)  # what cannot be used is refused before the first part is diagnosed
    if progress is not None:
        progress("diagnosing the first part", 0, 1)
    first = diagnose_torque(robot, log, settings=settings)
    # From here on the corrected model is the simulator, and its parameters are given.
    again = replace(settings, background=(), parameters="auto")
    bed = Bed(first.corrected, untouched, again)
    lasting = [f for f in first.findings if f.effect.name not in EVENTS]
    noise = (first.floor.low * first.floor.high).sqrt().tolist()
    known = [(kind(j), noise[j]) for kind in kinds for j in places]
    hide, plant_one = partial(_withheld, bed), partial(smallest_found, bed)
    withheld = each(hide, lasting, jobs, "withholding what was accepted", progress)
    planted = each(plant_one, known, jobs, "planting known effects", progress)
    flat = tuple(one for several in planted for one in several)
    return OwnCheck(first, tuple(untouched.names), whole, tuple(withheld), flat)


def _without(corrected: Robot, finding: Finding) -> Robot:
    """The corrected model as it would be without a finding."""
    kept = []
    for effect, values in nominal_effects(corrected):
        same = effect == finding.effect
        if finding.common:
            same = type(effect) is type(finding.effect) and tuple(values) == finding.values
        left = [a - b for a, b in zip(values, finding.values, strict=True)] if same else values
        if not same or any(abs(x) > 1e-9 * abs(v) for x, v in zip(left, values, strict=True)):
            kept.append(effect.record(left))
    return replace(corrected, effects=tuple(kept))


def _withheld(bed: Bed, finding: Finding) -> Withheld:
    torch.set_num_threads(1)
    robbed = _without(bed.robot, finding)
    found = diagnose_torque(robbed, bed.log, settings=bed.settings)
    given = prepare(robbed, bed.log, found.cutoff)
    before, after = map(Model.of, (robbed, bed.robot))
    reach = stuck(Columns(after, given.samples), found.floor.high)
    shown = traces(given.samples, None, [before], [after], found.band, reach=reach)
    known = closing(shown, found.floor, bed.settings.seed)
    name, place = finding.effect.name, finding.located
    return Withheld(
        name,
        place,
        named(found, name, place),
        in_set(found, name, place),
        tuple(FoundThere(f.effect.name, f.located) for f in found.findings),
        known.closed,
        found.how_far.closed,
        found.how_far.closed_ci95,
        found.status,
    )
