"""A gear that gives way between two masses: how far the link is behind the motor whose encoder is
logged.

    M(q) d'' + k dz(d) + D d' = tau,    d = q_motor - q_link

tau is the torque that a rigid link would ask for along the motor's motion, M the inertia that its
joint moves, k and D the gear's stiffness and damping, and dz(d) what of d lies beyond the play. So
the motor's motion alone drives the link: no measured torque enters (Spong 1987, Modeling and
control of elastic joint robots, J. Dyn. Sys. Meas. Control 109(4); with play Nordin and Gutman
2002, Controlling mechanical systems with backlash: a survey, Automatica 38(10), section 2).

Within the play no flank touches: there D is the bearing's drag, and the link flies. A flank pushes
and does not pull: k dz(d) + D d' has the sign of dz(d), or is zero.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch

from torchid.effects.instants import interval
from torchid.effects.variation import rigid_torque
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor

PIECE = 1.0
"""Length into which a motion is cut, so that its pieces are integrated side by side [s]."""


class Gear(NamedTuple):
    """B gears of one joint.

    Attributes:
        stiffness: (B,) [N m/rad; N/m].
        damping: (B,) while a flank touches [N m s/rad; N s/m].
        play: (B,) between the flanks [rad; m].
        drag: (B,) damping while none touches [N m s/rad; N s/m].
    """

    stiffness: Float[np.ndarray, " B"]
    damping: Float[np.ndarray, " B"]
    play: Float[np.ndarray, " B"]
    drag: Float[np.ndarray, " B"]

    @classmethod
    def ringing(
        cls,
        inertia: float,
        hertz: Sequence[float] | float,
        ratio: Sequence[float] | float,
        play: Sequence[float] | float = 0.0,
        drag: Sequence[float] | float = 0.0,
    ) -> "Gear":
        """Gears by their resonance [Hz] with a link of this inertia before a held motor, and their
        damping and drag relative to the critical damping."""
        given = [np.atleast_1d(np.asarray(x, dtype=float)) for x in (hertz, ratio, play, drag)]
        omega, ratios, plays, drags = np.broadcast_arrays(2 * math.pi * given[0], *given[1:])
        critical = 2 * inertia * omega
        return cls(inertia * omega**2, ratios * critical, plays, drags * critical)


class Lag(NamedTuple):
    """By which a link is behind its motor, (T, B): angle and its derivatives [rad, s]."""

    angle: Float[Tensor, "T B"]
    rate: Float[Tensor, "T B"]
    acceleration: Float[Tensor, "T B"]


def joint_load(
    robot: Robot, state: tuple[Tensor, Tensor, Tensor], joint: int, rigid: Tensor | None = None
) -> tuple[Float[Tensor, " T"], Float[Tensor, "T n"]]:
    """Torque (T,) that a rigid link would ask for along a motion (T, n), and the joint's column
    M(q) e_j (T, n) of the mass matrix; `rigid` is the `rigid_torque` there where it is known."""
    q, dq, ddq = state
    rigid = rigid_torque(robot, q, dq, ddq) if rigid is None else rigid
    unit = torch.zeros_like(q)
    unit[:, joint] = 1.0
    return rigid[:, joint], rigid_torque(robot, q, dq, ddq + unit) - rigid


class Driven(NamedTuple):
    """Links that are driven through gears, one a gear.

    Attributes:
        load: (T, 1) or (T, B) torque that a rigid link would ask for [N m; N].
        inertia: (T, 1) or (T, B) of the links; one that no body has, zero or less, is raised.
        t: (T,) uniform grid [s].
        gear: B of them.
    """

    load: Float[Tensor, "T ..."]
    inertia: Float[Tensor, "T ..."]
    t: Float[Tensor, " T"]
    gear: Gear


class _Pieces(NamedTuple):
    """A motion cut into P pieces of W instants, each with its lead.

    Attributes:
        load, inertia: (W, P, 1 or B), as in `Driven`: arrays, or tensors that gradients follow.
        gear: B of them.
        rate: of the samples [Hz].
    """

    load: Any
    inertia: Any
    gear: Gear
    rate: float

    @property
    def start(self) -> Any:
        """(P, B) angles at rest on the flank that the torque presses against."""
        first = self.load[0]
        xp: Any = torch if isinstance(first, Tensor) else np
        stiffness, play = xp.asarray(self.gear.stiffness), xp.asarray(self.gear.play)
        return first / stiffness + xp.sign(first) * play / 2

    @property
    def least(self) -> float:
        """The least inertia that the joint moves [kg m^2; kg]."""
        lightest = self.inertia.min()
        return float(lightest.detach() if isinstance(lightest, Tensor) else lightest)

    def flat(self, x: np.ndarray) -> np.ndarray:
        """(P * B,) of what holds for pieces, gears, or pieces with gears."""
        return np.broadcast_to(x, self.start.shape).ravel()


def link_lag(
    load: Float[Tensor, "T ..."],
    inertia: Float[Tensor, "T ..."],
    t: Float[Tensor, " T"],
    gear: Gear,
) -> Lag:
    """How links lag behind their motor; arguments as the attributes of `Driven`."""
    return link_lags([Driven(load, inertia, t, gear)])[0]


def link_lags(links: Sequence[Driven]) -> list[Lag]:
    """How links of several joints and trajectories lag behind their motors: those with play that
    need equally many steps of integration are integrated side by side."""
    found: dict[int, Sequence[np.ndarray] | Sequence[Tensor]] = {}
    flying: dict[tuple[int, int, int], list[tuple[int, _Pieces]]] = {}
    for k, (load, inertia, t, gear) in enumerate(links):
        # All pieces side by side, each with its lead; before the first instant the motion is held.
        rate = 1 / interval(t)
        # 2.0: length before each piece in which the link forgets how it began [s]
        piece, lead = max(1, round(PIECE * rate)), round(2.0 * rate)
        index = np.arange(0, len(t), piece) + np.arange(-lead, piece)[:, None]
        index = np.clip(index, 0, len(t) - 1)
        # 0.05: inertia of a joint that no body has (zero or less somewhere), relative to its mean
        least = max(0.05 * float(inertia.detach().abs().mean()), 1e-12)
        raised = inertia.double().clamp(min=least).cpu()
        u, m = torch.broadcast_tensors(load.double().cpu()[index], raised[index])
        traced = u.requires_grad or m.requires_grad
        own = _Pieces(u, m, gear, rate) if traced else _Pieces(u.numpy(), m.numpy(), gear, rate)
        if not gear.play.any():
            found[k] = [x[lead:] for x in _swings(own)]
        elif traced:
            found[k] = [x[lead:] for x in _traced_flight(own)]
        else:
            flying.setdefault((_steps(own), lead, piece), []).append((k, own))
    for (steps, lead, _), some in flying.items():
        flights = _flights([own for _, own in some], steps, lead)
        found |= {k: flight for (k, _), flight in zip(some, flights, strict=True)}
    return [
        Lag(*(_in_a_row(x, len(link.t)).to(link.load.device) for x in found[k]))
        for k, link in enumerate(links)
    ]


def _in_a_row(pieces: np.ndarray | Tensor, total: int) -> Float[Tensor, "T B"]:
    """Pieces (W, P, B) one after the other again."""
    x = torch.as_tensor(pieces)
    return x.transpose(0, 1).reshape(-1, x.shape[2])[:total].clone()


def _steps(pieces: _Pieces) -> int:
    """So many steps between two samples as the stiffest gear with the lightest link needs; odd, so
    that a rate is known in the middle."""
    fastest = math.sqrt(float(pieces.gear.stiffness.max()) / pieces.least) / (2 * math.pi)
    # 12: steps of integration in a period of the gear's resonance with the lightest link, at least:
    # its frequency is then right to 1 %, and others better
    steps = max(1, math.ceil(12 * fastest / pieces.rate))
    return steps + 1 - steps % 2


def _swings(pieces: _Pieces) -> Sequence[Any]:
    """Angle, rate and acceleration (W, P, B) without play: exact where the torque is linear and the
    inertia constant from one sample to the next. The gears are damped less than critically."""
    u, m, rate = pieces.load, pieces.inertia, pieces.rate
    # Of arrays or of tensors, which call the same functions by the same names.
    xp: Any = torch if isinstance(u, Tensor) else np
    k, damping, x = xp.asarray(pieces.gear.stiffness), xp.asarray(pieces.gear.damping), pieces.start
    # The deflection that follows a torque which grows so, and how the link swings about it.
    slope = (u[1:] - u[:-1]) * rate / k
    still = u[:-1] / k - damping / k * slope
    decay = damping / (2 * m[:-1])
    omega = xp.sqrt(xp.clip(k / m[:-1] - decay**2, 1e-12, None))
    fade = xp.exp(-decay / rate)
    sine, cosine = fade * xp.sin(omega / rate) / omega, fade * xp.cos(omega / rate)
    own, cross, back, rest = cosine + decay * sine, sine, -k / m[:-1] * sine, cosine - decay * sine
    xs, vs = [x], [xp.zeros_like(x)]
    for i in range(len(still)):
        away, speed = xs[-1] - still[i], vs[-1] - slope[i]
        xs.append(still[i] + slope[i] / rate + own[i] * away + cross[i] * speed)
        vs.append(slope[i] + back[i] * away + rest[i] * speed)
    angle, speeds = xp.stack(xs), xp.stack(vs)
    return angle, speeds, (u - k * angle - damping * speeds) / m


def _traced_flight(pieces: _Pieces) -> Sequence[Tensor]:
    """A link's way with play as `_flights` has it, of one motion, on tensors that gradients
    follow."""
    u, m, gear, rate = pieces
    k, damping, play, drag = map(torch.from_numpy, gear)
    steps, x, v = _steps(pieces), pieces.start, torch.zeros_like(u[0])
    xs, vs, middle = [x], [v], []
    for i in range(len(u) - 1):
        own, grows = 1 / (steps * rate) / m[i], (u[i + 1] - u[i]) / steps
        for step in range(steps):
            push = v + own * (u[i] + step * grows)
            beyond = x - torch.minimum(torch.maximum(x, -play / 2), play / 2)
            touching = (push - own * k * beyond) / (1 + own * damping)
            pushes = (push - touching) * beyond > 0
            v = torch.where(pushes, touching, push / (1 + own * drag))
            x = x + v / (steps * rate)
            if step == steps // 2:
                middle.append(v)
        xs.append(x)
        vs.append(v)
    before, after = torch.stack([middle[0], *middle]), torch.stack([*middle, middle[-1]])
    return torch.stack(xs), torch.stack(vs), (after - before) * rate


def _flights(some: Sequence[_Pieces], steps: int, lead: int) -> list[list[np.ndarray]]:
    """Links' ways of motions with play, behind their leads, by leapfrog steps (rates half a step
    from angles), the damping implicit.

    An impact may be shorter than the time between two samples: accelerations are means from the
    middle before a sample to the middle after it, so that none is lost.
    """
    # Every piece with every gear is one of K links. What drives it stands among the Q columns of
    # all loads, which many of them have in common.
    u = np.concatenate([p.load.reshape(len(p.load), -1) for p in some], 1)
    gains = [1 / (steps * p.rate) / p.inertia.reshape(len(p.load), -1) for p in some]
    slope, gain = np.diff(u, axis=0) / steps, np.concatenate(gains, 1)
    first = np.cumsum([0, *(p.load[0].size for p in some)])
    places = [a + np.arange(p.load[0].size) for a, p in zip(first, some, strict=False)]
    places = [x.reshape(p.load[0].shape) for x, p in zip(places, some, strict=True)]
    pairs = zip(some, places, strict=True)
    flat = [[p.flat(x) for x in (at, *p.gear, np.array(p.rate), p.start)] for p, at in pairs]
    column, k, damping, play, drag, rate, x = map(np.concatenate, zip(*flat, strict=True))
    half, below, h = play / 2, -play / 2, 1 / (steps * rate)
    xs, vs, middle = np.zeros((3, len(u) - lead, len(x)))
    # In place: these arrays fit the cache, and new ones would take half of the time.
    v = np.zeros_like(x)
    beyond, push, touching, rest = (np.empty_like(x) for _ in range(4))
    flank = np.empty(x.shape, dtype=bool)
    for i in range(len(u)):
        if i >= lead:
            xs[i - lead], vs[i - lead] = x, v
        if i == len(slope):
            break
        own = gain[i][column]
        held, free, stiff = 1 / (1 + own * damping), 1 / (1 + own * drag), own * k
        for step in range(steps):
            np.take(gain[i] * (u[i] + step * slope[i]), column, out=push, mode="clip")
            np.add(v, push, out=push)
            # What of the lag is beyond half the play.
            np.minimum(x, half, out=beyond)
            np.maximum(beyond, below, out=beyond)
            np.subtract(x, beyond, out=beyond)
            # A flank pushes, or else the link flies.
            np.multiply(stiff, beyond, out=touching)
            np.subtract(push, touching, out=touching)
            np.multiply(touching, held, out=touching)
            np.multiply(push, free, out=v)
            np.subtract(push, touching, out=rest)
            np.multiply(rest, beyond, out=rest)
            np.greater(rest, 0, out=flank)
            np.copyto(v, touching, where=flank)
            np.multiply(v, h, out=rest)
            np.add(x, rest, out=x)
            if step == steps // 2 and i + 1 >= lead:
                middle[i + 1 - lead] = v
    after = np.concatenate([middle[1:], middle[-1:]])
    ends = np.cumsum([p.start.size for p in some])[:-1]
    found = [np.split(x, ends, axis=1) for x in (xs, vs, (after - middle) * rate)]
    return [
        [x.reshape(len(x), *p.start.shape) for x in own]
        for p, *own in zip(some, *found, strict=True)
    ]
