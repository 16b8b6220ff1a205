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
from typing import NamedTuple

import numpy as np
import torch

from torchid.effects.instants import interval
from torchid.effects.variation import rigid_torque
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor

STEPS = 12
"""Steps of integration in a period of the gear's resonance with the lightest link, at least: its
frequency is then right to 1 %, and others better."""

PIECE = 1.0
"""Length into which a motion is cut, so that its pieces are integrated side by side [s]."""

LEAD = 2.0
"""Length before each piece in which the link forgets how it began [s]."""

LEAST_INERTIA = 0.05
"""Inertia of a joint that no body has (zero or less somewhere), relative to its mean."""


class Gear(NamedTuple):
    """Of one joint, for B gears at once.

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
    robot: Robot, state: tuple[Tensor, Tensor, Tensor], joint: int
) -> tuple[Float[Tensor, " T"], Float[Tensor, "T n"]]:
    """Torque (T,) that a rigid link would ask for along a motion (T, n), and the joint's column
    M(q) e_j (T, n) of the mass matrix."""
    q, dq, ddq = state
    unit = torch.zeros_like(q)
    unit[:, joint] = 1.0
    torque, more = (rigid_torque(robot, q, dq, a) for a in (ddq, ddq + unit))
    return torque[:, joint], more - torque


class Driven(NamedTuple):
    """Links that are driven through gears, one a gear.

    Attributes:
        load: (T, 1) or (T, B) torque that a rigid link would ask for [N m; N].
        inertia: (T, 1) or (T, B) of the links; one that no body has, zero or less, is raised.
        gear: B of them.
    """

    load: Float[Tensor, "T ..."]
    inertia: Float[Tensor, "T ..."]
    gear: Gear


def link_lag(
    load: Float[Tensor, "T ..."],
    inertia: Float[Tensor, "T ..."],
    t: Float[Tensor, " T"],
    gear: Gear,
) -> Lag:
    """How links lag behind their motor; see `Driven`.

    Args:
        load, inertia: of the links.
        t: (T,) uniform grid [s].
        gear: B of them.
    """
    return link_lags([Driven(load, inertia, gear)], t)[0]


def link_lags(links: Sequence[Driven], t: Float[Tensor, " T"]) -> list[Lag]:
    """How links of several joints lag behind their motors: those that need equally many steps of
    integration are integrated side by side."""
    total, rate = len(t), 1 / interval(t)
    # All pieces side by side, each with its lead; before the first instant the motion is held.
    piece, lead = max(1, round(PIECE * rate)), round(LEAD * rate)
    starts = np.arange(0, total, piece)
    index = np.clip(starts + np.arange(-lead, piece)[:, None], 0, total - 1)
    pieces: dict[int, list[tuple[int, np.ndarray, np.ndarray]]] = {}
    for k, (load, inertia, gear) in enumerate(links):
        least = max(LEAST_INERTIA * float(inertia.abs().mean()), 1e-12)
        m = inertia.double().clamp(min=least).numpy()[index]
        steps = _steps(m, gear, rate) if gear.play.any() else 0
        pieces.setdefault(steps, []).append((k, load.double().numpy()[index], m))
    lags: dict[int, Lag] = {}
    for steps, some in pieces.items():
        gears = [links[k].gear for k, *_ in some]
        gear = Gear(*map(np.concatenate, zip(*gears, strict=True)))
        widths = [len(g.play) for g in gears]
        u, m = (
            x[0]
            if len(x) == 1
            else np.concatenate(
                [np.broadcast_to(y, (*y.shape[:2], w)) for y, w in zip(x, widths, strict=True)], 2
            )
            for x in ([u for _, u, _ in some], [m for *_, m in some])
        )
        # At rest on the flank that the torque presses against.
        x = u[0] / gear.stiffness + np.sign(u[0]) * gear.play / 2
        found = _flights(u, m, gear, rate, x, steps) if steps else _swings(u, m, gear, rate, x)
        # Pieces one after the other again, without their leads.
        flat = [
            torch.from_numpy(
                p[lead:].transpose(1, 0, 2).reshape(len(starts) * piece, -1)[:total].copy()
            ).split(widths, 1)
            for p in found
        ]
        for (k, *_), *own in zip(some, *flat, strict=True):
            lags[k] = Lag(*own)
    return [lags[k] for k in range(len(links))]


def _steps(m: np.ndarray, gear: Gear, rate: float) -> int:
    """So many steps between two samples as the stiffest gear with the lightest link needs; odd, so
    that a rate is known in the middle."""
    fastest = math.sqrt(float(gear.stiffness.max() / m.min())) / (2 * math.pi)
    steps = max(1, math.ceil(STEPS * fastest / rate))
    return steps + 1 - steps % 2


def _swings(
    u: np.ndarray, m: np.ndarray, gear: Gear, rate: float, x: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angle, rate and acceleration (W, P, B) without play: exact where the torque is linear and the
    inertia constant from one sample to the next.

    Args:
        u, m: (W, P, 1 or B) torque and inertia of P pieces.
        gear: B gears, damped less than critically.
        rate: of the samples [Hz].
        x: (P, B) angle at the first sample, at rest.
    """
    k, damping = gear.stiffness, gear.damping
    # The deflection that follows a torque which grows so, and how the link swings about it.
    slope = np.diff(u, axis=0) * rate / k
    still = u[:-1] / k - damping / k * slope
    decay = damping / (2 * m[:-1])
    omega = np.sqrt(np.maximum(k / m[:-1] - decay**2, 1e-12))
    fade = np.exp(-decay / rate)
    sine, cosine = fade * np.sin(omega / rate) / omega, fade * np.cos(omega / rate)
    own, cross, back, rest = cosine + decay * sine, sine, -k / m[:-1] * sine, cosine - decay * sine
    xs, vs = np.empty((2, len(u), *x.shape))
    v = np.zeros_like(x)
    xs[0], vs[0] = x, v
    for i in range(len(still)):
        away, speed = x - still[i], v - slope[i]
        x = still[i] + slope[i] / rate + own[i] * away + cross[i] * speed
        v = slope[i] + back[i] * away + rest[i] * speed
        xs[i + 1], vs[i + 1] = x, v
    return xs, vs, (u - k * xs - damping * vs) / m


def _flights(
    u: np.ndarray, m: np.ndarray, gear: Gear, rate: float, x: np.ndarray, steps: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same with play, by leapfrog steps (rates half a step from angles), the damping implicit.

    An impact may be shorter than the time between two samples: accelerations are means from the
    middle before a sample to the middle after it, so that none is lost.
    """
    k, half = gear.stiffness, gear.play / 2
    h = 1 / (steps * rate)
    slope = np.diff(u, axis=0) / steps
    gain = h / m
    held, free, stiff = 1 / (1 + gain * gear.damping), 1 / (1 + gain * gear.drag), gain * k
    xs, vs, middle = np.zeros((3, len(u), *x.shape))
    # In place: these arrays fit the cache, and new ones would take half of the time.
    x, v = x.copy(), np.zeros_like(x)
    beyond, push, touching, rest = (np.empty_like(x) for _ in range(4))
    flank = np.empty(x.shape, dtype=bool)
    xs[0] = x
    for i in range(len(slope)):
        for step in range(steps):
            np.add(v, gain[i] * (u[i] + step * slope[i]), out=push)
            # What of the lag is beyond half the play.
            np.minimum(x, half, out=beyond)
            np.maximum(beyond, -half, out=beyond)
            np.subtract(x, beyond, out=beyond)
            # A flank pushes, or else the link flies.
            np.multiply(stiff[i], beyond, out=touching)
            np.subtract(push, touching, out=touching)
            np.multiply(touching, held[i], out=touching)
            np.multiply(push, free[i], out=v)
            np.subtract(push, touching, out=rest)
            np.multiply(rest, beyond, out=rest)
            np.greater(rest, 0, out=flank)
            np.copyto(v, touching, where=flank)
            np.multiply(v, h, out=rest)
            np.add(x, rest, out=x)
            if step == steps // 2:
                middle[i + 1] = v
        xs[i + 1], vs[i + 1] = x, v
    after = np.concatenate([middle[1:], middle[-1:]])
    return xs, vs, (after - middle) * rate
