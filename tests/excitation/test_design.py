"""Motions designed for a result: predictions against least squares, and against brute force."""

import json

import pytest
import torch

from tests.excitation.usage import limit_usage
from tests.fleet.records import identification
from torchid.errors import TorchidError
from torchid.excitation.design import (
    base_regressor,
    design_for,
    information,
    least_known,
    predicted_std,
)
from torchid.excitation.limits import motion_limits
from torchid.excitation.trajectories import random_trajectory
from torchid.identification.values import prior_of, read_identification
from torchid.robot.library import load_robot

PER_SECOND = 20.0


@pytest.fixture(scope="module")
def robot():
    return load_robot("3r_friction")


def prior_in(folder, robot, weight, undetermined=(), **settings):
    """Of a log of 200 random states of noise 0.1 N m; some parameters are not determined."""
    path = identification(folder / "a.json", 0, **settings)
    data = json.loads(path.read_text())
    whitening = (weight * torch.eye(3, dtype=torch.float64)).tolist()
    data["rows"] = {"seconds": 20.0, "per_second": PER_SECOND, "whitening": whitening}
    data["undetermined"] = list(undetermined)
    for k in map(data["base_names"].index, undetermined):
        for row in (*data["factor"], *data["covariance"]):
            row[k] = 0.0
        data["covariance"][k] = [0.0] * len(data["base_names"])
    path.write_text(json.dumps(data))
    return prior_of(read_identification(path), robot, "a file")


@pytest.fixture(scope="module")
def prior(robot, tmp_path_factory):
    return prior_in(tmp_path_factory.mktemp("prior"), robot, 10, blocks=100000)


def stacked(robot, prior, trajectory):
    motion = trajectory.at((torch.arange(200) + 0.5) / 20.0)
    return base_regressor(robot, prior.base, motion, effects=prior.effects) / 0.1


def test_prediction_is_least_squares_on_both_together(robot, prior):
    trajectory = random_trajectory(robot, 5, duration=10.0)
    both = prior.information + stacked(robot, prior, trajectory).T @ stacked(
        robot, prior, trajectory
    )
    expected = torch.linalg.inv(both).diagonal().sqrt()
    # The file's standard deviations are a sample of 100 000 degrees of freedom.
    torch.testing.assert_close(
        predicted_std(robot, prior, [trajectory]), expected, rtol=0.02, atol=0.0
    )
    torch.testing.assert_close(predicted_std(robot, prior, []), prior.std, rtol=1e-6, atol=0.0)


def test_information_is_per_second(robot, prior):
    """As many rows as the fit would have, however few instants are evaluated."""
    trajectory = random_trajectory(robot, 5, duration=10.0)
    fine, coarse = (
        information(robot, prior, trajectory, (torch.arange(k) + 0.5) * 10.0 / k)
        for k in (2000, 500)
    )
    torch.testing.assert_close(fine, coarse, rtol=0.02, atol=0.02 * float(fine.abs().max()))


@pytest.mark.parametrize("goal", ["a_optimal", "d_optimal"])
def test_the_design_beats_the_plain_one_within_the_limits(robot, prior, goal):
    found = design_for(robot, prior, seed=0, goal=goal, restarts=2, iterations=25, duration=8.0)
    assert float(limit_usage(found.trajectory.extremes(), motion_limits(robot)).max()) <= 1.0
    assert bool((found.after <= found.before).all())
    if goal == "a_optimal":
        assert found.shrinks(found.after) <= found.shrinks(found.with_plain) * 1.001
        assert bool((found.targets == least_known(prior)).all())
    else:
        t = (torch.arange(200) + 0.5) * 8.0 / 200
        told = [information(robot, prior, x, t) for x in (found.trajectory, found.plain)]
        volumes = [torch.linalg.slogdet(prior.information + n).logabsdet for n in told]
        assert volumes[0] >= volumes[1] - 1e-6


def test_what_the_log_did_not_determine_is_a_target(robot, tmp_path):
    prior = prior_in(tmp_path, robot, 1, ["Fv3"])
    k = prior.base.names.index("Fv3")
    assert bool(least_known(prior)[k])
    found = predicted_std(robot, prior, [random_trajectory(robot, 1)])
    assert bool(torch.isfinite(found).all())
    assert float(found[k]) < 10


def test_an_older_result_is_refused_with_what_to_do(robot, tmp_path):
    path = identification(tmp_path / "a.json", 0)
    with pytest.raises(TorchidError, match="how its rows were weighted") as caught:
        prior_of(read_identification(path), robot, "a file")
    assert "torchid identify" in caught.value.hint
