"""All effects that take error away from the motions, fitted together: which of them the motions
need is weighed by leaving each out again (`answered.needed_effects`).

What acts only beyond a limit (a profile, a clip, a stop, a plane) has no slope where it does not
act: beside a plain servo some sizes of it are simulated on all joints at once, and a joint takes
the best effect if its error falls. What has a slope everywhere (friction by load, derivative gain)
would make up for it, and comes after.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from torchid.effects.servo import INDEX, PARAMETERS, TORQUES, ServoEffect, ServoMotion
from torchid.position.data import PositionData
from torchid.position.effects import CORE, EFFECTS, KEPT
from torchid.position.fit import VALLEYS, giving_way
from torchid.position.servo_model import Motions, ServoModel
from torchid.simulation.servo import Servos
from torchid.statistics.criteria import ALIKE_LOSS
from torchid.typing import Bool, Float

SMOOTH = ("kd", "stiction", "stribeck_speed", "motor_share", "load_share", "stiction_share")
"""What has a slope everywhere, beside the core."""
NEARLY_EXPLAINED = 10.0
"""Times the loss that calls for no cause within which a model is fitted to the end [1]."""
TAKEN = 0.03
"""Share of a joint's loss that a size of an effect without slope must take away to be tried [1]."""
WORST = 0.3
"""Share of the worst joint's loss, over what calls for no cause, from which joints get their effect
first [1]."""
ROUNDS, SETTLED = 8, 0.03
"""Of a fit that is brought to its end, at most; and the share of a joint's loss that a round must
take away [1]."""
TOUCHED = 0.02
"""Share of all joints' loss that a plane must take away to be tried [1]."""
_ACCELERATIONS = (0.12, 0.25, 0.35, 0.5, 0.7, 1.0)
"""Limits to try, as shares of the largest acceleration that a joint shows."""
_EARLIER = (0.01, 0.02)
_LAGS = (0.02, 0.05, 0.1, 0.2)
"""Time constants of a filter to try [s]."""
_FAR = (0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.35, 1.5, 1.7)
_NEAR = (0.92, 0.97, 0.99, 1.0, 1.01, 1.03, 1.08)
_LONG = (0.4, 0.6, 0.8, 1.0, 1.25, 1.6, 2.5)
_ABOUT = dict.fromkeys(VALLEYS, (_FAR, _NEAR)) | {"stribeck_speed": (_LONG,)}
"""Factors on what has many small valleys, or one that is long and curved, by name."""
_QUANTILES = (5e-4, 5e-3, 2e-2)

FINITE_STAGE = "limits, stops and set points"
FINITE = tuple(
    e
    for e in EFFECTS
    if e.has_sizes or not e.parameters or {*e.parameters} & {"acceleration", "lag"}
)
"""Effects that are begun at a finite size beside all that has a slope."""
Rivals = dict[tuple[str, int | None], tuple[str, ...]]
"""By effect and joint, None of what all joints feel: what does as well in its place."""


def plain(motions: Motions) -> ServoModel:
    """The core alone: a servo as simulators have it, fitted to the motions."""
    free = dict.fromkeys(CORE, motions.every)
    begun = ServoModel(_start(motions.data, CORE), free).fitted(motions, 8)
    # Joints that feel each other settle slowly. Where much is left it is no plain servo, whose
    # numbers would only be driven away from where another model may begin.
    near = begun.losses(motions) < NEARLY_EXPLAINED * motions.slight
    return begun.fitted(motions, 25, joints=near)


def full(
    motions: Motions, say: Callable[[str], None], begun: ServoModel | None = None
) -> ServoModel:
    """Every effect that takes error away somewhere, fitted together.

    Args:
        motions: with the heights of the link that may touch a plane.
        say: hears what is being tried.
        begun: servos of a file, where the search begins on joints that these follow nearer.
    """
    say("gains, friction and delay")
    core = ServoModel(_start(motions.data, CORE), dict.fromkeys(CORE, motions.every))
    model = _geared(motions.data, core).fitted(motions, 8)
    if begun is not None:
        model = begun.joined(model, model.losses(motions) < begun.losses(motions))
    # What has a slope would make up for what has none: it comes after, and gives way then.
    say(FINITE_STAGE)
    model = _with_finite(motions, model)
    smooth = ServoModel(_start(motions.data, SMOOTH), dict.fromkeys(SMOOTH, motions.every))
    more = [name for name in SMOOTH if not bool(model.where_free(name).any())]
    model = model.joined(smooth, motions.every, more).fitted(motions, 5, plane=True)
    model = _beyond_valleys(motions, _with_finite(motions, model, 1))
    say("all together")
    return model.fitted(motions, 4, plane=True)


def _with_finite(motions: Motions, model: ServoModel, rounds: int = ROUNDS) -> ServoModel:
    """With the effect of a finite size that is best on each joint, worst joints first, and the next
    one beside it, until none takes much away: a limit makes most of what another one does, and what
    is left on others may be a bad joint's doing."""
    waiting = motions.every
    for _ in range(rounds):
        losses = model.losses(motions)
        waiting &= losses > motions.slight
        if not bool(waiting.any()):
            break
        tried = [_with_one(motions, model, effect) for effect in FINITE]
        left = torch.stack([one.losses(motions) for one in tried])
        alone = torch.minimum(losses, left.amin(0))
        for row, one, effect in zip(left, tried, FINITE, strict=True):
            if not effect.parameters:
                # A plane that leaves no more than an effect of its own on each joint.
                if one.plane and float(row.sum()) < ALIKE_LOSS * float(alone.sum()):
                    model, losses = one, row.clone()
                row.fill_(math.inf)
            elif effect.shared and not bool((row <= alone)[waiting].all()):
                row.fill_(math.inf)  # what all joints share is on all that have a gap, or on none
        best, which = left.min(0)
        excess = losses / motions.slight
        worst = waiting & (excess >= WORST * excess[waiting].amax())
        falls = waiting & _falls(motions, losses, best)
        joints = falls & worst if bool((falls & worst).any()) else falls
        waiting &= ~worst | falls
        if not bool(joints.any()):
            break
        for k in which[joints].unique().tolist():
            repeated = model.servos.repeated | tried[k].servos.repeated
            model = model.joined(tried[k], joints & (which == k))
            model = replace(model, servos=replace(model.servos, repeated=repeated))
        model = model.fitted(motions, 3, plane=True)
    return model


def _with_one(motions: Motions, model: ServoModel, effect: ServoEffect) -> ServoModel:
    """A model with one more effect of a finite size, on the joints whose loss falls."""
    if not effect.parameters:
        return model if model.plane else _with_plane(motions, model)
    if effect.has_sizes:
        # Others may have to give way first; of two stops both at once would hold a joint.
        only = len(effect.parameters) == 1
        for name in effect.parameters:
            model = _with_size(motions, model, name, sure=not only)
        return model
    return (_with_profile if "acceleration" in effect.parameters else _with_filter)(motions, model)


def _start(data: PositionData, names: Sequence[str]) -> Servos:
    """Servos of a small arm, their torques times the joints' strengths."""
    starts = {p.name: p.start for p in PARAMETERS if p.name in names}
    servos = replace(Servos.neutral(data.robot.n, **starts), link=data.link)
    servos.joint[:, INDEX["damping_share"]] = data.damping_share
    for name in TORQUES:
        if name in names:
            servos.joint[:, INDEX[name]] *= data.strength
    return servos


def _geared(data: PositionData, model: ServoModel) -> ServoModel:
    """With the command gains that commands and positions show at once, and no other number of these
    joints: the others would make up for it."""
    gain = data.command_gain
    far = gain != 1
    if not bool(far.any()):
        return model
    values, k = model.servos.joint.clone(), INDEX["scale"]
    values[:, k] = torch.where(far, gain, values[:, k])
    return replace(model.at(values), free={**model.free, "scale": far})


def settled(motions: Motions, model: ServoModel) -> ServoModel:
    """A model fitted until no joint gains, and beyond the valleys of what makes set-points where a
    joint that has such a number calls for a cause yet."""
    before = model.losses(motions)
    model = _beyond_valleys(motions, model)
    for _ in range(ROUNDS):
        model = model.fitted(motions, 3, plane=True)
        after = model.losses(motions)
        if bool((after > (1 - SETTLED) * before).all()):
            break
        before = after
    return model


def _beyond_valleys(motions: Motions, model: ServoModel) -> ServoModel:
    """With what slopes do not lead over where it is best of some factors about it, farther and
    nearer, on the joints that call for a cause yet."""
    begun, calls = model, model.losses(motions) > motions.slight
    for name, ladder in _ABOUT.items():
        k, on = INDEX[name], model.where_free(name)
        for factors in ladder if bool((on & calls).any()) else ():
            values = model.servos.joint[:, k] * torch.tensor(factors).double()[:, None]
            sets, losses = _with_values(motions, model, name, values)
            model = _of_sets(model, sets, losses.argmin(1), on)
    return model if model is begun else model.fitted(motions, 2)


def _with_values(
    motions: Motions, model: ServoModel, name: str, values: Float[Tensor, "V n"]
) -> tuple[Servos, Float[Tensor, "n Q"]]:
    """Servos with values of one number, others as they are or giving way, and what they leave:
    delay, damping and inertia make up for most of a change of what makes set-points."""
    sets = _sets(model.servos, len(values))
    sets.joint[:, :, INDEX[name]] = values
    others = {other: joints for other, joints in model.free.items() if other != name}
    return giving_way(motions.data, model.servos, sets, others, motions.windows)


def _falls(motions: Motions, before: Tensor, after: Tensor) -> Bool[Tensor, " n"]:
    """(n,) joints whose loss falls by enough for an effect to be tried there, and by more than what
    rounding to an encoder's count leaves."""
    gain = before - after
    return (gain > TAKEN * before) & (gain > motions.data.resolution**2 * motions.windows.rows)


def _sets(servos: Servos, count: int) -> Servos:
    """So many sets of the same servos."""
    joint = servos.joint.repeat(count, 1, 1)
    return replace(servos, joint=joint, plane=servos.plane.repeat(count, 1))


def _of_sets(model: ServoModel, sets: Servos, which: Tensor, joints: Tensor) -> ServoModel:
    """A model with the values of one of several sets (n,) on some joints."""
    values = sets.joint[which, torch.arange(sets.n)]
    return model.at(torch.where(joints[:, None], values, model.servos.joint))


def _with_size(motions: Motions, model: ServoModel, name: str, *, sure: bool) -> ServoModel:
    """With a parameter on the joints whose loss falls with one of some values, refitted around
    them; or, if not `sure`, on all of them, for the others may have to give way first."""
    data, of = motions.data, PARAMETERS[INDEX[name]]
    assert of.sizes is not None
    values = of.sizes(ServoMotion(data.tracks.u, data.q, data.dq, model.servos.of("kp")))
    sets = _sets(model.servos, 1 + len(values))
    sets.joint[1:, :, INDEX[name]] = values
    if name == "scale" and "offset" in model.free:
        # Its share of the mean command is in the zero of servos without it.
        zero = sets.joint[1:, :, INDEX["offset"]]
        zero -= sets.joint[1:, :, INDEX["kp"]] * (values - 1) * motions.data.tracks.u.mean(0)
    losses = motions.losses_of_sets(sets)
    least, best = losses[:, 1:].min(1)
    joints = _falls(motions, losses[:, 0], least) | (not sure)
    if not bool(joints.any()):
        return model
    grown = _of_sets(model, sets, 1 + best, joints).freed([name], joints)
    return grown.fitted(motions, 3, plane=True)


def _with_profile(motions: Motions, model: ServoModel) -> ServoModel:
    """A set-point of limited acceleration, which a repeated command may end.

    A servo without profile has taken the profile's lag for delay: sizes are tried with less of it.
    """
    dq = motions.data.dq
    ddq = (dq[2:] - dq[:-2]) / (2 * motions.data.tracks.dt)
    fastest = ddq.abs().quantile(0.999, 0).clamp(min=0.1)
    sizes = [(share * fastest, less) for share in _ACCELERATIONS for less in _EARLIER]
    before, every = model.losses(motions), motions.every
    best = float(before.sum()), model
    for repeated in (False, True):
        begun = replace(model, servos=replace(model.servos, repeated=repeated))
        sets = _sets(begun.servos, len(sizes))
        for row, (a, less) in zip(sets.joint, sizes, strict=True):
            row[:, INDEX["acceleration"]] = a
            row[:, INDEX["delay"]] = (row[:, INDEX["delay"]] - less).clamp(min=0)
        first = motions.losses_of_sets(sets).argmin(1)
        # The other parameters give way first, which costs no new set-points.
        others = _of_sets(begun, sets, first, every).fitted(motions, 2)
        limited = others.freed(["acceleration"], every).fitted(motions, 1)
        after = limited.losses(motions)
        # Joints that are not better with it stay as they were.
        joints = _falls(motions, before, after)
        total = float(torch.where(joints, after, before).sum())
        if bool(joints.any()) and total < best[0]:
            best = total, limited.joined(model, ~joints)
    return best[1]


def _with_filter(motions: Motions, model: ServoModel) -> ServoModel:
    """A filter of the set-point.

    A servo without it has made up for it with delay, damping and inertia: these give way.
    """
    sizes = torch.tensor(_LAGS).double()[:, None].expand(-1, model.servos.n)
    sets, losses = _with_values(motions, model, "lag", sizes)
    least, best = losses.min(1)
    joints = _falls(motions, model.losses(motions), least)
    if not bool(joints.any()):
        return model
    return _of_sets(model, sets, best, joints).freed(["lag"], joints).fitted(motions, 3, plane=True)


def _with_plane(motions: Motions, model: ServoModel) -> ServoModel:
    """A plane that a point in front of the link touches."""
    if motions.data.robot.parameters is None:
        return model
    point = motions.data.outwards
    height = motions.data.body.height @ torch.cat([point, point.new_ones(1)])
    levels = height.quantile(torch.tensor(_QUANTILES, dtype=torch.float64)).tolist()
    # A floor is harder than servos are.
    strong = max(1.0, float(motions.data.strength.median()))
    planes = list(itertools.product(levels, (300.0 * strong, 1000.0 * strong)))
    sets = _sets(model.servos, 1 + len(planes))
    for row, (level, stiffness) in zip(sets.plane[1:], planes, strict=True):
        row[:3], row[3], row[4] = point, level, stiffness
    total = motions.losses_of_sets(sets).sum(0)
    best = int(total.argmin())
    if not float(total[best]) < (1 - TOUCHED) * float(total[0]):
        return model
    touching = replace(model.servos, plane=sets.plane[best].clone())
    return ServoModel(touching, model.free, True).fitted(motions, 6, plane=True)


def with_usual_effects(motions: Motions, model: ServoModel) -> ServoModel:
    """What more than half of the joints have, tried at the size that is usual there on joints that
    lack it, or err with it: the servos of an arm are mostly of one make."""
    for effect in EFFECTS:
        has = model.where(effect)
        if effect in KEPT or not effect.parameters or 2 * int(has.sum()) <= len(has):
            continue
        before = model.losses(motions)
        others = ~has | (before > motions.slight)
        if not bool(others.any()):
            continue
        # The others begin where a search does: their numbers have made up for what they lack.
        values = torch.where(others[:, None], _start(motions.data, CORE).joint, model.servos.joint)
        for name in effect.parameters:
            k, there, here = INDEX[name], torch.ones_like(before), torch.ones_like(before)
            if name in TORQUES:  # beside kp
                there, here = model.servos.of("kp"), values[:, INDEX["kp"]]
            usual = (model.servos.of(name) / there)[has].median()
            values[others, k] = usual * here[others]
        free = {name: there & ~others for name, there in model.free.items()}
        free |= dict.fromkeys((*CORE, *effect.parameters), others)
        tried = replace(model.at(values), free=free).fitted(motions, 7)
        after = tried.losses(motions)
        model = model.joined(tried, others & _falls(motions, before, after))
    return model
