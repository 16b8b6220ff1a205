"""What is chosen from the training data alone, by cross-validation: cut-off and reversal speed.

A candidate filters the training data, fits on all but one of five contiguous stretches of every
trajectory, and predicts the torque of the one left out. Candidates are judged on the same torque,
but for the edges their filters lose: cut-offs on unfiltered torque, reversal speeds on torque
filtered at the cut-off. Rows at standstill are not judged: their torque is set by where friction
happens to hold the joint.

A low cut-off loses motion that carries torque, a high one feeds noise into the regressor, which
biases it. A low reversal speed takes velocity noise for motion; a high one delays the friction.
"""

import itertools
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import torch

from torchid.design.motion import Measurement, fast_speed, measurements, moves
from torchid.effects.base import Effect
from torchid.errors import LogError
from torchid.identification.base_parameters import base_parameters
from torchid.identification.least_squares import Fit, factor, fit, solve, stacked_factor
from torchid.identification.model import model_torque
from torchid.identification.record import CutoffRecord
from torchid.identification.rows import Layout, RowBlock, RowSource, layout
from torchid.identification.settings import Settings
from torchid.log.model import Log
from torchid.robot.model import Robot
from torchid.typing import Bool, Float, Tensor

CUTOFFS = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0, 96.0)
REVERSALS = (0.0, 0.0025, 0.005, 0.01, 0.02, 0.04)
"""Reversal speeds, as fractions of each joint's 99 % speed."""


FOLDS = 5

LONGEST = 40_000
"""Samples of the training data that take part in a choice, of robots of up to `MANY` joints."""

MANY = 10
"""Joints from which on fewer samples take part: the work for one grows with the rows and with their
columns, about as the square of the joints."""

Report = Callable[[int, int], None] | None


class CutoffChoice(CutoffRecord, frozen=True, kw_only=True):
    """What was tried, and what won: `cutoff` [Hz], or None for no filter."""

    cutoff: float | None


@dataclass(frozen=True)
class Training:
    """The training data and how they are fitted.

    Attributes:
        log: on a uniform grid.
        layout: the columns.
        settings: of the fit.
    """

    log: Log
    layout: Layout
    settings: Settings

    @classmethod
    def of(
        cls, robot: Robot, log: Log, effects: Sequence[Effect], settings: Settings
    ) -> "Training":
        """With the columns of base parameters and effects."""
        base = base_parameters(robot, effects, basis=settings.basis)
        return cls(log, layout(robot, base, effects), settings)

    @property
    def non_negative(self) -> Bool[Tensor, " B"]:
        """(B,) coefficients bounded at zero."""
        return self.layout.non_negative & (self.settings.signs == "bounded")

    def source(self, measured: Sequence[Measurement], report: Report = None) -> RowSource:
        """The rows of filtered trajectories."""
        moving = self.settings.rows == "moving"
        return RowSource(measured, self.layout, moving_only=moving, progress=report)

    def fit(self, source: RowSource, left_out: Bool[Tensor, " B"] | None = None) -> Fit:
        """As the settings say, without some coefficients."""
        return fit(
            source,
            method=self.settings.method,
            covariance=self.settings.covariance,
            non_negative=self.non_negative,
            left_out=left_out,
        )


def choose_cutoff(training: Training, report: Report = None) -> CutoffChoice:
    """The cut-off with the lowest mean error over joints.

    Candidates lie between 20 over the longest trajectory's length and a fifth of the sampling
    rate; no filter is one of them where the log has accelerations.
    """
    log = shortened(training.log)
    rate, seconds = min(log.rates), max(log.duration)
    tried: list[float | None] = [f for f in CUTOFFS if 20 / seconds <= f <= rate / 5]
    if log.ddq is not None:
        tried.append(None)
    if not tried:
        tried = [rate / 5]
    speed = fast_speed(measurements(log, tried[len(tried) // 2]))
    scores: list[float] = []
    for k, cutoff in enumerate(tried):
        # Twice in a row a tenth worse than the best: noise has taken over, higher is worse still.
        hopeless = len(scores) > 2 and min(scores[-2:]) > 1.1 * min(scores)
        score = float("inf")
        if cutoff is None or not hopeless:
            # A log may be too short for it.
            with suppress(LogError):
                measured = measurements(log, cutoff, REVERSALS[2] * speed)
                score = float(_unfiltered_errors(training, measured).nanmean())
        scores.append(score)
        if report is not None:
            report(k + 1, len(tried))
    best = min(range(len(tried)), key=scores.__getitem__)
    return CutoffChoice(tuple(tried), tuple(scores), cutoff=tried[best])


def choose_reversal(
    training: Training, cutoff: float | None, report: Report = None
) -> Float[Tensor, " n"]:
    """Each joint's reversal speed (n,) [rad/s or m/s]: the lowest whose error of the joint's own
    torque is within 1 % of the best. Zero where no effect jumps."""
    if not any(effect.jumps for effect in training.layout.effects):
        return torch.zeros(training.log.n, dtype=torch.float64)
    log = shortened(training.log)
    measured = measurements(log, cutoff)
    speed, errors = fast_speed(measured), []
    # Rows differ by the direction alone: one fit weighs them for all candidates.
    weights = fit(training.source(measured), non_negative=training.non_negative)
    for k, fraction in enumerate(REVERSALS):
        source = training.source(measurements(log, cutoff, fraction * speed))
        errors.append(_filtered_errors(training, source, weights))
        if report is not None:
            report(k + 1, len(REVERSALS))
    table = torch.stack(errors)
    # 1.01: a higher reversal speed must lower the error by more than 1 % to be preferred
    # 1e-6: errors closer than this are rounding [%]
    best = (table <= 1.01 * table.min(0).values + 1e-6).to(torch.uint8).argmax(0)
    return torch.tensor(REVERSALS, dtype=speed.dtype)[best] * speed.cpu()


def shortened(log: Log) -> Log:
    """Whole trajectories, evenly spread, `LONGEST` samples in all, or less of many joints; of a
    single one that is longer the first part."""
    longest = round(LONGEST * min(1.0, MANY / log.n) ** 2)
    if log.samples <= longest:
        return log
    rows = log.slices()
    keep = torch.zeros(log.samples, dtype=torch.bool)
    step = max(1, round(log.samples / longest))
    budget = longest
    for part in (part for first in range(step) for part in rows[first::step]):
        size = part.stop - part.start
        length = min(size, budget)
        if length < size and budget < longest // 2:
            break
        keep[part.start : part.start + length] = True
        budget -= length
    return log.select(keep)


def _unfiltered_errors(training: Training, measured: list[Measurement]) -> Float[Tensor, " n"]:
    """Relative error of the unfiltered torque of the stretches left out, per joint [%]."""
    source = training.source(measured)
    left_out = _left_out(training, source, fit(source, non_negative=training.non_negative))
    pairs = ((k, x, m) for k, (_, x) in enumerate(left_out) for m in measured)
    return _relative(training, (_stretch(m, training.layout, x, k) for k, x, m in pairs))


def _filtered_errors(training: Training, source: RowSource, weights: Fit) -> Float[Tensor, " n"]:
    """Relative error of the rows' torque of the stretches left out, per joint [%]."""
    left_out = _left_out(training, source, weights)

    def judged(block: RowBlock) -> tuple[Tensor, Tensor]:
        parts = [own[block.instant] * block.residual(training.layout, x) for own, x in left_out]
        return sum(parts) * block.moving, block.tau * block.moving

    return _relative(training, map(judged, source))


def _relative(training: Training, judged: Iterable[tuple[Tensor, Tensor]]) -> Float[Tensor, " n"]:
    """Relative error (n,) of errors and torques (_, n), piece by piece [%]."""
    squares = [torch.stack([x.square().sum(0).cpu() for x in pair]) for pair in judged]
    error, energy = torch.stack(squares).sum(0)
    relative = 100 * (error / energy).sqrt()
    # Of coordinates that no motor drives an error is relative to nothing.
    relative[list(training.layout.robot.free)] = torch.nan
    return relative


def _left_out(training: Training, source: RowSource, weights: Fit) -> list[tuple[Tensor, Tensor]]:
    """Instants (I, 1) of each stretch, and coefficients (B,) of the fit without it, with the
    weights of a fit of all rows."""
    lengths = [b - a for a, b in itertools.pairwise(source.boundaries)]
    fold = torch.cat([torch.arange(length) * FOLDS // max(1, length) for length in lengths])
    stretches = [(fold == k).unsqueeze(-1) for k in range(FOLDS)]
    factors = [factor(source, weights.robust * own, weights.whitening) for own in stretches]
    out = []
    for k, own in enumerate(stretches):
        # 0.1: factor on the rows of the stretch left out: with 1 % of their weight they determine
        # what no other stretch excites (a joint that moves once), instead of rounding
        others = stacked_factor([f * 0.1 if j == k else f for j, f in enumerate(factors)])
        out.append((own, solve(others, training.non_negative, weights.undetermined)[0]))
    return out


def _stretch(m: Measurement, layout: Layout, x: Tensor, k: int) -> tuple[Tensor, Tensor]:
    """Error and unfiltered torque (_, n) of stretch k of a trajectory, 0 of joints at rest."""
    inside = m.samples - 2 * m.edge
    part = slice(m.edge + inside * k // FOLDS, m.edge + inside * (k + 1) // FOLDS)
    motion, tau = m.motion.part(part), m.tau[part]
    values = x[layout.back].to(tau)
    error = tau - model_torque(layout.robot, layout.base, layout.effects, values, motion)
    moving = moves(motion, m.moving)
    return error * moving, tau * moving
