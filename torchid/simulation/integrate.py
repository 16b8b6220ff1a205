"""Time steps of a batch of arms with friction: implicit where friction is stiff or sticks.

One step of length h, from (q, dq) at its start to (q', dq') at its end, with forces in the middle:

    q_m = q + h/2 dq                                   (explicit half of a Verlet step)
    M(q_m) (dq' - dq)/h + bias(q_m, dq_m) + load(q_m, dq_m) + f = tau_m,   f in dry sign(dq')
    q' = q_m + h/2 dq',   dq_m = dq + w (dq' - dq)

With w = 1/2 it is second order and keeps the energy of a free arm bounded. A joint whose viscous
slope D is so stiff that the midpoint would overshoot, h D / M_ii > 2, gets w = 1 - M_ii/(h D), the
smallest that does not. Bias and loads are met by two passes, the first from the last acceleration.

Dry friction is set-valued at rest, |f| <= dry, so a joint sticks exactly: nothing chatters. Which
joints stick is found by an active-set (semi-smooth Newton) iteration on the linear system.
Moreau 1988; Stewart and Trinkle 1996; Alart and Curnier 1991. Steps are first order where a joint
starts, stops or turns within them.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from torchid.dynamics.forward import ComponentsAt
from torchid.dynamics.world_frame import Arms, Posture
from torchid.effects.base import Motion
from torchid.robot.model import Robot
from torchid.simulation.loads import BatchEffects

LONGEST_STEP = 2e-3
"""Seconds; longer intervals between samples are divided."""

RUNAWAY_SPEED = 1e3
"""Speed at which an arm has diverged [rad/s or m/s]."""

PASSES = 2
MOST_CHANGES = 12  # of the set of joints that stick; three suffice but for pathological couplings


class State(NamedTuple):
    """Of a batch of arms, between steps.

    Attributes:
        q, dq: (B, n).
        ddq: (B, n) of the last step; a first guess for the next.
        memory: of the effects.
        alive: (B,) whether the arm has not diverged.
    """

    q: Tensor
    dq: Tensor
    ddq: Tensor
    memory: list[Tensor | None]
    alive: Tensor


class Drive(NamedTuple):
    """Torque of the drives, feed - damping dq, clipped to the limit.

    Attributes:
        feed: (B, n) [N m; N].
        damping: (B, n), or None.
        limit: (n,) largest absolute torque, or None.
    """

    feed: Tensor
    damping: Tensor | None = None
    limit: Tensor | None = None

    def at(self, dq: Tensor) -> tuple[Tensor, Tensor]:
        """Torque, and what it loses per unit of speed."""
        slope = torch.zeros_like(dq) if self.damping is None else self.damping
        torque = self.feed - slope * dq
        if self.limit is None:
            return torque, slope
        clipped = torque.clamp(-self.limit, self.limit)
        return clipped, torch.where(clipped == torque, slope, torch.zeros_like(torque))


class Instant(NamedTuple):
    """The middle of a step, where the equations of motion hold: (B, n) each."""

    q: Tensor
    dq: Tensor
    ddq: Tensor
    torque: Tensor


@dataclass(frozen=True, eq=False)
class Plant:
    """The arms as they are: bodies and effects.

    Attributes:
        arms: bodies and kinematics, one for all or one an arm.
        effects: torques beyond the rigid body's.
        body: the robot that all arms are; None where their bodies differ.
    """

    arms: Arms
    effects: BatchEffects
    body: Robot | None = None

    def start(self, q: Tensor, dq: Tensor, ddq: Tensor, t: Tensor) -> State:
        """At positions and velocities (B, n) at times t (B,), effects at their beginning."""
        motion = Motion(q, dq, ddq, t=t, torque=torch.zeros_like(q))
        alive = torch.ones(q.shape[0], dtype=torch.bool, device=q.device)
        return State(q, dq, ddq, self.effects.initial(motion), alive)

    def step(self, state: State, h: float, t: Tensor, drive: Drive) -> tuple[State, Instant]:
        """One step; t (B,) is the time in its middle.

        An arm that diverges stays where it was and is no longer alive.
        """
        q = state.q + h / 2 * state.dq
        posture = self.arms.at(q)
        mass = posture.mass_matrix() + self.effects.inertia
        instant = Instant(q, state.dq + h / 2 * state.ddq, state.ddq, state.dq)
        change = torch.zeros_like(q)
        for _ in range(PASSES):
            instant, change = self._pass(state, h, t, drive, posture, mass, instant)
        dq = state.dq + change
        motion = Motion(q, (state.dq + dq) / 2, instant.ddq, t=t, torque=instant.torque)
        after = State(
            q + h / 2 * dq,
            dq,
            instant.ddq,
            self.effects.advance(motion, h, state.memory),
            state.alive,
        )
        return _kept(state, after), instant

    def _pass(
        self,
        state: State,
        h: float,
        t: Tensor,
        drive: Drive,
        posture: Posture,
        mass: Tensor,
        guess: Instant,
    ) -> tuple[Instant, Tensor]:
        """The step with bias and loads linearised about a guess of its middle, and its change of
        speed (B, n), which takes joints that stick to 0 exactly."""
        step = self.linearised(state, h, t, drive, posture, mass, guess)
        change = _with_dry_friction(step.matrix, step.impulse, step.dry, state.dq)
        dq = state.dq + step.weight * change
        torque = step.torque - step.loss * (dq - guess.dq)
        return Instant(guess.q, dq, change / h, torque), change

    def linearised(
        self,
        state: State,
        h: float,
        t: Tensor,
        drive: Drive,
        posture: Posture | ComponentsAt,
        mass: Tensor,
        guess: Instant,
    ) -> "Linearised":
        """The equations of motion about a guess of a step's middle."""
        bias = posture.torque(guess.dq)
        motion = Motion(guess.q, guess.dq, torch.zeros_like(guess.dq), t=t)
        if self.effects.needs_torque:
            transmitted = bias + (mass @ guess.ddq.unsqueeze(-1)).squeeze(-1)
            motion = motion._replace(torque=transmitted)
        loads = self.effects.at(motion, h / 2, state.memory)
        torque, loss = drive.at(guess.dq)
        own = mass.diagonal(dim1=-2, dim2=-1).abs()
        # A falling friction curve is followed, but must not outweigh the inertia.
        slope = torch.maximum(loads.slope + loss, -own / (4 * h))
        weight = (1 - own / (h * slope).clamp(min=1e-300)).clamp(min=0.5)
        matrix = mass + torch.diag_embed(h * weight * slope)
        rest = torque - bias - loads.smooth - slope * (state.dq - guess.dq)
        return Linearised(matrix, h * rest, h * loads.dry, weight, torque, loss)


class Linearised(NamedTuple):
    """matrix (dq' - dq) + f = impulse, f in dry sign(dq').

    Attributes:
        matrix: (B, n, n) symmetric.
        impulse, dry: (B, n).
        weight: (B, n) where in the step the speed counts.
        torque, loss: (B, n) of the drives, and per unit of speed.
    """

    matrix: Tensor
    impulse: Tensor
    dry: Tensor
    weight: Tensor
    torque: Tensor
    loss: Tensor


def _with_dry_friction(matrix: Tensor, impulse: Tensor, dry: Tensor, dq: Tensor) -> Tensor:
    """Change of speed x (B, n): matrix x + f = impulse with f in dry sign(dq + x).

    A joint sticks (dq + x = 0) or slides in a known direction; a stuck one that would need more
    than `dry` starts to slide, and one that would slide backwards sticks.
    """
    has_dry = dry > 0
    if not bool(has_dry.any()):
        return _solved(matrix, impulse)
    way = torch.sign(dq)
    identity = torch.eye(matrix.shape[-1], dtype=matrix.dtype, device=matrix.device)
    change = torch.zeros_like(dq)
    for _ in range(MOST_CHANGES):
        stuck = has_dry & (way == 0)
        rows = torch.where(stuck.unsqueeze(-1), identity, matrix)
        free = _solved(rows, torch.where(stuck, -dq, impulse - dry * way))
        change = torch.where(stuck, -dq, free)
        needed = impulse - (matrix @ change.unsqueeze(-1)).squeeze(-1)
        starts = torch.where(needed.abs() > dry, torch.sign(needed), torch.zeros_like(needed))
        turned = has_dry & ((dq + change) * way < 0)
        new = torch.where(stuck, starts, torch.where(turned, torch.zeros_like(way), way))
        if torch.equal(new, way):
            break
        way = new
    return change


def _solved(matrix: Tensor, right: Tensor) -> Tensor:
    """Without an error where a matrix is singular: that arm diverges, the others go on."""
    return torch.linalg.solve_ex(matrix, right.unsqueeze(-1))[0].squeeze(-1)


def _kept(before: State, after: State) -> State:
    """The new state, but for arms that diverge."""
    speed = after.dq.abs().amax(-1)
    good = before.alive & (speed < RUNAWAY_SPEED) & after.q.isfinite().all(-1)
    if bool(good.all()):
        return after
    rows = good.unsqueeze(-1)
    memory = [
        None if a is None or b is None else torch.where(rows, a, b)
        for a, b in zip(after.memory, before.memory, strict=True)
    ]
    return State(
        torch.where(rows, after.q, before.q),
        torch.where(rows, after.dq, torch.zeros_like(before.dq)),
        torch.where(rows, after.ddq, torch.zeros_like(before.ddq)),
        memory,
        good,
    )
