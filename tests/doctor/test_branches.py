"""Left and right that are exchanged in the log are found by the robot's own parameters."""

from dataclasses import replace

import pytest
import torch

import torchid
from tests.trees import front_legs, legs_log, two_arms
from torchid.doctor.branches import alike
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot

ORDER = [3, 4, 5, 0, 1, 2]


@pytest.fixture(scope="module")
def legs(tmp_path_factory):
    return front_legs(tmp_path_factory.mktemp("front"))


def exchanged(robot, log):
    return [c for c in torchid.examine(robot, log).checks if c.name == "branches exchanged"]


@pytest.mark.nightly
@pytest.mark.usefixtures("types_unchecked")
def test_exchanged_legs_are_found_and_mended(legs):
    log = legs_log(legs, 4)
    wrong = log.replace(q=log.q[:, ORDER], tau=log.tau[:, ORDER])
    # The masses of the model are wrong by up to 20 %, as a maker's are.
    draw = torch.Generator().manual_seed(1)
    scale = 0.8 + 0.4 * torch.rand(6, 1, generator=draw, dtype=torch.float64)
    model = replace(legs, parameters=InertialParameters(legs.parameters.pi * scale))
    (found,) = exchanged(model, wrong)
    assert (found.verdict, found.joints) == ("wrong", (0, 1, 2, 3, 4, 5))
    mended = torchid.examine(model, wrong).mended()
    assert torch.equal(mended.q, log.q)
    assert torch.equal(mended.tau, log.tau)
    assert not exchanged(model, log)
    assert not exchanged(model.with_parameters(None), wrong)  # free bodies fit either way


def test_branches_of_another_build_are_not_exchanged(legs, tmp_path):
    assert alike(legs) == [((0, 1, 2), (3, 4, 5))]
    assert alike(load_robot(two_arms(tmp_path), lock={"thumb_joint": 0.0})) == []
    assert alike(torchid.load_robot("3r")) == []
