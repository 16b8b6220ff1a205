"""The answered model of an arm's servos: what the search finds, and what each effect is worth
there."""

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchid.effects.servo import PLANE, ServoEffect
from torchid.parallel.pace import Pace
from torchid.position.data import Usual
from torchid.position.effects import BY_NAME, EFFECTS, GAINS, GRAVITY, KEPT, PAYLOAD
from torchid.position.evidence import LeastFall
from torchid.position.file_servos import Worth, beside_file, weighing_otherwise
from torchid.position.payload import Loaded, with_load
from torchid.position.problem import Problem
from torchid.position.record import error_words
from torchid.position.search import (
    FINITE_STAGE,
    WORST,
    Rivals,
    full,
    plain,
    settled,
    with_usual_effects,
)
from torchid.position.servo_model import Motions, ServoModel, better_in_sum, mostly_better
from torchid.results.answer import Answer
from torchid.robot.model import error_unit
from torchid.statistics.criteria import ALIKE_LOSS, SET_MASS
from torchid.typing import Bool, Float

SEVERAL = {
    "gains, friction and delay": 2, FINITE_STAGE: 30, "all together": 10,
}  # fmt: skip
"""Stages of a search for several effects on one joint, with their shares of the time [1]."""
ANCHORS = ("kp", "armature", "offset")
"""Numbers of a file beside which a load is sought: free, they make up for most of it."""

NEAR = math.log(SET_MASS / (1 - SET_MASS))
"""Evidence up to which neither of two answers is sure [nats]."""


@dataclass(frozen=True, eq=False)
class Answered:
    """What the search found.

    Attributes:
        motions: as a search looks at them, of the robot with the load if it carries one.
        model: the servos.
        worth, rivals: of effects; one of all joints has all its losses with one of them.
        load: that was found.
        by_file: (n,) joints whose gain is that of the robot's file; None where nothing was sought
            beside its servos.
    """

    motions: Motions
    model: ServoModel
    worth: Worth
    rivals: Rivals
    load: Loaded | None = None
    by_file: Bool[Tensor, " n"] | None = None

    @property
    def causes(self) -> tuple[tuple[str, int | None], ...]:
        """Effects and joints that are worth a name, None of what all joints feel; without gravity,
        which is settled first."""
        out = list[tuple[str, int | None]]()
        for name, (without, _) in self.worth.items():
            if name in BY_NAME and BY_NAME[name].parameters:
                out += [(name, j) for j, on in enumerate(without.isfinite().all(0)) if on]
            elif name != GRAVITY.name:
                out.append((name, None))
        return tuple(out)


def undecided(motions: Motions, first: ServoModel, of_file: bool) -> Answer:
    """What is known while the search goes on: the errors of the file's servos, or of plain ones, in
    some windows. An effect that was tried is no cause before it is decided."""
    data = motions.data
    errors = 1e3 * (first.losses(motions) / motions.windows.rows).sqrt() / data.scale
    joints, whole = errors.tolist(), float(errors.mean())
    each = zip(data.robot.joint_names, joints, joints, strict=True)
    words = error_words(of_file), error_unit(data.robot)
    return Answer.so_far(*words, (whole, whole), each, ())


def as_the_file(problem: Problem) -> Answered | None:
    """The servos of the robot's file where all joints follow them, as it is or but for gravity that
    they feel there, or do not feel; None where they do not."""
    file = problem.file
    if file is None:
        return None
    if bool((file.near | problem.data.still).all()):
        return Answered(file.motions, file.model, _of_doubted_gains(problem), {})
    if not problem.data.weighed or not bool(problem.data.robot.gravity.any()):
        return None
    other = problem.followed(replace(problem.few, data=weighing_otherwise(problem.data)))
    if not bool((other.near | problem.data.still).all()):
        return None
    without, with_it = (x.motions.losses(x.model.servos) for x in (file, other))
    return Answered(other.motions, other.model, {GRAVITY.name: (without, with_it)}, {})


def best_answer(
    problem: Problem, pace: Pace | None = None, watch: Callable[[Answer], None] | None = None
) -> Answered:
    """What the search finds in few windows and each effect is worth there, fitted to more.

    Where a file's servos with other numbers explain what it lacks, nothing else is looked for; else
    a search begins with them where they are nearer than plain ones. What there is no time for is
    left out.
    """
    pace = pace or Pace(None, {})
    given, problem = problem, _weighing_as_log(problem)
    few, squares, file = problem.few, problem.squares, problem.file
    if watch is not None:
        watch(undecided(few, problem.plain if file is None else file.model, file is not None))
    begun = problem.simple
    if file is not None:
        numbers = _refitted(few, file.model, begun.free)
        begun = numbers.joined(begun, begun.losses(few) <= numbers.losses(few))
    found, loaded, explained = begun, None, begun.losses(few) <= few.slight
    effects = "effects beside gains, friction and delay"
    if not bool((explained | problem.data.still).all()) and pace.has_time(effects, *SEVERAL):
        several = full(few, pace, None if file is None else begun)
        found = with_usual_effects(few, _no_worse(few, begun, several))
        loaded = with_load(few, found) if file is None else None
    pace("what each effect is worth")
    motions, model, worth = few, settled(few, found), Worth()
    if problem is not given:
        worth[GRAVITY.name] = (
            given.few.losses(given.simple.servos),
            few.losses(problem.simple.servos),
        )
    if loaded is not None:
        losses = (few.losses(model.servos), loaded.motions.losses(loaded.model.servos))
        gain = few.each((losses[0] - losses[1]).sum(1, keepdim=True))
        least = LeastFall.beside(loaded.motions, loaded.model.servos)
        told = float(least.told(model.losses(few)).sum())
        likely = told > _paid(least, [(PAYLOAD.name, None)]) and bool(mostly_better(gain))
        if likely and float(gain.sum()) > squares * float(losses[0].sum()):
            worth[PAYLOAD.name] = losses
            motions, model = loaded.motions, settled(loaded.motions, loaded.model)
    loaded = loaded if PAYLOAD.name in worth else None
    answered = _with_needed(problem, Answered(motions, model, worth, Rivals(), loaded))
    anchored = ~(problem.doubted | problem.data.still)  # by a gain that is known
    if file is None or not few.data.weighed or not bool(anchored.any()):
        return answered
    if not pace.has_time("a load", "a load"):
        return answered
    pace("a load")
    return _or_a_load_beside_file(problem, answered)


def _with_needed(problem: Problem, found: Answered) -> Answered:
    """What was found with what is needed of it alone, beside the file's servos if there are any."""
    motions, file, squares = found.motions, problem.file, problem.squares
    needed, worth, rivals = needed_effects(motions, found.model, squares)
    # More windows move what has settled in few by little: one round, over three times as many.
    model = needed.fitted(replace(problem.more, data=motions.data), 2, plane=True)
    searched = found.rivals | rivals
    answered = replace(found, model=model, worth=found.worth | worth, rivals=searched)
    if file is None:
        return answered
    servos, doubted = file.model.servos, problem.doubted
    begun = answered.worth | _of_doubted_gains(problem)
    model, by_file, worth, alike = beside_file(motions, model, servos, squares, begun, doubted)
    rivals = searched | {at: searched.get(at, ()) + gain for at, gain in alike.items()}
    # What follows no better than the file's servos is no reason for others.
    least = LeastFall.beside(motions, model.servos)
    near = (file.model.losses(motions) - least.left < least.of(1)) & ~doubted
    model, by_file = model.joined(file.model, near), by_file | near
    for name in worth.keys() - {GRAVITY.name, PAYLOAD.name}:
        if BY_NAME[name].parameters:
            worth[name] = worth[name][0].masked_fill(near, torch.nan), worth[name][1]
    worth = {name: losses for name, losses in worth.items() if bool(losses[0].isfinite().any())}
    return replace(answered, model=model, worth=worth, rivals=rivals, by_file=by_file)


def _of_doubted_gains(problem: Problem) -> Worth:
    """Of gains that contradict all else that is known: what the file's servos leave as they are,
    and with the gains that all else says."""
    if problem.file is None or problem.given is None or not bool(problem.doubted.any()):
        return {}
    motions = problem.file.motions
    without, with_it = (motions.losses(x) for x in (problem.given, problem.file.model.servos))
    return {GAINS[0].name: (without.masked_fill(~problem.doubted, torch.nan), with_it)}


def _or_a_load_beside_file(problem: Problem, answered: Answered) -> Answered:
    """The answer, or the one of an arm with a load whose servos are the file's but for what they
    lack yet, where that is likelier; where neither is, each has the other's names beside it.

    A load is one cause, with one price, of what all joints show.
    """
    few, file = problem.few, problem.file
    assert file is not None
    least = LeastFall.beside(few, answered.model.servos)
    paid, one = (_paid(least, causes) for causes in (answered.causes, [(PAYLOAD.name, None)]))
    if paid < one and bool((least.left <= few.slight).all()):
        return answered
    load = _beside_anchors(few, file.model, answered, least)
    if load is None:
        return answered
    free = {**load.model.free, **problem.simple.free}
    heavy = settled(load.motions, _refitted(load.motions, load.model, free))
    # What the servos named beside it leave without it.
    held = {name: on for name, on in heavy.free.items() if name not in ANCHORS}
    bare = replace(heavy, free=held).fitted(few, 8)
    losses = few.losses(bare.servos), load.motions.losses(heavy.servos)
    worth = {name: x for name, x in answered.worth.items() if name == GRAVITY.name}
    worth[PAYLOAD.name] = losses
    other = _with_needed(problem, Answered(load.motions, heavy, worth, Rivals(), load))
    told = float(least.told(other.model.losses(load.motions)).sum())
    gain = paid - _paid(least, other.causes) - told
    best, second = (other, answered) if gain > 0 else (answered, other)
    if abs(gain) > NEAR:
        return best
    # Each cause that one of them alone has stands beside the other's.
    rivals, others = dict(best.rivals), tuple(dict.fromkeys(name for name, _ in second.causes))
    for at in set(best.causes) - set(second.causes):
        rivals[at] = rivals.get(at, ()) + ((PAYLOAD.name,) if best is answered else others)
    return replace(best, rivals=rivals)


def _beside_anchors(
    few: Motions, file: ServoModel, answered: Answered, least: LeastFall
) -> Loaded | None:
    """A load beside gains and inertias of the file, but on joints where another gain is worth its
    price beside a load, too: of the two that follow worst the better."""

    def beside(own: Tensor) -> tuple[Loaded | None, Tensor]:
        model = answered.model.joined(file, ~own, ANCHORS)
        free = {k: on & own if k in ANCHORS else on for k, on in model.free.items()}
        model = replace(model, free=free).fitted(few, 3)
        load = with_load(few, model)
        return load, model.losses(few) if load is None else load.model.losses(load.motions)

    load, left = beside(own := ~few.every)
    others = torch.zeros_like(own)
    others[[j for name, j in answered.causes if name == GAINS[0].name and j is not None]] = True
    while bool((others & (left > few.slight)).any()):
        worst = least.told(left).masked_fill(~others, -math.inf).topk(min(2, int(others.sum())))
        ways = [own | (torch.arange(len(own)) == j) for j in worst.indices]
        tried = [(*beside(way), way) for way in ways]
        best = min(tried, key=lambda one: (one[0] is None, float(least.told(one[1]).sum())))
        if best[0] is None or float((least.told(left) - least.told(best[1])).sum()) < least.price:
            break
        load, left, own = best
        others &= ~own
    return load


def _paid(least: LeastFall, causes: Collection[tuple[str, int | None]]) -> float:
    """What causes cost, each as much as samples tell of its numbers [nats]; gains of one joint,
    which a weaker servo has all of, share a price."""
    gains = {effect.name for effect in GAINS}
    out = least.price * len({("" if name in gains else name, j) for name, j in causes})
    for name, j in causes:
        numbers = 4 if name == PAYLOAD.name else len(BY_NAME[name].parameters or PLANE)
        out += least.paid(numbers, slice(None) if j is None else j)
    return out


def _weighing_as_log(problem: Problem) -> Problem:
    """The question, of an arm whose servos feel gravity where those of its file do not, or the
    other way round, where that closes much of what gains of any size leave, and the file's do."""
    data, moves = problem.data, ~problem.data.still
    if problem.file is None or not data.weighed or not bool(data.robot.gravity.any()):
        return problem
    data = weighing_otherwise(data)
    few, more = (replace(x, data=data) for x in (problem.few, problem.more))
    other = replace(problem, data=data, few=few, more=more, simple=plain(few))
    assert other.file is not None
    pairs = (problem.file.model, other.file.model), (problem.simple, other.simple)
    falls = [(a.losses(problem.few) / b.losses(few)).log()[moves].mean() for a, b in pairs]
    return other if min(map(float, falls)) > math.log(ALIKE_LOSS) else problem


def _refitted(few: Motions, file: ServoModel, free: Mapping[str, Tensor]) -> ServoModel:
    """The numbers that a file's servos have, and what else is free, refitted."""
    return replace(file, free={**file.free, **free}).fitted(few, 12, plane=True)


def _no_worse(motions: Motions, simple: ServoModel, model: ServoModel) -> ServoModel:
    """The model with simple servos on the joints that these follow as well: a search may end where
    more parameters do no better."""
    more = [on.double() - simple.where_free(name).double() for name, on in model.free.items()]
    least = LeastFall.beside(motions, model.servos)
    call = least.of(torch.stack(more).sum(0).clamp(min=1.0))
    return model.joined(simple, simple.losses(motions) - least.left < call)


def needed_effects(
    motions: Motions, model: ServoModel, squares: float
) -> tuple[ServoModel, Worth, Rivals]:
    """A model of the effects without which motion after motion is followed worse, all others
    refitted; losses without each and with it; and what stands for it as well.

    Each effect is left out alone, which says what it takes away beside all others. Of a model with
    none of them the largest returns to each joint that loses by that, and the next one, until none
    does: what stands for another then has no reason to come.
    """
    whole = motions.losses(model.servos)
    least, usual = LeastFall.beside(motions, model.servos), motions.data.usual
    present = {e.name: e for e in EFFECTS if bool(model.where(e).any())}
    sought = {name: e for name, e in present.items() if e not in KEPT}
    rise = {
        name: _without(motions, model, e, 4).sum(0) - whole.sum(0) for name, e in sought.items()
    }
    waiting = [
        sorted((n for n, e in sought.items() if model.where(e)[j]), key=lambda n: float(rise[n][j]))
        for j in range(model.servos.n)
    ]
    chosen = {name: model.where(e) & (e in KEPT) for name, e in present.items()}
    stands = set[tuple[str, int]]()
    while True:
        lean = _with_only(model, chosen, usual).fitted(motions, 8, plane=True)
        left = motions.losses(lean.servos).sum(0)
        fall = left - whole.sum(0)
        lost = (fall > squares * left) & (fall > least.of(1))
        # The joints that are worst first: what others lose may be these joints' doing.
        excess = torch.where(lost, fall / least.of(1), 0.0)
        lost &= excess >= WORST * excess.amax()
        back = [(waiting[j].pop(), j) for j in lost.nonzero().flatten().tolist() if waiting[j]]
        if not back:
            break
        for name, j in back:
            if rise[name][j] <= least.of(1)[j]:
                stands.add((name, j))
            if sought[name].parameters:
                chosen[name][j] = True
                continue
            chosen[name] = motions.every
            waiting = [[x for x in names if x != name] for names in waiting]
    rivals: Rivals = {(name, j): tuple(waiting[j]) for name, j in stands if waiting[j]}
    return lean, _worth_of(motions, lean, present.values(), squares), rivals


def _worth_of(
    motions: Motions, model: ServoModel, effects: Collection[ServoEffect], squares: float
) -> Worth:
    """Losses without each effect that is worth a name, and with it."""
    whole, least, out = (
        motions.losses(model.servos),
        LeastFall.beside(motions, model.servos),
        Worth(),
    )
    for effect in effects:
        has = model.where(effect)
        if not bool(has.any()):
            continue
        losses = _without(motions, model, effect, 8)
        gain, total = motions.each(losses - whole), losses.sum(0)
        call = least.of(len(effect.parameters or PLANE))
        if not effect.parameters:  # a plane is there for all joints or for none
            gain, total = gain.sum(1, keepdim=True).expand_as(gain), total.sum().expand_as(total)
            call = call.sum().expand_as(call)
        often = better_in_sum(gain) if effect.family == "world" else mostly_better(gain)
        keep = has & (gain.sum(0) > squares * total) & (gain.sum(0) > call) & often
        if effect in KEPT:
            keep &= model.beyond(effect, motions.data.usual)
        if bool(keep.any()):
            out[effect.name] = torch.where(keep, losses, torch.nan), whole
    return out


def _without(
    motions: Motions, model: ServoModel, effect: ServoEffect, iterations: int
) -> Float[Tensor, "W n"]:
    """Losses of windows without an effect, all else refitted."""
    has, usual = model.where(effect), motions.data.usual
    losses = motions.losses(model.without(effect, has, usual).fitted(motions, iterations).servos)
    # A joint loses no more than where it alone lacks the effect, and nothing gives way.
    for j in has.nonzero().flatten().tolist() if effect.parameters else ():
        here = torch.arange(len(has)) == j
        own = motions.losses(model.without(effect, here, usual).servos)[:, j]
        if float(own.sum()) < float(losses[:, j].sum()):
            losses[:, j] = own
    return losses


def _with_only(
    model: ServoModel, chosen: Mapping[str, Bool[Tensor, " n"]], usual: Usual
) -> ServoModel:
    """A model with chosen effects alone."""
    for name, on in chosen.items():
        gone = model.where(BY_NAME[name]) & ~on
        if bool(gone.any()):
            model = model.without(BY_NAME[name], gone, usual)
    return model
