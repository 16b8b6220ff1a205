"""The diagnosis checked on one's own arm: accepted effects withheld, known ones planted.

Nobody knows what a real arm hides. But an effect that was accepted on a part of its logs can be
taken out of the corrected model again: on logs that took no part so far, the diagnosis should find
it once more and close with it what it is known to close. And a known effect added to the real
torque, with its real noise and its real other gaps, tells what would be seen on this robot, in this
log.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch

from torchid import __version__
from torchid.design.columns import Columns, Model
from torchid.effects.registry import EVENTS, nominal_effects
from torchid.errors import LogError, TorchidError
from torchid.gap.data import prepare
from torchid.gap.diagnose import diagnose
from torchid.gap.diagnosis import Diagnosis, Finding
from torchid.gap.noise.floor import stuck
from torchid.gap.record import record
from torchid.gap.settings import GapSettings
from torchid.gap.validate.closing import closing
from torchid.gap.validate.folds import traces
from torchid.json_data import plain
from torchid.log.model import Log
from torchid.robot.model import Robot
from torchid.withheld.parallel import each
from torchid.withheld.planting import Bed, Planted, in_set, named, plantable, smallest_found

SCHEMA = "torchid.withheld.own/1"

AS_MUCH = 0.9
"""Share of what an effect is known to close that must be closed once more."""

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Withheld:
    """An accepted effect, taken out of the corrected model, on untouched data.

    Attributes:
        effect: its name.
        joints: from 0; none where it belongs to the whole arm.
        named: whether it was named at its place.
        in_set: whether it, or something that it cannot be told from, was.
        findings: (name, joints from 0) of all that was named.
        known: share of the closable gap that it closes on these data, as fitted on the others; None
            where there is no gap without it.
        closed, closed_ci95: share that the diagnosis closed.
        status: of the diagnosis.
    """

    effect: str
    joints: tuple[int, ...]
    named: bool
    in_set: bool
    findings: tuple[tuple[str, tuple[int, ...]], ...]
    known: float | None
    closed: float | None
    closed_ci95: tuple[float, float] | None
    status: str

    @property
    def as_much(self) -> bool | None:
        """Whether the gap shrank as much as it is known to; None where there was none."""
        if self.known is None:
            return None
        return self.closed is not None and self.closed >= AS_MUCH * self.known


@dataclass(frozen=True)
class OwnCheck:
    """All of it.

    Attributes:
        first: the diagnosis on the first part of the logs.
        untouched: names of the trajectories that took no part in it.
        whole: whether these are trajectories of their own, not the ends of the same ones.
        withheld, planted: what became of both.
    """

    first: Diagnosis
    untouched: tuple[str, ...]
    whole: bool
    withheld: tuple[Withheld, ...]
    planted: tuple[Planted, ...]


@dataclass(frozen=True)
class _Hidden:
    """A diagnosis to make: a simulator, a log, and the finding the simulator was robbed of."""

    robot: Robot
    corrected: Robot
    log: Log
    settings: GapSettings
    finding: Finding


def check_own(
    robot: Robot,
    log: Log,
    *,
    untouched: Log | None = None,
    settings: GapSettings | None = None,
    plant: Sequence[str] = (),
    joints: Sequence[int] | None = None,
    jobs: int = 1,
    progress: Progress | None = None,
) -> OwnCheck:
    """Withhold every accepted effect once, and plant known ones.

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
    """
    kinds = [plantable(name) for name in plant]
    places = list(range(robot.n)) if joints is None else _joints(joints, robot)
    settings = replace(settings or GapSettings(), rollout=False, held_out_fraction=0.0)
    say = progress or (lambda stage, done, total: None)
    whole = untouched is not None
    if untouched is None:
        log, untouched = log.split(0.5)
    if untouched.tau is None:
        raise LogError("the untouched log has no torque.", got=list(untouched.signals))
    say("diagnosing the first part", 0, 1)
    first = diagnose(robot, log, settings=settings)
    # From here on the corrected model is the simulator, and its parameters are given.
    again = replace(settings, background=(), parameters="auto")
    hidden = [
        _Hidden(_without(first.corrected, f), first.corrected, untouched, again, f)
        for f in first.findings
        if f.effect.name not in EVENTS
    ]
    noise = (first.floor.low * first.floor.high).sqrt().tolist()
    beds = [
        Bed(first.corrected, untouched, again, kind, j, noise[j]) for kind in kinds for j in places
    ]
    withheld = _all(_withheld, hidden, jobs, "withholding what was accepted", say)
    planted = _all(smallest_found, beds, jobs, "planting known effects", say)
    flat = tuple(one for several in planted for one in several)
    return OwnCheck(first, tuple(untouched.names), whole, tuple(withheld), flat)


def own_record(found: OwnCheck) -> dict[str, Any]:
    """As JSON-ready data; joints from 1."""
    data: dict[str, Any] = plain(
        {
            "schema": SCHEMA,
            "version": __version__,
            "robot": found.first.robot.name,
            "untouched": found.untouched,
            "untouched_are_whole_trajectories": found.whole,
            "withheld": [
                {
                    "effect": w.effect,
                    "joints": [j + 1 for j in w.joints],
                    "named": w.named,
                    "in_set": w.in_set,
                    "found": [
                        {"effect": name, "joints": [j + 1 for j in js]} for name, js in w.findings
                    ],
                    "known_closed": w.known,
                    "closed": w.closed,
                    "closed_ci95": w.closed_ci95,
                    "as_much": w.as_much,
                    "status": w.status,
                }
                for w in found.withheld
            ],
            "planted": [
                {
                    "effect": p.effect,
                    "joint": p.joint + 1,
                    "size_over_noise": p.level,
                    "coefficients": p.coefficients,
                    "named": p.named,
                    "in_set": p.in_set,
                    "status": p.status,
                }
                for p in found.planted
            ],
            "diagnosis": record(found.first),
        }
    )
    return data


def _joints(joints: Sequence[int], robot: Robot) -> list[int]:
    wrong = [j + 1 for j in joints if not 0 <= j < robot.n]
    if wrong:
        raise TorchidError(
            f"robot '{robot.name}' has no such joint.", got=wrong, expected=f"1..{robot.n}"
        )
    return list(joints)


def _all(
    function: Callable[[Any], Any], todo: Sequence[Any], jobs: int, stage: str, say: Progress
) -> list[Any]:
    """Results in the order of the jobs."""
    done: dict[int, Any] = {}
    say(stage, 0, len(todo))
    for job, result in each(function, todo, jobs):
        done[id(job)] = result
        say(stage, len(done), len(todo))
    return [done[id(job)] for job in todo]


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


def _model(robot: Robot) -> Model:
    return Model(robot, tuple(nominal_effects(robot)))


def _withheld(job: _Hidden) -> Withheld:
    torch.set_num_threads(1)
    found = diagnose(job.robot, job.log, settings=job.settings)
    given = prepare(job.robot, job.log, found.cutoff)
    before, after = _model(job.robot), _model(job.corrected)
    reach = stuck(Columns(after, given.samples), found.floor.high)
    shown = traces(given.samples, None, [before], [after], found.band, reach=reach)
    known = closing(shown, found.floor, job.settings.seed)
    name, place = job.finding.effect.name, job.finding.located
    return Withheld(
        name,
        place,
        named(found, name, place),
        in_set(found, name, place),
        tuple((f.effect.name, f.located) for f in found.findings),
        known.closed,
        found.how_far.closed,
        found.how_far.closed_ci95,
        found.status,
    )
