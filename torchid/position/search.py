"""Which effects the motions need: begun from a plain servo, tried by simulation, weighed by leaving
each out again.

What has a slope everywhere (friction, gains, delay) is fitted from the start. What acts only
beyond a limit (a profile, a clip, a stop, a plane) has no slope where it does not act: some sizes
of it are simulated on all joints at once, and a joint takes the best of them if its error falls.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchid.position.data import PositionData
from torchid.position.effects import CORE
from torchid.position.fit import errors, fit, loss
from torchid.simulation.servo import INDEX, PARAMETERS, TORQUES, Servos
from torchid.simulation.servo_loop import PROFILE, Windows
from torchid.typing import Bool

SMOOTH = ("kd", "stiction", "stribeck_speed", "motor_share", "load_share")
"""What has a slope everywhere, beside the core."""
TAKEN = 0.03
"""Share of a joint's loss that a size of an effect without slope must take away to be tried [1]."""
TOUCHED = 0.02
"""Share of all joints' loss that a plane must take away to be tried [1]."""
_ACCELERATIONS = (0.12, 0.25, 0.35, 0.5, 0.7, 1.0)
"""Limits to try, as shares of the largest acceleration that a joint shows."""
_EARLIER = (0.01, 0.02)
_SCANS = (
    (0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.35, 1.5, 1.7),
    (0.9, 0.95, 1.0, 1.05, 1.1, 1.15),
    (0.96, 0.98, 0.99, 1.0, 1.01, 1.02, 1.04),
)
_QUANTILES = (5e-4, 5e-3, 2e-2)
_STOP_INSIDE = (0.0, 0.004, 0.01)


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
    servos = fit(data, _start(data, (*CORE, *SMOOTH)), free, windows, iterations=5)
    now = Found(servos, free, False)
    for what, attempt in (
        ("profile", _with_profile), ("stops", _with_stops), ("plane", _with_plane),
        ("clip", _with_clip), ("speed", _with_speed), ("dead zone", _with_dead_zone),
        ("scale of commands", _with_scale),
    ):  # fmt: skip
        say(what)
        now = attempt(data, now, windows)
        if what in ("profile", "scale of commands"):
            now = _scanned(data, now, windows)
    say("all together")
    servos = fit(data, now.servos, now.free, windows, plane=now.plane, profiles=True, iterations=4)
    return replace(now, servos=servos)


def _start(data: PositionData, names: tuple[str, ...]) -> Servos:
    """Servos of a small arm, their torques times the joints' strengths."""
    starts = {p.name: p.start for p in PARAMETERS if p.name in names}
    servos = replace(Servos.neutral(data.robot.n, **starts), link=data.link)
    for name in TORQUES:
        if name in names:
            servos.joint[:, INDEX[name]] *= data.strength
    return servos


def least_loss(data: PositionData, windows: Windows) -> Tensor:
    """(n,) losses that are no more than what rounding to an encoder's count leaves [rad^2]."""
    return data.resolution**2 * float((windows.length * windows.weight).sum())


def _tried(data: PositionData, sets: Servos, windows: Windows) -> Tensor:
    """(n, P) losses of sets of servos."""
    return loss(errors(data, sets, windows), windows)


def _batch(servos: Servos, count: int) -> Servos:
    joint = servos.joint.repeat(count, 1, 1)
    return replace(servos, joint=joint, plane=servos.plane.repeat(count, 1))


def _grown(
    data: PositionData, now: Found, windows: Windows, name: str, values: Tensor, iterations: int = 2
) -> Found:
    """With a parameter on the joints whose loss falls with one of some values (V, n), refitted
    once around them; a joint whose loss has not fallen by then goes without."""
    sets = _batch(now.servos, 1 + len(values))
    sets.joint[1:, :, INDEX[name]] = values
    cost = _tried(data, sets, windows)
    best = cost[:, 1:].argmin(1)
    gain = cost[:, 0] - cost[:, 1:].amin(1)
    joints = (gain > TAKEN * cost[:, 0]) & (gain > least_loss(data, windows))
    if not bool(joints.any()):
        return now
    chosen = now.servos.joint.clone()
    chosen[joints, INDEX[name]] = values[best, torch.arange(len(joints))][joints]
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


def _scanned(data: PositionData, now: Found, windows: Windows) -> Found:
    """With limits of acceleration where simulations are best, farther and nearer about where they
    are: motions that chase their commands have a loss with many small valleys, over which no slope
    leads."""
    if "acceleration" not in now.free:
        return now
    joints = now.free["acceleration"]
    for factors in _SCANS:
        sets = _batch(now.servos, len(factors))
        column = sets.joint[:, :, INDEX["acceleration"]]
        column *= torch.tensor(factors, dtype=torch.float64)[:, None]
        best = _tried(data, sets, windows).argmin(1)
        rows = torch.where(joints, best, torch.full_like(best, factors.index(1.0)))
        joint = sets.joint[rows, torch.arange(data.robot.n)]
        servos = fit(data, replace(now.servos, joint=joint), now.free, windows, iterations=2)
        now = replace(now, servos=servos)
    return now


def _with_stops(data: PositionData, now: Found, windows: Windows) -> Found:
    """End stops about where the joints came to their lowest and highest positions."""
    inside = torch.tensor(_STOP_INSIDE, dtype=torch.float64)[:, None]
    now = _grown(data, now, windows, "stop_low", data.q.amin(0) + inside)
    return _grown(data, now, windows, "stop_high", data.q.amax(0) - inside)


def _with_plane(data: PositionData, now: Found, windows: Windows) -> Found:
    """A plane that a point of the link touches: along its centre of mass, thrice as far out."""
    if data.body.height is None or data.robot.parameters is None:
        return now
    point = 3 * data.robot.parameters.com[data.link].to(torch.float64)
    height = data.body.height @ torch.cat([point, point.new_ones(1)])
    levels = height.quantile(torch.tensor(_QUANTILES, dtype=torch.float64))
    sets = _batch(now.servos, 1 + 2 * len(levels))
    for k, level in enumerate(levels.tolist()):
        for i, stiffness in enumerate((300.0, 1000.0)):
            row = sets.plane[1 + 2 * k + i]
            row[:3], row[3], row[4] = point, level, stiffness
    total = _tried(data, sets, windows).sum(0)
    best = int(total.argmin())
    if not float(total[best]) < (1 - TOUCHED) * float(total[0]):
        return now
    touching = replace(now.servos, plane=sets.plane[best].clone())
    servos = fit(data, touching, now.free, windows, plane=True, iterations=6)
    return Found(servos, now.free, True)


def _with_clip(data: PositionData, now: Found, windows: Windows) -> Found:
    # Shares of the torque that the largest position errors would make.
    e = (data.tracks.u - data.q).abs().quantile(0.999, 0)
    shares = torch.tensor([0.4, 0.6, 0.8], dtype=torch.float64)[:, None]
    return _grown(data, now, windows, "clip", shares * e * now.servos.of("kp"))


def _with_speed(data: PositionData, now: Found, windows: Windows) -> Found:
    top = data.dq.abs().quantile(0.9999, 0).clamp(min=0.1)
    shares = torch.tensor([0.7, 0.85, 1.0], dtype=torch.float64)[:, None]
    return _grown(data, now, windows, "speed", shares * top)


def _with_dead_zone(data: PositionData, now: Found, windows: Windows) -> Found:
    widths = torch.tensor([0.0015, 0.004], dtype=torch.float64)[:, None]
    return _grown(data, now, windows, "dead_zone", widths.expand(-1, data.robot.n))


def _with_scale(data: PositionData, now: Found, windows: Windows) -> Found:
    factors = torch.tensor([0.9, 0.97, 1.03, 1.1], dtype=torch.float64)[:, None]
    return _grown(data, now, windows, "scale", factors.expand(-1, data.robot.n))
