"""The block to copy: what an XML reader and MuJoCo make of it."""

from dataclasses import replace

import pytest
from lxml import etree

from torchid.report.exported import simulator_block
from torchid.robot.library import load_robot

EFFECTS = (
    {"effect": "viscous_friction", "joint": 1, "Fv": 0.5},
    {"effect": "coulomb_friction", "joint": 1, "Fc": 0.25},
    {"effect": "rotor_inertia", "joint": 2, "Ia": 0.125},
    {"effect": "load_dependent_friction", "joint": 3, "mu": 0.05},
)


@pytest.fixture(scope="module")
def text():
    robot = load_robot("3r")
    names = ("shoulder", 'a"b<c', "wrist")
    return simulator_block(replace(robot, joint_names=names, effects=EFFECTS))


def test_an_xml_reader_finds_every_number(text):
    joints = etree.fromstring(f"<all>{text}</all>").findall("joint")
    assert [j.get("name") for j in joints] == 2 * ["shoulder", 'a"b<c', "wrist"]
    assert dict(joints[0].attrib) == {"name": "shoulder", "damping": "0.5", "frictionloss": "0.25"}
    assert joints[1].get("armature") == "0.125"
    assert dict(joints[3].find("dynamics").attrib) == {"damping": "0.5", "friction": "0.25"}
    mjcf, urdf = text.split("<!-- URDF")
    assert "no field for: load_dependent_friction" in mjcf
    assert "rotor_inertia" in urdf.split("no field for")[1]


def test_mujoco_takes_the_joints(text):
    import mujoco

    joint = text.splitlines()[1]
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody><body>{joint}<geom size='.1'/></body></worldbody></mujoco>"
    )
    assert (model.dof_damping[0], model.dof_frictionloss[0]) == (0.5, 0.25)
