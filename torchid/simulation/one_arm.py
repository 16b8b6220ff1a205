"""One arm, stepped in plain numbers: the plant's own calculation as straight-line code."""

import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from torchid.dynamics.forward import Components
from torchid.effects.motion import Motion
from torchid.simulation.integrate import (
    MOST_CHANGES,
    PASSES,
    RUNAWAY_SPEED,
    Drive,
    Instant,
    Linearised,
    Plant,
    State,
)
from torchid.simulation.straight_line import NotStraightError, StraightLine
from torchid.typing import Float

DriveOf = Callable[[State, Tensor], Drive]
"""The drives in a step from a state, with what feeds them (B, n)."""

Numbers = Sequence[float]


def stepped(
    plant: Plant, begin: State, h: float, drive_of: DriveOf, feed: Float[Tensor, "T n"], every: int
) -> tuple[Float[Tensor, "4 S n"], State] | None:
    """q, dq, ddq and torque in the middle of every k-th step, and the state after the last one;
    None where plain numbers do not do: the plant branches, or numbers leave their range.

    Args:
        plant: one arm.
        begin: its state, at -h/2.
        h: length of a step [s].
        drive_of: its drives.
        feed: what feeds them, step by step.
        every: k.
    """
    try:
        arm = _OneArm(plant, begin, h, drive_of)
        rows = [arm.step(row, k * h) for k, row in enumerate(feed.tolist()) if arm.alive]
    except (NotStraightError, ArithmeticError, ValueError):
        return None
    rows += [rows[-1]] * (len(feed) - len(rows))
    return feed.new_tensor(rows[::every]).transpose(0, 1), arm.state(begin)


class _OneArm:
    """An arm's state and the functions that change it.

    Attributes:
        alive: whether it has not diverged.
    """

    def __init__(self, plant: Plant, begin: State, h: float, drive_of: DriveOf):
        n = begin.q.shape[-1]
        self._h = h
        self._q, self._dq, self._ddq = (x[0].tolist() for x in begin[:3])
        self._shapes = {f"m{k}": x.shape for k, x in enumerate(begin.memory) if x is not None}
        self._memory = [v for x in begin.memory if x is not None for v in x.flatten().tolist()]
        self.alive = True
        # The recursion has fewer operations, tensors fewer calls.
        bodies = plant.arms if plant.body is None else Components(plant.body)
        places = [None if x is None else f"m{k}" for k, x in enumerate(begin.memory)]

        def linearised(
            q: Tensor,
            dq: Tensor,
            t: Tensor,
            feed: Tensor,
            rate: Tensor,
            ddq: Tensor,
            **held: Tensor,
        ) -> Linearised:
            memory = [None if p is None else held[p] for p in places]
            state = State(q, dq, ddq, memory, begin.alive)
            middle = q + h / 2 * dq
            posture = bodies.at(middle)
            mass = posture.mass_matrix() + plant.effects.inertia
            guess = Instant(middle, rate, ddq, dq)
            return plant.linearised(state, h, t, drive_of(state, feed), posture, mass, guess)

        def advanced(
            q: Tensor, dq: Tensor, ddq: Tensor, t: Tensor, torque: Tensor, **held: Tensor
        ) -> list[Tensor]:
            memory = [None if p is None else held[p] for p in places]
            after = plant.effects.advance(Motion(q, dq, ddq, t=t, torque=torque), h, memory)
            return [x for x in after if x is not None]

        one, arm = {"t": (1,)}, (1, n)
        self._pass = StraightLine(
            linearised,
            {"q": arm, "dq": arm, **one, "feed": arm, "rate": arm, "ddq": arm, **self._shapes},
            late=("rate", "ddq"),
        )
        self._solve = StraightLine(
            _solution, {"matrix": (n, n), "right": (n,), "free": (n,), "hold": (n,)}
        )
        self._advance = None
        if self._memory:
            self._advance = StraightLine(
                advanced, {"q": arm, "dq": arm, "ddq": arm, **one, "torque": arm, **self._shapes}
            )

    def step(self, feed: Numbers, t: float) -> tuple[Numbers, Numbers, Numbers, Numbers]:
        """q, dq, ddq and torque in the middle of the next step, as `Plant.step` has them."""
        h, n, q, dq, ddq = self._h, len(self._q), self._q, self._dq, self._ddq
        known = self._pass.early(*q, *dq, t, *feed, *self._memory)
        rate = [v + h / 2 * a for v, a in zip(dq, ddq, strict=True)]
        change: Numbers = rate
        torque: Numbers = rate
        for _ in range(PASSES):
            values = self._pass.late(known, *rate, *ddq)
            rest = values[n * n :]
            impulse, dry, weight, push, loss = (rest[k * n : (k + 1) * n] for k in range(5))
            change = self._with_dry_friction(values[: n * n], impulse, dry)
            after = [v + w * x for v, w, x in zip(dq, weight, change, strict=True)]
            torque = [
                p - x * (new - old) for p, x, new, old in zip(push, loss, after, rate, strict=True)
            ]
            rate, ddq = after, [x / h for x in change]
        middle = [x + h / 2 * v for x, v in zip(q, dq, strict=True)]
        new = [v + x for v, x in zip(dq, change, strict=True)]
        if self._advance is not None:
            mean = [(a + b) / 2 for a, b in zip(dq, new, strict=True)]
            given = (*middle, *mean, *ddq, t, *torque, *self._memory)
            self._memory = list(self._advance.late(self._advance.early(*given)))
        self._q = [x + h / 2 * v for x, v in zip(middle, new, strict=True)]
        self._dq, self._ddq = new, ddq
        self.alive = max(map(abs, new)) < RUNAWAY_SPEED and math.isfinite(sum(self._q))
        return middle, rate, ddq, torque

    def _with_dry_friction(self, matrix: Numbers, impulse: Numbers, dry: Numbers) -> Numbers:
        """Change of speed x with matrix x + f = impulse, f in dry sign(dq + x), as for tensors."""
        dq, n = self._dq, len(self._dq)
        way = [float((v > 0.0) - (v < 0.0)) for v in dq]
        change: Numbers = dq
        for _ in range(MOST_CHANGES):
            free = [0.0 if d > 0.0 and w == 0.0 else 1.0 for d, w in zip(dry, way, strict=True)]
            right = [p - d * w for p, d, w in zip(impulse, dry, way, strict=True)]
            known = self._solve.early(*matrix, *right, *free, *(-v for v in dq))
            *change, least = self._solve.late(known)
            if not least > 0.0:
                raise ArithmeticError("no pivot is negative in a mass matrix")
            new = list(way)
            for k in range(n):
                if free[k] == 0.0:
                    row = matrix[k * n : (k + 1) * n]
                    needed = impulse[k] - sum(m * x for m, x in zip(row, change, strict=True))
                    new[k] = math.copysign(1.0, needed) if abs(needed) > dry[k] else 0.0
                elif dry[k] > 0.0 and (dq[k] + change[k]) * way[k] < 0.0:
                    new[k] = 0.0
            if new == way:
                break
            way = new
        return change

    def state(self, begin: State) -> State:
        """As tensors."""
        q, dq, ddq = (begin.q.new_tensor([x]) for x in (self._q, self._dq, self._ddq))
        memory, rest = [], self._memory
        for had in begin.memory:
            count = 0 if had is None else had.numel()
            memory.append(None if had is None else had.new_tensor(rest[:count]).reshape(had.shape))
            rest = rest[count:]
        return State(q, dq, ddq, memory, torch.tensor([self.alive]))


def _solution(matrix: Tensor, right: Tensor, free: Tensor, hold: Tensor) -> tuple[Tensor, Tensor]:
    """x (n,) of a symmetric positive matrix (n, n), by elimination: matrix x = right where `free`
    is 1, x = hold where it is 0; and the least pivot."""
    stuck = 1.0 - free
    right = free * (right - matrix @ (stuck * hold)) + stuck * hold
    rows = matrix * free * free.unsqueeze(-1) + torch.diag_embed(stuck)
    rows = torch.cat([rows, right.unsqueeze(-1)], -1)
    upper, least = [], rows[0, 0]
    for _ in range(len(right)):
        least = torch.minimum(least, rows[0, 0])
        upper.append(rows[0, 1:] / rows[0, 0])
        rows = rows[1:, 1:] - rows[1:, :1] * upper[-1]
    x: list[Tensor] = []
    for row in reversed(upper):
        above = row[-1] if not x else row[-1] - (row[:-1] * torch.stack(x)).sum()
        x.insert(0, above)
    return torch.stack(x), least
