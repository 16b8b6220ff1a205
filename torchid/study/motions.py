"""The motions and logs of a study, and torques of whole sets along them."""

from dataclasses import replace

from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Motion
from torchid.excitation.synthetic import PaperNoise, synthetic_log
from torchid.excitation.trajectories import (
    paper_trajectories_3r,
    random_trajectory,
    sinusoid,
    trajectory_log,
)
from torchid.feasibility.sets import ParameterSets, joined
from torchid.log.model import Log
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.study.settings import MotionSettings
from torchid.typing import Float, Tensor


def excitation(robot: Robot, settings: MotionSettings) -> Log:
    """The planned exciting trajectories (eq. 5.1)."""
    if settings.source == "table_5_1":
        return trajectory_log(paper_trajectories_3r(), settings.rate)
    trajectory = random_trajectory(
        robot, settings.seed, count=settings.count, duration=settings.duration
    )
    return trajectory_log(trajectory, settings.rate)


def new_motion(robot: Robot, settings: MotionSettings) -> Log:
    """A sinusoid within the limits (eq. 5.2), planned."""
    motion = sinusoid(robot, settings.seed, duration=settings.duration)
    return trajectory_log(motion, settings.rate)


def simulated(robot: Robot, motion: Log, settings: MotionSettings) -> Log:
    """The report's log of a motion: noise, if any, is on the trajectory."""
    noise = None if settings.noise_db is None else PaperNoise(snr_db=settings.noise_db)
    return synthetic_log(robot, motion, noise, settings.seed + 1)


def state(motion: Log) -> tuple[Tensor, Tensor, Tensor]:
    """q, dq, ddq (T, n) of a planned motion."""
    assert motion.dq is not None
    assert motion.ddq is not None
    return motion.q, motion.dq, motion.ddq


def sets_torque(robot: Robot, sets: ParameterSets, motion: Log) -> Float[Tensor, "K T n"]:
    """Joint torques (K, T, n) of whole sets, rigid body and effects [N m; N]."""
    signals = state(motion)
    rigid = inverse_dynamics(robot, *signals, InertialParameters(sets.parameters.pi.unsqueeze(1)))
    start = 0
    for effect in sets.effects:
        columns = effect.columns(Motion(*signals))
        stop = start + columns.shape[-1]
        rigid[..., effect.joint] += sets.coefficients[:, start:stop] @ columns.T
        start = stop
    return rigid


def with_real(sets: ParameterSets, real: ParameterSets) -> ParameterSets:
    """The true set before the others, under the name `real`, with the others' effects."""
    names = real.coefficient_names()
    order = [names.index(name) for name in sets.coefficient_names()]
    coefficients = real.coefficients[:, order]
    first = replace(real, ids=("real",), effects=sets.effects, coefficients=coefficients)
    return joined([first, sets])
