"""What looks like a fault of the log and is the arm's: presliding as a lag, pushes as couplings."""

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
import torch

from torchid.doctor.estimates import check_lag
from torchid.doctor.examine import Examination, examine
from torchid.doctor.hypothesis import Profile
from torchid.doctor.repair import ShiftTorque
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.log.model import Log
from torchid.robot.jacobian import tool_jacobian
from torchid.robot.library import load_robot

RATE = 200


@lru_cache
def presliding(length: float, seed: int, name: str = "3r") -> Log:
    """The log of an arm whose dry friction, .3 of its torque, comes near its full size as bristles
    bend (Dahl), over a length [rad]."""
    robot = replace(load_robot(name), effects=())
    log = trajectory_log(random_trajectory(robot, seed, usage=0.6, duration=12.0), RATE)
    assert log.dq is not None
    assert log.ddq is not None
    tau = inverse_dynamics(robot, log.q, log.dq, log.ddq)
    size = tau.std(0).clamp(min=0.05 * float(tau.std(0).max()))
    z, states = np.zeros(robot.n), []
    for step in np.diff(log.q.numpy(), axis=0, prepend=log.q[:1].numpy()):
        z = np.sign(step) + (z - np.sign(step)) * np.exp(-np.abs(step) / length)
        states.append(z)
    tau = tau + size * (0.3 * torch.from_numpy(np.stack(states)) + 0.1 * log.dq)
    noise = torch.from_numpy(np.random.default_rng(seed).normal(size=tau.shape))
    return log.replace(tau=tau + 0.01 * size * noise, dq=None, ddq=None, source="presliding")


def late(log: Log, seconds: float) -> Log:
    """With the torque late [s]."""
    assert log.tau is not None
    t = log.t.numpy()
    tau = np.stack([np.interp(t - seconds, t, x) for x in log.tau.numpy().T], 1)
    return log.replace(tau=torch.from_numpy(tau))


def said(found: Examination) -> tuple[str, float, float]:
    """Verdict on the lag, its estimate, and by how much the torque would be shifted [s]."""
    (check,) = (c for c in found.checks if c.name == "lag")
    assert isinstance(check.estimate, float)
    shift = sum(r.seconds for r in found.repairs if isinstance(r, ShiftTorque))
    return check.verdict, check.estimate, shift


@pytest.mark.parametrize(("length", "seed"), [(1e-3, 0), (1e-3, 1), (3e-3, 0), (3e-3, 1)])
@pytest.mark.parametrize("seconds", [0.0, 0.002, 0.02, 0.03])
def test_friction_that_builds_up_is_no_lag_and_hides_none(length, seed, seconds) -> None:
    found = examine("3r", late(presliding(length, seed), seconds), first=True)
    verdict, estimate, shift = said(found)
    assert abs(estimate - seconds) < 0.002
    assert abs(shift - seconds * (seconds > 0.01)) < 0.002
    assert (verdict in ("wrong", "doubtful")) == (seconds > 0.01)
    assert (verdict == "fine") == (seconds < 0.01)


SHOWN, NONE, UNTOLD = (0.03, 0.02, 0.04), (0.0, -0.01, 0.01), (math.nan,) * 3


@pytest.mark.parametrize(
    ("own", "verdict"),
    [
        ((SHOWN, SHOWN, UNTOLD), "doubtful"),
        ((SHOWN, SHOWN, NONE), "doubtful"),
        ((SHOWN, UNTOLD, UNTOLD), "cannot tell"),
        ((SHOWN, NONE, NONE), "cannot tell"),
        ((UNTOLD, UNTOLD, UNTOLD), "cannot tell"),
    ],
)
def test_a_lag_is_told_where_more_than_one_joint_shows_it(own, verdict: str) -> None:
    found = examine("3r", late(presliding(1e-3, 0), 0.03), first=True)
    assert found.judge is not None
    assert found.search is not None
    lag = Profile(0.03, 0.025, 0.035, 1.0, np.array(own))
    check = check_lag(found.judge, found.search, lag)
    assert check.verdict == verdict
    assert bool(check.repairs) == (verdict == "doubtful")


@pytest.mark.parametrize("half", [0.01, 0.02])
def test_a_lag_that_may_be_less_than_half_is_not_mended(half: float) -> None:
    found = examine("3r", late(presliding(1e-3, 0), 0.03), first=True)
    assert found.judge is not None
    assert found.search is not None
    lag = Profile(0.03, 0.03 - half, 0.03 + half, 1.0, np.array([SHOWN] * 3))
    check = check_lag(found.judge, found.search, lag)
    assert bool(check.repairs) == (half < 0.015)


@lru_cache
def pushed(seed: int) -> Log:
    """An arm that is pushed at its last link by hand, some two seconds at a time."""
    robot = load_robot("ur10e")
    draw, t = np.random.default_rng(seed), np.arange(1200) / 75
    angle = 2 * np.pi * draw.uniform(0.06, 0.14) * np.outer(t, [1, 2, 3])
    q = np.stack([np.sin(angle + draw.uniform(0, 6, 3)) @ [1, 0.4, 0.2] for _ in range(6)], 1)
    q = draw.uniform(0.2, 0.5, 6) * q + [0, -1.2, 1.4, -0.5, 1.2, 0]
    dq = np.gradient(q, t, axis=0)
    state = [torch.from_numpy(x) for x in (q, dq, np.gradient(dq, t, axis=0))]
    tau = inverse_dynamics(robot, *state) + torch.tanh(state[1] / 0.01) * robot.n
    force = np.zeros((len(t), 6))
    for start in np.arange(1.0, 13.0, 2.5):
        part = np.sin(np.pi * np.clip((t - start - draw.uniform(0, 0.5)) / 2.0, 0, 1)) ** 2
        force[:, :3] += part[:, None] * draw.normal(size=3) * 25
    tau = tau + torch.einsum("tij,ti->tj", tool_jacobian(robot, state[0]), torch.from_numpy(force))
    return Log(torch.from_numpy(t), state[0], tau=tau, source="pushed")


@pytest.mark.parametrize("seed", [4, 13])
def test_a_push_at_a_link_is_no_coupling_of_joints(seed: int) -> None:
    found = examine("ur10e", pushed(seed), first=True)
    assert "coupling of joints" not in [c.name for c in found.checks]
    assert not [c for c in found.checks if c.verdict == "wrong"]
