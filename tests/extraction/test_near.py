"""Bodies near to typical ones: torque against Pinocchio and MuJoCo, bounds, and what noise asks
for."""

from dataclasses import replace

import pytest
import torch

from tests.arms import arm, states
from tests.oracles import MujocoOracle, PinocchioOracle
from torchid.errors import TorchidError
from torchid.extraction.found import at_bounds
from torchid.extraction.from_identification import problem_of
from torchid.extraction.methods import near_set
from torchid.feasibility.plausibility import DENSITIES, bodies
from torchid.identification.identify import Settings, identify
from torchid.identification.values import nominal_base
from torchid.log.model import Log
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.typing import Tensor


def bare(robot: Robot) -> Robot:
    """The robot's kinematics."""
    return replace(robot, parameters=None)


def apart(robot: Robot, other: Robot, oracle: type) -> Tensor:
    """(n,) difference of two robots' torques over the first one's, root mean squares."""
    moved = states(robot, 60)
    own, theirs = (oracle(r).inverse_dynamics(*moved) for r in (robot, other))
    return (own - theirs).square().mean(0).sqrt() / own.square().mean(0).sqrt()


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "bounds"), [("panda", "none"), ("ur10e", "none"), ("ur10e", "wide"), ("mixed", "wide")]
)
def test_bodies_of_a_robot_of_known_kinematics_have_the_torque(name, bounds):
    true = arm(name)
    problem, _ = problem_of(bare(true), nominal_base(true), bounds=bounds)
    found = near_set(problem)
    assert found.verdict.feasible.all()
    made = found.sets.to_robot(true, 0)
    assert float(apart(true, made, PinocchioOracle).max()) < 0.01
    assert float(apart(true, made, MujocoOracle).max()) < 0.01
    p = made.parameters
    assert bool((p.mass > 0).all())
    assert bool((torch.linalg.eigvalsh(p.pseudo_inertia) > 0).all())
    low, high = problem.bounds.com.unbind(-1)
    assert bool(((low <= p.com) & (p.com <= high)).all())
    assert bool((p.mass <= problem.bounds.mass[:, 1]).all())


def moving(robot: Robot, seed: int, noise: float) -> Log:
    """A log of sines with noise on the torque."""
    g = torch.Generator().manual_seed(seed)
    t = torch.arange(0, 12, 0.01, dtype=torch.float64)
    rate = 1 + 2 * torch.rand(3, robot.n, generator=g, dtype=torch.float64)
    size = 0.4 * torch.rand(3, robot.n, generator=g, dtype=torch.float64)
    phase = t[:, None, None] * rate
    q, dq, ddq = (
        (size * x).sum(1) for x in (phase.sin(), rate * phase.cos(), -rate.square() * phase.sin())
    )
    tau = PinocchioOracle(robot).inverse_dynamics(q, dq, ddq)
    tau = tau + noise * torch.randn(tau.shape, generator=g, dtype=torch.float64)
    return Log(t=t, q=q, dq=dq, ddq=ddq, tau=tau)


@pytest.mark.nightly
def test_of_a_noisy_log_no_link_is_denser_than_lead():
    true = arm("ur10e")
    true = true.with_parameters(replace(true.parameters, pi=true.parameters.pi * 2))
    robot = bare(true)
    result = identify(robot, moving(true, 1, 1.0), settings=Settings(effects=(), cutoff=8.0))
    problem, notes = problem_of(robot, result)
    assert (problem.bounds.name, problem.target.loss) == ("wide", "one-step")
    assert "neither bounds nor inertial parameters" in notes[0]
    found = near_set(problem)
    density = bodies(found.sets.parameters).density
    assert DENSITIES[0] / 3 < float(density.min()) < float(density.max()) < DENSITIES[1]
    # The price: a few percent of the error that the log leaves anyway.
    error = (float(found.phi[0]) + problem.target.left**2) ** 0.5
    assert error < 1.05 * problem.target.left
    # Without the residual, the same loss asks for noise, and some body for no size.
    blind = replace(problem, target=replace(problem.target, left=0.0))
    assert float(bodies(near_set(blind).sets.parameters).density.max()) > DENSITIES[1]


@pytest.mark.parametrize(("factor", "said"), [(1.0, []), (10.0, ["m3 (upper)"])])
def test_bounds_that_the_torque_asks_to_leave_are_said(factor, said):
    robot = arm("3r")
    pi = robot.require_parameters("a test").pi.clone()
    pi[2] *= factor
    heavy = robot.with_parameters(InertialParameters(pi))
    problem, _ = problem_of(robot, nominal_base(heavy), bounds="from-robot")
    masses = [name for name in at_bounds(near_set(problem)) if name.startswith("m3 (")]
    assert masses == said


def test_conditions_that_it_does_not_keep_are_refused():
    robot = arm("3r")
    problem, _ = problem_of(robot, nominal_base(robot), bounds="wide", total_mass=(4.0, 6.0))
    with pytest.raises(TorchidError, match="total mass"):
        near_set(problem)
    problem, _ = problem_of(robot, nominal_base(robot), bounds="wide")
    box = problem.conditions.com_box.clone()
    box[1, 2] = torch.tensor([5.0, 6.0])
    elsewhere = replace(problem, conditions=replace(problem.conditions, com_box=box))
    with pytest.raises(TorchidError, match="no room for a centre of mass"):
        near_set(elsewhere)


@pytest.mark.nightly
def test_nominal_bodies_outside_the_bounds_are_moved_inside():
    """The 3R's own parameters with a first link that is too heavy and a second
    that is elsewhere, within its own bounds."""
    robot = arm("3r")
    own, n = robot.parameters, robot.n
    mass = own.mass * torch.tensor([100.0, 1.0, 1.0]).double()
    com = own.com + torch.tensor([[0.0], [3.0], [0.0]]).double()
    changed = robot.with_parameters(
        InertialParameters.from_com(mass, com, own.inertia_about_com.expand(n, 6))
    )
    problem, _ = problem_of(robot, nominal_base(robot))
    found = near_set(replace(problem, robot=changed))
    own = found.sets.parameters
    low, high = problem.bounds.mass.unbind(-1)
    assert bool(((low <= own.mass) & (own.mass <= high)).all())
    assert float(found.torque.max()) < 0.01
