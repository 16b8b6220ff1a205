"""Which effects the motions need: begun from a plain servo, tried by simulation, weighed by leaving
each out again.

What has a slope everywhere (friction, gains, delay) is fitted from the start. What acts only
beyond a limit (a profile, a clip, a stop, a plane) has no slope where it does not act: some sizes
of it are simulated on all joints at once, and a joint takes the best of them if its error falls.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import torch
from torch import Tensor

from torchid.effects.servo import ServoEffect
from torchid.position.data import PositionData
from torchid.position.effects import BY_NAME, CORE, EFFECTS, KEPT
from torchid.position.fit import VALLEYS, errors, fit, huber, loss
from torchid.simulation.servo import INDEX, PARAMETERS, TORQUES, Servos
from torchid.simulation.servo_loop import PROFILE, Windows
from torchid.typing import Bool, Float

SMOOTH = ("kd", "stiction", "stribeck_speed", "motor_share", "load_share")
"""What has a slope everywhere, beside the core."""
NEAR = 10.0
"""Times the loss that calls for no cause within which a plain servo is fitted to the end [1]."""
TAKEN = 0.03
"""Share of a joint's loss that a size of an effect without slope must take away to be tried [1]."""
ROUNDS, SETTLED = 8, 0.03
"""Of a fit that is brought to its end, at most; and the share of a joint's loss that a round must
take away [1]."""
ALIKE = 1.5
"""Losses of two effects of which the larger is less than this times the other tell neither [1]."""
TOUCHED = 0.02
"""Share of all joints' loss that a plane must take away to be tried [1]."""
_ACCELERATIONS = (0.12, 0.25, 0.35, 0.5, 0.7, 1.0)
"""Limits to try, as shares of the largest acceleration that a joint shows."""
_EARLIER = (0.01, 0.02)
_LAGS = (0.02, 0.05, 0.1, 0.2)
"""Time constants of a filter to try [s]."""
_SCANS = (
    (0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.35, 1.5, 1.7),
    (0.9, 0.95, 1.0, 1.05, 1.1, 1.15),
    (0.96, 0.98, 0.99, 1.0, 1.01, 1.02, 1.04),
)
_QUANTILES = (5e-4, 5e-3, 2e-2)
_STOP_INSIDE = (0.0, 0.004, 0.01)
_FAR, _AT_STOP = 0.9, (0.1, 0.5)


@dataclass(frozen=True, eq=False)
class Found:
    """Servos, and which of their parameters were searched on which joints.

    Attributes:
        servos: one set.
        free: parameters with the joints (n,) on which they are free.
        plane: whether there is a plane.
    """

    servos: Servos
    free: Mapping[str, Bool[Tensor, " n"]]
    plane: bool


def plain(data: PositionData, windows: Windows) -> Found:
    """The core alone: a servo as simulators have it, fitted to the motions."""
    n = data.robot.n
    free = {name: torch.ones(n, dtype=torch.bool) for name in CORE}
    servos = fit(data, _start(data, CORE), free, windows, iterations=8)
    # Joints that feel each other settle slowly. Where much is left it is no plain servo, whose
    # numbers would only be driven away from where another model may begin.
    near = _one(data, Found(servos, free, False), windows) < NEAR * slight(data, windows)
    rest = {name: on & near for name, on in free.items()}
    servos = fit(data, servos, rest, windows, iterations=25)
    return Found(servos, free, False)


def full(data: PositionData, windows: Windows, say: Callable[[str], None] | None = None) -> Found:
    """Every effect that takes error away somewhere, fitted together.

    Args:
        data: motions, with the heights of the link that may touch a plane.
        windows: to fit to.
        say: hears what is being tried.
    """
    say = say or (lambda _: None)
    n = data.robot.n
    every = torch.ones(n, dtype=torch.bool)
    free = dict.fromkeys((*CORE, *SMOOTH), every)
    say("gains, friction and delay")
    begun = _geared(data, Found(_start(data, (*CORE, *SMOOTH)), free, False))
    now = replace(begun, servos=fit(data, begun.servos, begun.free, windows, iterations=5))
    say("profile")
    now = _scanned(data, _with_profile(data, now, windows), windows)
    for what, names in (
        ("stops", ("stop_low", "stop_high")), ("plane", ()), ("clip", ("clip",)),
        ("speed", ("speed",)), ("filter", ("lag",)), ("integral action", ("integral",)),
        ("dead zone", ("dead_zone",)), ("scale of commands", ("scale",)),
    ):  # fmt: skip
        say(what)
        if not names:
            now = _with_plane(data, now, windows)
        for name in names:
            grown = _with_filter if name == "lag" else partial(_grown, name=name)
            now = grown(data, now, windows)
    now = _scanned(data, now, windows)
    say("all together")
    return refit(data, now, windows, iterations=4)


def _start(data: PositionData, names: tuple[str, ...]) -> Servos:
    """Servos of a small arm, their torques times the joints' strengths."""
    starts = {p.name: p.start for p in PARAMETERS if p.name in names}
    servos = replace(Servos.neutral(data.robot.n, **starts), link=data.link)
    servos.joint[:, INDEX["damping_share"]] = data.damping_share
    for name in TORQUES:
        if name in names:
            servos.joint[:, INDEX[name]] *= data.strength
    return servos


def _geared(data: PositionData, now: Found) -> Found:
    """With the command gains that commands and positions show at once, and no other number of these
    joints: the others would make up for it."""
    gain = data.command_gain
    far = gain != 1
    if not bool(far.any()):
        return now
    joint = now.servos.joint.clone()
    joint[:, INDEX["scale"]] = torch.where(far, gain, joint[:, INDEX["scale"]])
    return replace(now, servos=replace(now.servos, joint=joint), free={**now.free, "scale": far})


def refit(data: PositionData, found: Found, windows: Windows, *, iterations: int) -> Found:
    """A model with all that it searches fitted anew, set-points' numbers and the plane's too."""
    servos = fit(
        data,
        found.servos,
        found.free,
        windows,
        plane=found.plane,
        profiles=True,
        iterations=iterations,
    )
    return replace(found, servos=servos)


def settled(data: PositionData, found: Found, windows: Windows) -> Found:
    """A model fitted until no joint gains: the numbers of set-points move once a round, for every
    step of theirs simulates the commands' way anew, and are looked for beyond their valleys."""
    before = _one(data, found, windows)
    for _ in range(ROUNDS):
        near = _scanned(data, found, windows, _SCANS[1:])
        found = refit(data, near, windows, iterations=3)
        after = _one(data, found, windows)
        if bool((after > (1 - SETTLED) * before).all()):
            break
        before = after
    return found


def least_loss(data: PositionData, windows: Windows) -> Tensor:
    """(n,) losses that are no more than what rounding to an encoder's count leaves [rad^2]."""
    return data.resolution**2 * windows.rows


def _tried(data: PositionData, sets: Servos, windows: Windows) -> Tensor:
    """(n, P) losses of sets of servos."""
    return loss(errors(data, sets, windows), windows)


def _batch(servos: Servos, count: int) -> Servos:
    joint = servos.joint.repeat(count, 1, 1)
    return replace(servos, joint=joint, plane=servos.plane.repeat(count, 1))


def _grown(
    data: PositionData,
    now: Found,
    windows: Windows,
    name: str,
    *,
    sure: bool = True,
    iterations: int = 2,
) -> Found:
    """With a parameter on the joints whose loss falls with one of some values, refitted around
    them; or, if not `sure`, on all of them, for the others may have to give way first."""
    values = _SIZES[name](data, now.servos)
    sets = _batch(now.servos, 1 + len(values))
    sets.joint[1:, :, INDEX[name]] = values
    if (
        name == "scale" and "offset" in now.free
    ):  # whose share of the mean command is in the zero of servos without it
        mean = data.tracks.u.mean(0)
        column = sets.joint[1:, :, INDEX["offset"]]
        column -= sets.joint[1:, :, INDEX["kp"]] * (values - 1) * mean
    cost = _tried(data, sets, windows)
    best = cost[:, 1:].argmin(1)
    gain = cost[:, 0] - cost[:, 1:].amin(1)
    joints = (gain > TAKEN * cost[:, 0]) & (gain > least_loss(data, windows))
    if not sure:
        joints = torch.ones_like(joints)
    if not bool(joints.any()):
        return now
    own = sets.joint[1 + best, torch.arange(len(joints))]
    chosen = torch.where(joints[:, None], own, now.servos.joint)
    free = {**now.free, name: now.free.get(name, torch.zeros_like(joints)) | joints}
    servos = fit(
        data,
        replace(now.servos, joint=chosen),
        free,
        windows,
        plane=now.plane,
        profiles=name in PROFILE,
        iterations=iterations,
    )
    return replace(now, servos=servos, free=free)


def _with_profile(data: PositionData, now: Found, windows: Windows) -> Found:
    """A set-point of limited acceleration, which a repeated command may end.

    A servo without profile has taken the profile's lag for delay: sizes are tried with less of it.
    """
    dq = data.dq
    shown = ((dq[2:] - dq[:-2]) / (2 * data.tracks.dt)).abs().quantile(0.999, 0).clamp(min=0.1)
    sizes = [(share * shown, less) for share in _ACCELERATIONS for less in _EARLIER]
    before = _tried(data, _batch(now.servos, 1), windows)[:, 0]
    n, best = data.robot.n, (float(before.sum()), now)
    for repeated in (False, True):
        sets = _batch(replace(now.servos, repeated=repeated), len(sizes))
        for row, (a, less) in zip(sets.joint, sizes, strict=True):
            row[:, INDEX["acceleration"]] = a
            row[:, INDEX["delay"]] = (row[:, INDEX["delay"]] - less).clamp(min=0)
        first = _tried(data, sets, windows).argmin(1)
        begun = replace(now.servos, joint=sets.joint[first, torch.arange(n)], repeated=repeated)
        # The other parameters give way first, which costs no new set-points.
        servos = fit(data, begun, now.free, windows, iterations=2)
        free = {**now.free, "acceleration": torch.ones(n, dtype=torch.bool)}
        servos = fit(data, servos, free, windows, profiles=True, iterations=1)
        after = _tried(data, _batch(servos, 1), windows)[:, 0]
        # Joints that are not better with it stay as they were.
        gain = before - after
        joints = (gain > TAKEN * before) & (gain > least_loss(data, windows))
        joint = torch.where(joints[:, None], servos.joint, now.servos.joint)
        total = float(torch.where(joints, after, before).sum())
        if bool(joints.any()) and total < best[0]:
            kept = Found(replace(servos, joint=joint), {**free, "acceleration": joints}, now.plane)
            best = total, kept
    return best[1]


def _with_filter(data: PositionData, now: Found, windows: Windows) -> Found:
    """A filter of the set-point.

    A servo without it has made up for it with delay, damping and inertia: at each size these give
    way first, which costs no new set-points, and then the size itself moves.
    """
    before = _tried(data, _batch(now.servos, 1), windows)[:, 0]
    lag, delay, begun = INDEX["lag"], INDEX["delay"], []
    for size in _LAGS:
        joint = now.servos.joint.clone()
        joint[:, lag], joint[:, delay] = size, (joint[:, delay] - size).clamp(min=0)
        filtered = replace(now.servos, joint=joint)
        begun.append(fit(data, filtered, now.free, windows, iterations=4).joint)
    sets = replace(_batch(now.servos, len(begun)), joint=torch.stack(begun))
    cost, best = _tried(data, sets, windows).min(1)
    gain = before - cost
    joints = (gain > TAKEN * before) & (gain > least_loss(data, windows))
    if not bool(joints.any()):
        return now
    own = sets.joint[best, torch.arange(len(joints))]
    servos = replace(now.servos, joint=torch.where(joints[:, None], own, now.servos.joint))
    free = {**now.free, "lag": now.free.get("lag", torch.zeros_like(joints)) | joints}
    return refit(data, replace(now, servos=servos, free=free), windows, iterations=3)


def _scanned(
    data: PositionData, now: Found, windows: Windows, scans: Sequence[Sequence[float]] = _SCANS
) -> Found:
    """With profiles and filters where simulations are best, farther and nearer about where they
    are: their losses have valleys."""
    for name, factors in itertools.product(VALLEYS, scans):
        if name not in now.free:
            continue
        joints = now.free[name]
        sets = _batch(now.servos, len(factors))
        column = sets.joint[:, :, INDEX[name]]
        column *= torch.tensor(factors, dtype=torch.float64)[:, None]
        best = _tried(data, sets, windows).argmin(1)
        rows = torch.where(joints, best, torch.full_like(best, factors.index(1.0)))
        if bool((rows == factors.index(1.0)).all()):
            continue
        joint = sets.joint[rows, torch.arange(data.robot.n)]
        servos = fit(data, replace(now.servos, joint=joint), now.free, windows, iterations=2)
        now = replace(now, servos=servos)
    return now


def _with_plane(data: PositionData, now: Found, windows: Windows) -> Found:
    """A plane that a point in front of the link touches."""
    if data.body.height is None or data.robot.parameters is None:
        return now
    point = data.outwards
    height = data.body.height @ torch.cat([point, point.new_ones(1)])
    levels = height.quantile(torch.tensor(_QUANTILES, dtype=torch.float64))
    # A floor is harder than servos are.
    sets, strong = _batch(now.servos, 1 + 2 * len(levels)), max(1.0, float(data.strength.median()))
    for k, level in enumerate(levels.tolist()):
        for i, stiffness in enumerate((300.0 * strong, 1000.0 * strong)):
            row = sets.plane[1 + 2 * k + i]
            row[:3], row[3], row[4] = point, level, stiffness
    total = _tried(data, sets, windows).sum(0)
    best = int(total.argmin())
    if not float(total[best]) < (1 - TOUCHED) * float(total[0]):
        return now
    touching = replace(now.servos, plane=sets.plane[best].clone())
    servos = fit(data, touching, now.free, windows, plane=True, iterations=6)
    return Found(servos, now.free, True)


def _held(q: Float[Tensor, "T n"], u: Float[Tensor, "T n"]) -> Float[Tensor, "V n"]:
    """Positions of joints while their commands are farthest beyond them: of a soft stop a little
    more than where it begins."""
    beyond = u - q
    far = beyond >= beyond.quantile(_FAR, 0)
    return q.masked_fill(~far, torch.nan).nanquantile(torch.tensor(_AT_STOP, dtype=q.dtype), 0)


def _shares(*shares: float) -> Tensor:
    return torch.tensor(shares, dtype=torch.float64)[:, None]


_SIZES: dict[str, Callable[[PositionData, Servos], Tensor]] = {
    # End stops about where the joints came to their lowest and highest positions, or are while
    # their commands are far beyond.
    "stop_low": lambda data, servos: torch.cat(
        [data.q.amin(0) + _shares(*_STOP_INSIDE), -_held(-data.q, -data.tracks.u)]
    ),
    "stop_high": lambda data, servos: torch.cat(
        [data.q.amax(0) - _shares(*_STOP_INSIDE), _held(data.q, data.tracks.u)]
    ),
    # Of the torque that the largest position errors would make, which of stiff servos is many times
    # their limit.
    "clip": lambda data, servos: (
        _shares(0.04, 0.1, 0.2, 0.4, 0.6, 0.8)
        * (data.tracks.u - data.q).abs().quantile(0.999, 0)
        * servos.of("kp")
    ),
    "speed": lambda data, servos: (
        _shares(0.4, 0.55, 0.7, 0.85, 1.0) * data.dq.abs().quantile(0.9999, 0).clamp(min=0.1)
    ),
    # Beside kp, in 1/s.
    "integral": lambda data, servos: _shares(0.1, 0.5, 2.0) * servos.of("kp"),
    "dead_zone": lambda data, servos: _shares(0.0015, 0.004).expand(-1, servos.n),
    "scale": lambda data, servos: _shares(0.9, 0.97, 1.03, 1.1).expand(-1, servos.n),
}
"""(V, n) values to try of what has no slope where it does not act."""


def slight(data: PositionData, windows: Windows) -> Tensor:
    """(n,) losses that call for no cause [rad^2]."""
    return data.slight**2 * windows.rows


BESIDE_PLAIN = tuple(effect for effect in EFFECTS if effect.name not in KEPT)
"""What plain servos do not have."""
Rivals = dict[tuple[str, int], tuple[str, ...]]
"""By effect and joint: what does as well in its place."""


def alone(
    data: PositionData,
    simple: Found,
    windows: Windows,
    watch: Callable[[str, Tensor], None] | None = None,
    effects: Sequence[ServoEffect] = BESIDE_PLAIN,
) -> tuple[Found, Tensor, Rivals]:
    """Each effect by itself beside plain servos, or a file's, whose gains are not free: a joint
    that one of them explains needs no other.

    Args:
        data: motions.
        simple: the servos.
        windows: to fit to.
        watch: called with each effect and the losses (n,) that are left with it.
        effects: to try.

    Returns:
        The servos, and on every joint that has a gap the effect that closes most of it; the
        joints (n,) on which no gap is left; what does as well in an effect's place.
    """
    least, before = slight(data, windows), _one(data, simple, windows)
    if bool((before <= least).all()):
        return simple, before <= least, {}
    tried: dict[str, Found] = {}
    cost: dict[str, Tensor] = {}
    calm = _calm(data, simple, windows, before > NEAR * least)
    for effect in effects:
        limit = bool(effect.parameters) and effect.parameters[0] in _SIZES
        model = _beside(data, calm if limit else simple, windows, effect)
        tried[effect.name], cost[effect.name] = model, _one(data, model, windows)
        if watch is not None:
            watch(effect.name, cost[effect.name])
    # What makes set-points is brought to where they are best, where that can matter.
    for name in ("set_point_profile", "set_point_speed", "command_filter"):
        best = torch.stack(list(cost.values())).amin(0)
        open_ = (best > least) | (cost[name] < ALIKE * best)
        if bool((open_ & (before > least) & (cost[name] < 0.7 * before)).any()):
            tried[name] = _scanned(data, tried[name], windows)
            cost[name] = _one(data, tried[name], windows)
    now, cost_now = simple, before
    own = torch.stack([cost[name] for name in tried if BY_NAME[name].parameters])
    names = [name for name in tried if BY_NAME[name].parameters]
    # A plane that leaves no more on all joints than an effect of its own on each.
    plane = next((name for name in tried if not BY_NAME[name].parameters), None)
    if plane and float(cost[plane].sum()) < ALIKE * float(torch.minimum(own.amin(0), before).sum()):
        now, cost_now = tried[plane], cost[plane]
    given, rivals = torch.zeros(data.robot.n, dtype=torch.bool), {}
    # The joints that are worst first: what is left on others may be these joints' doing.
    for share in (0.3, 0.0):
        excess = cost_now / least
        worst = ~given & (excess > 1) & (excess >= share * excess.amax())
        best, which = own.min(0)
        worst &= best < (1 - TAKEN) * cost_now
        if not bool(worst.any()):
            continue
        joint, free, repeated = now.servos.joint.clone(), dict(now.free), now.servos.repeated
        for j in torch.nonzero(worst).flatten().tolist():
            name = names[int(which[j])]
            model = tried[name]
            joint[j] = model.servos.joint[j]
            repeated |= model.servos.repeated
            for key in BY_NAME[name].parameters:
                on = free.get(key, torch.zeros_like(given)).clone()
                on[j] = bool(model.free.get(key, on)[j])
                free[key] = on
            rivals[name, j] = tuple(
                other
                for other, loss_of in zip(names, own[:, j].tolist(), strict=True)
                if other != name and loss_of < ALIKE * float(best[j])
            )
        given |= worst
        servos = replace(now.servos, joint=joint, repeated=repeated)
        servos = fit(data, servos, free, windows, plane=now.plane, iterations=3)
        now = Found(servos, free, now.plane)
        cost_now = _one(data, now, windows)
    # Joints feel each other's set-points: all of them are best before one is judged.
    if any(name in now.free for name in VALLEYS):
        now = settled(data, now, windows)
        cost_now = _one(data, now, windows)
    # Where one effect is nearly enough, the fit is brought to its end before that is judged.
    near = given & (cost_now > least) & (cost_now < NEAR * least)
    if bool(near.any()):
        rest = {name: on & near for name, on in now.free.items()}
        servos = fit(data, now.servos, rest, windows, plane=now.plane, iterations=15)
        now = replace(now, servos=servos)
        cost_now = _one(data, now, windows)
    return now, cost_now <= least, rivals


def _calm(data: PositionData, simple: Found, windows: Windows, far: Bool[Tensor, " n"]) -> Found:
    """Plain servos as the calmer half of the windows tells them, on the joints where much is left.

    What acts beyond a limit does nothing there; beside numbers that have made up for it, it would
    not be found.
    """
    servos, begun = simple.servos, _start(data, CORE)
    free = {name: on & far for name, on in simple.free.items()}
    for _ in range(2 if "kp" in free and bool(far.any()) else 0):
        error = errors(data, _batch(servos, 1), windows)[..., 0]
        own = huber(error)[:, far] / windows.length[:, None]
        calm = (own / own.mean(0)).sum(1).argsort()[: max(1, len(own) // 2)]
        joint = torch.where(far[:, None], begun.joint, servos.joint)
        servos = fit(data, replace(servos, joint=joint), free, windows.some(calm), iterations=8)
    return replace(simple, servos=servos)


def shared(data: PositionData, now: Found, windows: Windows) -> Found:
    """What more than half of the joints have, tried on the others at the size that is usual there:
    the servos of an arm are mostly of one make."""
    for effect in EFFECTS:
        on = torch.zeros(data.robot.n, dtype=torch.bool)
        for name in effect.parameters:
            on |= now.free.get(name, on)
        if effect.name in KEPT or 2 * int(on.sum()) <= len(on) or bool(on.all()):
            continue
        before, begun = _one(data, now, windows), _start(data, CORE)
        # The others begin where a search does: their numbers have made up for what they lack.
        joint = torch.where(on[:, None], now.servos.joint, begun.joint)
        for name in effect.parameters:
            k, unit = INDEX[name], torch.ones_like(joint)
            if name in TORQUES:  # beside kp
                unit = joint[:, INDEX["kp"], None]
            joint[~on, k] = (joint[on, k] / unit[on, 0]).median() * unit[~on, 0]
        free = {name: there & ~on for name, there in now.free.items()}
        free |= dict.fromkeys((*CORE, *effect.parameters), ~on)
        profiles = any(name in PROFILE for name in effect.parameters)
        servos = replace(now.servos, joint=joint)
        servos = fit(data, servos, free, windows, iterations=6)
        servos = fit(data, servos, free, windows, profiles=profiles, iterations=1)
        after = _one(data, replace(now, servos=servos), windows)
        gain = before - after
        better = ~on & (gain > TAKEN * before) & (gain > least_loss(data, windows))
        if not bool(better.any()):
            continue
        joint = torch.where(better[:, None], servos.joint, now.servos.joint)
        free = dict(now.free)
        for name in (*CORE, *effect.parameters):
            free[name] = free.get(name, torch.zeros_like(on)) | better
        now = replace(now, servos=replace(now.servos, joint=joint), free=free)
    return now


def _one(data: PositionData, model: Found, windows: Windows) -> Tensor:
    """(n,) losses of a model."""
    return _tried(data, _batch(model.servos, 1), windows)[:, 0]


def _beside(data: PositionData, simple: Found, windows: Windows, effect: ServoEffect) -> Found:
    """Plain servos with one more effect, on every joint that is better with it."""
    if not effect.parameters:
        return _with_plane(data, simple, windows)
    if effect.name == "set_point_profile":
        return _with_profile(data, simple, windows)
    if effect.name == "command_filter":
        return _with_filter(data, simple, windows)
    now = simple
    geared = effect.name == "command_gain" and "kp" in simple.free
    if geared and bool((far := data.command_gain != 1).any()):
        joint = torch.where(far[:, None], _start(data, CORE).joint, now.servos.joint)
        now = _geared(data, replace(now, servos=replace(now.servos, joint=joint)))
        servos = fit(data, now.servos, now.free, windows, profiles=True, iterations=12)
        now = replace(now, servos=servos)
    if effect.parameters[0] in _SIZES:
        for name in effect.parameters:
            # Of two stops each where it helps: both at once would hold the joint.
            only = len(effect.parameters) == 1
            now = _grown(data, now, windows, name, sure=not only, iterations=3)
        return now
    begun = _start(data, effect.parameters)
    joint = simple.servos.joint.clone()
    for name in effect.parameters:
        joint[:, INDEX[name]] = begun.joint[:, INDEX[name]]
    every = torch.ones(data.robot.n, dtype=torch.bool)
    free = {**simple.free, **dict.fromkeys(effect.parameters, every)}
    servos = fit(data, replace(simple.servos, joint=joint), free, windows, iterations=4)
    return Found(servos, free, False)
