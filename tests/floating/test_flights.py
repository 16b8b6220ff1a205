"""A base that moves and is measured: identification and diagnosis of flights that MuJoCo makes."""

import numpy as np
import pytest
import torch

import torchid
from tests.floating import flown
from torchid.errors import LogError, RobotError
from torchid.feasibility.sets import nominal_set
from torchid.fleet.model import FleetModel
from torchid.identification.base_parameters import nominal_values
from torchid.log.readers import log_from_columns
from torchid.robot.library import load_robot

GAP = torchid.GapSettings(effects=("link_inertia", "viscous_friction", "coulomb_friction"))


@pytest.fixture(scope="module")
def columns():
    return flown.flights(heavier=0.0, count=4, seed=1, noise=0.01)


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory):
    return load_robot(flown.write(tmp_path_factory.mktemp("hull")), base="moving")


@pytest.fixture(scope="module")
def identified(robot, columns):
    log = log_from_columns(columns, "flights.csv")
    return torchid.identify(robot, log, settings=torchid.Settings(effects=()))


def test_mujocos_free_body_is_the_moving_base(robot):
    assert (robot.n, len(robot.driven)) == (12, 6)
    assert robot.link_names[5] == "hull"
    assert float(robot.parameters.pi[5, 0]) == 4.0


def test_a_log_holds_the_base_before_the_joints(columns):
    log = log_from_columns(columns, "flights.csv")
    assert log.n == 12
    assert not log.tau[:, :6].any()
    np.testing.assert_array_equal(log.q[:, 0], columns["base_x"])
    # Rates of the coordinates are the derivatives of them.
    rows = slice(10, 1000)
    slope = np.gradient(log.q[:, 3:6].numpy(), 1 / flown.RATE, axis=0)
    np.testing.assert_allclose(slope[rows], log.dq[rows, 3:6], atol=0.02)


@pytest.mark.slow
def test_all_parameters_of_the_base_are_identified(robot, identified):
    found = identified
    expected = nominal_values(robot, found.base)
    names = list(found.base.names)
    # The mass of all of it, which a robot in a stand never shows.
    total = next(k for k, name in enumerate(names) if "m6 " in f"{name} ")
    assert float(found.values[total]) == pytest.approx(float(expected[total]), rel=0.02)
    error = (found.values - expected).norm() / expected.norm()
    assert float(error) < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("heavier", [pytest.param(0.0, marks=pytest.mark.slow), 0.3])
def test_a_wrong_forearm_is_named_and_nothing_else(robot, heavier):
    log = log_from_columns(flown.flights(heavier, count=4, seed=2, noise=0.01), "flights.csv")
    found = torchid.diagnose(robot, log, settings=GAP)
    named = [link for one in found.which if one.effect == "link_inertia" for link in one.at]
    fore = robot.link_names.index("left_fore")
    assert named == ([robot.own_links.index(fore)] if heavier else [])
    assert {one.effect for one in found.which} <= {"link_inertia"}


def test_a_moving_base_that_was_not_measured_is_one_error(robot, columns):
    joints = {k: v for k, v in columns.items() if not k.startswith("base_")}
    log = log_from_columns(joints, "flights.csv")
    with pytest.raises(LogError, match="does not hold the motion of the base") as raised:
        torchid.identify(robot, log)
    assert "base_qw" in raised.value.expected


def test_a_measured_base_of_a_robot_that_is_held_is_one_error(tmp_path, columns):
    held = load_robot(flown.write(tmp_path))
    with pytest.raises(LogError, match="another number of joints") as raised:
        torchid.identify(held, log_from_columns(columns, "flights.csv"))
    assert "base='moving'" in raised.value.hint


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"base_qw": None}, "part of the base's pose"),
        ({"base_qx": 1.0}, "no unit quaternion"),
        ({"base_qx": 0.0, "base_qy": 0.7, "base_qz": 0.0, "base_qw": 0.714}, "pitches too far"),
    ],
)
def test_poses_that_are_none_are_refused(columns, changed, words):
    bad = {k: v for k, v in columns.items() if changed.get(k, 0.0) is not None}
    for name, value in changed.items():
        if value is not None:
            bad[name] = np.full_like(columns["t"], value)
    with pytest.raises(LogError, match=words):
        log_from_columns(bad, "flights.csv")


def test_without_a_twist_velocities_are_left_out(columns):
    less = {k: v for k, v in columns.items() if k != "base_wz"}
    log = log_from_columns(less, "flights.csv")
    assert log.dq is None
    assert "dq left out" in log.warnings[0]
    assert torch.equal(log.q[:, 6:], log_from_columns(columns, "flights.csv").q[:, 6:])


def test_a_moving_base_is_written_and_read_back(robot, tmp_path):
    torchid.write_robot(robot, tmp_path / "flyer.yaml")
    again = load_robot(tmp_path / "flyer.yaml")
    assert (again.floating, again.free, again.bodies) == (True, robot.free, robot.bodies)
    assert torch.equal(again.before, robot.before)
    assert torch.equal(again.parameters.pi, robot.parameters.pi)


@pytest.mark.slow
def test_a_result_keeps_how_its_base_was_taken(identified, tmp_path):
    found = identified
    found.save(tmp_path / "found.json")
    again = torchid.load(tmp_path / "found.json")
    assert again.model.floating
    percent = found.fit.relative_percent
    assert bool(percent[:6].isnan().all())
    assert bool((percent[6:] < 5).all())


@pytest.mark.parametrize(
    "use",
    [
        lambda robot, log: torchid.excite(robot),
        torchid.simulate,
        lambda robot, log: torchid.payload(robot, None, log),
        lambda robot, log: torchid.diagnose(robot, log.replace(tau=None, u=log.q)),
        lambda robot, log: torchid.check(robot),
        torchid.examine,
        lambda robot, log: torchid.equal_torque_study(robot),
        lambda robot, log: torchid.compare_wrenches(robot, nominal_set(robot)),
        lambda robot, log: torchid.compare_pair(log, log, robot),
        lambda robot, log: FleetModel(robot),
    ],
)
def test_what_cannot_have_a_moving_base_is_refused(robot, columns, use):
    with pytest.raises(RobotError, match="a base that moves, which"):
        use(robot, log_from_columns(columns, "flights.csv"))


@pytest.mark.slow
def test_no_motion_is_designed_for_a_moving_base(identified):
    with pytest.raises(RobotError, match="a base that moves, which"):
        torchid.excite_for(identified)
