import pickle

import pytest
import torch

from torchid.errors import RobotError
from torchid.robot.library import built_in_robots, load_robot
from torchid.robot.model import link_poses


def test_the_built_in_robots_are_there():
    report = {"3r", "3r_friction", "kuka_lwr4", "kuka_lwr4_friction"}
    assert report | {"panda", "ur10e"} <= set(built_in_robots())
    assert built_in_robots() == sorted(built_in_robots())


@pytest.mark.parametrize("name", built_in_robots())
def test_a_built_in_robot_is_complete(name):
    robot = load_robot(name)
    assert robot.name == name
    assert robot.before.shape == robot.after.shape == (robot.n, 4, 4)
    # The report's arms are the ones with published masses.
    if name.startswith(("3r", "kuka")):
        assert robot.parameters.pi.shape == (robot.n, 10)
    assert robot.limits.position.shape == robot.limits.velocity.shape == (robot.n, 2)
    poses = link_poses(robot, torch.zeros(robot.n, dtype=torch.float64))
    rotations = poses[:, :3, :3]
    eye = torch.eye(3, dtype=torch.float64)
    assert (rotations @ rotations.transpose(1, 2) - eye).abs().max() < 1e-12


def test_the_friction_variant_differs_in_its_effects_only():
    plain, friction = load_robot("3r"), load_robot("3r_friction")
    assert plain.effects == ()
    assert len(friction.effects) == 9
    assert plain.before.equal(friction.before)
    assert plain.parameters.pi.equal(friction.parameters.pi)


def test_3r_stretched_out():
    # Table 3.1: d1 = 0.3, a2 = 0.22, a3 = 0.15, alpha1 = 90 degrees.
    robot = load_robot("3r")
    pose = link_poses(robot, torch.zeros(3, dtype=torch.float64))[-1]
    assert torch.allclose(pose[:3, 3], torch.tensor([0.37, 0.0, 0.3], dtype=torch.float64))
    up = link_poses(robot, torch.tensor([0.0, torch.pi / 2, 0.0], dtype=torch.float64))[-1]
    assert torch.allclose(up[:3, 3], torch.tensor([0.0, 0.0, 0.67], dtype=torch.float64))


def test_an_unknown_name_lists_the_built_in_ones():
    with pytest.raises(RobotError, match="unknown robot 'puma'") as raised:
        load_robot("puma")
    assert raised.value.available == built_in_robots()


def test_an_own_yaml_is_read(tmp_path):
    path = tmp_path / "mine.yml"
    path.write_text(
        "name: mine\ndh: {convention: modified, joints: [{a: 1}, {type: P}]}", encoding="utf-8"
    )
    assert load_robot(str(path)).name == "mine"
    with pytest.raises(RobotError, match="`tip="):
        load_robot(path, tip="link_1")


def test_a_tip_on_a_built_in_robot_is_refused():
    with pytest.raises(RobotError, match="`tip="):
        load_robot("3r", tip="link_1")


@pytest.mark.parametrize("name", ["kuka_lwr4_friction", "ur10e"])
def test_a_robot_goes_to_another_process(name):
    robot = load_robot(name)
    again = pickle.loads(pickle.dumps(robot))
    assert again.effects == robot.effects
    assert torch.equal(again.before, robot.before)


def test_a_result_is_no_robot_and_the_error_says_what_makes_one_of_it():
    with pytest.raises(RobotError, match=r"torchid export out/identification\.json --to urdf"):
        load_robot("out/identification.json")
