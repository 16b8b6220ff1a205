"""Errors per joint, by hand."""

import numpy as np
import pytest
import torch
from scipy.signal import butter, sosfiltfilt

from tests.excitation.test_excitation import random_arm
from tests.identification.test_rows import EFFECTS, a_log, arm
from torchid.design.motion import measurements, moves
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.registry import on_every_joint
from torchid.excitation.synthetic import HonestNoise
from torchid.identification.base_parameters import base_parameters, random_states, stacked_regressor
from torchid.identification.model import model_torque
from torchid.identification.rows import at_ease
from torchid.identification.validation import errors, predict
from torchid.log.model import Log
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot

ROBOT = load_robot("3r_friction")
KINDS = on_every_joint(EFFECTS, 3)
BASE = base_parameters(ROBOT, KINDS)


def values(seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(len(BASE), generator=generator, dtype=torch.float64)


def log() -> Log:
    return a_log(ROBOT, rates=(100.0, 50.0), durations=(10.0, 14.0), noise=HonestNoise(1e-4, 0.1))


@pytest.mark.parametrize("robot", [ROBOT, random_arm(4, "RPRP")], ids=["3r", "RPRP"])
def test_the_model_torque_is_that_of_any_full_set_with_these_base_parameters(robot):
    kinds = on_every_joint(EFFECTS, robot.n)
    base = base_parameters(robot, kinds)
    motion = random_states(robot, 3, 40)
    generator = torch.Generator().manual_seed(1)
    full = torch.randn(len(base.parameter_names), generator=generator, dtype=torch.float64)
    expected = (stacked_regressor(robot, kinds, motion) @ full).reshape(-1, robot.n)
    got = model_torque(robot, base, kinds, base.project(full), motion)
    assert torch.allclose(got, expected, atol=1e-10 * float(expected.abs().max()))
    rigid = 10 * robot.n
    bare = base_parameters(robot)
    alone = model_torque(robot, bare, (), bare.project(full[:rigid]), motion)
    pi = InertialParameters.from_paper_order(full[:rigid])
    assert torch.allclose(alone, inverse_dynamics(robot, *motion.state, pi), atol=1e-9)


def by_hand(cutoff: float | None) -> dict[str, np.ndarray]:
    measured, predicted, raw, raw_predicted, moving = [], [], [], [], []
    for m in measurements(log(), cutoff):
        model = model_torque(ROBOT, BASE, KINDS, values(), at_ease(m).motion).numpy()
        tau = m.tau.numpy()
        middle = slice(m.edge, m.samples - m.edge)
        filtered = [tau, model]
        if cutoff is not None:
            sos = butter(4, cutoff, fs=m.rate, output="sos")
            pad = min(round(8 * m.rate / cutoff), m.samples - 1)
            filtered = [sosfiltfilt(sos, x, axis=0, padlen=pad) for x in filtered]
        measured.append(filtered[0][middle])
        predicted.append(filtered[1][middle])
        raw.append(tau[middle])
        raw_predicted.append(model[middle])
        moving.append(m.motion.dq.abs().numpy()[middle] > 0.02)
    y, p, r, rp, on = (np.concatenate(x) for x in (measured, predicted, raw, raw_predicted, moving))
    columns = range(3)
    norm = np.linalg.norm
    return {
        "rmse": np.sqrt(np.mean((y - p) ** 2, axis=0)),
        "relative_percent": 100 * norm(y - p, axis=0) / norm(y, axis=0),
        "relative_percent_moving": np.array(
            [100 * norm((y - p)[on[:, j], j]) / norm(y[on[:, j], j]) for j in columns]
        ),
        "relative_percent_raw": 100 * norm(r - rp, axis=0) / norm(r, axis=0),
        "standstill_fraction": 1 - on.mean(0),
        "standstill_error_share": np.array(
            [norm((y - p)[~on[:, j], j]) ** 2 / norm((y - p)[:, j]) ** 2 for j in columns]
        ),
    }


@pytest.mark.parametrize("cutoff", [None, 3.0, 8.0])
def test_errors_by_hand(cutoff):
    found = errors([predict(m, ROBOT, BASE, KINDS, values()) for m in measurements(log(), cutoff)])
    assert found.trajectories == log().names
    for name, expected in by_hand(cutoff).items():
        got = getattr(found, name)
        assert got.dtype == torch.float64
        assert got.tolist() == pytest.approx(expected.tolist(), rel=1e-5), name
    assert 0 < float(found.standstill_fraction.max()) < 0.5


def test_a_prediction_leaves_out_the_edges():
    (m, _) = measurements(log(), 4.0)
    found = predict(m, ROBOT, BASE, KINDS, values())
    middle = slice(25, m.samples - 25)
    assert m.edge == 25
    assert torch.equal(found.t, m.t[middle])
    assert torch.equal(found.moving, moves(m.whole)[middle])
    assert found.measured.shape == found.predicted.shape == (m.samples - 50, 3)
    assert found.name == m.name


def test_a_perfect_model():
    robot = arm("kuka_lwr4")
    base = base_parameters(robot)
    exact = base.project(robot.parameters.to_paper_order())
    found = errors([predict(m, robot, base, (), exact) for m in measurements(a_log(robot), None)])
    assert float(found.rmse.max()) < 1e-10
    assert float(found.relative_percent_raw.max()) < 1e-8


def test_a_joint_that_never_moves_has_no_error_of_moving_rows():
    still = log()
    signals = {"q": still.q.clone()}
    signals["q"][:, 1] = 0.3
    measured = measurements(still.replace(**signals), 4.0)
    found = errors([predict(m, ROBOT, BASE, KINDS, values()) for m in measured])
    assert torch.isnan(found.relative_percent_moving).tolist() == [False, True, False]
    assert float(found.standstill_fraction[1]) == 1.0
    assert float(found.standstill_error_share[1]) == pytest.approx(1.0)
    assert bool(torch.isfinite(found.relative_percent).all())
