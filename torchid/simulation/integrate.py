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

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchid.dynamics.forward import Components, ComponentsAt
from torchid.dynamics.straight_line import Opaque, straight_line
from torchid.dynamics.world_frame import Arms, Posture, arms_of
from torchid.effects.base import Motion
from torchid.robot.model import Robot
from torchid.simulation.loads import BatchEffects

LONGEST_STEP = 2e-3
"""Seconds; longer intervals between samples are divided."""


_MOST_CHANGES = 12  # of the set of joints that stick; three suffice but for pathological couplings


class State(NamedTuple):
    """What a batch of B arms is in between two steps.

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
    """Torque of the drives, feed - stiffness q - damping dq, clipped to the limit.

    Attributes:
        feed: (B, n) [N m; N].
        damping, stiffness: (B, n), or None.
        limit: (n,) largest absolute torque, or None.
    """

    feed: Tensor
    damping: Tensor | None = None
    limit: Tensor | None = None
    stiffness: Tensor | None = None

    def at(self, q: Tensor, dq: Tensor) -> tuple[Tensor, Tensor]:
        """Torque, and what it loses per unit of speed."""
        slope = torch.zeros_like(dq) if self.damping is None else self.damping
        torque = self.feed - slope * dq
        if self.stiffness is not None:
            torque = torque - self.stiffness * q
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
        robots: the arms as robots, one for all or one an arm.
    """

    arms: Arms | Components
    effects: BatchEffects
    robots: tuple[Robot, ...]

    @property
    def alike(self) -> bool:
        """Whether all arms are one."""
        return len(self.robots) == 1 and len(self.effects.inertia) == 1

    def alone(self, arm: int) -> "Plant":
        """The plant of one of the arms."""
        if self.alike:
            return self
        robot = self.robots[min(arm, len(self.robots) - 1)]
        effects = self.effects.alone(arm)
        return Plant(arms_of([robot], effects.inertia), effects, (robot,))

    def start(self, q: Tensor, dq: Tensor, ddq: Tensor, t: Tensor) -> State:
        """At positions and velocities (B, n) at times t (B,), effects at their beginning."""
        motion = Motion(q, dq, ddq, t=t, torque=torch.zeros_like(q))
        alive = torch.ones(q.shape[0], dtype=torch.bool, device=q.device)
        return State(q, dq, ddq, self.effects.initial(motion), alive)

    def step(self, state: State, h: float, t: Tensor, drive: Drive) -> tuple[State, Instant]:
        """One step; t (B,) is the time in its middle.

        An arm that diverges stays where it was and is no longer alive.
        """
        after, instant = self.unguarded(state, h, t, drive)
        return kept(state, after), instant

    def unguarded(self, state: State, h: float, t: Tensor, drive: Drive) -> tuple[State, Instant]:
        """The step of arms whether they diverge or not."""
        q = state.q + h / 2 * state.dq
        posture = self.arms.at(q)
        mass = posture.mass_matrix() + self.effects.inertia
        instant = Instant(q, state.dq + h / 2 * state.ddq, state.ddq, state.dq)
        change = torch.zeros_like(q)
        # 2: passes, the second with what the first one found
        for _ in range(2):
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
        return after, instant

    def _pass(
        self,
        state: State,
        h: float,
        t: Tensor,
        drive: Drive,
        posture: Posture | ComponentsAt,
        mass: Tensor,
        guess: Instant,
    ) -> tuple[Instant, Tensor]:
        """The step with bias and loads linearised about a guess of its middle, and its change of
        speed (B, n), which takes joints that stick to 0 exactly."""
        bias = posture.torque(guess.dq)
        motion = Motion(guess.q, guess.dq, torch.zeros_like(guess.dq), t=t)
        if self.effects.needs_torque:
            transmitted = bias + (mass @ guess.ddq.unsqueeze(-1)).squeeze(-1)
            motion = motion._replace(torque=transmitted)
        loads = self.effects.at(motion, h / 2, state.memory)
        torque, loss = drive.at(guess.q, guess.dq)
        own = mass.diagonal(dim1=-2, dim2=-1).abs()
        # A falling friction curve is followed, but must not outweigh the inertia.
        slope = torch.maximum(loads.slope + loss, -own / (4 * h))
        w = (1 - own / (h * slope).clamp(min=1e-300)).clamp(min=0.5)
        matrix = mass + torch.diag_embed(h * w * slope)
        rest = torque - bias - loads.smooth - slope * (state.dq - guess.dq)
        change = _change_of_speed(matrix, h * rest, h * loads.dry, state.dq)
        dq = state.dq + w * change
        return Instant(guess.q, dq, change / h, torque - loss * (dq - guess.dq)), change


def _with_dry_friction(matrix: Tensor, impulse: Tensor, dry: Tensor, dq: Tensor) -> Tensor:
    """Change of speed x (B, n): matrix x + f = impulse with f in dry sign(dq + x).

    A joint sticks (dq + x = 0) or slides in a known direction; a stuck one that would need more
    than `dry` starts to slide, and one that would slide backwards sticks.
    """
    solved: Tensor = _active_set(torch, _solved, matrix.movedim(0, -1), impulse.T, dry.T, dq.T)
    return solved.T


def _solved(matrix: Tensor, right: Tensor) -> Tensor:
    """Without an error where a matrix is singular: that arm diverges, the others go on."""
    rows = torch.linalg.solve_ex(matrix.movedim(-1, 0), right.T.unsqueeze(-1))[0]
    return rows.squeeze(-1).T


def _active_set(xp: Any, solved: Any, matrix: Any, impulse: Any, dry: Any, dq: Any) -> Any:
    """The active set with arms on the last axis, for the tensors of `torch` or the arrays of
    `numpy`."""
    has_dry = dry > 0
    if not bool(has_dry.any()):
        return solved(matrix, impulse)
    n = len(impulse)
    identity = xp.zeros_like(matrix[:, :, :1])
    identity[range(n), range(n)] = 1.0
    change, way, places = xp.zeros_like(dq), xp.sign(dq), xp.arange(dq.shape[1])
    for _ in range(_MOST_CHANGES):
        stuck = has_dry & (way == 0)
        sticks = bool(stuck.any())
        rows = xp.where(stuck[:, None], identity, matrix) if sticks else matrix
        right = impulse - dry * way
        own = solved(rows, xp.where(stuck, -dq, right) if sticks else right)
        change[:, places] = own
        new = xp.where(has_dry & ((dq + own) * way < 0), 0.0, way)
        if sticks:
            needed = impulse - (matrix * own).sum(1)
            new = xp.where(stuck, xp.where(abs(needed) > dry, xp.sign(needed), 0.0), new)
        again = (new != way).any(0)
        if not bool(again.any()):
            break
        # Most arms are done; the others go on without them.
        places, way = places[again], new[:, again]
        matrix, has_dry = matrix[:, :, again], has_dry[:, again]
        impulse, dry, dq = impulse[:, again], dry[:, again], dq[:, again]
    return change


def _of_one(
    matrix: Sequence[float], impulse: Sequence[float], dry: Sequence[float], dq: Sequence[float]
) -> Sequence[float]:
    """`_with_dry_friction` of one arm, on floats."""
    n = len(impulse)
    solve, joints = _elimination(n), range(n)
    if not any(dry):
        return _checked(solve(*matrix, *impulse))
    way = [(v > 0) - (v < 0) for v in dq]
    change: Sequence[float] = ()
    for _ in range(_MOST_CHANGES):
        right = [b - f * w for b, f, w in zip(impulse, dry, way, strict=True)]
        stuck = [i for i in joints if not way[i] and dry[i] > 0]
        rows = matrix
        if stuck:
            rows = list(matrix)
            for i in stuck:
                rows[i * n : i * n + n] = [float(i == j) for j in joints]
                right[i] = -dq[i]
        change = _checked(solve(*rows, *right))
        new = [
            0 if (v + x) * w < 0 and f > 0 else w
            for v, x, w, f in zip(dq, change, way, dry, strict=True)
        ]
        for i in stuck:
            needed = impulse[i] - sum(matrix[i * n + j] * change[j] for j in joints)
            new[i] = ((needed > 0) - (needed < 0)) * (abs(needed) > dry[i])
        if new == way:
            break
        way = new
    return change


def _checked(solved: tuple[float, ...]) -> tuple[float, ...]:
    """The solution, where elimination without exchanges of rows lost no digits."""
    # 1e-6: share of a diagonal entry that elimination may leave of it
    if solved[-1] < 1e-6:
        raise ArithmeticError
    return solved[:-1]


@lru_cache(maxsize=32)
def _elimination(n: int) -> Callable[..., tuple[float, ...]]:
    """Solution of a system of n equations, and the least pivot in its diagonal entry."""

    def solution(matrix: Tensor, right: Tensor) -> list[Tensor]:
        rows, out = [list(row.unbind()) for row in matrix], list(right.unbind())
        least = torch.ones_like(out[0])
        for k in range(n):
            least = torch.minimum(least, rows[k][k].abs() / matrix[k, k].abs())
            for i in range(k + 1, n):
                share = rows[i][k] / rows[k][k]
                out[i] = out[i] - share * out[k]
                rows[i] = [a - share * b for a, b in zip(rows[i], rows[k], strict=True)]
        for k in reversed(range(n)):
            known = sum((rows[k][j] * out[j] for j in range(k + 1, n)), torch.zeros_like(out[0]))
            out[k] = (out[k] - known) / rows[k][k]
        return [*out, least]

    eye = torch.eye(n, dtype=torch.float64)
    return straight_line(solution, [eye, eye[0]]).on_floats


def _of_many(*arguments: Sequence[np.ndarray | float]) -> Sequence[np.ndarray]:
    """`_with_dry_friction` of arrays (B,)."""
    n, many = len(arguments[1]), max(np.size(x) for x in arguments[1])
    matrix, *others = (
        np.array([x if np.ndim(x) else np.full(many, x) for x in argument])
        for argument in arguments
    )
    return list(_active_set(np, _solved_arrays, matrix.reshape(n, n, many), *others))


def _solved_arrays(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    return _solved(torch.from_numpy(matrix), torch.from_numpy(right)).numpy()


_change_of_speed = Opaque(_with_dry_friction, _of_one, _of_many)


def kept(before: State, after: State) -> State:
    """The new state, but for arms that diverge."""
    good = before.alive & held(after)
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


def held(state: State) -> Tensor:
    """Whether arms (B,) have not diverged in a step."""
    # 1e3: speed at which an arm has diverged [rad/s or m/s]
    return (state.dq.abs().amax(-1) < 1e3) & state.q.isfinite().all(-1)
