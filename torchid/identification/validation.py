"""How well a model predicts measured torque: per joint, filtered and raw, all rows and moving."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add

import torch

from torchid.design.motion import Measurement
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Effect, JointEffect, Motion
from torchid.effects.registry import in_rounds
from torchid.identification.base_parameters import BaseParameters
from torchid.identification.record import Errors
from torchid.log.filtering import ZeroPhaseFilter
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.typing import Bool, Float, Samples, Tensor


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
        t: (T,) [s].
        measured, predicted: (T, n) filtered torque [N m; N].
        moving: (T, n) whether each joint moves.
        sums: of squares, for the errors.
    """

    name: str
    t: Float[Tensor, " T"]
    measured: Samples
    predicted: Samples
    moving: Bool[Tensor, "T n"]
    sums: Sums


def model_torque(
    robot: Robot,
    base: BaseParameters,
    effects: Sequence[Effect],
    values: Float[Tensor, " B"],
    motion: Motion,
    *,
    load_only: bool = False,
) -> Float[Tensor, "*batch n"]:
    """Torque (..., n) of base parameters and effects.

    Args:
        robot, base, effects, values: the model; the values (B,) are those of `base`.
        motion: states (..., n).
        load_only: whether to leave out effects of the torque. The rest is the load that they see.
    """
    # The independent parameters carry the base values and the dependent ones are zero, which is one
    # of the full sets with these.
    full = values.new_zeros(len(base.parameter_names))
    full[list(base.independent)] = values
    rigid, rest = full.tensor_split([base.n_rigid_parameters])
    parts = rest.split([len(e.coefficients) for e in effects])
    valued = [(e, x.tolist()) for e, x in zip(effects, parts, strict=True)]
    first, later = in_rounds(valued)
    tau = inverse_dynamics(robot, *motion.state, InertialParameters.from_paper_order(rigid))
    for effect, own in first:
        if isinstance(effect, JointEffect):
            tau[..., effect.joint] += effect.torque(motion, own)
        else:
            tau = tau + effect.all_torques(motion, own, robot)
    if load_only or not later:
        return tau
    loaded = motion._replace(torque=tau)
    return tau + sum(effect.all_torques(loaded, own, robot) for effect, own in later)


def predict(
    measurement: Measurement,
    robot: Robot,
    base: BaseParameters,
    effects: Sequence[Effect],
    values: Float[Tensor, " B"],
) -> Prediction:
    """Measured and predicted torque, both through the measurement's filter."""
    m = measurement
    middle = slice(m.edge, m.samples - m.edge)
    raw = model_torque(robot, base, effects, values.to(m.tau), m.motion)
    measured, predicted = m.tau, raw
    if m.cutoff is not None:
        low_pass = ZeroPhaseFilter(m.rate, m.cutoff)
        # Joint by joint: the spectra of a long log need not all be in memory at once.
        measured, predicted = (
            torch.stack([low_pass.apply(x) for x in signal.unbind(-1)], -1)
            for signal in (m.tau, raw)
        )
    measured, predicted, moving = (x[middle].cpu() for x in (measured, predicted, m.moving))
    raw_error = (m.tau - raw)[middle].cpu()
    del raw
    error = measured - predicted
    sums = Sums(
        torch.full((robot.n,), float(len(error)), dtype=torch.float64),
        _squares(error),
        _squares(measured),
        _squares(error * moving),
        _squares(measured * moving),
        _squares(raw_error),
        _squares(m.tau[middle].cpu()),
        moving.double().sum(0),
    )
    return Prediction(m.name, m.t[middle].cpu(), measured, predicted, moving, sums)


def errors(predictions: Sequence[Prediction]) -> Errors:
    """Errors over whole trajectories together."""
    total = reduce(add, (p.sums for p in predictions))
    standing_error = total.error - total.moving_error
    return Errors(
        tuple(p.name for p in predictions),
        (total.error / total.instants).sqrt(),
        100 * (total.error / total.torque).sqrt(),
        100 * (total.moving_error / total.moving_torque).sqrt(),
        100 * (total.raw_error / total.raw_torque).sqrt(),
        1 - total.moving / total.instants,
        standing_error / total.error.clamp(min=1e-300),
    )


def _squares(x: Samples) -> Float[Tensor, " n"]:
    return x.square().sum(0)
