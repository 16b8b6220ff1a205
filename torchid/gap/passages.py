"""What the diagnosis looks at: trajectories on a common grid, and the rows of its least squares.

Columns that jump (signs, hysteresis, dead bands) must be computed from sharp motion and be smoothed
afterwards like the torque; so there are two bands. A `Passage` is one trajectory in the wide band,
on which all columns are evaluated. `Rows` takes any signal on passages to the narrow band: one
zero-phase filter for torque and columns alike, decimated to two and a half samples a period of the
cut-off, so that white noise stays nearly white and rows are few.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch

from torchid.effects.base import Motion
from torchid.identification.motion import MOVING, Measurement
from torchid.log.filtering import ZeroPhaseFilter, extended
from torchid.typing import Bool, Float, Signals, Tensor

GRID = 6.0
"""Samples of a passage a period of the wide band's edge, at least where the log has as many."""

ROWS = 2.5
"""Rows a period of the cut-off."""

EDGE = 3.0
"""Length that is left out at both ends of a passage, in periods of the cut-off: beyond them the
filter sees a reflection, and most trajectories begin and end at rest, where friction can be
anything."""

REACH = 0.75
"""How far the filter carries what happens at a reversal, in periods of the cut-off, at least."""
MISTIMED = 0.125
"""How long the direction of dry friction is wrong at a reversal, in periods of the cut-off: it is
known as well as the velocity, and a joint that turns may stick."""

NEVER = 1e-3
"""A joint that travels less than this never moves [rad or m]."""

STOP = 0.1
"""Time at less than half the resting speed that makes a dwell [s]."""


@dataclass(frozen=True)
class Passage:
    """One trajectory in the wide band.

    Attributes:
        name: of the trajectory.
        trajectory: number of the trajectory in the log.
        rate: of the grid [Hz].
        band: low-pass of the signals [Hz].
        motion: q, dq, ddq, direction, age (T, n) and t (T,) [s].
        tau: (T, n) measured torque [N m; N].
        own_velocity: whether dq was measured on its own, so that it can lag behind q.
    """

    name: str
    trajectory: int
    rate: float
    band: float
    motion: Motion
    tau: Float[Tensor, "T n"]
    own_velocity: bool

    @property
    def samples(self) -> int:
        """T."""
        return self.tau.shape[0]

    @property
    def start(self) -> float:
        """Its first time [s]; time runs on from one passage to the next."""
        return float(self.motion.require("t", "a passage")[0])

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.tau.shape[1]


class Rows:
    """Signals of passages, low-passed and decimated, edges left out.

    Args:
        passages: all on the same rate.
        cutoff: [Hz].
    """

    def __init__(self, passages: Sequence[Passage], cutoff: float):
        rates = {p.rate for p in passages}
        assert len(rates) == 1, "passages are resampled to one rate"
        self.rate = rates.pop()
        self.cutoff = cutoff
        self.passages = tuple(passages)
        self.step = max(1, int(self.rate / (ROWS * cutoff)))
        if self.step > 2:
            self.step -= self.step % 2
        self._filter = ZeroPhaseFilter(self.rate, cutoff) if cutoff < 0.45 * self.rate else None
        self.edge = round(EDGE * self.rate / cutoff)

    @property
    def interval(self) -> float:
        """Seconds between rows."""
        return self.step / self.rate

    @cached_property
    def bounds(self) -> tuple[slice, ...]:
        """Rows of each passage."""
        counts = [len(range(self.edge, p.samples - self.edge, self.step)) for p in self.passages]
        ends = list(itertools.accumulate(counts, initial=0))
        return tuple(slice(a, b) for a, b in itertools.pairwise(ends))

    def __len__(self) -> int:
        return self.bounds[-1].stop

    def apply(self, signals: Sequence[Float[Tensor, "..."]]) -> Float[Tensor, "..."]:
        """Rows (..., N) of signals (..., T_p), one tensor a passage."""
        return torch.cat([self._one(x) for x in signals], -1)

    def low_passed(self, x: Float[Tensor, "T n"]) -> Float[Tensor, "T n"]:
        """A signal of a passage through the rows' filter, on the passage's grid."""
        return x if self._filter is None else self._filter.apply(x.T).T.contiguous()

    def pick(self, signals: Sequence[Tensor]) -> Tensor:
        """Unfiltered values (N, ...) of signals (T_p, ...) at the rows' instants."""
        return torch.cat([x[self.edge : x.shape[0] - self.edge : self.step] for x in signals])

    def _one(self, x: Signals) -> Float[Tensor, "*batch _"]:
        last = x.shape[-1] - self.edge
        if self._filter is None:
            return x[..., self.edge : last : self.step]
        tail = self._filter.tail
        padded = extended(x, tail, tail)
        # Cut at the rows' own Nyquist frequency, the spectrum would ring along all rows, and what
        # happens at a reversal would be everywhere. At twice that there is nothing left to cut.
        half = self.step // 2 if self.step > 2 else 1
        finer = self._filter.decimated(padded, half, tail + self.edge, tail + last)
        return finer[..., :: self.step // half]


def passages_of(measured: Sequence[Measurement], band: float, clock: float = 0.0) -> list[Passage]:
    """Passages of trajectories differentiated in the wide band (see `measurements`).

    Their time runs on from one to the next where the log's does not.

    Args:
        measured: with the wide band as their cut-off.
        band: the wide band's edge [Hz].
        clock: time at which they begin [s], at the earliest.
    """
    out = []
    for k, m in enumerate(measured):
        step = max(1, int(m.rate / (GRID * band)))
        tau = m.tau
        if step > 1:
            tau = ZeroPhaseFilter(m.rate, min(1.5 * band, 0.4 * m.rate / step)).apply(tau.T).T
        t = m.t - measured[0].t[0]
        # Files whose clocks all start at zero follow one another, as far as anyone knows.
        t = t + max(0.0, clock - float(t[0]))
        clock = float(t[-1]) + 1 / m.rate
        motion = m.motion._replace(t=t)
        out.append(
            Passage(
                name=m.name,
                trajectory=k,
                rate=m.rate / step,
                band=band,
                motion=motion.every(step)._replace(sensed=tau[::step].contiguous()),
                tau=tau[::step].contiguous(),
                own_velocity=m.own_velocity,
            )
        )
    return out


def when(passages: Sequence[Passage], t: float) -> tuple[str, float]:
    """The trajectory at a time that runs on from one to the next, and its own time [s] there."""
    begins = [p.start for p in passages]
    k = max((k for k, begin in enumerate(begins) if begin <= t), default=0)
    return passages[k].name, t - begins[k]


def reach(rows: Rows, dry: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
    """How far (n,) the filter carries a reversal above the noise, in periods of the cut-off:
    `REACH` at least, further where the dry friction is many times the noise.

    Args:
        rows: whose filter it is.
        dry: (n,) dry friction relative to the noise of the rows.
    """
    period = rows.rate / rows.cutoff
    half = round(0.5 * MISTIMED * period)
    pulse = torch.zeros(2 * round(8 * period) + 1, 1, dtype=torch.float64)
    middle = len(pulse) // 2
    pulse[middle - half : middle + half + 1] = 2.0
    tail = rows.low_passed(pulse)[middle:, 0].abs()
    heard = tail.flip(0).cummax(0).values.flip(0) * dry.unsqueeze(1) > 1.0
    return (heard.sum(1) / period).clamp(min=REACH)


def row_masks(
    rows: Rows, reach: Float[Tensor, " n"] | float = REACH
) -> tuple[Bool[Tensor, "n N"], Bool[Tensor, "n N"], tuple[int, ...]]:
    """Rows whose own joint moves, rows that a reversal reaches, and the joints that never move.

    At rest static friction holds any torque. A joint that moves in less than a tenth of the rows
    keeps them all: what holds it is then most of what is known about it, unless dry friction does,
    of which reversals reach further than the least.
    """
    q = torch.cat([p.motion.q for p in rows.passages])
    moving = rows.pick([p.motion.dq for p in rows.passages]).T.abs() > MOVING
    turning = rows.pick([_turns(p, rows.cutoff, reach) for p in rows.passages]).T
    still = ((q.amax(0) - q.amin(0)) < NEVER).nonzero().flatten().tolist()
    held = ((moving & ~turning).double().mean(1) < 0.1) & _free(reach, len(moving))
    return moving | held.unsqueeze(1), turning & ~held.unsqueeze(1), tuple(still)


def _free(reach: Float[Tensor, " n"] | float, n: int) -> Bool[Tensor, " n"]:
    """Joints without dry friction that is heard beside the noise."""
    return torch.as_tensor(reach).expand(n) <= REACH


def sliding(rows: Rows, reach: Float[Tensor, " n"] | float = REACH) -> Bool[Tensor, "n N"]:
    """Rows away from rest and reversals, where what differs between two runs is what friction did,
    not noise; `reach` (n,) in periods of the cut-off."""
    moving, turning, _ = row_masks(rows, reach)
    return moving & ~turning


def moving_instants(
    p: Passage, cutoff: float, reach: Float[Tensor, " n"] | None
) -> Bool[Tensor, "T n"]:
    """Instants (T, n) at which a joint moves, without those that a reversal reaches (n,) periods of
    the cut-off away; with them if None. All of a joint's, if it hardly moves and no dry friction
    holds it."""
    moving = p.motion.dq.abs() > MOVING
    if reach is not None:
        moving = moving & ~_turns(p, cutoff, reach)
    free = _free(REACH if reach is None else reach, p.n)
    return moving | ((moving.double().mean(0) < 0.1) & free)


def _turns(
    p: Passage, cutoff: float, reach: Float[Tensor, " n"] | float = REACH
) -> Bool[Tensor, "T n"]:
    """Instants that a reversal of the joint reaches through the filter, and twice as far around a
    dwell, during which friction can be far from any law."""
    sign = torch.sign(p.motion.dq)
    turns = torch.zeros_like(sign)
    turns[1:] = (sign[1:] != sign[:-1]).to(sign)
    slow = (p.motion.dq.abs() < 0.5 * MOVING).to(sign)
    dwells = 1 - widened(1 - slow, 0.5 * STOP * p.rate)
    out = torch.zeros_like(p.motion.dq, dtype=torch.bool)
    for j, own in enumerate(torch.as_tensor(reach).expand(p.n).tolist()):
        column = slice(j, j + 1)
        near = widened(turns[:, column], own / cutoff * p.rate)
        around = widened(dwells[:, column], max(own, 2 * REACH) / cutoff * p.rate)
        out[:, column] = (near + around) > 0
    return out


def widened(mask: Float[Tensor, "T n"], samples: float) -> Float[Tensor, "T n"]:
    """1 wherever the mask is 1 within so many samples."""
    width = 2 * round(samples) + 1
    return torch.nn.functional.max_pool1d(mask.T.unsqueeze(1), width, 1, width // 2)[:, 0].T
