"""The integrator against closed forms, energy balances and MuJoCo."""

import math

import numpy as np
import pytest
import torch
from scipy.interpolate import CubicHermiteSpline
from torch import Tensor

from tests.arms import consistent_parameters
from tests.oracles import MujocoOracle
from tests.simulation.bodies import INERTIA, bare, effect, flywheel, free, reference, run
from torchid.dynamics import lagrange
from torchid.dynamics.forward import gravity_torque
from torchid.robot.model import Robot
from torchid.simulation.closed_loop import closed_loop
from torchid.simulation.controller import Controller
from torchid.simulation.integrate import Drive, State

NO_TORQUE = torch.zeros(1, 1, dtype=torch.float64)


def _energies(robot: Robot, states: list[State]) -> Tensor:
    q, dq = (torch.cat(x) for x in zip(*((s.q, s.dq) for s in states), strict=True))
    return lagrange.kinetic_energy(robot, q, dq) + lagrange.potential_energy(robot, q)


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["3r", "mixed"])
def test_energy_of_a_free_arm_drifts_with_the_square_of_the_step(name: str) -> None:
    found = bare(name)
    robot = found.with_parameters(consistent_parameters(found.n, 5))
    q, dq = (
        torch.full((1, robot.n), 0.4, dtype=torch.float64),
        torch.zeros(1, robot.n, dtype=torch.float64),
    )
    plant = free(robot, [], q)
    drift = []
    for h in (2e-3, 1e-3, 5e-4):
        states = run(plant, q, dq, 0.2, h, torch.zeros_like(q))
        energy = _energies(robot, states)
        drift.append(float((energy - energy[0]).abs().max() / energy.abs().max()))
    assert drift[0] < 5e-3
    assert 3.2 < drift[0] / drift[1] < 5.0
    assert 3.2 < drift[1] / drift[2] < 5.0


def test_energy_lost_is_the_work_of_friction() -> None:
    robot = bare("3r")
    q, dq = torch.full((1, 3), 0.4, dtype=torch.float64), torch.zeros(1, 3, dtype=torch.float64)
    viscous = [effect(robot, "viscous_friction", joint=j, Fv=0.3) for j in (1, 2, 3)]
    dry = [effect(robot, "coulomb_friction", joint=j, Fc=0.2) for j in (1, 2, 3)]
    h = 5e-4
    states = run(free(robot, viscous + dry, q), q, dq, 0.2, h, torch.zeros_like(q))
    energy = _energies(robot, states)
    speeds = torch.cat([s.dq for s in states])
    middle = (speeds[1:] + speeds[:-1]) / 2
    lost = h * (0.3 * middle.square() + 0.2 * middle.abs()).sum()
    assert float(lost) > 0.05
    assert float((energy[0] - energy[-1] - lost).abs() / lost) < 2e-3


@pytest.mark.nightly
def test_a_wheel_with_dry_friction_stops_where_it_must_and_stays() -> None:
    """v0^2 I / (2 Fc) after v0 I / Fc seconds; then not a trace of motion."""
    robot = flywheel()
    q, dq = torch.zeros(1, 1, dtype=torch.float64), torch.full((1, 1), 1.2, dtype=torch.float64)
    plant = free(robot, [effect(robot, "coulomb_friction", joint=1, Fc=0.7)], q)
    states = run(plant, q, dq, 1.5, 2e-3, NO_TORQUE)
    stop = 1.2 * INERTIA / 0.7
    after = torch.cat([s.q for s in states[math.ceil(stop / 2e-3) + 1 :]])
    assert abs(float(after[0]) - 1.2**2 * INERTIA / (2 * 0.7)) < 1.5e-3 * 1.2
    assert float((after - after[0]).abs().max()) == 0.0
    assert float(states[-1].dq) == 0.0


@pytest.mark.parametrize(("share", "moves"), [(0.99, False), (1.01, True)])
def test_dry_friction_holds_what_it_can(share: float, moves: bool) -> None:
    """An arm under gravity at rest, each joint's friction a little above or below its load."""
    robot = bare("3r")
    q = torch.tensor([[0.3, 0.4, -0.5]], dtype=torch.float64)
    load = gravity_torque(robot, q)[0].abs() + 1e-6
    dry = [
        effect(robot, "coulomb_friction", joint=j + 1, Fc=float(load[j]) / share) for j in range(3)
    ]
    states = run(free(robot, dry, q), q, torch.zeros_like(q), 0.2, 2e-3, torch.zeros_like(q))
    moved = float((states[-1].q - q).abs().max())
    assert (moved > 1e-4) if moves else (moved == 0.0)


@pytest.mark.nightly
def test_a_joint_breaks_away_at_its_static_friction() -> None:
    """Stribeck: Fc + Fs holds, Fc slides; under a slow ramp it slips once the sum is exceeded."""
    robot = flywheel()
    q = torch.zeros(1, 1, dtype=torch.float64)
    law = [
        effect(robot, "coulomb_friction", joint=1, Fc=1.0),
        effect(robot, "stribeck_friction", joint=1, Fs=0.5, vs=0.05),
    ]
    plant = free(robot, law, q)
    state = plant.start(
        q, torch.zeros_like(q), torch.zeros_like(q), torch.zeros(1, dtype=torch.float64)
    )
    slipped = None
    for k in range(1000):
        torque = 2e-3 * (k + 0.5)
        state, _ = plant.step(
            state,
            2e-3,
            torch.zeros(1, dtype=torch.float64),
            Drive(torch.full((1, 1), torque, dtype=torch.float64)),
        )
        if slipped is None and float(state.dq) != 0.0:
            slipped = torque
    assert slipped == pytest.approx(1.5, abs=2.1e-3)
    assert float(state.dq) > 0.1


def test_viscosity_much_stiffer_than_the_step_does_not_ring() -> None:
    robot = flywheel()
    q, dq = torch.zeros(1, 1, dtype=torch.float64), torch.ones(1, 1, dtype=torch.float64)
    stiff = [effect(robot, "viscous_friction", joint=1, Fv=50 * INERTIA / 2e-3)]
    speeds = torch.cat([s.dq for s in run(free(robot, stiff, q), q, dq, 0.05, 2e-3, NO_TORQUE)])
    assert bool((speeds >= 0).all())
    assert float(speeds[-1]) < 1e-6


def test_bristles_much_stiffer_than_the_step_do_not_ring() -> None:
    """A presliding stiffness Fh/length of 1e5 N m/rad on 0.5 kg m^2, 450 rad/s, in steps of 5 ms.
    The deflection that holds 0.5 N m is -length ln(1 - 0.5/Fh)."""
    robot = flywheel()
    q = torch.zeros(1, 1, dtype=torch.float64)
    law = [
        effect(robot, "presliding_hysteresis", joint=1, Fh=1.0, length=1e-5),
        effect(robot, "viscous_friction", joint=1, Fv=1000.0),
    ]
    states = run(
        free(robot, law, q),
        q,
        torch.zeros_like(q),
        0.3,
        5e-3,
        torch.full((1, 1), 0.5, dtype=torch.float64),
    )
    assert float(states[-1].q) == pytest.approx(1e-5 * math.log(2), rel=0.05)
    assert float(states[-1].dq.abs()) < 1e-6


def test_viscous_motion_is_second_order() -> None:
    """v = v0 exp(-Fv t / I), q = v0 I/Fv (1 - exp(-Fv t / I))."""
    robot = flywheel()
    q, dq = torch.zeros(1, 1, dtype=torch.float64), torch.ones(1, 1, dtype=torch.float64)
    law = [effect(robot, "viscous_friction", joint=1, Fv=2.0)]
    exact = INERTIA / 2.0 * (1 - math.exp(-2.0 * 0.4 / INERTIA))
    errors = []
    for h in (4e-3, 2e-3):
        states = run(free(robot, law, q), q, dq, 0.4, h, NO_TORQUE)
        errors.append(abs(float(states[-1].q) - exact))
    assert errors[0] < 1e-5
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


def test_rotor_inertia_slows_the_wheel() -> None:
    robot = flywheel()
    q = torch.zeros(1, 1, dtype=torch.float64)
    plant = free(robot, [effect(robot, "rotor_inertia", joint=1, Ia=1.5)], q)
    states = run(plant, q, torch.zeros_like(q), 0.1, 2e-3, torch.ones(1, 1, dtype=torch.float64))
    assert float(states[-1].dq) == pytest.approx(0.1 / (INERTIA + 1.5), rel=1e-12)


def test_only_the_arm_that_diverges_stops() -> None:
    robot = flywheel()
    q = torch.zeros(2, 1, dtype=torch.float64)
    tau = torch.tensor([[1.0], [1e7]], dtype=torch.float64)
    states = run(free(robot, [], q), q, torch.zeros_like(q), 0.1, 2e-3, tau)
    assert states[-1].alive.tolist() == [True, False]
    assert float(states[-1].dq[0]) == pytest.approx(0.2, rel=1e-12)
    assert bool(states[-1].q.isfinite().all())


def test_a_controlled_arm_moves_as_in_mujoco() -> None:
    """The 3R with viscous friction that its controller does not know, 0.3 s; MuJoCo at 10 us."""
    robot = bare("3r")
    log = reference(robot, 0.3, 1000.0)
    friction = torch.tensor([0.4, 0.3, 0.2], dtype=torch.float64)
    law = [effect(robot, "viscous_friction", joint=j + 1, Fv=float(friction[j])) for j in range(3)]
    controller = Controller(feed_forward=False)
    ours, finer = (
        closed_loop(robot, [log], [law], controller=controller, longest_step=h)[0]
        for h in (1e-3, 5e-4)
    )

    stiffness, damping = (x.numpy() for x in controller.gains(robot, log.q))
    oracle = MujocoOracle(robot)
    fine = 1e-5
    oracle.model.opt.timestep = fine
    data, found = oracle.data, []
    wanted = CubicHermiteSpline(log.t, log.q, log.dq)
    grid = np.arange(0, 0.3, fine)
    target, rate = wanted(grid), wanted.derivative()(grid)
    data.qpos[:], data.qvel[:] = target[0], rate[0]
    for k in range(len(grid)):
        if k % 100 == 0:
            found.append(data.qpos.copy())
        torque = stiffness * (target[k] - data.qpos) + damping * (rate[k] - data.qvel)
        data.qfrc_applied[:] = torque - friction.numpy() * data.qvel
        oracle.mujoco.mj_step(oracle.model, data)
    theirs = torch.from_numpy(np.stack(found))
    assert float((theirs - log.q[: len(theirs)]).abs().max()) > 0.02
    assert float((ours.q[: len(theirs)] - theirs).abs().max()) < 5e-5
    assert float((finer.q[: len(theirs)] - theirs).abs().max()) < 1.5e-5
