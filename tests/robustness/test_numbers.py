"""Numbers under stress: other units, light links beside heavy ones, motions that hardly tell
parameters apart, one joint's data given twice. What holds for good numbers holds, or it is said why
not."""

import math
from dataclasses import replace

import pytest
import torch

from tests.marks import quick_first
from torchid.dynamics.forward import forward_dynamics
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.dynamics.regressor import regressor
from torchid.errors import LogError
from torchid.excitation.synthetic import synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.identification.identify import identify
from torchid.identification.settings import Settings
from torchid.log.model import Log
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot
from torchid.robot.model import JointType, Robot

ROBOT = load_robot("3r")
SETTINGS = Settings(effects=("viscous_friction", "coulomb_friction"), cutoff=8.0)


def noisy(robot: Robot, seed: int = 0, noise: float = 0.05) -> Log:
    log = synthetic_log(robot, trajectory_log(random_trajectory(robot, seed, fill=True), 200.0))
    random = torch.Generator().manual_seed(seed)
    extra = noise * torch.randn(log.tau.shape, generator=random, dtype=torch.float64)
    own = 0.3 * torch.sign(log.dq) + 0.2 * log.dq
    return log.replace(tau=log.tau + own + extra, ddq=None)


LOG = noisy(ROBOT)


@pytest.mark.parametrize("factor", quick_first([4.448, 1e3, 1e-3, 1e6], 1))
def test_torques_in_another_unit_scale_every_result(factor):
    """Torques of N mm, kN m, ..: coefficients and standard deviations are theirs, exactly."""
    one = identify(ROBOT, LOG, settings=SETTINGS)
    two = identify(ROBOT, LOG.replace(tau=factor * LOG.tau), settings=SETTINGS)
    std = one.covariance.diagonal().sqrt()
    assert one.cutoff == two.cutoff
    assert bool(((two.values / factor - one.values).abs() <= 1e-6 * std).all())
    scaled = two.covariance.diagonal().sqrt() / factor
    assert torch.allclose(scaled, std, rtol=1e-6)
    assert torch.allclose(two.fit.relative_percent, one.fit.relative_percent, rtol=1e-6)


@pytest.mark.parametrize(
    ("signal", "factor", "said"),
    [
        ("dq", 180 / math.pi, "degrees per second"),
        ("dq", 1e3, "dq1 is 1000 times the derivative of q1"),
        ("q", 65536 / math.pi, "neither radians nor degrees"),
    ],
)
def test_angles_in_another_unit_are_refused(signal, factor, said):
    with pytest.raises(LogError, match=said):
        identify(ROBOT, LOG.replace(**{signal: factor * getattr(LOG, signal)}), settings=SETTINGS)


@pytest.mark.parametrize(
    ("factor", "said", "way"),
    [
        (1e3, "looks like millimetres", "divide q1 by 1000;"),
        (1e6, "looks like micrometres", "divide q1 by 1e6;"),
        (1e9, "neither metres nor millimetres nor micrometres", "steps of an encoder"),
    ],
)
def test_metres_in_another_unit_are_refused(factor, said, way):
    types = (JointType.PRISMATIC, *ROBOT.joint_types[1:])
    slider = replace(ROBOT, joint_types=types).with_limits(position=[[-0.5, 0.5]] + [[-3, 3]] * 2)
    q = LOG.q * torch.tensor([0.1 * factor, 1.0, 1.0], dtype=torch.float64)
    with pytest.raises(LogError, match=said) as caught:
        identify(slider, LOG.replace(q=q, dq=None), settings=SETTINGS)
    assert way in caught.value.hint


def uneven(masses: list[float]) -> Robot:
    """The 3R with links of very different masses, their inertias in proportion."""
    pi = ROBOT.require_parameters("this").pi
    scale = torch.tensor(masses, dtype=torch.float64) / pi[:, 0]
    return ROBOT.with_parameters(InertialParameters(pi * scale.unsqueeze(-1)))


MASSES = [[100.0, 1e-3, 1e-3], [1e-3, 100.0, 1e-3], [1e-3, 1e-3, 100.0], [100.0, 1e-3, 100.0]]


@pytest.mark.parametrize("masses", MASSES)
def test_dynamics_of_light_links_beside_heavy_ones(masses):
    """Torque is linear in parameters, and forward dynamics undoes inverse dynamics as far as the
    mass matrix's condition lets it."""
    robot = uneven(masses)
    random = torch.Generator().manual_seed(1)
    q, dq, ddq = torch.randn(3, 20, 3, generator=random, dtype=torch.float64)
    tau = inverse_dynamics(robot, q, dq, ddq)
    flat = robot.require_parameters("this").to_paper_order()
    linear = regressor(robot, q, dq, ddq) @ flat
    assert torch.allclose(linear, tau, rtol=1e-10, atol=1e-12 * float(tau.abs().max()))
    back = forward_dynamics(robot, q, dq, tau)
    assert torch.allclose(back, ddq, rtol=0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("masses", MASSES)
def test_identification_of_light_links_beside_heavy_ones(masses):
    """Within five standard deviations of the truth, or not told at all."""
    robot = uneven(masses)
    found = identify(robot, noisy(robot), settings=SETTINGS)
    flat = robot.require_parameters("this").to_paper_order()
    rigid = [k for k, i in enumerate(found.base.independent) if i < len(flat)]
    truth = found.base.project(torch.cat([flat, torch.tensor([0.2, 0.3] * 3).double()]))
    std = found.covariance.diagonal().sqrt()
    names = [found.base.names[k] for k in rigid]
    told = [k for k in rigid if found.base.names[k] not in {*found.undetermined, *found.bounded}]
    assert told, names
    off = ((found.values - truth).abs() / std)[told]
    assert float(off.max()) < 5.0


def test_what_hardly_moves_is_told_with_its_uncertainty():
    """A hundredth of a degree, a whole motion beside its own resolution: what is told of it lies
    within its standard deviations."""
    t = torch.arange(4000, dtype=torch.float64) / 200
    w = torch.tensor([1.9, 2.7, 3.3], dtype=torch.float64)
    q, dq, ddq = (
        2e-4 * f(t[:, None] * w) * w**k
        for k, f in ((0, torch.sin), (1, torch.cos), (2, lambda x: -torch.sin(x)))
    )
    random = torch.Generator().manual_seed(3)
    noise = 0.05 * torch.randn(q.shape, generator=random, dtype=torch.float64)
    log = Log(t, q, dq=dq, tau=inverse_dynamics(ROBOT, q, dq, ddq) + noise)
    found = identify(ROBOT, log, settings=replace(SETTINGS, effects=()))
    truth = found.base.project(ROBOT.require_parameters("this").to_paper_order())
    std = found.covariance.diagonal().sqrt()
    told = std > 0
    assert bool(told.any())
    assert float(((found.values - truth).abs() / std)[told].max()) < 6.0


def test_joints_that_move_as_one_are_told_by_what_they_do_not_tell():
    """Joints 2 and 3 always in proportion: fewer parameters are told, and those are right."""
    log = LOG
    q = log.q.clone()
    q[:, 2] = 0.5 * q[:, 1]
    t = log.t
    dq = torch.stack([torch.gradient(q[:, j], spacing=(t,))[0] for j in range(3)], -1)
    ddq = torch.stack([torch.gradient(dq[:, j], spacing=(t,))[0] for j in range(3)], -1)
    tau = inverse_dynamics(ROBOT, q, dq, ddq)
    tau = tau + 0.05 * torch.randn(tau.shape, generator=torch.Generator().manual_seed(2)).double()
    both = identify(ROBOT, Log(t, q, dq=dq, tau=tau), settings=replace(SETTINGS, effects=()))
    free = identify(ROBOT, LOG, settings=replace(SETTINGS, effects=()))
    assert both.undetermined or both.scaled_condition_number > free.scaled_condition_number


@pytest.mark.slow
@pytest.mark.parametrize("signals", [("q", "dq"), ("tau",), ("q", "dq", "tau")])
def test_a_joint_with_anothers_data_is_said(signals):
    changed = {}
    for name in signals:
        changed[name] = getattr(LOG, name).clone()
        changed[name][:, 2] = changed[name][:, 0]
    found = identify(ROBOT, LOG.replace(**changed), settings=SETTINGS)
    for name in signals:
        if name != "dq":
            assert any(f"{name}3 is the same as {name}1" in w for w in found.warnings)


def test_joints_that_differ_are_not_said_to_be_copies():
    assert not [w for w in identify(ROBOT, LOG, settings=SETTINGS).warnings if "copied" in w]
