"""Arms that replay torques: how far a model's motion stays with the measured one."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchid.effects.base import Effect, Motion
from torchid.effects.registry import Valued, nominal_effects
from torchid.errors import TorchidError
from torchid.robot.model import Robot
from torchid.simulation.closed_loop import plant_of
from torchid.simulation.course import course
from torchid.simulation.integrate import LONGEST_STEP, Drive
from torchid.simulation.loads import adds_torque, changes_measurement
from torchid.typing import Bool, Float


class Rollout(NamedTuple):
    """A batch of forward simulations.

    Attributes:
        q, dq: (B, T, n); NaN from where an arm diverges.
        diverged: (B,) whether it does.
        ignored: names of the effects in the sensors that could not be undone.
    """

    q: Float[Tensor, "B T n"]
    dq: Float[Tensor, "B T n"]
    diverged: Bool[Tensor, " B"]
    ignored: tuple[str, ...]


@torch.no_grad()
def rollout(
    robot: Robot,
    effects: Sequence[Valued],
    q0: Float[Tensor, "B n"],
    dq0: Float[Tensor, "B n"],
    tau: Float[Tensor, "B T n"],
    dt: float,
    t0: float | Float[Tensor, " B"] = 0.0,
    *,
    longest_step: float = LONGEST_STEP,
) -> Rollout:
    """Motions that measured torques give.

    The robot has its own effects and those given. Effects in the sensors are undone on the torque
    where they are an affine map of it at each instant (gains, crosstalk), and on the initial
    position where they only add a constant to it; others (a delay, a compliance) are ignored and
    named. An open loop drifts even with a good model, so windows should be short.

    Args:
        robot: with parameters.
        effects: beyond its own.
        q0, dq0: state at the first sample [rad, rad/s; m, m/s].
        tau: measured torque at the samples [N m; N], on straight lines between them.
        dt: seconds between samples.
        t0: time of the first sample, on the clock of the effects [s].
        longest_step: of the integration [s].

    Returns:
        Positions and velocities at the samples.

    Raises:
        RobotError: the robot has no parameters.
        TorchidError: dt is not positive.
    """
    if not 0 < dt < math.inf:
        raise TorchidError("the time between samples is positive.", got=dt, expected="> 0 s")
    plant = plant_of(robot, [list(effects)], q0)
    true, shift, ignored = undone(robot, [*nominal_effects(robot), *effects], tau)
    begin = Motion(q0 - shift, dq0, torch.zeros_like(q0))
    steps = max(1, math.ceil(dt / longest_step - 1e-9))
    h = dt / steps
    t = torch.as_tensor(t0).to(q0).expand(len(true))
    state = plant.start(begin.q, begin.dq, begin.ddq, t)
    share = (torch.arange(steps).to(true) + 0.5) / steps
    between = torch.lerp(true[:, :-1, None], true[:, 1:, None], share[:, None])
    feeds = between.flatten(1, 2).transpose(0, 1)
    run = course(
        plant, state, Drive(true[:, 0]), feeds, t + h / 2, h,
        keep="states", every=steps, first=steps - 1,
    )  # fmt: skip
    moved = run.signals.masked_fill(~run.alive.unsqueeze(-1), math.nan).transpose(1, 2)
    q, dq = (torch.cat([x[:, None], y], 1) for x, y in zip(state[:2], moved, strict=True))
    return Rollout(q + shift, dq, ~run.alive[-1:].all(0), ignored)


def undone(
    robot: Robot, effects: Sequence[Valued], tau: Float[Tensor, "B T n"]
) -> tuple[Float[Tensor, "B T n"], Float[Tensor, " n"], tuple[str, ...]]:
    """True torques of measured ones; how much more the encoders read than the true position; names
    of effects in the sensors that cannot be undone."""
    shift, ignored = tau.new_zeros(robot.n), []
    for effect, values in reversed(effects):
        if not changes_measurement(effect):
            continue
        affine = _affine(robot, effect, values)
        if affine is None:
            ignored.append(effect.name)
            continue
        gain, offset, moved = (x.to(tau) for x in affine)
        tau = torch.linalg.solve_ex(gain, (tau - offset).unsqueeze(-1))[0].squeeze(-1)
        shift = shift + moved
    return tau, shift, tuple(dict.fromkeys(reversed(ignored)))


def true_torque(
    robot: Robot, sensed: Sequence[Valued]
) -> tuple[Float[Tensor, "n n"], Float[Tensor, " n"]]:
    """A (n, n) and b (n,) of the true torque A tau + b of a measured one.

    Args:
        robot: the arm.
        sensed: effects in the torque sensors that can be undone (see `runs`).
    """
    unit = torch.eye(robot.n, dtype=torch.float64)
    true = undone(robot, sensed, torch.cat([torch.zeros_like(unit[:1]), unit]).unsqueeze(0))[0][0]
    return (true[1:] - true[:1]).T, true[0]


def runs(robot: Robot, effect: Effect, values: Sequence[float]) -> bool:
    """Whether a simulation of an arm can have an effect beside its bodies: it adds torque, or is
    in the torque sensors alone and can be undone there."""
    if not changes_measurement(effect):
        return adds_torque(effect)
    affine = _affine(robot, effect, values)
    return affine is not None and not bool(affine[2].any())


def _affine(
    robot: Robot, effect: Effect, values: Sequence[float]
) -> tuple[Tensor, Tensor, Tensor] | None:
    """G, o and d where the effect measures G torque + o and q + d at every instant; else None.

    Found by probing it with random motions, which it must map so, too.
    """
    g = torch.Generator().manual_seed(0)
    n, samples = robot.n, 4 * robot.n + 16
    q, dq, ddq, torque = torch.randn(4, samples, n, generator=g, dtype=torch.float64)
    t = torch.arange(samples, dtype=torch.float64) * 1e-3
    motion = Motion(q, dq, ddq, t=t, torque=10 * torque)
    seen = effect.measured(motion, values, robot)
    assert seen.torque is not None
    ones = torch.cat([10 * torque, torch.ones(samples, 1, dtype=torch.float64)], -1)
    fit = torch.linalg.lstsq(ones, seen.torque).solution
    moved = (seen.q - q)[0]
    same = (
        torch.allclose(ones @ fit, seen.torque, atol=1e-8)
        and torch.allclose(seen.q, q + moved, atol=1e-10)
        and torch.allclose(seen.dq, dq, atol=1e-10)
    )
    return (fit[:n].T, fit[n], moved) if same else None
