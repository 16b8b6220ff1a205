"""The motions and logs of a study, torques and wrenches of sets along them, and its payload."""

from dataclasses import replace

import torch
from msgspec import structs

from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Motion
from torchid.excitation.synthetic import HonestNoise, PaperNoise, synthetic_log
from torchid.excitation.trajectories import (
    paper_trajectories_3r,
    random_trajectory,
    sinusoid,
    trajectory_log,
)
from torchid.feasibility.sets import ParameterSets, joined
from torchid.identification.identify import Settings, identify
from torchid.identification.payload import estimate_payload, with_payload
from torchid.log.model import Log
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.study.result import PayloadResult, SetsOnMotion
from torchid.study.settings import MotionSettings, StudySettings
from torchid.typing import Float, Tensor
from torchid.wrenches.regressor import wrench_norms

PAYLOAD_RATE = 200.0
"""Sampling rate [Hz] of the logs of the payload part, which have the noise of real sensors and are
filtered: the report's 29 Hz would be too slow."""


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


def sets_on_motion(robot: Robot, sets: ParameterSets, motion: Log) -> SetsOnMotion:
    """Sets, the real one first, along a planned motion."""
    return SetsOnMotion(
        motion,
        sets.ids,
        sets_torque(robot, sets, motion),
        *wrench_norms(robot, *state(motion), sets.parameters),
    )


def payload_part(robot: Robot, settings: StudySettings, motion: Log) -> PayloadResult:
    """The same exciting motion with and without a payload, with the noise of real sensors."""
    body = settings.payload
    com = torch.tensor([body.com], dtype=torch.float64)
    inertia = torch.tensor([body.inertia_about_com], dtype=torch.float64)
    mass = torch.tensor([body.mass], dtype=torch.float64)
    true = InertialParameters.from_com(mass, com, inertia).pi[0]
    loaded = with_payload(robot, true)
    plan = excitation(robot, structs.replace(settings.excitation, rate=PAYLOAD_RATE))
    chosen = Settings(effects=settings.effects, signs="free")
    results = []
    for k, arm in enumerate((robot, loaded)):
        log = synthetic_log(arm, plan, HonestNoise(), settings.excitation.seed + 10 + k)
        results.append(identify(arm, log, settings=chosen))
        chosen = replace(chosen, cutoff=results[0].cutoff)
    estimate = estimate_payload(*results)
    guessed = with_payload(robot, estimate.tool.parameters.value.nan_to_num(0.0))
    arms = (robot, loaded, guessed)
    pi = torch.stack([arm.require_parameters("the study").pi for arm in arms])
    force, moment = wrench_norms(robot, *state(motion), InertialParameters(pi))
    return PayloadResult(true, estimate, force, moment)
