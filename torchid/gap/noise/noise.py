"""The noise of a log, as the diagnosis uses it: a whitener, a floor, and which motions repeat."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.registry import Valued, effect_torque, in_rounds, model_torque
from torchid.gap.candidates import Whiten
from torchid.gap.diagnosis import NoiseFloor
from torchid.gap.flexible import OutOfFold, predict_out_of_fold
from torchid.gap.floor import Floor, NoFloorError, noise_floor
from torchid.gap.missing import WhiteRows
from torchid.gap.passages import Passage, Rows, sliding
from torchid.gap.repeats import Repeats, find_repeats
from torchid.gap.spectrum import white_level
from torchid.robot.model import Robot
from torchid.typing import Bool, Float, Tensor

STRUCTURE = 0.25
"""Predictable share of a joint's noise variance from which structure is worth saying."""


@dataclass(frozen=True)
class Noise:
    """Noise of the rows.

    Attributes:
        floor: in the fit's rows and in the report's band, with the whitener.
        groups: per passage the motion it belongs to; repeats share one.
        structure: (n,) share of the noise's variance by which a flexible predictor lowers the
            residual, where that is significant; else 0. Zero where none was asked.
        level: (n,) noise density of the measured torque, above the rows' cut-off, where the floor
            was measured; trajectories with more of it have that much larger noise.
        unpredicted: (n,) RMS of what a flexible predictor leaves of the residual in the band of the
            report, where one was asked; else the floor's upper end [N m; N].
    """

    floor: Floor
    groups: tuple[int, ...]
    structure: Float[Tensor, " n"]
    level: Float[Tensor, " n"]
    unpredicted: Float[Tensor, " n"]

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences for the user."""
        return self.floor.report.notes

    @property
    def report(self) -> NoiseFloor:
        """Floor in the band of the report."""
        return self.floor.report

    @property
    def repeated(self) -> bool:
        """Whether it comes from repeats."""
        return self.report.source == "repeats"

    def whitening(self, rows: Rows, keep: Bool[Tensor, "n N"]) -> Whiten:
        """How rows are whitened, those that do not count left out. Without repeats nobody knows
        which part of the spectrum is noise, and rows are only scaled."""
        if self.repeated:
            level = white_levels(rows) / self.level.unsqueeze(1)
            counts = torch.tensor([own.stop - own.start for own in rows.bounds])
            size = level.clamp(min=1.0).sqrt().repeat_interleave(counts, 1)
            return WhiteRows(self.floor.whitener.on(rows.bounds), keep, size)
        return self.scaling(keep)

    def scaling(self, keep: Bool[Tensor, "n N"]) -> Whiten:
        """Rows in units of the noise, their spectrum as it is; those that do not count are zero."""
        return lambda x, joint: x * (keep[joint] / self.size[joint])

    @property
    def size(self) -> Float[Tensor, " n"]:
        """RMS (n,) of the noise in the fit's rows [N m; N]; without repeats its upper bound."""
        rms = self.floor.rms if self.repeated else self.floor.high
        return rms.clamp(min=1e-12)


def noise_of(
    robot: Robot,
    effects: Sequence[Valued],
    rows: Rows,
    report: Rows,
    *,
    keep: Bool[Tensor, "n N"] | None = None,
    seed: int,
) -> Noise:
    """Noise that a model's residual holds.

    Args:
        robot, effects: the model.
        rows, report: of the fit, and of the report's band.
        keep: (n, N) rows at which a flexible predictor looks for structure although the log has
            repeats; None for no such look.
        seed: of the flexible predictor.
    """
    passages = rows.passages
    residual, loaded = _residuals(robot, effects, passages)
    repeats = find_repeats(passages)
    flexible = None
    rows_of_residual = rows.apply([r.T for r in residual])
    if not repeats:
        flexible = predict_out_of_fold(loaded, rows, rows_of_residual, seed)
    try:
        floor = noise_floor(loaded, residual, rows, report, flexible, repeats or None)
    except NoFloorError:  # repeats too short for the filter are as good as none
        flexible = predict_out_of_fold(loaded, rows, rows_of_residual, seed)
        floor = noise_floor(loaded, residual, rows, report, flexible, None)
    structure, unpredicted = torch.zeros(robot.n, dtype=torch.float64), floor.report.high
    if keep is not None:
        looked = rows_of_residual * keep
        found = predict_out_of_fold(loaded, rows, looked, seed)
        share = keep.double().mean(1).clamp(min=0.05)
        structure = _structure(found, looked, floor) / share
        # Between the fit's cut-off and the report's nothing was predicted.
        beyond = _variance(report, residual) - _variance(rows, residual)
        unpredicted = (found.left(looked).square().mean(1) / share + beyond.clamp(min=0)).sqrt()
    groups = _groups(len(passages), repeats)
    again = [k for k, g in enumerate(groups) if groups.count(g) > 1] or list(range(len(groups)))
    level = white_levels(rows)[:, again].mean(1).clamp(min=1e-300)
    return Noise(floor, groups, structure, level, unpredicted)


def _variance(rows: Rows, residual: Sequence[Tensor]) -> Float[Tensor, " n"]:
    """Mean square of a residual in some rows, those that count with repeats."""
    counting = sliding(rows)
    squares = rows.apply([r.T for r in residual]).square() * counting
    return squares.sum(1) / counting.sum(1).clamp(min=1)


def dry_friction(robot: Robot, effects: Sequence[Valued], rows: Rows) -> Float[Tensor, " n"]:
    """RMS (n,) of what effects that jump at a reversal add to the torque [N m; N]."""
    jumping = [pair for pair in effects if pair[0].jumps]
    if not jumping:
        return torch.zeros(robot.n, dtype=torch.float64)
    torques = [
        effect_torque(robot, jumping, p.motion, inverse_dynamics(robot, *p.motion.state))
        for p in rows.passages
    ]
    return torch.cat(torques).square().mean(0).sqrt()


def white_levels(rows: Rows) -> Float[Tensor, "n K"]:
    """Density (n, K) of the measured torque of each passage above the rows' cut-off."""
    levels = [white_level([p], [p.tau], rows.cutoff) for p in rows.passages]
    return torch.stack(levels, 1)


def _residuals(
    robot: Robot, effects: Sequence[Valued], passages: Sequence[Passage]
) -> tuple[list[Tensor], list[Passage]]:
    """Measured less model torque (T, n) a passage, and passages that know the model's torque."""
    first, _ = in_rounds(effects)
    residual, loaded = [], []
    for p in passages:
        residual.append(p.tau - model_torque(robot, effects, p.motion))
        load = model_torque(robot, first, p.motion)
        loaded.append(replace(p, motion=p.motion._replace(torque=load)))
    return residual, loaded


def _groups(count: int, repeats: Repeats) -> tuple[int, ...]:
    """Number of each passage's motion: the first passage that it repeats."""
    group = list(range(count))
    for pair in repeats.pairs:
        group[pair.b] = group[pair.a]
    return tuple(group)


def _structure(
    flexible: OutOfFold, residual: Float[Tensor, "n N"], floor: Floor
) -> Float[Tensor, " n"]:
    variance = residual.square().mean(1)
    share = flexible.r2 * variance / floor.rms.square().clamp(min=1e-300)
    return torch.where(flexible.interval[:, 0] > 0, share, torch.zeros_like(share))
