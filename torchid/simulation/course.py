"""Many steps of arms in a row, by whichever is faster: tensors, or straight-line code.

A step of one arm on tensors is all overhead; as straight-line code on floats it takes a thirtieth
of the time, and on arrays, for some hundred arms that are alike, a third. It is the step of
`integrate.py` itself, recorded once, with the recursive dynamics in the place of the batched (see
`straight_line`). It is compared with the step on tensors before it is used; where an effect has no
such form, or the two differ, tensors it is.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchid.dynamics.forward import Components
from torchid.dynamics.straight_line import Code, NoStraightLineError, straight_line
from torchid.simulation.integrate import Drive, Instant, Plant, State, held
from torchid.typing import Bool, Float

MOST_ALONE = 8
"""Arms that are stepped one after the other on floats; more are stepped together."""


class Course(NamedTuple):
    """What is kept of many steps.

    Attributes:
        signals: (S, K, B, n) q, dq after steps, or q, dq, ddq, torque in their middle; NaN from
            where no arm moves any more.
        alive: (K, B) whether an arm has not diverged by then.
    """

    signals: Float[Tensor, "S K B n"]
    alive: Bool[Tensor, "K B"]


class _Task(NamedTuple):
    """Steps of some arms.

    Attributes:
        plant, state, drive, feeds, h: as of `course`.
        t: (B,) in the middle of the first step [s].
        kept: whether states are kept, or instants.
        every, first: of which steps.
    """

    plant: Plant
    state: State
    drive: Drive
    feeds: Float[Tensor, "K B n"]
    t: Float[Tensor, " B"]
    h: float
    states: bool
    every: int
    first: int

    def blank(self) -> Course:
        """Nothing yet."""
        steps, arms, n = self.feeds.shape
        rows = len(range(self.first, steps, self.every))
        signals = self.feeds.new_full((2 if self.states else 4, rows, arms, n), torch.nan)
        return Course(signals, torch.zeros(rows, arms, dtype=torch.bool))

    def arm(self, k: int) -> "_Task":
        """The course of one of the arms."""
        now, limit = self.state, self.drive.limit
        own = slice(k, k + 1)
        state = State(
            now.q[own], now.dq[own], now.ddq[own], [_row(x, k) for x in now.memory], now.alive[own]
        )
        damping, stiffness = (_row(x, k) for x in (self.drive.damping, self.drive.stiffness))
        return self._replace(
            plant=self.plant.alone(k),
            state=state,
            drive=Drive(now.q[own], damping, limit, stiffness),
            feeds=self.feeds[:, own],
            t=self.t[own],
        )


def _row(x: Tensor | None, k: int) -> Tensor | None:
    return x if x is None or len(x) == 1 else x[k : k + 1]


def course(
    plant: Plant,
    state: State,
    drive: Drive,
    feeds: Float[Tensor, "K B n"],
    t: Float[Tensor, " B"],
    h: float,
    *,
    keep: Literal["states", "instants"],
    every: int = 1,
    first: int = 0,
) -> Course:
    """Steps of length h.

    Args:
        plant: the arms.
        state: at the beginning.
        drive: with gains and limit.
        feeds: its `feed`, step by step.
        t: time in the middle of the first step [s].
        h: [s].
        keep: what is returned, of every so many steps from the first such on.
        every, first: see `keep`.
    """
    task = _Task(plant, state, drive, feeds, t, h, keep == "states", every, first)
    arms = feeds.shape[1]
    # 100: steps that take as long as recording one
    if len(feeds) < 100 or feeds.device.type != "cpu" or feeds.dtype != torch.float64:
        return _on_tensors(task)
    if plant.alike and arms > MOST_ALONE:
        return _run(task)
    if arms > MOST_ALONE:
        return _on_tensors(task)
    each = [_run(task.arm(k)) for k in range(arms)]
    return Course(torch.cat([c.signals for c in each], 2), torch.cat([c.alive for c in each], 1))


def _run(task: _Task) -> Course:
    """Arms that are alike."""
    drive, limit = task.drive, task.drive.limit
    gains = drive.damping is not None, drive.stiffness is not None
    bound = None if limit is None else tuple(limit.tolist())
    with np.errstate(all="ignore"):
        code = _recorded(task.plant, task.h, gains, bound)
        if code is not None and _same(code, task):
            return _on_code(code, task)
    return _on_tensors(task)


def _on_tensors(task: _Task) -> Course:
    out, state = task.blank(), task.state
    for k, feed in enumerate(task.feeds):
        drive, t = task.drive._replace(feed=feed), task.t + k * task.h
        state, instant = task.plant.step(state, task.h, t, drive)
        at, rest = divmod(k, task.every)
        if rest == task.first:
            out.signals[:, at] = torch.stack(state[:2] if task.states else list(instant))
            out.alive[at] = state.alive
    return out


@lru_cache(maxsize=8)
def _recorded(
    plant: Plant, h: float, gains: tuple[bool, bool], limit: tuple[float, ...] | None
) -> Code | None:
    """The step of one arm: of q, dq, ddq, memory, t, feed, gains; the same state after it, the
    other signals of the instant, and whether the arm has not diverged."""
    zero = torch.zeros(1, plant.robots[0].n, dtype=torch.float64)
    start = plant.start(zero, zero, zero, zero[:, 0])
    memory = [x for x in start.memory if x is not None]
    components = replace(plant, arms=Components(plant.robots[0]))
    bound = None if limit is None else torch.tensor(limit, dtype=torch.float64)

    def step(*given: Tensor) -> list[Tensor]:
        state, t, drive = _unpacked(given, len(memory), gains, bound)
        after, instant = components.unguarded(state, h, t, drive)
        return _outputs(after, instant)

    examples = [zero, zero, zero, *memory, zero[:, 0], zero, *[zero] * sum(gains)]
    try:
        with torch.inference_mode(False):
            return straight_line(step, [x.clone() for x in examples])
    except NoStraightLineError:
        return None


def _unpacked(
    given: Sequence[Tensor], memory: int, gains: tuple[bool, bool], limit: Tensor | None
) -> tuple[State, Tensor, Drive]:
    """State, time and drive from the inputs of recorded code."""
    q, dq, ddq, *rest = given
    t, feed, *own = rest[memory:]
    damping, stiffness = (own.pop(0) if there else None for there in gains)
    alive = torch.ones(len(q), dtype=torch.bool)
    return State(q, dq, ddq, list(rest[:memory]), alive), t, Drive(feed, damping, limit, stiffness)


def _gains(drive: Drive) -> list[Tensor]:
    return [x for x in (drive.damping, drive.stiffness) if x is not None]


def _outputs(after: State, instant: Instant) -> list[Tensor]:
    """What is recorded of a step: its state, and the instant in its middle."""
    return [*_signals(after), instant.q, instant.dq, instant.torque, held(after)]


def _signals(state: State) -> list[Tensor]:
    return [state.q, state.dq, state.ddq, *(x for x in state.memory if x is not None)]


def _on_code(code: Code, task: _Task) -> Course:
    """On floats for one arm, on arrays for several."""
    arms, n = task.feeds.shape[1:]
    alone, out, alive = arms == 1, task.blank(), task.state.alive
    run = code.on_floats if alone else code.on_arrays
    signals = _signals(task.state)
    size = n * len(signals)
    # Where in the outputs what is kept begins: q, dq; or q, dq, ddq, torque of the instant.
    places = (0, n) if task.states else (size, size + n, 2 * n, size + 2 * n)
    picked = [place + j for place in places for j in range(n)]
    x: Sequence[Any] = _elements(signals, arms)
    gains = _elements(_gains(task.drive), arms)
    clock: Any = float(task.t[0]) if alone else task.t.numpy()
    feeds = task.feeds[:, 0].tolist() if alone else task.feeds.mT.contiguous().numpy()
    rows = np.full((out.alive.shape[0], len(picked), arms), np.nan)
    dead = ~alive.numpy()
    at = 0
    for k, feed in enumerate(feeds):
        try:
            got = run(*x, clock + k * task.h, *feed, *gains)
            good = bool(got[-1] if alone else np.all(got[-1] | dead))
        except (ArithmeticError, ValueError):
            good = False
        if not good:
            state = _state_of(x, task.state, alive)
            drive = task.drive._replace(feed=task.feeds[k])
            after, instant = task.plant.step(state, task.h, task.t + k * task.h, drive)
            got, alive = tuple(_elements(_outputs(after, instant), arms)), after.alive
            dead = ~alive.numpy()
            if dead.all():
                break
        elif not alone and dead.any():
            # Arms that have diverged stay where they were.
            got = (*(np.where(dead, a, b) for a, b in zip(x, got, strict=False)), *got[size:])
        x = got[:size]
        if k % task.every == task.first:
            for j, place in enumerate(picked):
                rows[at, j] = got[place]
            out.alive[at] = alive
            at += 1
    out.signals.copy_(torch.from_numpy(rows).unflatten(1, (-1, n)).permute(1, 0, 3, 2))
    return out


def _elements(signals: Sequence[Tensor], arms: int) -> list[Any]:
    """Floats of one arm, arrays of several, element by element."""
    wide = (s.expand(arms, *s.shape[1:]).reshape(arms, -1) for s in signals)
    if arms == 1:
        return [e for s in wide for e in s[0].tolist()]
    return [e for s in wide for e in s.T.contiguous().numpy()]


def _state_of(x: Sequence[Any], like: State, alive: Tensor) -> State:
    """A state from the rows that recorded code fills."""
    arms, n = len(alive), like.q.shape[1]
    whole = np.stack([np.broadcast_to(e, arms) for e in x], -1).reshape(arms, -1, n)
    q, dq, ddq, *memory = torch.from_numpy(whole).unbind(1)
    return State(q, dq, ddq, list(memory), alive)


def _same(code: Code, task: _Task) -> bool:
    """Whether code does what the step does, near the beginning and with torques of the way."""
    generator = torch.Generator().manual_seed(0)
    sizes = (0.3, 1.0, 1.0, *[0.1] * len(task.state.memory))
    # states of the comparison
    samples = 4
    shape = samples, task.feeds.shape[2]
    signals = [
        x[:1] + size * torch.randn(shape, generator=generator, dtype=x.dtype)
        for x, size in zip(_signals(task.state), sizes, strict=True)
    ]
    some = torch.linspace(0, len(task.feeds) - 1, samples).long()
    gains = [x[:1].expand(shape) for x in _gains(task.drive)]
    given = [*signals, task.t[:1] + some * task.h, task.feeds[some, 0], *gains]
    there = task.drive.damping is not None, task.drive.stiffness is not None
    state, t, drive = _unpacked(given, len(signals) - 3, there, task.drive.limit)
    wanted = torch.cat(
        [x.reshape(samples, -1) for x in _outputs(*task.plant.unguarded(state, task.h, t, drive))],
        1,
    )
    run, flat = code.on_arrays, _elements(given, samples)
    if task.feeds.shape[1] > 1:
        rows = np.stack([np.broadcast_to(e, samples) for e in run(*flat)], 1)
    else:
        try:
            rows = np.array([code.on_floats(*(float(e[k]) for e in flat)) for k in range(samples)])
        except (ArithmeticError, ValueError):
            return False
    # 1e-9: of a signal's largest value in the comparison
    bound = 1e-9 * wanted.abs().amax(0).clamp(min=1.0)
    return bool(((torch.from_numpy(rows.astype(float)) - wanted).abs() <= bound).all())
