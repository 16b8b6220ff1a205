"""Without effects the simulated arm is the nominal one, to MuJoCo and to torchid."""

import numpy as np
import pytest
import torch

from tests.torchid_bench.withheld.plant.conftest import quiet
from torchid.effects.base import Motion
from torchid.effects.registry import model_torque, nominal_effects
from torchid.robot.library import load_robot
from torchid_bench.withheld.plant.case import simulate_case
from torchid_bench.withheld.plant.plan import Plan
from torchid_bench.withheld.plant.simulate import simulated

STEP = 2.5e-4


def signals(columns, n, trajectory=0):
    rows = columns["traj"] == trajectory
    return (
        np.stack([columns[f"{x}{k + 1}"][rows] for k in range(n)], 1) for x in ("q", "dq", "tau")
    )


@pytest.mark.slow
@pytest.mark.parametrize("arm", ["3r", "6r", "7r"])
def test_torchid_explains_a_log_without_effects(arm, tmp_path):
    case = simulate_case(quiet(arm))
    path = tmp_path / "robot.urdf"
    path.write_text(case.urdf)
    robot = load_robot(path)
    q, dq, tau = signals(case.columns, robot.n)
    ddq = np.gradient(dq, 1e-3, axis=0)
    motion = Motion(*(torch.tensor(x, dtype=torch.float64) for x in (q, dq, ddq)))
    model = model_torque(robot, nominal_effects(robot), motion).numpy()
    # Within two samples of a reversal the differences are of two branches of the friction.
    moves = np.abs(dq) > 0.02
    error = np.where(moves, tau - model, 0.0)
    for j in range(robot.n):
        assert np.sqrt(np.mean(error[:, j] ** 2)) < 1e-3 * np.sqrt(np.mean(tau[:, j] ** 2)), j


def test_known_friction_is_fc_sign_dq_plus_fv_dq_where_it_moves(bench):
    scene, base, nominal = bench
    truth = simulated(scene, base, nominal, STEP)[0].truth
    rest = truth.tau - nominal.rigid(truth.q, truth.dq, truth.ddq)
    law = base.known_damping * truth.dq + base.known_friction * np.sign(truth.dq)
    moves = np.abs(truth.dq) > 0.02
    # Mean, for the step at which friction turns is in between.
    assert np.abs((rest - law)[moves]).mean() < 1e-3 * np.abs(truth.tau).mean()


def test_a_round_trip_without_friction_takes_no_work(bench):
    scene, base, nominal = bench
    from dataclasses import replace

    zeros = np.zeros(3)
    plant = replace(base.plant, damping=zeros, friction=zeros)
    truth = simulated(scene, Plan(plant, zeros, zeros), nominal, STEP)[0].truth
    power = (truth.tau * truth.dq).sum(1)
    assert abs(power.sum()) < 2e-3 * np.abs(power).sum()
