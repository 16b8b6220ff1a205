"""Units that files mix up, planted in robots whose answers are known."""

from dataclasses import replace

import pytest
import torch

from tests.trees import package_urdfs
from torchid.feasibility.plausibility import bodies
from torchid.feasibility.record import check
from torchid.feasibility.units import unit_findings
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot
from torchid.robot.model import Limits

ARMS = ("3r", "kuka_lwr4", "ur10e")


def planted(name, *, mass=1.0, inertia=1.0, com=1.0, joints=1.0, links=slice(None)):
    """A built-in robot whose numbers are so many times what they should be."""
    robot = load_robot(name)
    p = robot.parameters
    m, c, i = p.mass.clone(), p.com.clone(), p.inertia_about_com.clone()
    m[links] *= mass
    c[links] *= com
    i[links] *= inertia
    before, after, tool = robot.before.clone(), robot.after.clone(), robot.tool.clone()
    for pose in (before, after, tool):
        pose[..., :3, 3] *= joints
    return replace(
        robot,
        parameters=InertialParameters.from_com(m, c, i),
        before=before,
        after=after,
        tool=tool,
    )


def sentences(robot):
    return [finding.sentence for finding in unit_findings(robot)]


@pytest.mark.parametrize("name", ARMS)
def test_arms_as_they_are_have_no_findings(name):
    assert sentences(load_robot(name)) == []


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"inertia": 1e6}, "inertias in kg mm^2"),
        ({"inertia": 1e4}, "inertias in kg cm^2"),
        ({"inertia": 1e9}, "inertias in g mm^2"),
        ({"inertia": 1e3}, "inertias 1000 times too large"),
        ({"inertia": 1e-3}, "inertias 1000 times too small"),
        ({"mass": 1e3}, "masses in g for kg"),
        ({"mass": 1e3, "inertia": 1e3}, "inertias in g m^2"),
        ({"mass": 1e3, "inertia": 1e9}, "inertias in g mm^2"),
        ({"com": 1e3}, "mm for m"),
        ({"com": 100.0}, "cm for m"),
        ({"joints": 1e3}, "places of joints in mm"),
        ({"joints": 1e3, "com": 1e3, "inertia": 1e6}, "lengths in mm for m"),
    ],
)
def test_what_all_links_have_in_another_unit_is_named(name, wrong, words):
    said = sentences(planted(name, **wrong))
    assert len(said) == 1, said
    assert words in said[0]
    # Links that no body can be, as three of the LWR's, have no density.
    assert said[0].startswith("'link_1', 'link_2'")


@pytest.mark.parametrize("name", ["3r", "kuka_lwr4"])
def test_ten_times_the_inertia_is_named(name):
    (said,) = sentences(planted(name, inertia=10.0))
    assert "inertias 10 times too large" in said


@pytest.mark.parametrize("wrong", [{"inertia": 1e6}, {"com": 1e3}, {"mass": 1e3}])
def test_one_link_in_another_unit_is_named_alone(wrong):
    robot = planted("kuka_lwr4", links=slice(1, 2), **wrong)
    (found,) = unit_findings(robot)
    assert found.link == 2
    assert found.sentence.startswith(f"'{robot.link_names[1]}': ")


def test_masses_that_no_limit_of_torque_holds_are_told():
    robot = load_robot("3r")
    zero = torch.zeros(3, 6, dtype=torch.float64)
    points = InertialParameters.from_com(1e3 * robot.parameters.mass, robot.parameters.com, zero)
    heavy = replace(robot, parameters=points)
    assert sentences(replace(heavy, limits=Limits())) == []
    assert all("its limit is" in said for said in sentences(heavy.with_limits(torque=60.0)))
    assert sentences(heavy.with_limits(torque=60.0))


def test_massless_and_tiny_links_are_no_findings_and_no_violation():
    robot = load_robot("3r")
    pi = robot.parameters.pi.clone()
    pi[1] = 0.0
    framed = replace(robot, parameters=InertialParameters(pi))
    assert sentences(framed) == []
    found = check(framed)
    assert found.feasibility.feasible.tolist() == [True]
    assert found.record.sets[0].links[1].mass == 0.0
    tiny = pi.clone()
    tiny[1] = 1e-4 * robot.parameters.pi[1]
    assert sentences(replace(robot, parameters=InertialParameters(tiny))) == []
    # Some mass alone is a point, and no inertia alone a body.
    pi[1, 0] = 1.0
    assert not bool(check(replace(robot, parameters=InertialParameters(pi))).feasibility.feasible)


def test_check_has_the_same_findings():
    robot = planted("3r", inertia=1e6)
    said = [finding.sentence for finding in check(robot).findings[0]]
    assert set(sentences(robot)) <= set(said)


def test_meshes_in_millimetres_are_told(tmp_path):
    solid = "".join(
        f"facet normal 0 0 1\nouter loop\n{corners}endloop\nendfacet\n"
        for corners in (
            "vertex -50 -50 0\nvertex 50 -50 0\nvertex 0 50 300\n",
            "vertex -50 -50 0\nvertex 50 50 0\nvertex 0 50 300\n",
        )
    )
    (tmp_path / "link.stl").write_text(f"solid a\n{solid}endsolid a\n")
    text = """<robot name="arm"><link name="base"/><link name="l1"><inertial><mass value="2"/>
<origin xyz="0 0 0.15"/><inertia ixx="0.02" iyy="0.02" izz="0.003" ixy="0" ixz="0" iyz="0"/>
</inertial><visual><geometry><mesh filename="link.stl"{}/></geometry></visual></link>
<link name="tool"/><joint name="j" type="revolute"><parent link="base"/><child link="l1"/>
<limit lower="-1" upper="1" effort="9" velocity="1"/></joint><joint name="f" type="fixed">
<parent link="l1"/><child link="tool"/><origin xyz="0 0 0.3"/></joint></robot>"""
    path = tmp_path / "arm.urdf"
    for scale, told in (("", True), (' scale="0.001 0.001 0.001"', False)):
        path.write_text(text.format(scale))
        said = [f.sentence for f in check(path).findings[0] if f.what == "units"]
        assert ["meshes in mm" in s for s in said] == [True] * told


@pytest.mark.slow
@pytest.mark.skipif(not package_urdfs(), reason="needs the package example-robot-data")
def test_published_arms_have_no_findings():
    arms = ("panda.urdf", "z1.urdf", "xarm7.urdf", "so101.urdf", "ur10_robot.urdf", "go2.urdf")
    tried = [path for path in package_urdfs() if path.name in arms]
    assert len(tried) >= 5
    assert {path.name: sentences(load_robot(path)) for path in tried} == {
        path.name: [] for path in tried
    }


@pytest.mark.parametrize("links", [slice(None), slice(1, 2)])
def test_links_as_dense_as_steel_are_named_with_their_share_of_the_mass(links):
    """An export of solid parts: masses and inertias times one factor, the shape is right."""
    robot = load_robot("kuka_lwr4")
    own = bodies(robot.parameters).density[links]
    factor = 6000.0 / float(own[torch.isfinite(own)].quantile(0.5))
    (found,) = unit_findings(planted("kuka_lwr4", mass=factor, inertia=factor, links=links))
    assert found.link == (2 if links == slice(1, 2) else None)
    assert "'link_2'" in found.sentence
    assert "of the" in found.sentence
    assert "nearly solid steel; compare their mass with the maker's" in found.sentence


GRIPPER = """<joint name="mount" type="fixed"><parent link="l1"/><child link="gripper"/>
<origin xyz="0 0 0.3"/></joint><link name="gripper"><inertial><mass value="0.9"/>
<origin xyz="0 0 0.05"/><inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/>
</inertial></link>"""


@pytest.mark.parametrize("rest", ["", GRIPPER])
def test_a_link_too_light_for_its_inertia_has_two_remedies_also_where_another_is_fixed_to_it(
    tmp_path, rest
):
    """7 g with the inertia of a bar of 0.7 kg, 0.3 m long: 0.00525 kg m^2, 0.09 m of gyration."""
    path = tmp_path / "arm.urdf"
    path.write_text(f"""<robot name="arm"><link name="base"/><link name="l1"><inertial>
<mass value="0.007"/><origin xyz="0 0 0.15"/><inertia ixx="0.00525" iyy="0.00525" izz="0.0003"
ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="j" type="revolute"><parent link="base"/>
<child link="l1"/><limit lower="-1" upper="1" effort="9" velocity="1"/></joint><link name="tool"/>
<joint name="f" type="fixed"><parent link="l1"/><child link="tool"/><origin xyz="0 0 0.3"/></joint>
{rest}</robot>""")
    robot = load_robot(path, tip="tool")
    (found,) = unit_findings(robot)
    assert found.link == 1
    assert found.sentence.startswith("'l1': ")
    assert "inertias 1000 times too large" in found.sentence
    mass = float(found.sentence.split("or like another mass: ")[1].split()[0])
    assert mass == pytest.approx(0.7, rel=0.2)
    assert found.sentence.endswith(f"{mass:g} kg has this inertia")
