"""Arms under control, with effects that change how they move."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from torchid.dynamics.world_frame import arms_of
from torchid.effects.base import Motion
from torchid.effects.registry import Valued, nominal_effects
from torchid.errors import LogError, TorchidError
from torchid.log.model import Log
from torchid.robot.model import Robot
from torchid.simulation.controller import Controller
from torchid.simulation.course import Course, course
from torchid.simulation.integrate import LONGEST_STEP, Drive, Plant
from torchid.simulation.loads import BatchEffects
from torchid.typing import Float


def closed_loop(
    robot: Robot,
    references: Sequence[Log],
    effects: Sequence[Sequence[Valued]],
    *,
    rate: float | None = None,
    controller: Controller | None = None,
    longest_step: float = LONGEST_STEP,
) -> list[Log]:
    """True motion and true torque of arms that follow references as well as they can.

    The controller knows the robot as it is described, with its nominal effects. The arms have
    those and their own: effects change how they move. All arms are stepped together.

    At every sample of the result the equations of motion hold to integration accuracy: the torque
    is that of the rigid body along (q, dq, ddq) and of the effects, but where joints stick, which
    friction holds with anything up to its dry part.

    Args:
        robot: kinematics, nominal parameters and nominal effects.
        references: one an arm; t, q, dq, ddq of one trajectory.
        effects: one list an arm, beyond the nominal ones; those that only change what is measured
            have no influence here, see `sensors.measured_log`.
        rate: samples per second of the results [Hz]; that of the first reference if None.
        controller: the default one if None.
        longest_step: of the integration [s]; sampling intervals are divided into steps.

    Returns:
        One log an arm, on a uniform grid from its reference's first instant: q, dq, ddq, tau.

    Raises:
        RobotError: the robot has no nominal parameters.
        LogError: a reference has several trajectories, no dq or ddq, or other joints.
        TorchidError: another number of lists than references, effects with which an arm's inertia
            is not positive definite, or an arm diverges.
    """
    controller = controller or Controller()
    _check(robot, references, effects)
    rate = references[0].rates[0] if rate is None else rate
    if not 0 < rate < math.inf:
        raise TorchidError("a sampling rate is a frequency.", got=rate, expected="> 0 Hz")
    longest = max(float(log.t[-1] - log.t[0]) for log in references)
    # 1e7: samples that memory bears
    if longest * rate > 1e7:
        raise TorchidError(
            "the simulated log would have more than ten million samples.",
            got=f"{longest:g} s at {rate:g} Hz",
        )
    steps = max(1, math.ceil(1 / rate / longest_step - 1e-9))
    targets = [_on_grid(log, steps * rate) for log in references]
    each = [controller.gains(robot, m.q) for m in targets]
    feed = _padded([controller.feed(robot, m, g) for m, g in zip(targets, each, strict=True)])
    stiffness, damping = (torch.stack(gains) for gains in zip(*each, strict=True))
    drive = Drive(feed[:, 0], damping, controller.limit(robot.n), stiffness)
    firsts = zip(*([x[0] for x in m.state] for m in targets), strict=True)
    begin = Motion(*(torch.stack(first) for first in firsts))
    plant = plant_of(robot, effects, begin.q)
    _check_inertia(plant, _padded([m.q for m in targets]), references)
    h = 1 / (steps * rate)
    lengths = [-(-len(m.q) // steps) for m in targets]
    run = _run(plant, begin, feed, drive, h, steps)
    lost = [log.names[0] for log, ok in zip(references, run.alive[-1], strict=True) if not ok]
    if lost:
        raise TorchidError(
            "the arm runs away: no controller holds these effects, or the step is too long.",
            got=", ".join(lost),
            hint="smaller effects, another controller, or a shorter `longest_step`",
        )
    return [
        _log(robot, log, run.signals[:, :length, k], rate)
        for k, (log, length) in enumerate(zip(references, lengths, strict=True))
    ]


def plant_of(robot: Robot, effects: Sequence[Sequence[Valued]], like: Tensor) -> Plant:
    """Arms as they are: the robot with its nominal effects and with those of each arm.

    Arms with equal effects are one, so that a step is recorded once for all of them.

    Args:
        robot: the nominal one.
        effects: one list an arm.
        like: dtype and device.
    """
    nominal = nominal_effects(robot)
    alike = all(own == effects[0] for own in effects)
    every = [[*nominal, *own] for own in (effects[:1] if alike else effects)]
    bodies = [_body(robot, own) for own in every]
    same = all(body is robot for body in bodies)
    robots = (robot,) if same else tuple(bodies)
    return Plant(arms_of(robots, like), BatchEffects(every, robot, like), robots)


def _body(robot: Robot, effects: Sequence[Valued]) -> Robot:
    for effect, values in effects:
        robot = effect.plant(robot, values)
    return robot


@torch.inference_mode()
def _run(
    plant: Plant, begin: Motion, feed: Float[Tensor, "B T n"], drive: Drive, h: float, every: int
) -> Course:
    """q, dq, ddq, torque of every k-th step's middle, where the reference's samples are."""
    # The state from which the middle of the first step, the first sample, is as it shall begin.
    now = torch.zeros_like(begin.q[:, 0])
    feeds = feed.transpose(0, 1)
    ddq = begin.ddq
    for trial in range(3):
        dq = begin.dq - h / 2 * ddq
        state = plant.start(begin.q - h / 2 * dq, dq, ddq, now - h / 2)
        if trial < 2:
            ddq = plant.step(state, h, now, drive._replace(feed=feeds[0]))[1].ddq
    return course(plant, state, drive, feeds, now, h, keep="instants", every=every)


def _on_grid(log: Log, rate: float) -> Motion:
    """The reference at multiples of 1/rate after its first instant, with t from 0."""
    assert log.dq is not None
    assert log.ddq is not None
    t = log.t - log.t[0]
    count = int(float(t[-1]) * rate + 1e-6) + 1
    grid = torch.arange(count, dtype=torch.float64) / rate
    if count == len(t) and bool(((t - grid).abs() < 1e-9).all()):
        return Motion(log.q, log.dq, log.ddq, t=grid)
    at = grid.clamp(max=float(t[-1]))
    q, _ = _cubic(t, log.q, log.dq, at)
    return Motion(q, *_cubic(t, log.dq, log.ddq, at), t=grid)


def _cubic(
    t: Float[Tensor, " T"],
    x: Float[Tensor, "T n"],
    rate: Float[Tensor, "T n"],
    at: Float[Tensor, " M"],
) -> tuple[Float[Tensor, "M n"], Float[Tensor, "M n"]]:
    """Values and slopes of the cubic through x with these rates (Hermite; not SciPy's, whose import
    takes as long as a simulation)."""
    k = (torch.searchsorted(t, at, right=True) - 1).clamp(0, len(t) - 2)
    step = (t[k + 1] - t[k]).unsqueeze(1)
    s = (at - t[k]).unsqueeze(1) / step
    rise, before, after = (x[k + 1] - x[k]) / step, rate[k], rate[k + 1]
    bend, twist = 3 * rise - 2 * before - after, before + after - 2 * rise
    value = x[k] + step * s * (before + s * (bend + s * twist))
    return value, before + s * (2 * bend + 3 * s * twist)


def _padded(feeds: Sequence[Tensor]) -> Float[Tensor, "B T n"]:
    """All as long as the longest: an arm that is done holds its last command."""
    longest = max(len(x) for x in feeds)
    return torch.stack([torch.cat([x, x[-1:].expand(longest - len(x), -1)]) for x in feeds])


def _log(robot: Robot, reference: Log, signals: Float[Tensor, "4 T n"], rate: float) -> Log:
    q, dq, ddq, tau = (x.clone() for x in signals)
    t = reference.t[0] + torch.arange(len(q), dtype=torch.float64) / rate
    source = f"simulated {robot.name}"
    return Log(t, q, dq, ddq, tau, names=reference.names, source=source)


def _check(robot: Robot, references: Sequence[Log], effects: Sequence[Sequence[Valued]]) -> None:
    robot.require_parameters("simulation")
    if len(references) != len(effects) or not references:
        raise TorchidError(
            "every arm needs one reference and one list of effects.",
            got=f"{len(references)} references, {len(effects)} lists of effects",
        )
    for log in references:
        if log.trajectory_count != 1:
            raise LogError(
                "a reference is one trajectory.", got=log.trajectory_count, hint="Log.trajectories"
            )
        missing = [name for name in ("dq", "ddq") if getattr(log, name) is None]
        if missing or log.n != robot.n:
            raise LogError(
                f"a reference for robot '{robot.name}' needs q, dq and ddq of its joints.",
                got=f"{log.n} joints, signals {', '.join(log.signals)}",
                expected=f"{robot.n} joints, signals q, dq, ddq",
                hint="`torchid excite` writes all three",
            )


def _check_inertia(plant: Plant, q: Float[Tensor, "B T n"], references: Sequence[Log]) -> None:
    """Effects may take inertia away, or couple joints by more than both have (the inertia of a
    coupled motor without that of its own joint): no body moves like that."""
    if not bool(plant.effects.inertia.any()):
        return
    # 50: instants of a reference at which the arm's inertia is looked at
    for k in torch.linspace(0, q.shape[1] - 1, 50, dtype=torch.float64).long().tolist():
        mass = plant.arms.at(q[:, k]).mass_matrix() + plant.effects.inertia
        bad = torch.linalg.cholesky_ex(mass)[1] > 0
        if bool(bad.any()):
            raise TorchidError(
                "with these effects the inertia of the arm is not positive definite.",
                got=references[int(bad.nonzero()[0])].names[0],
                hint="a coupled motor's Iam beside a rotor_inertia of at least that on both joints",
            )
