"""Boxes of the links' shapes, against corners and surfaces sampled in the tests."""

import math
import struct
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from torchid.errors import RobotError
from torchid.robot.library import load_robot
from torchid.robot.model import link_poses
from torchid.robot.placement import pose, roll_pitch_yaw
from torchid.robot.shapes import (
    SHORTEST,
    joint_points,
    link_lengths,
    link_shapes,
    own_inertials,
    reach,
)
from torchid.robot.solids import box, capsule, cylinder, ellipsoid, find_mesh, mesh_vertices, points

MASS = (
    '<inertial><mass value="{}"/>'
    '<inertia ixx="{}" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
)
REVOLUTE = (
    '<joint name="{}" type="revolute"><parent link="{}"/><child link="{}"/>'
    '<origin xyz="{}"/></joint>'
)
FIXED = (
    '<joint name="{}" type="fixed"><parent link="{}"/><child link="{}"/>'
    '<origin xyz="{}" rpy="{}"/></joint>'
)


def link(name, *shapes, mass=1.0, ixx=1.0, tag="collision"):
    drawn = "".join(
        f'<{tag}><origin xyz="{xyz}" rpy="{rpy}"/><geometry>{geometry}</geometry></{tag}>'
        for geometry, xyz, rpy in shapes
    )
    return f'<link name="{name}">{MASS.format(mass, ixx) if mass else ""}{drawn}</link>'


def at(geometry, xyz="0 0 0", rpy="0 0 0"):
    return geometry, xyz, rpy


def robot_of(folder, *parts):
    path = folder / "arm.urdf"
    path.write_text(f'<robot name="arm"><link name="base"/>{"".join(parts)}</robot>')
    return load_robot(path)


def one(folder, *shapes, **more):
    return robot_of(folder, link("a", *shapes, **more), REVOLUTE.format("j", "base", "a", "0 0 1"))


def box_of(*corners):
    return torch.tensor(corners, dtype=torch.float64)


@pytest.mark.parametrize(
    ("geometry", "expected", "volume"),
    [
        ('<box size="0.2 0.4 0.6"/>', [[-0.1, 0.1], [-0.2, 0.2], [-0.3, 0.3]], 0.048),
        ('<sphere radius="0.1"/>', [[-0.1, 0.1]] * 3, 4 / 3 * math.pi * 1e-3),
        (
            '<cylinder radius="0.1" length="0.5"/>',
            [[-0.1, 0.1], [-0.1, 0.1], [-0.25, 0.25]],
            math.pi * 0.01 * 0.5,
        ),
        (
            '<capsule radius="0.1" length="0.5"/>',
            [[-0.1, 0.1], [-0.1, 0.1], [-0.35, 0.35]],
            math.pi * 0.01 * 0.5 + 4 / 3 * math.pi * 1e-3,
        ),
    ],
)
def test_primitives_along_the_axes(tmp_path, geometry, expected, volume):
    shapes = link_shapes(one(tmp_path, at(geometry, "0.3 0 -0.1")))
    moved = torch.tensor(expected, dtype=torch.float64) + torch.tensor(
        [[0.3], [0.0], [-0.1]], dtype=torch.float64
    )
    torch.testing.assert_close(shapes.boxes[0], moved)
    assert float(shapes.volumes[0]) == pytest.approx(volume)
    assert shapes.kinds == ("collision",)
    assert shapes.warnings == ()


angles = st.floats(-3, 3)
sizes = st.floats(0.01, 2)


@settings(max_examples=25)
@given(angles, angles, angles, sizes, sizes)
def test_boxes_of_turned_solids_touch_their_surfaces(roll, pitch, yaw, radius, length):
    turned = pose(roll_pitch_yaw([roll, pitch, yaw]), [0.1, -0.2, 0.3])
    t = torch.linspace(0, 2 * math.pi, 721, dtype=torch.float64)
    ring = torch.stack([radius * t.cos(), radius * t.sin(), torch.zeros_like(t)], -1)
    top = torch.tensor([0.0, 0.0, length / 2], dtype=torch.float64)
    rims = torch.cat([ring + top, ring - top])
    u, v = torch.meshgrid(t[::4], t[:361:2], indexing="ij")
    ball = torch.stack([v.sin() * u.cos(), v.sin() * u.sin(), v.cos()], -1).reshape(-1, 3)
    semi = torch.tensor([radius, length, 0.5], dtype=torch.float64)
    for solid, surface in (
        (cylinder(turned, radius, length), rims),
        (capsule(turned, radius, length), torch.cat([radius * ball + top, radius * ball - top])),
        (ellipsoid(turned, semi), ball * semi),
        (
            box(turned, semi),
            torch.cartesian_prod(
                *(torch.tensor([-1.0, 1.0], dtype=torch.float64) * s for s in semi)
            ),
        ),
    ):
        sampled = surface @ turned[:3, :3].T + turned[:3, 3]
        found = torch.stack([sampled.amin(0), sampled.amax(0)], -1)
        torch.testing.assert_close(solid.box, found, atol=2e-3, rtol=0)
        assert (found[:, 0] >= solid.box[:, 0] - 1e-12).all()
        assert (found[:, 1] <= solid.box[:, 1] + 1e-12).all()


def test_collision_goes_before_visual(tmp_path):
    drawn = '<visual><geometry><sphere radius="9"/></geometry></visual>'
    solid = link("a", at('<sphere radius="0.1"/>')).replace("</link>", drawn + "</link>")
    robot = robot_of(tmp_path, solid, REVOLUTE.format("j", "base", "a", "0 0 1"))
    assert float(link_shapes(robot).boxes.max()) == pytest.approx(0.1)
    robot = one(tmp_path, at('<sphere radius="0.2"/>'), tag="visual")
    shapes = link_shapes(robot)
    assert shapes.kinds == ("visual",)
    assert float(shapes.boxes.max()) == pytest.approx(0.2)


def test_links_behind_fixed_joints_are_united_in_the_moving_links_frame(tmp_path):
    robot = robot_of(
        tmp_path,
        link("a", at('<box size="0.2 0.2 0.2"/>')),
        link("b", at('<box size="0.1 0.1 1.0"/>', "0 0 0.5")),
        link("c", at('<sphere radius="0.05"/>'), mass=0),
        REVOLUTE.format("j", "base", "a", "0 0 1"),
        FIXED.format("f", "a", "b", "0 0 0.1", f"{math.pi / 2} 0 0"),
        FIXED.format("g", "b", "c", "0 0 1", "0 0 0"),
    )
    # b's z is a's -y: its box reaches to y = -1, and c is a ball around (0, -1, 0.1).
    shapes = link_shapes(robot)
    expected = box_of([-0.1, 0.1], [-1.05, 0.1], [-0.1, 0.15])
    torch.testing.assert_close(shapes.boxes[0], expected)
    volume = 0.008 + 0.01 + 4 / 3 * math.pi * 0.05**3
    assert float(shapes.volumes[0]) == pytest.approx(volume)


def test_a_base_and_branches_off_the_chain_do_not_count(tmp_path):
    parts = (
        link("a", at('<sphere radius="0.1"/>')),
        link("b", at('<sphere radius="5"/>')),
        link("side", at('<sphere radius="7"/>')),
        REVOLUTE.format("j", "base", "a", "0 0 1"),
        REVOLUTE.format("k", "a", "b", "0 0 1"),
        REVOLUTE.format("s", "base", "side", "0 0 1"),
    )
    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="arm"><link name="base"/>{"".join(parts)}</robot>')
    assert float(link_shapes(load_robot(path, tip="a")).boxes.max()) == pytest.approx(0.1)


CUBE = [(x, y, z) for x in (0.0, 1.0) for y in (0.0, 2.0) for z in (0.0, 3.0)]


def write_stl(path, kind, corners=CUBE):
    """Triangles through the corners; only their corners are looked at."""
    faces = [(corners[i], corners[(i + 1) % 8], corners[(i + 3) % 8]) for i in range(8)]
    if kind == "binary":
        # Many exporters begin a binary file with "solid" too.
        head = b"solid made by some exporter".ljust(80) + struct.pack("<I", len(faces))
        body = [struct.pack("<12fH", 0, 0, 1, *(c for v in f for c in v), 0) for f in faces]
        path.write_bytes(head + b"".join(body))
    elif kind == "ascii":
        rows = [f"vertex {v[0]} {v[1]:e} {v[2]}" for f in faces for v in f]
        path.write_text("solid s\n facet normal 0 0 1\n" + "\n ".join(rows) + "\nendsolid s\n")
    else:
        path.write_text("# obj\n" + "".join(f"v {x} {y} {z}\nvn 9 9 9\n" for x, y, z in corners))


@pytest.mark.parametrize(
    ("kind", "name"), [("binary", "m.stl"), ("ascii", "m.STL"), ("obj", "m.obj")]
)
def test_meshes(tmp_path, kind, name):
    write_stl(tmp_path / name, kind)
    mesh = f'<mesh filename="{name}" scale="0.1 0.1 -0.1"/>'
    shapes = link_shapes(one(tmp_path, at(mesh, "0 0 1")))
    torch.testing.assert_close(shapes.boxes[0], box_of([0, 0.1], [0, 0.2], [0.7, 1.0]))
    assert float(shapes.volumes[0]) == pytest.approx(0.006)


@pytest.mark.parametrize(
    ("reference", "place"),
    [
        ("package://arm_description/meshes/m.stl", "arm_description/meshes/m.stl"),
        ("package://arm_description/meshes/m.stl", "arm_description/urdf/meshes/m.stl"),
        ("package://other/m.stl", "other/m.stl"),
        ("meshes/m.stl", "arm_description/urdf/meshes/m.stl"),
        ("../m.stl", "arm_description/m.stl"),
        ("file://{}/elsewhere/m.stl", "elsewhere/m.stl"),
    ],
)
def test_mesh_references(tmp_path, reference, place):
    urdf = tmp_path / "arm_description" / "urdf" / "arm.urdf"
    file = tmp_path / place
    for folder in (urdf.parent, file.parent):
        folder.mkdir(parents=True, exist_ok=True)
    file.write_text("")
    found = find_mesh(reference.format(tmp_path), urdf)
    assert found is not None
    assert found.samefile(file)
    assert find_mesh("package://arm_description/none.stl", urdf) is None
    assert find_mesh("https://example.org/m.stl", urdf) is None


@pytest.mark.parametrize(
    ("shape", "said"),
    [
        ('<mesh filename="none.stl"/>', "'none.stl' was not found"),
        ('<mesh filename="m.dae"/>', "is not read"),
        ('<mesh filename="broken.stl"/>', "is not STL"),
        ('<mesh filename="empty.obj"/>', "has no corner"),
        ('<mesh filename="nan.obj"/>', "not finite"),
        ('<mesh filename="words.obj"/>', "is not OBJ"),
        ("<mesh/>", "filename"),
        ('<box size="1 2"/>', "wrong count"),
        ('<box size="1 2 -3"/>', "negative"),
        ("<box/>", "size"),
        ('<sphere radius="big"/>', "not a number"),
        ('<cylinder radius="1"/>', "length"),
        ('<cone radius="1"/>', "not known"),
    ],
)
def test_what_cannot_be_read_is_unknown_with_a_warning(tmp_path, shape, said):
    (tmp_path / "m.dae").write_text("<COLLADA/>")
    (tmp_path / "broken.stl").write_bytes(b"x" * 200)
    (tmp_path / "empty.obj").write_text("# nothing\n")
    (tmp_path / "nan.obj").write_text("v 0 0 nan\n")
    (tmp_path / "words.obj").write_text("v a b c\n")
    shapes = link_shapes(one(tmp_path, at(shape)))
    assert shapes.boxes.isnan().all()
    assert shapes.volumes.isnan().all()
    assert shapes.known == (False,)
    assert len(shapes.warnings) == 1
    assert said in shapes.warnings[0]
    assert "'a'" in shapes.warnings[0]


def test_a_missing_collision_mesh_leaves_the_visual(tmp_path):
    solid = link("a", at('<mesh filename="none.stl"/>')).replace(
        "</link>", '<visual><geometry><sphere radius="0.1"/></geometry></visual></link>'
    )
    shapes = link_shapes(robot_of(tmp_path, solid, REVOLUTE.format("j", "base", "a", "0 0 1")))
    assert shapes.kinds == ("visual",)
    assert shapes.warnings == ()


@pytest.mark.parametrize(("mass", "known"), [(0, True), (0.5, False)])
def test_a_merged_link_with_mass_and_no_shape_makes_the_box_unknown(tmp_path, mass, known):
    robot = robot_of(
        tmp_path,
        link("a", at('<sphere radius="0.1"/>')),
        link("b", mass=mass),
        REVOLUTE.format("j", "base", "a", "0 0 1"),
        FIXED.format("f", "a", "b", "0 0 1", "0 0 0"),
    )
    shapes = link_shapes(robot)
    assert shapes.known == (known,)
    assert len(shapes.warnings) == (0 if known else 1)


def test_a_urdf_without_shapes_says_nothing(tmp_path):
    shapes = link_shapes(one(tmp_path))
    assert shapes.known == (False,)
    assert shapes.warnings == ()


def test_robots_of_dh_tables_have_no_shapes():
    robot = load_robot("3r")
    assert link_shapes(robot) is None
    assert own_inertials(robot) == ()


def test_own_inertials_tell_merged_base_and_alone(tmp_path):
    robot = robot_of(
        tmp_path,
        link("a", ixx=0.5),
        link("b", mass=2.0),
        link("c"),
        link("d", mass=0),
        REVOLUTE.format("j", "base", "a", "0 0 1"),
        FIXED.format("f", "a", "b", "0 0 1", "1 0 0"),
        REVOLUTE.format("k", "b", "c", "0 0 1"),
        FIXED.format("g", "c", "d", "0 0 1", "0 0 0"),
        link("post"),
        FIXED.format("h", "base", "post", "0 0 1", "0 0 0"),
    )
    found = {own.link: own for own in own_inertials(robot)}
    told = {name: (own.moving_link, own.alone, own.mass) for name, own in found.items()}
    assert told == {
        "a": (0, False, 1.0), "b": (0, False, 2.0), "c": (1, True, 1.0), "post": (None, False, 1.0)
    }  # fmt: skip
    assert found["a"].inertia_about_com.tolist() == [0.5, 0, 0, 1, 0, 1]


def test_a_urdf_that_changed_is_an_error(tmp_path):
    robot = one(tmp_path)
    (tmp_path / "arm.urdf").write_text('<robot name="r"><link name="z"/></robot>')
    with pytest.raises(RobotError, match="has no link 'a'"):
        link_shapes(robot)


MJCF = """<mujoco><worldbody><body name="a" pos="0 0 1">
<joint axis="0 0 1"/><geom type="box" size="0.1 0.2 0.3" mass="1"/>
<geom type="sphere" size="5" contype="0" conaffinity="0" mass="0"/>
<body name="a2" pos="0 0 1" euler="90 0 0"><geom type="capsule" size="0.05 0.2" mass="1"/>
<body name="a3" pos="0 0 0.5"><geom type="sphere" size="0.01" mass="1"/></body></body>
<body name="b" pos="0 0 0.4"><joint name="b1" axis="1 0 0"/><joint name="b2" axis="0 1 0"/>
<geom type="cylinder" size="0.1 0.2" mass="1" contype="0" conaffinity="0"/>{}</body>
</body></worldbody></mujoco>"""


def test_mjcf_geoms(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(MJCF.format(""))
    robot = load_robot(path)
    shapes = link_shapes(robot)
    assert robot.link_names == ("a", "b/b1", "b")
    assert shapes.kinds == ("collision", None, "visual")
    # a2's z is a's -y: a3 is a ball around (0, -0.5, 1).
    expected = box_of([-0.1, 0.1], [-0.51, 0.25], [-0.3, 1.05])
    torch.testing.assert_close(shapes.boxes[0], expected)
    torch.testing.assert_close(shapes.boxes[2], box_of([-0.1, 0.1], [-0.1, 0.1], [-0.2, 0.2]))
    assert shapes.warnings == ()
    # Massive and without shape, merged into b.
    inertial = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
    path.write_text(MJCF.format(f'<body name="c">{inertial}</body>'))
    shapes = link_shapes(load_robot(path))
    assert shapes.known == (True, False, False)
    assert "'b'" in shapes.warnings[0]


def test_mjcf_meshes_are_their_corners(tmp_path):
    write_stl(tmp_path / "m.stl", "binary")
    path = tmp_path / "arm.xml"
    path.write_text(
        '<mujoco><asset><mesh name="m" file="m.stl" scale="0.1 0.1 0.1" inertia="convex"/></asset>'
        '<worldbody><body name="a"><joint axis="0 0 1"/>'
        '<geom type="mesh" mesh="m" pos="0 0 1" euler="0 0 90"/></body></worldbody></mujoco>'
    )
    found = link_shapes(load_robot(path)).boxes[0]
    torch.testing.assert_close(found, box_of([-0.2, 0], [0, 0.1], [1, 1.3]), atol=1e-6, rtol=0)


def test_joint_points_are_where_the_joints_are(robot):
    """The next joint's frame from one link is its own joint's from the next, at any position."""
    q = torch.zeros(robot.n, dtype=torch.float64)
    poses = link_poses(robot, q)
    ends = joint_points(robot)
    world = (poses[:, None, :3, :3] @ ends.unsqueeze(-1)).squeeze(-1) + poses[:, None, :3, 3]
    torch.testing.assert_close(world[:-1, 1], world[1:, 0], atol=1e-12, rtol=0)
    assert (link_lengths(robot) >= SHORTEST).all()
    assert reach(robot) >= float((ends[:, 1] - ends[:, 0]).norm(dim=-1).sum())


def test_link_lengths_of_the_3r():
    robot = load_robot("3r")
    lengths = link_lengths(robot)
    mean = (0.3 + 0.22 + 0.15) / 3
    torch.testing.assert_close(lengths, torch.tensor([0.3, mean, mean], dtype=torch.float64))
    assert reach(robot) == pytest.approx(0.67)


def test_prismatic_joints_add_their_travel_to_the_reach(arm_urdf):
    robot = load_robot(arm_urdf)
    limits = robot.limits.position.clone()
    limits[2] = torch.tensor([-1.0, 3.0], dtype=torch.float64)
    drawn = replace(robot, limits=replace(robot.limits, position=limits))
    assert reach(drawn) - reach(robot) == pytest.approx(3.0 - 0.4)


def test_vertices_of_unknown_suffix(tmp_path):
    with pytest.raises(RobotError, match="is not read"):
        mesh_vertices(tmp_path / "m.ply")


def test_a_flat_mesh_has_no_volume():
    flat = points(
        pose(), torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], dtype=torch.float64)
    )
    assert flat.volume == 0
