"""Noise of positions: what an arm does otherwise where its commands are the same again.

As of torques (`design.repeats`), but motions are alike by their commands, and what is compared is
the error of a model: other starts, and commands that are not quite the same, cancel there.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchid.design.repeats import MOVES, find_repeats
from torchid.design.segments import Segment
from torchid.effects.motion import Motion
from torchid.position.data import WINDOW_S, PositionData, rates
from torchid.position.fit import errors_of_one
from torchid.simulation.servo import Servos
from torchid.simulation.servo_loop import Windows, windows_of
from torchid.statistics.differences import noise_level
from torchid.typing import Float, Int, Tensor

FEWEST = 5.0
"""Independent differences of a joint below which they do not tell its noise [1]."""
FARTHEST_BACK = 40
"""Motions before one that it may repeat [1]: of hundreds of episodes not all are compared."""
MOST_WINDOWS = 250
"""Windows of either side that are simulated [1]."""


@dataclass(frozen=True, eq=False)
class PositionNoise:
    """RMS errors (n,) that no servo closes [rad]; NaN of joints of which no repeat tells them.

    Attributes:
        low, high: 90 % interval of those of whole motions.
        windows: upper end of that of windows of 2 s from their measured start.
    """

    low: Float[Tensor, " n"]
    high: Float[Tensor, " n"]
    windows: Float[Tensor, " n"]

    @property
    def square(self) -> Float[Tensor, " n"]:
        """Squared noise of whole motions [rad^2]; 0 where no repeat tells it."""
        return (0.5 * (self.low.square() + self.high.square())).nan_to_num(0.0)

    def at_least(self, slight: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
        """Errors in windows that are noise, no less than what calls for no cause [rad]."""
        return torch.maximum(slight, self.windows.nan_to_num(0.0))


def no_noise(joints: int) -> PositionNoise:
    """Of a log that repeats nothing."""
    none = torch.full((joints,), torch.nan, dtype=torch.float64)
    return PositionNoise(none, none, none)


def noise_of_repeats(data: PositionData, servos: Servos) -> PositionNoise:
    """How far positions part where the same is commanded again.

    Args:
        data: motions.
        servos: whose errors are compared; what they do not know is the same each time.
    """
    pairs = _same_commands(data)
    size = max(2, round(WINDOW_S / data.tracks.dt))
    parts = [
        (k, a.start + row, b.start + row)
        for k, (a, b) in enumerate(pairs)
        for row in range(0, a.stop - a.start - size + 1, size)
    ]
    if not parts:
        return no_noise(data.robot.n)
    # Joints whose command moves in a stretch as it does in others.
    spread = torch.stack([data.tracks.u[rows].var(0) for rows in data.slices]).mean(0).sqrt()
    moves = [data.tracks.u[rows].std(0) > MOVES * spread for rows, _ in pairs]
    whole = windows_of(data.tracks, None)
    error = whole.on_rows(errors_of_one(data, servos, whole), torch.zeros_like(data.q))
    low, high = _interval(data, [error[b] - error[a] for a, b in pairs], moves)
    # Windows that begin at once in both.
    parts = parts[:: math.ceil(len(parts) / MOST_WINDOWS)]
    owner, first, second = torch.tensor(parts).T.contiguous()
    apart = _errors_from(data, servos, second, size) - _errors_from(data, servos, first, size)
    _, again = _interval(data, apart.unbind(1), [moves[k] for k in owner.tolist()])
    return PositionNoise(low, high, again)


def _same_commands(data: PositionData) -> list[tuple[slice, slice]]:
    """Pairs of stretches, as rows of all motions one after the other."""
    tracks = data.tracks
    rate = rates(tracks.u, tracks, torch.zeros(len(tracks.first), dtype=torch.bool))
    segments, whole = [], data.slices
    for name, rows in zip(data.log.names, whole, strict=True):
        u, du, q = (x[rows] for x in (tracks.u, rate, data.q))
        motion = Motion(u, du, torch.zeros_like(u))
        segments.append(Segment(name, 1 / tracks.dt, 0.5 / tracks.dt, motion, q, False))

    def of_all(motion: int, rows: slice) -> slice:
        return slice(whole[motion].start + rows.start, whole[motion].start + rows.stop)

    pairs = find_repeats(segments, FARTHEST_BACK).pairs
    return [(of_all(p.a, p.rows_a), of_all(p.b, p.rows_b)) for p in pairs]


def _errors_from(
    data: PositionData, servos: Servos, start: Int[Tensor, " W"], size: int
) -> Float[Tensor, "size W n"]:
    """Errors in windows that begin at some rows."""
    motion = torch.searchsorted(data.tracks.first, start, right=True) - 1
    one = torch.ones(len(start), dtype=torch.float64)
    return errors_of_one(data, servos, Windows(start, torch.full_like(start, size), motion, one))


def _interval(
    data: PositionData, differences: Sequence[Tensor], moves: Sequence[Tensor]
) -> tuple[Tensor, Tensor]:
    """90 % interval of the noise (n,) in either of two errors, from their differences (T, n) in the
    stretches that move a joint."""
    ends = torch.full((2, data.robot.n), torch.nan, dtype=torch.float64)
    length = max(4, round(WINDOW_S / data.tracks.dt))
    for j in range(data.robot.n):
        moving = [d[:, j] for d, on in zip(differences, moves, strict=True) if bool(on[j])]
        if not moving:
            continue
        stops = torch.tensor([len(d) for d in moving]).cumsum(0).tolist()
        bounds = [slice(stop - len(d), stop) for d, stop in zip(moving, stops, strict=True)]
        x = torch.cat(moving)[None] / math.sqrt(2)
        noise = noise_level(x, torch.ones_like(x, dtype=torch.bool), bounds, length)
        if float(noise.freedom) >= FEWEST:
            ends[:, j] = torch.cat([noise.low, noise.high])
    return ends[0], ends[1]
