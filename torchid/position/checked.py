"""How far: what servos do on motions that they were not fitted on, whole motions from their
measured start and windows of 2 s."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from torchid.position.answered import Answered
from torchid.position.data import WINDOW_S, PositionData
from torchid.position.fit import VALLEYS, errors
from torchid.position.judge import Equations, closed_share
from torchid.position.problem import Problem
from torchid.position.record import Accuracy
from torchid.position.servo_model import Motions, ServoModel
from torchid.simulation.servo import Servos
from torchid.simulation.servo_loop import windows_of
from torchid.statistics.blocks import block_numbers, block_sums
from torchid.statistics.resampling import (
    DRAWS,
    nested_weights,
    percentile_interval,
)
from torchid.typing import Bool, Float, Int

FOLDS = 5
Regimes = dict[str, tuple[Float[Tensor, " n"], Float[Tensor, " n"]]]
"""By regime: RMS errors before and after [mrad of the log's unit]."""


@dataclass(frozen=True, eq=False)
class Checked:
    """Errors of motions that were left out.

    Attributes:
        commanded, simple, answered, file: how near the command itself, plain servos, the answered
            model and the servos of the robot's file come; the last None where it has none.
        errors: (T, n) whole motions' of the file's servos, or plain ones, and of the answered
            model, row by row [log's unit].
        closed_ci95: of the share of the errors that is closed; nan where too little is defined.
    """

    commanded: Accuracy
    simple: Accuracy
    answered: Accuracy
    file: Accuracy | None
    errors: tuple[Float[Tensor, "T n"], Float[Tensor, "T n"]]
    closed_ci95: tuple[float, float]

    def left(self, unseen: Float[Tensor, " n"]) -> tuple[Float[Tensor, " n"], float]:
        """Mean squared errors (n,) in windows that the answered model leaves [log's unit squared],
        and their share of the arm's before; nothing of joints that never move.

        Args:
            unseen: RMS errors that call for no cause [log's unit].
        """
        before, after = (
            1e-6 * way.windows.square() for way in (self.file or self.simple, self.answered)
        )
        rest = (after - unseen.square()).clamp(min=0).nan_to_num(0.0)
        return rest, min(1.0, float(rest.sum() / before.nansum().clamp(min=1e-300)))


def check(answered: Answered, problem: Problem, known: Equations) -> Checked:
    """What is free of plain servos and of the answered model is told without the fold of motions
    that it is judged on; servos of a file are as they are.

    Args:
        answered: the model.
        problem: the question.
        known: the answered model's equations.
    """
    data, own = problem.data, answered.motions.data
    by_log = problem.file is None or answered.by_file is not None
    models = [
        (data, _without_folds(data, problem.plain, None, problem)),
        (own, _without_folds(own, answered.model, known, problem) if by_log else known.servos),
    ]
    if problem.given is not None:
        models.append((data, problem.given))
    held_out = [_errors(*each) for each in models]
    commanded = (data.tracks.u - data.q) / data.scale
    ways = [
        Accuracy.of_joints(*(_rms(x).masked_fill(data.still, torch.nan) for x in pair))
        for pair in ((commanded, commanded), *held_out)
    ]
    before, after = held_out[-1 if len(held_out) > 2 else 0][0], held_out[1][0]
    noise = problem.noise.square / data.scale.square()
    return Checked(
        commanded=ways[0],
        simple=ways[1],
        answered=ways[2],
        file=ways[3] if problem.file is not None else None,
        errors=(before, after),
        closed_ci95=closed_interval(data, before, after, ~data.still, noise),
    )


def _without_folds(
    data: PositionData, model: ServoModel, known: Equations | None, problem: Problem
) -> Servos:
    """Servos for each motion, told by those that are not of its fold: by their normal equations; or
    fitted to them, where these are not known, or have nothing of a plane.

    Args:
        data: the motions.
        model: fitted to all of them.
        known: its equations.
        problem: the question.
    """
    few, folds = problem.few.windows, folds_of(len(data.tracks.first))
    # Limits of set-points, over which no slope leads, stay.
    free = {name: joints for name, joints in model.free.items() if name not in VALLEYS}
    model, each = replace(model, free=free), []
    for fold in folds.unique().tolist():
        if known is None or model.plane:
            others = few.some(torch.nonzero(folds[few.motion] != fold).flatten())
            each.append(model.fitted(Motions(data, others), 2, plane=True).servos)
        else:
            each.append(known.without(folds[: len(known.gram)] == fold))
    joint, plane = (torch.stack([getattr(s, x) for s in each])[folds] for x in ("joint", "plane"))
    return replace(model.servos, joint=joint, plane=plane)


def _errors(data: PositionData, servos: Servos) -> tuple[Tensor, Tensor]:
    """Errors (T, n) of rows in whole motions and in windows [log's unit], of servos of every motion
    or of one set."""
    out = []
    for some in (windows_of(data.tracks, None), windows_of(data.tracks, WINDOW_S)):
        motion = some.motion if servos.joint.ndim == 3 else torch.zeros_like(some.motion)
        joint, plane = (
            servos.joint.reshape(-1, *servos.joint.shape[-2:]),
            servos.plane.reshape(-1, 5),
        )
        apart = replace(servos, joint=joint[motion][:, None], plane=plane[motion][:, None])
        error = errors(data, apart, some)[..., 0]
        out.append(some.on_rows(error, torch.zeros_like(data.q)) / data.scale)
    return out[0], out[1]


def folds_of(motions: int, count: int = FOLDS) -> Int[Tensor, " m"]:
    """Which fold each motion is in: every fifth, so that like ones that were driven one after the
    other are apart."""
    return torch.arange(motions) % min(count, motions)


def closed_interval(
    data: PositionData,
    before: Float[Tensor, "T n"],
    after: Float[Tensor, "T n"],
    moves: Bool[Tensor, " n"],
    noise: Float[Tensor, " n"],
) -> tuple[float, float]:
    """95 % interval of the share of whole motions' errors that is closed, on other motions: motions
    are drawn again, and blocks of each.

    Args:
        data: motions.
        before, after: errors of their rows.
        moves: joints that count.
        noise: mean squares that no model closes.
    """
    block = block_numbers(data.slices, max(1, round(WINDOW_S / data.tracks.dt)))
    # Of which motion each block is.
    owner = torch.searchsorted(block[data.tracks.last], torch.arange(int(block[-1]) + 1)).numpy()
    weights = torch.from_numpy(nested_weights(owner, DRAWS, np.random.default_rng(0)))
    *squares, rows = (
        weights @ block_sums(x.T[moves], block).T
        for x in (before.square(), after.square(), torch.ones_like(before))
    )
    first, last = (x / rows.clamp(min=1) for x in squares)
    return percentile_interval(closed_share(first, last, noise[moves]).numpy())


def _rms(error: Float[Tensor, "T n"]) -> Float[Tensor, " n"]:
    return 1e3 * error.square().mean(0).sqrt()


def errors_of_motions(data: PositionData, error: Float[Tensor, "T n"]) -> Float[Tensor, "m n"]:
    """RMS errors of motions [mrad]."""
    return torch.stack([_rms(error[rows]) for rows in data.slices])


def errors_of_regimes(
    data: PositionData, before: Float[Tensor, "T n"], after: Float[Tensor, "T n"]
) -> Regimes:
    """RMS errors by what the command does: stands, creeps, turns, moves, jumps; NaN where it never
    does."""
    rate = torch.zeros_like(data.q)
    rate[1:] = data.tracks.u.diff(dim=0) / data.tracks.dt
    rate[data.tracks.first] = 0.0
    top = rate.abs().quantile(0.99, 0).clamp(min=1e-9)
    stands = rate.abs() < 1e-9
    # The command turns within a quarter of a second.
    reach = max(1, round(0.25 / data.tracks.dt))
    highest, lowest = (
        sign * torch.nn.functional.max_pool1d(sign * rate.T, 2 * reach + 1, 1, reach).T
        for sign in (1, -1)
    )
    turns = (highest > 0.02 * top) & (lowest < -0.02 * top) & ~stands
    fast = (rate.abs() > 0.5 * top) & ~turns
    masks = {
        "holding": stands,
        "reversal": turns,
        "high_speed": fast,
        "low_speed": ~stands & ~turns & ~fast,
    }
    out: Regimes = {}
    for name, mask in masks.items():
        rms = (1e3 * ((e * mask).square().sum(0) / mask.sum(0)).sqrt() for e in (before, after))
        out[name] = next(rms), next(rms)  # 0 of 0 is NaN
    return out
