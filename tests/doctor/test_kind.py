"""What a torque is: with gravity, without it, or without the model."""

from dataclasses import replace

import pytest
import torch

from tests.doctor.synthetic import clean
from tests.marks import quick_first, some
from torchid.doctor.examine import examine
from torchid.doctor.first import WrongLogError, ask_first
from torchid.doctor.kind import holds_no_gravity
from torchid.dynamics.newton_euler import inverse_dynamics, joint_wrenches
from torchid.log.filtering import ZeroPhaseFilter, central_difference
from torchid.robot.inertia import InertialParameters

ARMS = some(["3r", "ur10e", "panda", "kuka_lwr4"], 1, 1)
ZERO = torch.zeros(3, dtype=torch.float64)


def torques(name, *, gravity, inertial, off=0.1, friction=0.1, factor=1.0):
    """A robot and a log of an arm whose masses are off a little, out of whose torque shares of the
    robot's own gravity and inertial torques have been taken."""
    robot, log = clean(name, 0, nominal=True)
    generator = torch.Generator().manual_seed(3)
    factors = 1 + off * (2 * torch.rand(robot.n, 1, generator=generator, dtype=torch.float64) - 1)
    arm = robot.with_parameters(InertialParameters(robot.parameters.pi * factors))
    rate = 1 / float(log.t.diff().median())
    q = ZeroPhaseFilter(rate, 8.0).apply(log.q.T)
    dq = central_difference(q, rate)
    ddq, still = central_difference(dq, rate).T, torch.zeros_like(log.q)

    def torque(one, *motion):
        return torch.as_tensor(inverse_dynamics(one, q.T, *motion))

    whole = torque(arm, dq.T, ddq)
    own = torque(replace(robot, gravity=ZERO), dq.T, ddq)
    tau = whole - gravity * torque(robot, still, still) - inertial * own
    noise = 0.01 * torch.randn(tau.shape, generator=generator, dtype=tau.dtype)
    tau = tau + whole.std(0) * (friction * torch.sign(log.dq) + noise)
    return robot, log.replace(tau=factor * tau)


def said(robot, log):
    checks = examine(robot, log, first=True).checks
    return [c for c in checks if c.name == "torque kind" or holds_no_gravity(c)]


@pytest.mark.parametrize("name", ARMS)
def test_a_torque_without_gravity_is_said(name):
    (found,) = said(*torques(name, gravity=1.0, inertial=0.0))
    assert found.name == "gravity"
    assert "--torque without-gravity" in found.fix


def test_a_diagnosis_asks_for_it_first_and_reads_it():
    robot, log = torques("3r", gravity=1.0, inertial=0.0)
    with pytest.raises(WrongLogError, match="holds none"):
        ask_first(robot, log)
    assert ask_first(robot.without_gravity(), log).short == ""


@pytest.mark.parametrize("name", ARMS)
def test_a_torque_without_the_model_is_said(name):
    (found,) = said(*torques(name, gravity=1.0, inertial=1.0))
    assert found.name == "torque kind"
    assert "external" in found.evidence


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize(
    "arm",
    [
        {"gravity": 0.0, "off": 0.4},
        {"gravity": 0.5},  # half of it is taken by springs
        {"gravity": 0.0, "factor": 0.01},  # the motors' side, or amperes
        {"gravity": 0.0, "factor": 1e3},
        {"gravity": 0.0, "friction": 1.0},
    ],
    ids=["masses", "springs", "motors", "mNm", "friction"],
)
def test_a_torque_with_gravity_is_never_said_to_hold_none(name, arm):
    assert not said(*torques(name, inertial=0.0, **arm))


@pytest.mark.parametrize("name", quick_first(["ur10e", "panda"], 1))
def test_another_moment_of_the_joint_is_no_torque_without_gravity(name):
    """Joints whose torque no body explains have no vote on gravity and units."""
    robot, log = clean(name, 0, nominal=True)
    rate = 1 / float(log.t.diff().median())
    q = ZeroPhaseFilter(rate, 8.0).apply(log.q.T)
    dq = central_difference(q, rate)
    wrenches = joint_wrenches(robot, q.T, dq.T, central_difference(dq, rate).T)
    # What a simulator has reported of all joints: the moment about one axis of the link's frame.
    moments = wrenches[:, list(robot.own_links), 3:]
    across = [int(robot.after[link, 2, :3].abs().argmin()) for link in robot.own_links]
    tau = moments[:, range(robot.n), across]
    result = examine(robot, log.replace(tau=tau), first=True)
    verdicts = {c.name: c for c in result.checks}
    assert verdicts["torque explained"].verdict == "doubtful"
    assert "is the moment about" in verdicts["torque explained"].evidence
    assert verdicts["torque unit"].verdict == "cannot tell"
    assert not [c.name for c in result.checks if c.verdict == "wrong"]
