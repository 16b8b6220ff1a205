"""How well a model predicts measured torque: per joint, filtered and raw, all rows and moving."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add

import torch

from torchid.design.motion import Measurement, moves
from torchid.effects.base import Effect, Motion
from torchid.identification.base_parameters import BaseParameters
from torchid.identification.model import model_torque
from torchid.identification.record import Errors
from torchid.identification.rows import at_ease
from torchid.log.filtering import ZeroPhaseFilter, extended
from torchid.robot.model import Robot
from torchid.typing import Bool, Float, Samples, Tensor

PIECE = 131_072
"""Samples of a long trajectory whose torque is predicted at a time."""

MOST_SHOWN = 7_000_000
"""Values of a signal, samples times joints, that are kept of a long trajectory, to be looked at."""


@dataclass(frozen=True)
class Sums:
    """Sums of squares over the instants of a trajectory, (n,) each.

    Attributes:
        instants: how many, the same for all joints.
        error, torque: filtered; `moving_...` over rows whose own joint moves; `raw_...` unfiltered.
        moving: number of moving rows.
    """

    instants: Tensor
    error: Tensor
    torque: Tensor
    moving_error: Tensor
    moving_torque: Tensor
    raw_error: Tensor
    raw_torque: Tensor
    moving: Tensor

    def __add__(self, other: "Sums") -> "Sums":
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return Sums(*(a + b for a, b in pairs))


@dataclass(frozen=True)
class Prediction:
    """Measured and predicted torque of one trajectory, edges left out.

    Attributes:
        name: of the trajectory.
        t: (T,) [s]; of a long log every so many samples.
        measured, predicted: (T, n) filtered torque [N m; N].
        moving: (T, n) whether each joint moves.
        sums: of squares over all samples, for the errors.
    """

    name: str
    t: Float[Tensor, " T"]
    measured: Samples
    predicted: Samples
    moving: Bool[Tensor, "T n"]
    sums: Sums


def pieces(m: Measurement, start: int, stop: int, effects: Sequence[Effect]) -> list[slice]:
    """Samples from one to another as many at a time as a model's torque is computed of: all, but
    of a motion that is made in parts; and all where an effect remembers what was before."""
    remembers = any(e.memory for e in effects)
    if isinstance(m.motion, Motion) or remembers:
        return [slice(start, stop)]
    return [slice(a, min(a + PIECE, stop)) for a in range(start, stop, PIECE)]


def predict(
    measurement: Measurement,
    robot: Robot,
    base: BaseParameters,
    effects: Sequence[Effect],
    values: Float[Tensor, " B"],
    progress: Callable[[int, int], None] | None = None,
) -> Prediction:
    """Measured and predicted torque, both through the measurement's filter.

    Args:
        measurement: the trajectory.
        robot, base, effects, values: as in `model_torque`.
        progress: called with (samples done, samples in all).
    """
    m = at_ease(measurement)
    low_pass = None if m.cutoff is None else ZeroPhaseFilter(m.rate, m.cutoff)
    tail = 0 if low_pass is None else low_pass.tail
    step = 1 if isinstance(m.motion, Motion) else -(-m.samples * robot.n // MOST_SHOWN)
    first = m.edge
    shown: list[tuple[Tensor, ...]] = []
    sums: list[Sums] = []
    if progress is not None:
        progress(0, m.samples - 2 * m.edge)
    for rows in pieces(m, m.edge, m.samples - m.edge, effects):
        lo, hi = max(0, rows.start - tail), min(m.samples, rows.stop + tail)
        motion, tau = m.motion.part(slice(lo, hi)), m.tau[lo:hi]
        raw = model_torque(robot, base, effects, values.to(tau), motion)
        inside = slice(rows.start - lo, rows.stop - lo)
        measured, predicted = tau[inside], raw[inside]
        if low_pass is not None:
            # At the trajectory's ends as the whole of it is extended.
            before, after = tail if lo == 0 else 0, tail if hi == m.samples else 0
            begin, end = before + inside.start, before + inside.stop
            # Joint by joint: the spectra of a long log need not all be in memory at once.
            measured, predicted = (
                torch.stack(
                    [
                        low_pass.decimated(extended(x, before, after), 1, begin, end)
                        for x in signal.unbind(-1)
                    ],
                    -1,
                )
                for signal in (tau, raw)
            )
        moving = moves(motion.part(inside), m.moving)
        measured, predicted, moving = (x.cpu() for x in (measured, predicted, moving))
        raw_error = (tau - raw)[inside].cpu()
        error = measured - predicted
        sums.append(
            Sums(
                torch.full((robot.n,), float(len(error)), dtype=torch.float64),
                _squares(error),
                _squares(measured),
                _squares(error * moving),
                _squares(measured * moving),
                _squares(raw_error),
                _squares(tau[inside].cpu()),
                moving.double().sum(0),
            )
        )
        some = slice((first - rows.start) % step, None, step)
        kept = (m.t[rows].cpu(), measured, predicted, moving)
        # Copies: a view would keep all that is left out.
        shown.append(tuple(x if step == 1 else x[some].clone() for x in kept))
        if progress is not None:
            progress(rows.stop - m.edge, m.samples - 2 * m.edge)
    t, measured, predicted, moving = (
        x[0] if len(x) == 1 else torch.cat(x) for x in zip(*shown, strict=True)
    )
    return Prediction(m.name, t, measured, predicted, moving, reduce(add, sums))


def errors(predictions: Sequence[Prediction], free: Sequence[int] = ()) -> Errors:
    """Errors over whole trajectories together.

    Args:
        predictions: of the trajectories.
        free: coordinates (from 0) that no motor drives: an error relative to no torque is nan.
    """
    total = reduce(add, (p.sums for p in predictions))
    standing_error = total.error - total.moving_error

    def percent(error: Tensor, torque: Tensor) -> Tensor:
        relative = 100 * (error / torque).sqrt()
        relative[list(free)] = torch.nan
        return relative

    return Errors(
        tuple(p.name for p in predictions),
        (total.error / total.instants).sqrt(),
        percent(total.error, total.torque),
        percent(total.moving_error, total.moving_torque),
        percent(total.raw_error, total.raw_torque),
        1 - total.moving / total.instants,
        standing_error / total.error.clamp(min=1e-300),
    )


def moving_rms(predictions: Sequence[Prediction]) -> Float[Tensor, " n"]:
    """RMS error (n,) over the rows in which the joints move, of whole trajectories together
    [N m; N]."""
    total = reduce(add, (p.sums for p in predictions))
    return (total.moving_error / total.moving.clamp(min=1)).sqrt()


def _squares(x: Samples) -> Float[Tensor, " n"]:
    return x.square().sum(0)
