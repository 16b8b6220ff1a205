"""The diagnosis checked on one's own arm: accepted effects withheld.

Nobody knows what a real arm hides. But an effect that was accepted on a part of its logs can be
taken out of the corrected model again: on logs that took no part so far, the diagnosis should find
it once more and close with it what it is known to close.
"""

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Annotated

import torch
from msgspec import UNSET, UnsetType, field, structs

from torchid import __version__
from torchid.design.columns import Columns, Model
from torchid.doctor.first import ask_first
from torchid.effects.registry import EVENTS, nominal_effects
from torchid.errors import LogError
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
from torchid.log.model import Log
from torchid.parallel.workers import Progress, each
from torchid.results.record import Col, Joint, Part, Record, Result, Rows
from torchid.results.words import number_list, percent
from torchid.robot.model import Robot


@dataclass(frozen=True)
class Bed:
    """Where effects are hidden: the corrected model as the simulator, and the untouched log."""

    robot: Robot
    log: Log
    settings: GapSettings


def named(found: TorqueDiagnosis, name: str, place: tuple[int, ...]) -> bool:
    """Whether an effect was named at its place."""
    return any((f.effect.name, f.located) == (name, place) for f in found.findings)


def in_set(found: TorqueDiagnosis, name: str, place: tuple[int, ...]) -> bool:
    """Named, or among what a finding at its place, or of the whole arm, cannot be told from."""
    said = [({f.effect.name, *f.ambiguous_with}, f.located) for f in found.findings]
    said += [(set(p.ambiguous_with), p.links) for p in found.parametric]
    return any(name in names and (not place or not at or at == place) for names, at in said)


AS_MUCH = 0.9
"""Share of what an effect is known to close that must be closed once more."""


class FoundThere(Part, frozen=True):
    """An effect that was named, and where."""

    effect: str
    joints: tuple[Joint, ...]

    def __str__(self) -> str:
        return f"{self.effect} {number_list(self.joints)}".strip()


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

    effect: Annotated[str, Col()]
    joints: Annotated[tuple[Joint, ...], Col()]
    named: Annotated[bool, Col()]
    in_set: Annotated[bool, Col()]
    found: Annotated[tuple[FoundThere, ...], Col("all that is named")]
    known: Annotated[float | None, Col("known to close", words=percent)] = field(
        name="known_closed"
    )
    closed: Annotated[float | None, Col(words=percent)]
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
        withheld: what became of every accepted effect.
    """

    first: TorqueDiagnosis
    untouched: tuple[str, ...]
    whole: bool
    withheld: tuple[Withheld, ...]

    def __repr__(self) -> str:
        named = sum(w.named for w in self.withheld)
        name = self.first.robot.name
        return f"OwnCheck('{name}', {named} of {len(self.withheld)} withheld effects named again)"

    @cached_property
    def record(self) -> OwnRecord:
        """As the JSON has it."""
        first = self.first
        return OwnRecord.of(self, version=__version__, robot=first.robot.name, first=first.record)


def withheld_own(
    robot: RobotLike,
    log: LogLike,
    *,
    untouched: LogLike | None = None,
    settings: GapSettings | None = None,
    force: bool = False,
    jobs: int = 1,
    progress: Progress | None = None,
) -> OwnCheck:
    """The diagnosis checked on one's own arm: every accepted effect is taken out of the corrected
    model once, and sought again on untouched data.

    Args:
        robot: as for `diagnose`.
        log: trajectories of the real arm.
        untouched: other ones; if None the second half of every trajectory is kept apart.
        settings: of all diagnoses; rollouts are left out.
        force: go on with logs that the doctor's decisive checks say are wrong.
        jobs: processes.
        progress: called with (stage, done, total).

    Raises:
        WrongLogError: a decisive check of `torchid.doctor.first` says that a log is wrong.
        LogError: logs that cannot be used.

    >>> import torchid
    >>> robot = torchid.load_robot("3r")
    >>> motions = [torchid.excite(robot, seed=k, duration=10.0, restarts=1, iterations=0).log()
    ...            for k in (1, 2)]
    >>> friction = {"effect": "viscous_friction", "joint": 2, "Fv": 0.5}
    >>> first, other = (torchid.simulate(robot, m, effects=[friction]) for m in motions)
    >>> settings = GapSettings(effects=("viscous_friction", "coulomb_friction"))
    >>> found = withheld_own(robot, first, untouched=other, settings=settings)
    >>> [(w.effect, w.joints, w.named, w.as_much) for w in found.withheld]
    [('viscous_friction', (1,), True, True)]
    """
    robot = as_robot(robot)
    log = as_log(log, robot)
    untouched = None if untouched is None else as_log(untouched, robot)
    robot.require_fixed_base("the check by withheld effects")
    settings = replace(settings or GapSettings(), rollout=False, held_out_fraction=0.0)
    whole = untouched is not None
    if untouched is None:
        log, untouched = log.split(0.5)
    if untouched.tau is None:
        raise LogError("the untouched log has no torque.", got=list(untouched.signals))
    doubts = ask_first(robot, Log.concatenate([log, untouched]), force=force)
    prepared(untouched, robot)  # what cannot be used is refused before the first part is diagnosed
    if progress is not None:
        progress("diagnosing the first part", 0, 1)
    first = diagnose_torque(robot, log, settings=settings, force=force)
    first = replace(first, doubt=doubts.short, warnings=(*doubts.warnings, *first.warnings))
    # From here on the corrected model is the simulator, and its parameters are given.
    again = replace(settings, background=(), parameters="auto")
    lasting = [f for f in first.findings if f.effect.name not in EVENTS]
    hide = partial(_withheld, Bed(first.corrected, untouched, again))
    withheld = each(hide, lasting, jobs, "withholding what was accepted", progress)
    return OwnCheck(first, tuple(untouched.names), whole, tuple(withheld))


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
