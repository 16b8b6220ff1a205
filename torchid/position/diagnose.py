"""From logs of commands and positions to named causes: data, search, what each is worth, how far.

Read from top to bottom: `diagnose_positions` is the pipeline.
"""

import itertools
import math
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import msgspec
import torch
from torch import Tensor

from torchid.effects.servo import ServoEffect
from torchid.log.checks import STILL
from torchid.log.model import Log
from torchid.position.data import WINDOW_S, PositionData, missing_commands, prepare
from torchid.position.diagnosis import Number, PositionDiagnosis, finding_of
from torchid.position.early import EarlyAnswer
from torchid.position.effects import BY_NAME, CORE, EFFECTS, GAINS, GRAVITY, KEPT, PAYLOAD, neutral
from torchid.position.equal import OF_TYPE, pooled, with_data_sheets
from torchid.position.file_servos import (
    Worth,
    beside_file,
    changes_of,
    follows,
    weighing_otherwise,
)
from torchid.position.fit import NOISE, VALLEYS, errors, errors_of_one, fit
from torchid.position.judge import (
    Equations,
    closed_interval,
    each_window,
    equations,
    folds_of,
    losses_of,
    mostly_better,
    of_motions,
    value_interval,
)
from torchid.position.model import ServoArm
from torchid.position.odds import alike_rises, drawn_windows, effect_sure
from torchid.position.payload import Loaded, with_load
from torchid.position.record import Accuracy, PositionFinding
from torchid.position.repeats import PositionNoise, noise_of_repeats
from torchid.position.replay import accuracy
from torchid.position.rods import PER_METRE
from torchid.position.search import (
    ALIKE,
    Found,
    Rivals,
    alone,
    full,
    plain,
    refit,
    settled,
    shared,
    slight,
)
from torchid.position.untestable import not_testable
from torchid.results.answer import UNCHANGED, Answer
from torchid.results.replication import Replication
from torchid.robot.model import Robot
from torchid.simulation.servo import INDEX, PARAMETERS, PER_KP, PLANE, TORQUES, Servos, as_share
from torchid.simulation.servo_loop import Windows, windows_of
from torchid.statistics.criteria import LIKELY, WORTHWHILE
from torchid.statistics.proportion import HALF_95
from torchid.typing import Float

STAGES = 16
"""That are told as progress."""
MOST = 250
"""Windows that a search looks at [1]: more do not change what it finds, only how long it takes."""
WORSE = 0.1
"""Rise of a joint's squared error from which it is not of the type of the others [1]."""
RATIO = 0.2
"""Standard deviation of a torque's scale from which only ratios are told, by the load that noise
leaves to be seen, or by the log as it is [1]."""


def diagnose_positions(
    robot: Robot,
    log: Log,
    *,
    held_out: Log | None = None,
    trusted: bool = False,
    types: Sequence[str] = (),
    sheets: Sequence[Mapping[str, float]] = (),
    start: ServoArm | None = None,
    worthwhile: float = WORTHWHILE,
    progress: Callable[[str, int, int], None] | None = None,
    watch: Callable[[Answer], None] | None = None,
) -> PositionDiagnosis:
    """Which causes part an arm's positions from its commands, and how far that goes.

    Args:
        robot: gravity of its masses tells torques from ratios. Where it has none, its links are
            taken for rods, and all torques are told in their ratios.
        log: t, q and u of several motions; of one alone nothing can be held out but its parts.
        held_out: motions that take part in nothing but the judgement.
        trusted: whether the masses of the robot's file are right; else they are known as files are,
            and all torques with them.
        start: the arm that the robot's own file describes. Where its servos follow all joints
            nothing is sought; else what is found is held against them.
        types: of the joints' servos: those of one name are units of one type.
        sheets: what their makers say of them, values by parameter.
        worthwhile: least share of a joint's error by which a cause must lower it to be named.
        progress: called with the stage, steps done and steps in all.
        watch: called with an `Answer` of status `searching` whenever more is known.

    Returns:
        The answer; its `corrected` arm is what `torchid.replay` moves.

    Raises:
        LogError: no commands, other joints than the robot's, uneven sampling, or too short a log.
    """
    robot.require_fixed_base("a diagnosis of positions")
    begun, stages = time.perf_counter(), itertools.count()

    def say(stage: str) -> None:
        if progress is not None:
            progress(stage, next(stages), STAGES)

    log, warnings = _parted(log)
    scaled = start is not None and bool((start.scale != 1).any())
    data = prepare(robot, log, start.scale if start is not None and scaled else None)
    if start is not None:
        data = replace(data, damping_share=start.servos.of("damping_share"))
    windows = windows_of(data.tracks, WINDOW_S)
    say("a plain servo")
    simple = plain(data, some_of(windows, MOST))
    telling = _telling(data, simple, windows)
    few, more = some_of(windows, MOST, telling), some_of(windows, 3 * MOST, telling)
    noise = noise_of_repeats(data, simple.servos)
    given, still, answered = data, _still(data), None
    as_given, own, by_file = None, None, None
    squares = 1.0 - (1.0 - worthwhile) ** 2
    if start is not None:
        as_given, own = follows(data, start.servos, simple.free, noise, few)
        answered = _as_the_file(data, start.servos, (as_given, own), simple, noise, few)
    if answered is None:
        early = None
        if watch is not None:
            first = simple if own is None else own
            early = EarlyAnswer(
                watch, data, losses_of(data, first.servos, few).sum(0), few, own is not None
            )
        answered = _answer(data, simple, few, more, say, early, squares, own)
        if own is not None:
            found, by_file, worth = beside_file(
                answered.data, answered.found, own.servos, few, squares, answered.worth
            )
            answered = replace(answered, found=found, worth=worth)
    data, found = answered.data, answered.found
    say("how far it goes")
    known = equations(data, found.servos, found.free, more, trusted=trusted)
    if any(sheets):
        known = with_data_sheets(known, sheets, ~still)
        found = replace(found, servos=known.servos)
    if len(set(types) - {""}) and data.weighed:
        known, odd = _of_one_type(data, known, found, types, ~still, few)
        found = replace(found, servos=known.servos)
        warnings += odd
    answered, servos = replace(answered, found=found), found.servos
    models = [(given, simple), (data, found)]
    if own is not None:
        fixed = (data, Found(servos, {}, False)) if by_file is None else models[1]
        models = [models[0], fixed, (given, Found(own.servos, {}, False))]
    ways, errors_of = _accuracies(models, windows, few)
    before = len(models) - 1 if own is not None else 0
    deviation = known.deviations()[:, known.names.index("kp")]
    # A joint at rest tells no torque either.
    anchored = torch.tensor([t != "" for t in types or [""] * servos.n])
    anchored |= torch.tensor(["kp" in sheet for sheet in sheets or [{}] * servos.n])
    unanchored = (_ratio_only(known) & ~anchored) | (not data.weighed)
    # What a file's masses are unsure by is no ratio in that file.
    unanchored |= (deviation.square() - known.torque_std.square()).clamp(min=0).sqrt() > RATIO
    ratio_only = unanchored | (deviation > RATIO)
    if own is not None:
        # The file's gain and masses are the scale; the log refutes a gain beside masses alone.
        ratio_only = unanchored = torch.full_like(still, not data.weighed) & ~(
            torch.ones_like(still) if by_file is None else by_file
        )
    findings = _findings(answered, known, few, ratio_only, noise, None if own is None else start)
    findings = _held_to(findings, ways[1 + before], ways[1], ways[2], own is not None)
    unknown = still | ratio_only
    interval = [
        value_interval("kp", k, d)
        for k, d in zip(servos.of("kp").tolist(), deviation.tolist(), strict=True)
    ]
    result = PositionDiagnosis(
        data=data,
        servos=servos,
        findings=findings,
        gains=(
            servos.of("kp").masked_fill(unknown, torch.nan),
            torch.tensor(interval).masked_fill(unknown[:, None], torch.nan),
        ),
        ratio_only=ratio_only,
        unanchored=unanchored,
        commanded=ways[0],
        plain_servo=ways[1],
        answered=ways[2],
        file=ways[3] if own is not None else None,
        regimes=_regimes(data, errors_of[before], errors_of[1]),
        motions=(log.names, _by_motion(data, errors_of[1])),
        errors=(errors_of[before], errors_of[1]),
        still=still,
        warnings=warnings + missing_commands(log) + _cautions(data, still),
        not_testable=not_testable(data, known, few, ~still),
        closed_ci95=closed_interval(
            data, errors_of[before], errors_of[1], ~still, noise.square / data.scale.square()
        ),
        noise=noise,
        seconds=time.perf_counter() - begun,
        known=tuple(
            (tuple(itertools.compress(known.names, on)), covariance[on][:, on])
            for covariance, on in zip(known.expected(), known.mask & ~still[:, None], strict=True)
        ),
        as_given=as_given,
        changes=() if start is None else changes_of(start, known, ratio_only, still),
    )
    if held_out is None:
        return result
    return replace(result, held_out=accuracy(result.corrected, held_out, ~still))


def _cautions(data: PositionData, still: Tensor) -> tuple[str, ...]:
    """What to know about joints and robot, one sentence each."""
    names = data.robot.joint_names
    out = [
        f"joint {j + 1} {names[j]} never moves, so its servo is not identified."
        for j in torch.nonzero(still).flatten().tolist()
    ]
    if not data.weighed:
        out.append(
            f"robot '{data.robot.name}' has no masses: its links were taken for rods of "
            f"{PER_METRE:g} kg per metre, so gains, friction and inertias are right in their "
            "ratios alone."
        )
    out += [
        f"joint {j + 1}: dq is {float(s):.3g} times the rate of q, so q and u are taken to be in "
        f"another unit than radians, by that factor"
        for j, s in enumerate(data.scale)
        if s != 1
    ]
    return tuple(out)


def _as_the_file(
    data: PositionData,
    servos: Servos,
    own: tuple[Tensor, Found],
    simple: Found,
    noise: PositionNoise,
    windows: Windows,
) -> "_Answer | None":
    """The servos of a robot's file where all joints follow them, as it is or but for gravity that
    they feel there, or do not feel; None where they do not."""
    still, (near, found) = _still(data), own
    if bool((near | still).all()):
        return _Answer(data, found, {}, {}, None)
    if not data.weighed or not bool(data.robot.gravity.any()):
        return None
    other = weighing_otherwise(data)
    near, there = follows(other, servos, simple.free, noise, windows)
    if not bool((near | still).all()):
        return None
    without = losses_of(data, found.servos, windows)
    with_it = losses_of(other, there.servos, windows)
    return _Answer(other, there, {GRAVITY.name: (without, with_it)}, {}, None)


def _held_to(
    findings: Sequence[PositionFinding],
    before: Accuracy,
    simple: Accuracy,
    after: Accuracy,
    of_file: bool,
) -> tuple[PositionFinding, ...]:
    """Findings of which none is sure that does no good on motions that were left out, neither
    beside what there was before, nor beside plain servos; and no change is whose interval holds
    what the robot's file says."""
    out = []
    for f in findings:
        at = list(f.joints) or slice(None)
        was = before if of_file and (f.was or f.effect == GRAVITY.name) else simple
        ends = [float(way.whole[at].nanmean()) for way in (was, after)]
        same = bool(f.was) and all(
            f.ci95[name][0] <= was <= f.ci95[name][1] for name, was in f.was.items()
        )
        most = 1.0 if ends[1] < UNCHANGED * ends[0] and not same else LIKELY - 0.01
        most = most if f.how_sure is None else min(f.how_sure, most)
        out.append(f if most == f.how_sure else msgspec.structs.replace(f, how_sure=most))
    return tuple(out)


def _of_one_type(
    data: PositionData,
    known: Equations,
    found: Found,
    types: Sequence[str],
    moves: Tensor,
    windows: Windows,
) -> tuple[Equations, tuple[str, ...]]:
    """Joints of one type drawn together, with a sentence for each that would then follow worse: it
    stays as it was fitted."""
    kinds, odd = list(types), list[str]()
    before = losses_of(data, found.servos, windows).sum(0)
    for _ in range(len(kinds)):
        drawn = pooled(known, kinds, moves)
        # What is left over of the small steps that equations do not know of.
        servos = fit(data, drawn.servos, found.free, windows, iterations=1)
        after = losses_of(data, servos, windows).sum(0)
        worse = (after - before) / before.clamp(min=1e-300) * moves
        j = int(worse.argmax())
        if not float(worse[j]) > WORSE or not kinds[j]:
            return replace(drawn, servos=servos), tuple(odd)
        odd.append(
            f"joint {j + 1} is not like the others of type {kinds[j]}: with their numbers its "
            f"error grows by {100 * ((1 + float(worse[j])) ** 0.5 - 1):.0f} %, so it keeps its own."
        )
        kinds[j] = ""
    return known, tuple(odd)


def answer(robot: Robot, log: Log) -> tuple[PositionData, Found]:
    """The answered model alone, without what is told about it.

    Raises:
        LogError: as `prepare`.
    """
    data = prepare(robot, log)
    windows = windows_of(data.tracks, WINDOW_S)
    simple = plain(data, some_of(windows, MOST))
    telling = _telling(data, simple, windows)
    few, more = some_of(windows, MOST, telling), some_of(windows, 3 * MOST, telling)
    answered = _answer(data, simple, few, more, lambda _: None)
    return answered.data, answered.found


def refitted(arm: ServoArm, data: PositionData, *allowed: Collection[str]) -> tuple[ServoArm, ...]:
    """The arm with servos that have some parameters alone, fitted to a log.

    Args:
        arm: whose servos may have more.
        data: of the same robot, from `prepare`.
        allowed: of `torchid.simulation.servo.PARAMETERS`, the core's among them, once for each of
            the answers; others than the core's are free where the arm has them. A `plane` stays
            where the arm has it, or goes.
    """
    windows = some_of(windows_of(data.tracks, WINDOW_S), MOST)
    used = {p.name: arm.servos.of(p.name) != p.neutral for p in PARAMETERS}
    used |= dict.fromkeys(CORE, torch.ones(data.robot.n, dtype=torch.bool))
    used["damping_share"] = torch.zeros(data.robot.n, dtype=torch.bool)
    core = torch.tensor([p.name in CORE for p in PARAMETERS])
    logs = core & torch.tensor([p.kind == "log" for p in PARAMETERS])
    neutral = torch.tensor([p.neutral for p in PARAMETERS], dtype=torch.float64)
    simple, out = None, []
    for names in allowed:
        free = {name: on for name, on in used.items() if name in names and bool(on.any())}
        plane = arm.servos.plane * ("plane" in names)
        said = torch.tensor([p.name in names for p in PARAMETERS])
        joint = torch.where(said, arm.servos.joint, neutral)
        # What is searched on a logarithmic scale begins at a number.
        least = 1e-6 * float(joint[:, INDEX["kp"]].max())
        begun = [torch.where(logs, joint.clamp(min=least), joint)]
        if bool((joint != arm.servos.joint).any()) or bool((plane != arm.servos.plane).any()):
            # Where something is missing plain servos may be the better beginning.
            simple = simple or plain(data, windows)
            begun.append(torch.where(core, simple.servos.joint, joint))
        servos = replace(arm.servos, plane=plane)
        ends = [
            fit(data, replace(servos, joint=one), free, windows, profiles=True, iterations=12)
            for one in begun
        ]
        worth = torch.stack([losses_of(data, end, windows).sum(0) for end in ends])
        joint = torch.stack([e.joint for e in ends])[worth.argmin(0), torch.arange(data.robot.n)]
        out.append(replace(arm, robot=data.robot, servos=replace(servos, joint=joint), std=None))
    return tuple(out)


@dataclass(frozen=True, eq=False)
class _Answer:
    """What the search found.

    Attributes:
        data: the motions, of the robot with the load if it carries one.
        found: the servos.
        worth, rivals: of effects.
        load: with losses of windows (W, n) without and with it, and what does as well in its place.
    """

    data: PositionData
    found: Found
    worth: "Worth"
    rivals: Rivals
    load: "tuple[Loaded, Tensor, Tensor, tuple[str, ...]] | None"


def _answer(
    data: PositionData,
    simple: Found,
    few: Windows,
    more: Windows,
    say: Callable[[str], None],
    early: EarlyAnswer | None = None,
    squares: float = 1.0 - (1.0 - WORTHWHILE) ** 2,
    file: Found | None = None,
) -> _Answer:
    """What the search finds in few windows and each effect is worth there, fitted to more.

    Where one number a joint explains what a file's servos lack, nothing else is looked for; else
    these are begun with where they are nearer than plain ones.
    `squares` is the share of the squared error by which an effect must lower it to be named."""
    say("one effect at a time")
    load, others, explained = None, tuple[str, ...](), torch.tensor([False])
    if file is not None:
        # How late commands come within a sample is no cause.
        own = replace(file, free={"delay": torch.ones_like(explained).expand(data.robot.n)})
        of_joints = tuple(effect for effect in EFFECTS if effect.parameters)
        # What came as near before the gains were refitted is no rival yet.
        found, _, _ = alone(data, own, few, early, (*GAINS, *of_joints))
        alike: Rivals = {}
        found = replace(found, free={**simple.free, **found.free})
        found = refit(data, found, few, iterations=8)
        before, after = (losses_of(data, m.servos, few).sum(0) for m in (simple, found))
        explained = after <= slight(data, few)
        simple = _joined(found, simple, before <= after)
    beside_plain = not bool((explained | _still(data)).all())
    if beside_plain:
        found, explained, alike = alone(data, simple, few, early)
    say("a load")
    if beside_plain and bool(
        (losses_of(data, simple.servos, few).sum(0) > slight(data, few)).any()
    ):
        load = with_load(data, simple, few) if data.weighed else None
    if load is not None:
        # One cause of what all joints show, where no more is needed, comes before several.
        heavy, known, names = alone(load.data, load.found, few)
        with_it, without = (
            float(losses_of(*model, few).sum())
            for model in ((load.data, heavy.servos), (data, found.servos))
        )
        # Of two complete explanations the one of fewer causes counts, then the nearer one.
        fewer = 1 + _causes(heavy) < _causes(found)
        as_few = 1 + _causes(heavy) == _causes(found) and with_it < without
        if bool(known.all()) and (fewer or as_few or not bool(explained.all())):
            if bool(explained.all()) and without < ALIKE * with_it:
                named = (e for e in EFFECTS if e.name not in KEPT)
                others = tuple(e.name for e in named if bool(_present(found, e).any()))
            load, explained, alike = replace(load, found=heavy), known, names
        else:
            load = None
    if beside_plain and not bool(explained.all()):
        found = _no_worse(data, found, _no_worse(data, simple, full(data, few, say), few), few)
        found = shared(data, found, few)
        load = with_load(data, found, few) if data.weighed else None
    say("what each effect is worth")
    found = settled(data, found, few)
    gain = None
    if load is not None:
        before = losses_of(data, found.servos, few)
        after = losses_of(load.data, load.found.servos, few)
        total = of_motions((before - after).sum(1, keepdim=True), few)
        needed = float(total.sum()) > squares * float(before.sum()) and bool(mostly_better(total))
        gain = (load, before, after, others) if needed else None
    if gain is not None:
        data, found = gain[0].data, settled(gain[0].data, gain[0].found, few)
    worth, rivals, found = _needed(data, found, few, squares)
    rivals = {at: names for at, names in alike.items() if bool(explained[at[1]])} | rivals
    # More windows move what has settled in few by little: one round, over three times as many.
    found = refit(data, found, more, iterations=2)
    return _Answer(data, found, worth, rivals, gain)


def _no_worse(data: PositionData, simple: Found, found: Found, windows: Windows) -> Found:
    """The model with simple servos on the joints that these follow as well: a search may end where
    more parameters do no better."""
    before, after = (losses_of(data, model.servos, windows).sum(0) for model in (simple, found))
    return _joined(found, simple, before - after < slight(data, windows))


def _joined(found: Found, simple: Found, needless: Tensor) -> Found:
    """A model with another's servos on some joints."""
    joint = torch.where(needless[:, None], simple.servos.joint, found.servos.joint)
    none = torch.zeros_like(needless)
    free = {
        name: torch.where(needless, simple.free.get(name, none), found.free.get(name, none))
        for name in {**found.free, **simple.free}
    }
    return Found(replace(found.servos, joint=joint), free, found.plane)


def _still(data: PositionData) -> Tensor:
    """(n,) joints that never move: at rest an encoder may flicker between two counts."""
    count = data.resolution * 12**0.5
    return data.q.amax(0) - data.q.amin(0) < (2.5 * count).clamp(min=STILL)


def _parted(log: Log) -> tuple[Log, tuple[str, ...]]:
    """The log with enough motions to hold some out: one long motion is taken in parts."""
    if log.trajectory_count > 1:
        return log, ()
    parts = torch.arange(log.samples) * 4 // log.samples
    names = tuple(f"{log.names[0]}[part {k + 1}]" for k in range(4))
    return log.replace(trajectory=parts, names=names), (
        "one motion only: its quarters are held out in turn, which are more alike than motions are",
    )


def some_of(windows: Windows, most: int, size: Tensor | None = None) -> Windows:
    """At most so many windows, each with what it stands for.

    Args:
        windows: all of them.
        most: to take.
        size: (W,) how much each tells; the chance to be taken grows with it. None: all alike.
    """
    if size is None:
        size = torch.ones(len(windows.start), dtype=torch.float64)
    chance = (size / size.sum() * most).clamp(max=1.0)
    for _ in range(20):  # what is certain leaves more of the chances to the others
        free = chance < 1
        left = most - float((~free).sum())
        if left <= 0 or not bool(free.any()):
            break
        chance = torch.where(free, (size / size[free].sum() * left).clamp(max=1.0), 1.0)
    # Evenly spaced along the sum of chances: no draw, and every stretch of the log has its share.
    ends = chance.cumsum(0) + 0.5
    rows = torch.nonzero(ends.floor() > (ends - chance).floor()).flatten()
    some = windows.some(rows)
    return replace(some, weight=some.weight / chance[rows])


def _telling(data: PositionData, model: Found, windows: Windows) -> Tensor:
    """(W,) how much windows tell: the plain servo's error there, and no less than half of the
    typical one, so that none is left to chance alone."""
    error = errors_of_one(data, model.servos, windows)
    own = (error.square().sum(0) / (error != 0).sum(0).clamp(min=1)).mean(1).sqrt()
    return own + own.median() / 2


def _present(found: Found, effect: ServoEffect) -> Tensor:
    """(n,) joints on which an effect is part of the model."""
    if not effect.parameters:
        return torch.full((found.servos.n,), found.plane)
    on = torch.zeros(found.servos.n, dtype=torch.bool)
    for name in effect.parameters:
        on |= found.free.get(name, on)
    return on


def _causes(found: Found) -> int:
    """Effects beside plain servos, joint by joint; a plane is one."""
    named = (e for e in EFFECTS if e.name not in KEPT)
    return sum(int(_present(found, e).sum()) if e.parameters else int(found.plane) for e in named)


def _without(found: Found, effect: ServoEffect, joints: Tensor, sample: float) -> Found:
    """The model without an effect on some joints; of a delay without what is beyond a sample."""
    if not effect.parameters:
        plane = found.servos.plane.clone()
        plane[4] = 0.0
        return Found(replace(found.servos, plane=plane), found.free, False)
    joint, free = found.servos.joint.clone(), dict(found.free)
    for name, value in neutral(effect).items():
        column = joint[joints, INDEX[name]]
        # A command that is held until the next one, from some instant of the bus's cycle on, is
        # late by less than a sample: that is no cause, and no row of a log tells it from another.
        joint[joints, INDEX[name]] = column.clamp(max=sample) if name == "delay" else value
        if name in free:
            free[name] = free[name] & ~joints
    free = {name: on for name, on in free.items() if bool(on.any())}
    return Found(replace(found.servos, joint=joint), free, found.plane)


def _needed(
    data: PositionData, found: Found, windows: Windows, squares: float
) -> tuple[Worth, Rivals, Found]:
    """The effects without which motion after motion is followed worse, all others refitted."""
    whole, n = losses_of(data, found.servos, windows), found.servos.n
    least = slight(data, windows)
    worth: Worth = {}
    removed: dict[str, Tensor] = {}
    for effect in EFFECTS:
        on = _present(found, effect)
        if not bool(on.any()):
            continue
        less = _without(found, effect, on, data.tracks.dt)
        servos = fit(data, less.servos, less.free, windows, iterations=2)
        without = losses_of(data, servos, windows)
        gain, total = of_motions(without - whole, windows), without.sum(0)
        if not effect.parameters:
            gain, total = gain.sum(1, keepdim=True).expand(-1, n), total.sum().expand(n)
        often = _mostly(gain) if effect.family == "world" else mostly_better(gain)
        # A plane is there for all joints or for none.
        call = least if effect.parameters else least.sum()
        keep = on & (gain.sum(0) > squares * total) & (gain.sum(0) > call) & often
        if effect.name == "command_delay":
            keep &= found.servos.of("delay") > data.tracks.dt
        worth[effect.name] = without, whole
        removed[effect.name] = on & ~keep
    now = found
    for name, joints in removed.items():
        # Delay and offset are numbers of any servo: they stay, unnamed.
        if name not in KEPT and bool(joints.any()):
            now = _without(now, BY_NAME[name], joints, data.tracks.dt)
    servos = fit(data, now.servos, now.free, windows, iterations=2)
    now = replace(now, servos=servos)
    return _returned(data, found, now, worth, removed, whole, least, windows, squares)


def _mostly(gain: Tensor) -> Tensor:
    """(n,) whether motions (m, n) gain more than others lose: what acts at the ends of the travel
    alone matters to few motions, by how much and not to how many counts."""
    return gain.clamp(min=0).sum(0) > 0.7 * gain.abs().sum(0)


def _returned(
    data: PositionData,
    found: Found,
    now: Found,
    worth: Worth,
    removed: dict[str, Tensor],
    whole: Tensor,
    least: Tensor,
    windows: Windows,
    squares: float,
) -> tuple[Worth, Rivals, Found]:
    """Effects that stood for each other: one of them returns, with the others' names."""
    lean = losses_of(data, now.servos, windows)
    fall = lean.sum(0) - whole.sum(0)
    lost = (fall > squares * lean.sum(0)) & (fall > least)
    candidates = {
        name: joints & lost
        for name, joints in removed.items()
        if bool((joints & lost).any()) and name not in KEPT
    }
    kept = {name: _present(now, BY_NAME[name]) for name in worth}
    for name in KEPT:
        if name in kept:
            kept[name] &= ~removed[name]
    stood: Rivals = {}
    for j in torch.nonzero(lost).flatten().tolist():
        rivals = [name for name, joints in candidates.items() if bool(joints[j])]
        if not rivals:
            continue
        first = max(rivals, key=lambda name: float(worth[name][0][:, j].sum()))
        if not BY_NAME[first].parameters:  # a plane, which is there for all joints
            plane = replace(now.servos, plane=found.servos.plane.clone())
            now = Found(plane, now.free, found.plane)
            kept[first][:], worth[first][0][:] = True, lean
        joint, free = now.servos.joint.clone(), dict(now.free)
        for name in BY_NAME[first].parameters:
            joint[j, INDEX[name]] = found.servos.joint[j, INDEX[name]]
            there = free.get(name, torch.zeros(now.servos.n, dtype=torch.bool)).clone()
            there[j] = bool(found.free.get(name, there)[j])
            free[name] = there
        now = Found(replace(now.servos, joint=joint), free, now.plane)
        kept[first][j] = True
        worth[first][0][:, j] = lean[:, j]
        stood[first, j] = tuple(r for r in rivals if r != first)
    if bool(lost.any()):
        servos = fit(data, now.servos, now.free, windows, iterations=2)
        now = replace(now, servos=servos)
    shown = {
        name: (torch.where(kept[name], without, torch.nan), with_it)
        for name, (without, with_it) in worth.items()
        if bool(kept[name].any())
    }
    return shown, stood, now


def _findings(
    answered: _Answer,
    known: Equations,
    windows: Windows,
    shares: Tensor,
    noise: PositionNoise,
    file: ServoArm | None,
) -> tuple[PositionFinding, ...]:
    """What is named, by what it was worth in windows; torques of some joints as shares of kp, and
    beside what the robot's file says."""
    data, found, rivals = answered.data, answered.found, answered.rivals
    # Losses that call for no cause, or are noise, where repeats tell it [rad^2].
    least = windows.rows * noise.at_least(data.slight).square()
    independent = (windows.length * windows.weight)[:, None] / known.alike
    draws = drawn_windows(windows)

    def sure(
        losses: Sequence[Tensor],
        numbers: int,
        again: Replication | None = None,
        joint: int | slice = slice(None),
        alike: float = 0.0,
    ) -> float:
        """Of an effect, from losses without it and with it."""
        without, with_it, rows = (x[:, joint].reshape(len(x), -1) for x in (*losses, independent))
        return effect_sure(
            without.sum(1), with_it.sum(1), float(least[joint].sum()), numbers, again,
            rows=rows.mean(1), draws=draws, looks=len(EFFECTS) * data.robot.n, alike=alike,
        )  # fmt: skip

    deviation = known.deviations(shares)
    # Torques of servos of one type are alike beside their gain.
    beside_gain = known.deviations(torch.ones_like(shares))
    looked = float(data.tracks.u.shape[0])
    motions = list(zip(data.log.names, data.log.duration, strict=True))
    out = []
    if answered.load is not None:
        load, light, heavy, others = answered.load
        body = _load_sizes(load)
        far, near = (1e3 * float((x.sum(0).mean() / looked).sqrt()) for x in (light, heavy))
        by = sure((light, heavy), len(body))
        out.append(finding_of(PAYLOAD, None, body, (far, near), others, how_sure=by))
    for name, losses in answered.worth.items():
        effect = GRAVITY if name == GRAVITY.name else BY_NAME[name]
        # Errors in the log's unit: of the joint, or of all of them.
        without, with_it = (1e3 * (x.sum(0) / looked).sqrt() / data.scale for x in losses)
        if not effect.parameters:
            plane = (
                ()
                if effect is GRAVITY
                else tuple(
                    Number(key, "N/m" if key == "stiffness" else "m", value, (torch.nan, torch.nan))
                    for key, value in zip(PLANE, found.servos.plane.tolist(), strict=True)
                )
            )
            far, near = (float(x.square().mean().sqrt()) for x in (without, with_it))
            by = sure(losses, len(plane))
            out.append(finding_of(effect, None, plane, (far, near), how_sure=by))
            continue
        joints = torch.nonzero(without.isfinite() & ~_still(data)).flatten().tolist()
        alike = dict(
            zip(joints, _alike(known, beside_gain, effect.parameters[0], joints), strict=True)
        )
        for j in joints:
            sizes = [
                _size(key, known, deviation, j, bool(shares[j]), data.held, file)
                for key in effect.parameters
                if (key in found.free and bool(found.free[key][j])) or _has(file, key, j)
            ]
            others = rivals.get((name, j), ())
            neutral = PARAMETERS[INDEX[effect.parameters[0]]].neutral
            again = None
            first = effect.parameters[0]
            fitted = first in found.free and bool(found.free[first][j])
            if fitted and effect.family != "world" and first not in VALLEYS:
                again = known.replication(sizes[0].name.removesuffix(as_share("")), j, motions)
            if effect.twin and (not effect.twin_below or (sizes and sizes[0].value < neutral)):
                others += (effect.twin,)
            ends = float(without[j]), float(with_it[j])
            by = sure(losses, len(sizes), again, j, alike[j])
            out.append(finding_of(effect, j, sizes, ends, others, again, by))
    return tuple(sorted(out, key=lambda f: f.error_with - f.error_without))


def _load_sizes(load: Loaded) -> tuple[Number, ...]:
    """Mass and centre of a load. The mass goes with the servos' gains, by factors: its interval is
    theirs, of a logarithm."""
    half = (HALF_95 * load.std).tolist()
    factor = math.exp(half[0] / load.mass)
    mass = Number("mass", "kg", load.mass, (load.mass / factor, load.mass * factor))
    com = (
        Number(key, "m", value, (value - h, value + h))
        for key, value, h in zip("xyz", load.com.tolist(), half[1:], strict=True)
    )
    return (mass, *com)


def _size(
    name: str,
    known: Equations,
    deviation: Float[Tensor, "n K"],
    joint: int,
    share: bool,
    held: float,
    file: ServoArm | None,
) -> Number:
    """A number of an effect on one joint, of torques but the gain as a share of it if asked for,
    beside what the robot's file says."""
    value, unit, shown = float(known.servos.of(name)[joint]), PARAMETERS[INDEX[name]].unit, name
    was = float(file.servos.of(name)[joint]) if file and _has(file, name, joint) else math.nan
    if name == "delay":
        # Commands are simulated along straight lines; that they are held until the next one makes
        # them half a sample late on average, which is no delay of its own.
        value -= 0.5 * held
    if share and name in TORQUES and name != "kp":
        value /= float(known.servos.of("kp")[joint])
        was /= float(file.servos.of("kp")[joint]) if file else 1.0
        unit, shown = PER_KP[unit], as_share(name)
    std = float(deviation[joint, known.names.index(name)]) if name in known.names else math.nan
    return Number(shown, unit, value, value_interval(name, value, std), was)


def _has(file: ServoArm | None, name: str, joint: int) -> bool:
    """Whether a robot's file has a number of a joint's servo."""
    return (
        file is not None and float(file.servos.of(name)[joint]) != PARAMETERS[INDEX[name]].neutral
    )


def _alike(
    known: Equations, deviation: Float[Tensor, "n K"], name: str, joints: Sequence[int]
) -> list[float]:
    """Rises of an effect on joints that have it, by a parameter that all servos of a type share;
    deviations of torques are those of shares of kp."""
    if name not in OF_TYPE or name not in known.names or not joints:
        return [0.0] * len(joints)
    value, std = known.servos.of(name), deviation[:, known.names.index(name)]
    if name in TORQUES:
        value = value / known.servos.of("kp")
    if PARAMETERS[INDEX[name]].kind == "log":
        std = std * value
    return alike_rises(value[joints], std[joints]).tolist()


def _ratio_only(known: Equations) -> Tensor:
    """(n,) joints of which a common factor on all torques is hardly told: no load anchors it."""
    # Torques are searched as shares of kp, so that kp alone is that factor.
    k = known.names.index("kp")
    return known.gram.sum(0)[:, k, k] / known.alike < (NOISE / RATIO) ** 2


def _accuracies(
    models: Sequence[tuple[PositionData, Found]], windows: Windows, few: Windows
) -> tuple[list[Accuracy], list[Tensor]]:
    """How near the command, a plain servo, the answered model and others come; what is free of them
    is fitted without the fold that they are judged on. With their whole-motion errors (T, n)."""
    data = models[0][0]
    folds = folds_of(len(data.tracks.first))
    commanded = (data.tracks.u - data.q) / data.scale
    errors_of: dict[str, list[Tensor]] = {"whole": [], "windows": []}
    for body, model in models:
        servos = {}
        for fold in folds.unique().tolist():
            rest = torch.nonzero(folds[few.motion] != fold).flatten()
            others = few.some(rest)
            servos[fold] = fit(
                body, model.servos, model.free, others, plane=model.plane, iterations=2
            )
        for name, some in (("whole", windows_of(data.tracks, None)), ("windows", windows)):
            apart = each_window(servos, folds[some.motion])
            error = errors(body, apart, some)[..., 0]
            errors_of[name].append(some.on_rows(error, torch.zeros_like(data.q)) / data.scale)
    pairs = zip(*errors_of.values(), strict=True)
    still = _still(data)
    ways = [
        Accuracy.of_joints(*(_rms(error).masked_fill(still, torch.nan) for error in pair))
        for pair in ((commanded, commanded), *pairs)
    ]
    return ways, errors_of["whole"]


def _rms(error: Tensor) -> Tensor:
    return 1e3 * error.square().mean(0).sqrt()


def _by_motion(data: PositionData, error: Tensor) -> Tensor:
    ends = zip(data.tracks.first.tolist(), data.tracks.last.tolist(), strict=True)
    return torch.stack([_rms(error[a : b + 1]) for a, b in ends])


def _regimes(data: PositionData, before: Tensor, after: Tensor) -> dict[str, tuple[Tensor, Tensor]]:
    """Whole-motion errors [mrad] by what the command does: stands, creeps, turns, moves, jumps;
    NaN where it never does."""
    rate = torch.zeros_like(data.q)
    rate[1:] = data.tracks.u.diff(dim=0) / data.tracks.dt
    rate[data.tracks.first] = 0.0
    top = rate.abs().quantile(0.99, 0).clamp(min=1e-9)
    stands = rate.abs() < 1e-9
    # The command turns within a quarter of a second.
    reach = max(1, round(0.25 / data.tracks.dt))
    sign = torch.nn.functional.max_pool1d(rate.T, 2 * reach + 1, 1, reach).T
    other = -torch.nn.functional.max_pool1d(-rate.T, 2 * reach + 1, 1, reach).T
    turns = (sign > 0.02 * top) & (other < -0.02 * top) & ~stands
    fast = (rate.abs() > 0.5 * top) & ~turns
    masks = {
        "holding": stands,
        "reversal": turns,
        "high_speed": fast,
        "low_speed": ~stands & ~turns & ~fast,
    }
    out = {}
    for name, mask in masks.items():
        count = mask.sum(0)  # 0 of 0 is NaN
        out[name] = tuple(
            1e3 * ((e * mask).square().sum(0) / count).sqrt() for e in (before, after)
        )
    return out  # type: ignore[return-value]
