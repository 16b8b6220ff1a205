"""The rows of the least-squares problem, in pieces: filtered regressor and torque.

The regressor's columns and the torque pass through the same zero-phase filter and are decimated
with it. Each torque row keeps only its own non-zero columns: joint i does not feel links
that it does not move.
Rigid columns, viscous friction, rotor inertia and offsets are smooth functions of a motion that the
same filter has smoothed, so they are worked out at `SMOOTH` times the cut-off only: what then folds
into the filter's band is less than what its tail leaves out, 1e-8 of them. Other friction has
edges, and torque is measured: theirs are taken at all samples.
Pieces are made again for each pass over a long log, and kept for a short one, so memory does not
grow without end with the log.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch

from torchid.design.motion import Measurement, direction, moves, resting_speed
from torchid.dynamics.regressor import regressor_chunks
from torchid.effects.base import Effect, JointEffect, Motion
from torchid.effects.friction import TorqueOffset, ViscousFriction
from torchid.effects.inertia import RotorInertia
from torchid.identification.base_parameters import BaseParameters, non_negative
from torchid.log.checks import NO_TORQUE
from torchid.log.filtering import ZeroPhaseFilter, extended
from torchid.robot.inertia import PARAMETERS_PER_LINK, paper_order
from torchid.robot.model import Robot
from torchid.typing import Bool, Float, Int, Tensor

PIECE = 16384
"""Samples filtered at a time, besides the filter's tails."""

SMOOTH = 20.0
"""Sampling rate of smooth columns at least, in cut-offs."""


LINEAR = (ViscousFriction, RotorInertia, TorqueOffset)
"""Effects whose columns are as smooth as the motion."""

MEMORY = 1e9
"""Bytes of rows that are kept rather than made again."""

LITTLE = 300e6
"""The same beside a log so long that its motion is not kept either."""


@dataclass(frozen=True)
class Layout:
    """Which columns each torque row has.

    Columns are ordered by link here, each link's effects behind it (those of two joints behind the
    later link), so that torque row i has non-zeros only from link i on; `order` leads back to the
    order of the base parameters.

    Attributes:
        robot, base, effects: what is identified.
        order: (B,) position in `base.independent` of each column.
        rigid: per torque row the (link, parameter) pairs of its rigid columns.
        own: per torque row the (effect, coefficient) pairs of its effects, smooth ones first.
        columns: per torque row the column numbers, rigid ones first.
    """

    robot: Robot
    base: BaseParameters
    effects: tuple[Effect, ...]
    order: tuple[int, ...]
    rigid: tuple[tuple[tuple[int, int], ...], ...]
    own: tuple[tuple[tuple[int, int], ...], ...]
    columns: tuple[tuple[int, ...], ...]

    @property
    def size(self) -> int:
        """Number of columns B."""
        return len(self.order)

    @property
    def back(self) -> Int[Tensor, " B"]:
        """What takes a vector of columns to the base parameters' own order."""
        return torch.tensor(self.order, dtype=torch.long).argsort()

    @property
    def non_negative(self) -> Bool[Tensor, " B"]:
        """Columns that are one coefficient which physics forbids to be negative."""
        return non_negative(self.base, self.effects)[list(self.order)]


def layout(robot: Robot, base: BaseParameters, effects: Sequence[Effect]) -> Layout:
    """The columns of each torque row, for the base parameters of a robot with effects."""
    flat = paper_order(robot.n_links).tolist()
    coefficients = [
        (e, c) for e, effect in enumerate(effects) for c in range(len(effect.coefficients))
    ]
    described = []
    for position, k in enumerate(base.independent):
        if k < len(flat):
            link, parameter = divmod(flat[k], PARAMETERS_PER_LINK)
            described.append((link, 0, position, (link, parameter)))
        else:
            e, c = coefficients[k - len(flat)]
            described.append((max(effects[e].joints), 1, position, (e, c)))
    described.sort()
    rigid, own, columns = [], [], []
    of_effects = [(j, d[3]) for j, d in enumerate(described) if d[1] == 1]
    for i in range(robot.n):
        moved = set(robot.moved_by(i))
        r = [(j, d[3]) for j, d in enumerate(described) if d[1] == 0 and d[0] in moved]
        o = [(j, pair) for j, pair in of_effects if i in effects[pair[0]].joints]
        rigid.append(tuple(pair for _, pair in r))
        o.sort(key=lambda column: not isinstance(effects[column[1][0]], LINEAR))
        own.append(tuple(pair for _, pair in o))
        columns.append(tuple(j for j, _ in r + o))
    return Layout(
        robot,
        base,
        tuple(effects),
        tuple(d[2] for d in described),
        tuple(rigid),
        tuple(own),
        tuple(columns),
    )


@dataclass(frozen=True)
class RowBlock:
    """Rows of m instants.

    Attributes:
        augmented: per joint (m, columns of its row + 1), the filtered torque behind the columns.
        moving: (m, n) rows whose own joint moves.
        keep: (m, n) rows that take part in the fit.
        instant: (m,) running number of the instant over all trajectories.
    """

    augmented: tuple[Float[Tensor, "m _"], ...]
    moving: Bool[Tensor, "m n"]
    keep: Bool[Tensor, "m n"]
    instant: Int[Tensor, " m"]

    @property
    def matrices(self) -> tuple[Float[Tensor, "m _"], ...]:
        """Per joint (m, columns of its row)."""
        return tuple(a[:, :-1] for a in self.augmented)

    @property
    def tau(self) -> Float[Tensor, "m n"]:
        """Filtered torque."""
        return torch.stack([a[:, -1] for a in self.augmented], -1)

    def residual(self, layout: Layout, x: Float[Tensor, " B"]) -> Float[Tensor, "m n"]:
        """tau minus the rows times x, x in the layout's order."""
        each = zip(self.augmented, layout.columns, strict=True)
        return torch.stack([a[:, -1] - a[:, :-1] @ x[list(own)] for a, own in each], -1)


class RowSource:
    """All rows of a set of trajectories, as often as needed.

    Args:
        measured: filtered trajectories.
        layout: the columns.
        moving_only: leave out rows whose own joint does not move.
        progress: called with (pieces done, pieces in all) while a pass is made.
    """

    def __init__(
        self,
        measured: Sequence[Measurement],
        layout: Layout,
        *,
        moving_only: bool = False,
        progress: Callable[[int, int], None] | None = None,
    ):
        self.measured = tuple(map(at_ease, measured))
        self.layout = layout
        self.moving_only = moving_only
        self._progress = progress
        self._kept: list[RowBlock] | None = None

    def __iter__(self) -> Iterator[RowBlock]:
        if self._kept is not None:
            yield from self._kept
            return
        size = 8.0 * self.instants * sum(len(c) for c in self.layout.columns)
        whole = all(isinstance(m.motion, Motion) for m in self.measured)
        kept: list[RowBlock] | None = [] if size <= (MEMORY if whole else LITTLE) else None
        total = sum(len(_pieces(m)) for m in self.measured)
        done = 0
        for m, first in zip(self.measured, self.boundaries, strict=False):
            for block in _blocks(m, self.layout, self.moving_only, first):
                if kept is not None:
                    kept.append(block)
                yield block
                done += 1
                if self._progress is not None:
                    self._progress(done, total)
        self._kept = kept

    @property
    def instants(self) -> int:
        """Instants of all blocks together, after decimation."""
        return self.boundaries[-1]

    @cached_property
    def boundaries(self) -> list[int]:
        """First instant of each trajectory, and the end of the last."""
        counts = (-(-(m.samples - 2 * m.edge) // _step(m)) for m in self.measured)
        return list(itertools.accumulate(counts, initial=0))

    @property
    def interval(self) -> list[float]:
        """Seconds between instants, per trajectory."""
        return [_step(m) / m.rate for m in self.measured]


def at_ease(m: Measurement) -> Measurement:
    """A trajectory whose joints have half a direction, that from which they came, where they rest,
    and none before they first moved. Friction that stopped a joint can hold on, and can relax to
    nothing: half of it is the middle. A joint that turns keeps its direction, for it stands still
    for an instant only. Directions of a motion in parts stay as they are."""
    motion = m.motion
    if not isinstance(motion, Motion) or motion.direction is None:
        return m
    limit = resting_speed(motion, m.moving)
    held, came = motion.sign.clone(), direction(motion.dq, limit)
    for j, speed in enumerate(motion.dq.unbind(-1)):
        pace = (speed / limit[j]).square()
        slow = pace <= 1
        # Stays, numbered from 1; what is in motion between them is none.
        stay = (slow & slow.diff(prepend=slow.new_zeros(1))).cumsum(0) * slow
        # 1 / 12: mean square of a joint's speed while it does not move, in squares of the speed at
        # which it does, below which it rests: half the speed of a joint that turns, which passes
        # evenly through all speeds there and has a third
        rests = slow & (stay.bincount(pace) < (1 / 12) * stay.bincount())[stay]
        held[rests, j] = 0.5 * came[rests, j].to(held)
    return replace(m, motion=motion._replace(direction=held))


def _filter(m: Measurement) -> ZeroPhaseFilter | None:
    return None if m.cutoff is None else ZeroPhaseFilter(m.rate, m.cutoff)


def _step(m: Measurement) -> int:
    low_pass = _filter(m)
    return 1 if low_pass is None else low_pass.largest_step


def _every(m: Measurement) -> int:
    """Samples between those at which smooth columns are worked out, a divisor of the step."""
    step, least = _step(m), SMOOTH * (m.cutoff or 0.0) * (1 - 1e-6)
    divisors = [d for d in range(1, step + 1) if step % d == 0]
    return max((d for d in divisors if m.rate / d >= least), default=1)


def _tail(m: Measurement) -> int:
    """Samples that the filter needs on either side, a multiple of the step."""
    low_pass = _filter(m)
    return 0 if low_pass is None else -(-low_pass.tail // _step(m)) * _step(m)


def _pieces(m: Measurement) -> list[tuple[int, int, int]]:
    """Sample ranges between the trajectory's edges, each a whole number of steps long, and every
    how many of their samples smooth columns are worked out: all of those whose filter reaches past
    the trajectory's ends, where their reflection has a kink."""
    step, every, tail = _step(m), _every(m), _tail(m)
    first, last = m.edge, m.samples - m.edge
    inner = first + max(0, -(-(tail - first) // step)) * step
    outer = first + (m.samples - tail - first) // step * step
    parts = [(first, last, 1)]
    if every > 1 and inner < outer:
        parts = [(first, inner, 1), (inner, outer, every), (outer, last, 1)]
    return [
        (k, min(k + length, b), d)
        for a, b, d in parts
        for length in [max(1, PIECE * d // step) * step]
        for k in range(a, b, length)
    ]


def _filtered(
    m: Measurement, signals: Float[Tensor, "C _"], apart: int, start: int, stop: int
) -> Float[Tensor, "C _"]:
    """Signals of a piece, tails and all, as many samples apart, at the instants of its rows."""
    low_pass, step, tail = _filter(m), _step(m), _tail(m)
    if low_pass is None:
        return signals
    # At the ends of the trajectory nothing is thinned, and all is extended.
    before, after = max(0, tail - start), max(0, stop + tail - m.samples)
    padded = extended(signals, before, after) if before or after else signals
    thin = replace(low_pass, every=apart)
    return thin.decimated(padded, step // apart, tail // apart, (tail + stop - start) // apart)


def _blocks(
    m: Measurement, layout: Layout, moving_only: bool, first_instant: int
) -> Iterator[RowBlock]:
    step, tail, pieces = _step(m), _tail(m), _pieces(m)
    # Where none is measured; what holds a base that moves is zero, and known.
    silent = (m.tau.abs().amax(0) < NO_TORQUE).cpu()
    silent[list(layout.robot.free)] = False
    # What remembers the past is evaluated from the trajectory's beginning, once a pass.
    whole: dict[Effect, Tensor] = {
        e: e.columns(m.whole) for e in layout.effects if isinstance(e, JointEffect) and e.memory
    }
    # The regressor of a short log at once: a piece at its end would take as many calls as all.
    short = sum((b - a + 2 * tail) // d for a, b, d in pieces) <= 2 * PIECE
    for group in [pieces] if short else [[piece] for piece in pieces]:
        reach = [slice(max(0, a - tail), min(m.samples, b + tail)) for a, b, _ in group]
        motions = [m.motion.part(own) for own in reach]
        thin = [motion.every(d) for motion, (_, _, d) in zip(motions, group, strict=True)]
        sharp = [
            _sharp_columns(motion, m.tau[own], layout, {e: x[own] for e, x in whole.items()})
            for motion, own in zip(motions, reach, strict=True)
        ]
        # Row by row: of many joints the columns of all rows would not all fit, with their spectra.
        # Whatever the device of the log: what follows is small, and sequential.
        rows = [
            [
                torch.cat([_filtered(m, x, d, a, b), _filtered(m, next(y), 1, a, b)]).cpu()
                for x, y, (a, b, d) in zip(smooth, sharp, group, strict=True)
            ]
            for smooth in _smooth_columns(thin, layout)
        ]
        for (a, b, _), own, motion, *augmented in zip(group, reach, motions, *rows, strict=True):
            moving = moves(motion.part(slice(a - own.start, b - own.start, step)), m.moving).cpu()
            keep = moving.clone() if moving_only else torch.ones_like(moving)
            # Nothing rubs on a base that nothing holds: its rows count at rest, too.
            keep[:, list(layout.robot.free)] = True
            keep[:, silent] = False
            instant = torch.arange(len(keep)) + first_instant
            first_instant += len(keep)
            yield RowBlock(tuple(x.T for x in augmented), moving, keep, instant)


def sampled(
    measured: Sequence[Measurement], signals: Sequence[Float[Tensor, "C _"]]
) -> Float[Tensor, "C I"]:
    """Signals along whole trajectories at the instants of the rows, filtered like them."""
    out = []
    for m, x in zip(measured, signals, strict=True):
        start, stop, tail = m.edge, m.samples - m.edge, _tail(m)
        out.append(_filtered(m, x[:, max(0, start - tail) : stop + tail], 1, start, stop))
    return torch.cat(out, -1)


def _smooth_columns(
    motions: Sequence[Motion], layout: Layout
) -> Iterator[tuple[Float[Tensor, "C _"], ...]]:
    """Smooth columns of each torque row along several motions, made in one go and split again."""
    joined = Motion(*(torch.cat(x) for x in zip(*(m.state for m in motions), strict=True)))
    smooth = {e: e.columns(joined) for e in layout.effects if isinstance(e, LINEAR)}
    rows: list[list[Tensor]] = [[] for _ in range(layout.robot.n)]
    start = 0
    for chunk in regressor_chunks(layout.robot, *joined.state):
        here = slice(start, start := start + len(chunk.like))
        for i, (pairs, own) in enumerate(zip(layout.rigid, layout.own, strict=True)):
            effects = [(layout.effects[e], c) for e, c in own]
            columns = [chunk.entry(i, link, k) for link, k in pairs]
            columns += [smooth[e][here, c] for e, c in effects if isinstance(e, LINEAR)]
            empty = chunk.like.new_empty(0, len(chunk.like))
            rows[i].append(torch.stack(columns) if columns else empty)
    for parts in rows:
        made = parts[0] if len(parts) == 1 else torch.cat(parts, -1)
        parts.clear()
        yield made.split([len(motion.q) for motion in motions], -1)


def _sharp_columns(
    motion: Motion, tau: Float[Tensor, "M n"], layout: Layout, whole: Mapping[Effect, Tensor]
) -> Iterator[Float[Tensor, "C M"]]:
    """Columns of the other effects on each torque row, and the torque behind them.

    Args:
        motion, tau: of the samples.
        layout: the columns.
        whole: columns of effects that remember, at the samples.
    """
    # Once for all joints.
    motion = motion._replace(direction=None if motion.direction is None else motion.sign)
    made = [
        [] if isinstance(e, LINEAR) else [whole[e]] if e in whole else e.own_columns(motion)
        for e in layout.effects
    ]
    for i, own in enumerate(layout.own):
        columns = [made[e][layout.effects[e].joints.index(i)][:, c] for e, c in own if made[e]]
        yield torch.stack([*columns, tau[:, i]])
