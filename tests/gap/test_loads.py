"""A load is told as a body, beside the one that the robot's file has, and goes into every file."""

from dataclasses import replace
from functools import cache

import mujoco
import pytest
import torch

import torchid
from tests.gap.small_logs import ROBOT, Recording, arm, carrying, friction, logged
from torchid.effects.inertia import Payload
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.log.model import Log
from torchid.results.words import PAYLOAD
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.robot.yaml_file import from_mapping

pytestmark = pytest.mark.usefixtures("types_unchecked")

ALONE = torchid.GapSettings(effects=(PAYLOAD,), parameters="trusted")
SOME = torchid.GapSettings(effects=("viscous_friction", PAYLOAD, "link_inertia"))
MASS, PLACE, INERTIA = 0.5, (0.2, 0.05, 0.05), 0.004
LOAD = carrying(MASS, PLACE, INERTIA).parameters.pi[-1] - ROBOT.parameters.pi[-1]
GIVEN = arm(Payload().record(LOAD.tolist()))
"""The 3R with a load, which its file has beside the link."""


def load_in(found: TorqueDiagnosis) -> InertialParameters:
    """The one load of a corrected model."""
    (own,) = (e for e in found.corrected.effects if e["effect"] == PAYLOAD)
    return InertialParameters(torch.tensor([[own[c.name] for c in Payload.coefficients]]).double())


@pytest.mark.parametrize("to", ["mjcf", "urdf"])
def test_a_point_on_the_tip_of_two_joints_goes_into_a_file(to, tmp_path):
    """Six of its ten numbers make no torque, Jyy = m x^2 among them: no motion in a plane tells
    them, and left at zero they are no body's."""
    joint, link = {"type": "R", "alpha": 0, "d": 0, "theta": 0}, [0.002, 0, 0, 0.04, 0, 0.04]
    robot = from_mapping(
        {
            "name": "two",
            "gravity": [0, -9.81, 0],
            "dh": {"convention": "modified", "joints": [joint | {"a": 0}, joint | {"a": 0.4}]},
            "parameters": {
                "mass": [3, 1.5],
                "com": [[0.2, 0, 0]] * 2,
                "inertia_about_com": [link] * 2,
            },
            "limits": {"position": [2.5, 2.5], "velocity": [3, 3], "acceleration": [10, 10]},
        },
        "two",
    )
    runs = [random_trajectory(robot, seed, duration=8.0, fill=True) for seed in (0, 1)]
    motion = Log.concatenate([trajectory_log(run, 100.0) for run in runs])
    log = torchid.simulate(carrying(1.0, (0.4, 0.0, 0.0), 0.0, robot), motion)
    found = torchid.diagnose(robot, log, settings=ALONE, force=True)
    (cause,) = found.causes
    assert cause.parameters["m"] == load_in(found).mass.item() == pytest.approx(1.0, rel=0.01)
    done = torchid.export_dynamics(found.corrected, to, tmp_path, nominal=robot)
    model = mujoco.MjModel.from_xml_path(str(done.files[0]))
    assert model.body_mass.sum() == pytest.approx(5.5, rel=0.01)


@cache
def beside(left: float) -> TorqueDiagnosis:
    """Of an arm that carries a share of the load that its file has."""
    real = carrying(left * MASS, PLACE, left * INERTIA)
    return torchid.diagnose(GIVEN, logged(real, Recording(runs=(0, 1))), settings=SOME, force=True)


@pytest.mark.parametrize("left", [0.0, 0.4, 1.6])
def test_a_load_of_the_file_is_told_before_and_after(left, tmp_path):
    found = beside(left)
    (cause,) = found.causes
    assert (cause.effect, cause.ambiguous_with) == (PAYLOAD, ("link_inertia",))
    mass, *_ = cause.sizes
    assert (mass.was, mass.determined) == (pytest.approx(MASS), True)
    assert mass.value == load_in(found).mass.item() == pytest.approx(left * MASS, abs=0.01)
    # The link is as it was, and the load, though gone, a body.
    torch.testing.assert_close(found.corrected.parameters.pi, ROBOT.parameters.pi)
    assert load_in(found).consistency_margin().item() > 0
    assert not any("rigid body" in w for w in found.warnings)
    torchid.export_dynamics(found.corrected, "mjcf", tmp_path, nominal=ROBOT)


def test_a_load_of_the_file_that_is_there_stays_one(tmp_path):
    found = beside(1.0)
    assert not found.causes
    torch.testing.assert_close(load_in(found).pi[0], LOAD)
    torchid.export_dynamics(found.corrected, "mjcf", tmp_path, nominal=ROBOT)


def hanging(mass: float) -> Robot:
    """With a load on a rope: its weight pulls, and it does not turn with the link."""
    pi = ROBOT.parameters.pi.clone()
    pi[-1, :2] += torch.tensor([mass, 0.3 * mass])
    return ROBOT.with_parameters(InertialParameters(pi))


@pytest.mark.parametrize(
    ("real", "doubted"),
    [
        (hanging(0.5), True),
        (carrying(0.5, (0.3, 0.0, 0.0), 0.0), False),
        (replace(carrying(0.5, (0.3, 0.0, 0.0), 0.0), effects=(friction(2, Fv=2.0),)), False),
    ],
    ids=["on a rope", "a point", "a point beside friction"],
)
def test_a_load_that_is_no_body_is_in_doubt(real, doubted):
    log = logged(real, Recording(runs=(0, 1)))
    found = torchid.diagnose(ROBOT, log, settings=ALONE, force=True)
    assert [c.effect for c in found.causes] == [PAYLOAD]
    assert load_in(found).consistency_margin().item() > 0
    said = [w for w in found.warnings if "the load is no rigid body here" in w]
    assert len(said) == doubted
    assert all("N m on joint" in w for w in said)
