"""How well a model predicts measured torque: per joint, filtered and raw, all rows and moving."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Effect, Motion
from torchid.identification.base_parameters import BaseParameters
from torchid.identification.motion import Measurement
from torchid.log.filtering import ZeroPhaseFilter
from torchid.robot.inertia import PARAMETERS_PER_LINK, InertialParameters
from torchid.robot.model import Robot
from torchid.typing import Float, Samples, Tensor


@dataclass(frozen=True)
class Errors:
    """Prediction errors per joint.

    Attributes:
        trajectories: names of the trajectories.
        rmse: (n,) of the filtered torque, all rows [N m; N].
        relative_percent: (n,) 100 ||tau - tau_hat|| / ||tau||, filtered torque, all rows.
        relative_percent_moving: (n,) the same over rows whose own joint moves; nan if none does.
        relative_percent_raw: (n,) the same for unfiltered torque, all rows.
        standstill_fraction: (n,) share of the rows in which the joint does not move.
        standstill_error_share: (n,) their share of the squared error.
    """

    trajectories: tuple[str, ...]
    rmse: Float[Tensor, " n"]
    relative_percent: Float[Tensor, " n"]
    relative_percent_moving: Float[Tensor, " n"]
    relative_percent_raw: Float[Tensor, " n"]
    standstill_fraction: Float[Tensor, " n"]
    standstill_error_share: Float[Tensor, " n"]


@dataclass(frozen=True)
class Prediction:
    """Measured and predicted torque of one trajectory, edges left out.

    Attributes:
        name: of the trajectory.
        t: (T,) [s].
        measured, predicted: (T, n) filtered torque [N m; N].
        measured_raw: (T, n) unfiltered.
        predicted_raw: (T, n) unfiltered.
        dq: (T, n) velocity.
        moving: (T, n) whether each joint moves.
    """

    name: str
    t: Float[Tensor, " T"]
    measured: Samples
    predicted: Samples
    measured_raw: Samples
    predicted_raw: Samples
    dq: Samples
    moving: Tensor


def model_torque(
    robot: Robot,
    base: BaseParameters,
    effects: Sequence[Effect],
    values: Float[Tensor, " B"],
    motion: Motion,
    wide: Motion | None = None,
) -> Float[Tensor, "*batch n"]:
    """Torque (..., n) of base parameters: the independent parameters carry the base values and the
    dependent ones are zero, which is one of the full sets with these base parameters.

    Args:
        wide: motion for columns that jump, if another than `motion`.
    """
    full = values.new_zeros(len(base.parameter_names))
    full[list(base.independent)] = values
    rigid = PARAMETERS_PER_LINK * robot.n
    pi = InertialParameters.from_paper_order(full[:rigid])
    tau = inverse_dynamics(robot, *motion.state, pi)
    start = rigid
    for effect in effects:
        stop = start + len(effect.coefficients)
        used = wide if wide is not None and effect.jumps else motion
        tau[..., effect.joint] += effect.torque(used, full[start:stop])
        start = stop
    return tau


def predict(
    measurement: Measurement,
    robot: Robot,
    base: BaseParameters,
    effects: Sequence[Effect],
    values: Float[Tensor, " B"],
) -> Prediction:
    """Measured and predicted torque, both through the measurement's filter."""
    m = measurement
    raw = model_torque(robot, base, effects, values.to(m.tau), m.motion, m.wide)
    measured, predicted = m.tau, raw
    if m.cutoff is not None:
        low_pass = ZeroPhaseFilter(m.rate, m.cutoff)
        measured, predicted = (low_pass.apply(x.T).T for x in (m.tau, raw))
    middle = slice(m.edge, m.samples - m.edge)
    return Prediction(
        m.name,
        *(x[middle].cpu() for x in (m.t, measured, predicted, m.tau, raw, m.motion.dq, m.moving)),
    )


def errors(predictions: Sequence[Prediction]) -> Errors:
    """Errors over whole trajectories together."""
    measured = torch.cat([p.measured for p in predictions])
    error = measured - torch.cat([p.predicted for p in predictions])
    raw = torch.cat([p.measured_raw for p in predictions])
    raw_error = raw - torch.cat([p.predicted_raw for p in predictions])
    moving = torch.cat([p.moving for p in predictions])
    return Errors(
        tuple(p.name for p in predictions),
        error.square().mean(0).sqrt(),
        _relative(error, measured),
        _relative(error * moving, measured * moving),
        _relative(raw_error, raw),
        1 - moving.double().mean(0),
        1 - (error * moving).square().sum(0) / error.square().sum(0).clamp(min=1e-300),
    )


def _relative(error: Tensor, reference: Tensor) -> Tensor:
    return 100 * torch.linalg.vector_norm(error, dim=0) / torch.linalg.vector_norm(reference, dim=0)
