"""Room along planned motions, against distances in closed form and MuJoCo's own kinematics."""

import json
import math
import struct
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch

from tests.excitation.shaped import loaded
from tests.excitation.usage import full_design, limit_usage
from tests.marks import quick_first
from torchid.errors import RobotError, TorchidError
from torchid.excitation.clearance import FAR_ROOM, motion_clearance
from torchid.excitation.distances import Distances
from torchid.excitation.fourier import FourierTrajectory
from torchid.excitation.limits import motion_limits
from torchid.excitation.restriction import AllOf
from torchid.excitation.torque import nominal_torque_limits
from torchid.excitation.trajectories import random_trajectory, sinusoid
from torchid.robot.library import load_robot
from torchid.robot.placement import pose, roll_pitch_yaw
from torchid.robot.solids import box, capsule, cylinder, ellipsoid, points


def with_acceleration(robot):
    five = torch.tensor([[-5.0, 5.0]] * robot.n, dtype=torch.float64)
    velocity = five / 2 if robot.limits.velocity is None else robot.limits.velocity
    limits = replace(robot.limits, velocity=velocity, acceleration=five)
    return replace(robot, limits=limits)


def test_distances_are_those_of_closed_forms():
    """Balls, capsules, turned boxes along their axes, and all solids above a half-space."""
    g = torch.Generator().manual_seed(0)
    turn = pose(roll_pitch_yaw([0.4, -0.7, 1.1]))
    half = torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64)
    corners = torch.stack(torch.meshgrid(*[torch.tensor([-1.0, 1.0]).double()] * 3, indexing="ij"))
    corners = corners.reshape(3, 8).T * half
    at = pose(None, [0.05, -0.02, 0.03])
    solids = [
        capsule(at, 0.07, 0.0), box(at @ turn, half), points(at @ turn, corners),
        cylinder(at @ turn, 0.07, 0.4), capsule(at @ turn, 0.07, 0.4), ellipsoid(at @ turn, half),
        points(at @ turn, corners * torch.tensor([1.0, 1.0, 0.0])),
    ]  # fmt: skip
    normal = torch.nn.functional.normalize(torch.tensor([0.3, -0.5, 0.8]).double(), dim=0)
    plane = torch.cat([normal, torch.tensor([0.11]).double()])
    count = 2 * len(solids)
    distances = Distances([*solids, *solids], plane.unsqueeze(0))

    drawn = torch.randn(20, 2, 3, generator=g).double()
    where = torch.stack([pose(roll_pitch_yaw(x.tolist()), y) for x, y in drawn])
    still = torch.eye(4).double().expand(20, 4, 4)

    def apart(one, other, first=still, second=where):
        """Of two shapes with their links, and that the balls around them are no further apart."""
        pairs = torch.tensor([[one, other]]).expand(len(first), 2)
        links = torch.eye(4).double().repeat(len(first), count + 1, 1, 1)
        links[:, one], links[:, other] = first, second
        placed = distances.placed(links)
        out, ends = distances.between(pairs, placed[:, [one, other]], 100.0)
        assert bool((distances.at_least(placed, pairs[:1])[:, 0] <= out + 1e-6).all())
        torch.testing.assert_close((ends[:, 1] - ends[:, 0]).norm(dim=-1), out.abs())
        # Beyond the farthest only that is told.
        near, _ = distances.between(pairs, placed[:, [one, other]], 0.3)
        torch.testing.assert_close(near, out.clamp(max=0.3), atol=1e-5, rtol=0)
        return out

    other = len(solids)
    centres = where @ at[:, 3]
    torch.testing.assert_close(apart(0, other), (centres[:, :3] - at[:3, 3]).norm(dim=-1) - 0.14)
    # Of two capsules the first is along z up to 0.2 m, and the other along y: side by side their
    # axes are as far apart as along x, above its end also as along z.
    upright = torch.linalg.inv(at @ turn)
    for height, expected in ((0.1, 0.3), (0.6, 0.5)):
        crossed = pose(roll_pitch_yaw([math.pi / 2, 0.0, 0.0]), [0.3, 0.05, height])
        d = apart(4, 4 + other, upright[None], (crossed @ upright)[None])
        assert float(d) == pytest.approx(expected - 0.14, abs=1e-6)
    # Boxes moved along one of their axes.
    for k in range(3):
        for second in (1 + other, 2):
            shift = pose(None, (0.9 * (at @ turn)[:3, k]))
            d = apart(1, second, still[:1], shift[None])
            assert float(d) == pytest.approx(0.9 - 2 * float(half[k]), abs=1e-6)
    # A half-space is as far as the support in the direction against its normal says.
    for index, solid in enumerate(solids):
        for found, pose_ in zip(apart(count, index), where, strict=True):
            placed = pose_ @ solid.pose
            n = placed[:3, :3].T @ normal
            support = {
                "box": lambda n: float(n.abs() @ half),
                "ellipsoid": lambda n: float((n * half).norm()),
                "cylinder": lambda n: 0.07 * float(n[:2].norm()) + 0.2 * float(n[2].abs()),
                "capsule": lambda n, solid=solid: 0.07 + float(solid.size[1] * n[2].abs()),
                "hull": lambda n, solid=solid: float(-(solid.corners @ n).min()),
            }[solid.kind](n)
            expected = float(normal @ placed[:3, 3]) - support - 0.11
            assert float(found) == pytest.approx(expected, abs=1e-5)


def mujoco_distances(robot_path, clearance, q):
    """(T, P) distances of the checked pairs with MuJoCo's own URDF reader and kinematics."""
    model = mujoco.MjModel.from_xml_path(str(robot_path))
    data = mujoco.MjData(model)
    joints = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, f"joint{k + 1}")
              for k in range(clearance.robot.n)]  # fmt: skip
    geoms = {}
    for g in range(model.ngeom):
        body = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, int(model.geom_bodyid[g]))
        geoms.setdefault("base" if body == "world" else body, []).append(g)
    own, seen = [], {}
    for name in clearance.names:
        k = seen[name] = seen.get(name, -1) + 1
        own.append(geoms[name][k])
    out = np.empty((len(q), len(clearance.pairs)))
    for row, state in enumerate(q.tolist()):
        data.qpos[[model.jnt_qposadr[j] for j in joints]] = state
        mujoco.mj_kinematics(model, data)
        for k, (a, b) in enumerate(clearance.pairs.tolist()):
            out[row, k] = mujoco.mj_geomDistance(model, data, own[a], own[b], 9.0, None)
    return torch.from_numpy(out)


@pytest.mark.parametrize("name", ["3r", "6r", "7r"])
def test_distances_along_motions_are_mujocos(name, tmp_path):
    robot = with_acceleration(loaded(name, tmp_path))
    clearance = motion_clearance(robot)
    motion = random_trajectory(robot, 3, fill=True).sample(500.0)
    every = slice(0, None, 100)
    expected = mujoco_distances(robot.source, clearance, motion.q[every])
    found = clearance.apart(motion.q[every])
    near = expected < clearance.needed + FAR_ROOM
    assert bool(near.any()) or name == "3r"
    torch.testing.assert_close(found[near], expected[near], atol=1e-5, rtol=0)
    assert bool((found <= expected + 1e-5).all())


def made(name, folder, **more):
    robot = with_acceleration(loaded(name, folder))
    return robot, motion_clearance(robot, **more)


@pytest.mark.parametrize("plan", quick_first([sinusoid, random_trajectory], 1))
def test_a_motion_is_repaired(plan, tmp_path):
    """What is left keeps its distances at instants that nobody chose, by MuJoCo's kinematics."""
    robot, clearance = made("6r", tmp_path, floor=-0.4, clearance=0.03)
    whole = plan(robot, 1)
    assert not bool(clearance.fits(whole))
    done = clearance.within(whole)
    assert bool(clearance.fits(done))
    assert clearance.within(done) is done
    q = done.at(torch.rand(400, generator=torch.Generator().manual_seed(1)).double() * 20).q
    solid = clearance.pairs[:, 0] < clearance.names.index("the floor")
    links = replace(
        clearance, names=clearance.names[:-1], pairs=clearance.pairs[solid],
        needed=clearance.needed[solid],
    )  # fmt: skip
    apart = mujoco_distances(robot.source, links, q)
    assert bool((apart >= links.needed - 1e-5).all())
    # The floor is a plane: links above it keep their balls' lowest points above it.
    assert float(clearance.apart(q)[:, ~solid].min()) >= 0.03 - 1e-5
    assert bool((limit_usage(done.extremes(), motion_limits(robot)) <= 1 + 1e-9).all())


def test_a_touch_between_samples_is_found(tmp_path):
    """One joint swings a bar; how near its end comes to a wall is known in closed form."""
    robot = bar(tmp_path)
    # q = A (1 - cos wt): at rest at the ends of the period, at 2 A in its middle.
    swing = 0.6
    w = math.pi / 5
    motion = FourierTrajectory(
        torch.zeros(1, 1).double(), torch.tensor([[swing / 2 * w]]).double(),
        torch.tensor([swing / 2]).double(), w, 10.0, 0.0,
    )  # fmt: skip
    highest = math.sin(swing) * 1.0 + 0.05  # of the capsule's end, along y
    for spare, fits in ((0.0015, True), (-0.0002, False)):
        wall = highest + 0.02 + spare
        clearance = motion_clearance(robot, workspace=[-9, 9, -9, wall, -9, 9])
        assert bool(clearance.fits(motion)) is fits
        nearest = clearance.nearest([motion])
        assert nearest.distance == pytest.approx(0.02 + spare, abs=1e-5)
        assert nearest.time == pytest.approx(5.0, abs=0.1)
        assert nearest.first == "the workspace's maximum of y"


def bar(folder, mesh=""):
    """One link, a capsule of radius 0.05 along x from 0 to 1 m."""
    path = folder / "bar.urdf"
    shape = mesh or '<capsule radius="0.05" length="1"/>'
    path.write_text(f"""<robot name="bar"><link name="base"/><link name="bar">
      <inertial><mass value="1"/><origin xyz="0.5 0 0"/>
      <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
      <collision><origin xyz="0.5 0 0" rpy="0 1.5707963267948966 0"/>
      <geometry>{shape}</geometry></collision></link>
      <joint name="j" type="revolute"><parent link="base"/><child link="bar"/><axis xyz="0 0 1"/>
      <limit lower="-2" upper="2" velocity="2" effort="50"/></joint></robot>""")
    return with_acceleration(load_robot(path))


@pytest.mark.nightly
def test_the_gradient_is_that_of_the_distance(tmp_path):
    robot, clearance = made("6r", tmp_path, floor=-0.4)
    start = random_trajectory(robot, 5, count=2, fill=True)

    def penalty(a):
        return clearance.penalty(replace(start, a=a)).sum()

    a = start.a.clone().requires_grad_()
    penalty(a).backward()
    way = torch.randn(a.shape, generator=torch.Generator().manual_seed(0)).double()
    step = 1e-5
    with torch.no_grad():
        numeric = (penalty(start.a + step * way) - penalty(start.a - step * way)) / (2 * step)
    assert float((a.grad * way).sum()) == pytest.approx(float(numeric), rel=0.02)
    quiet = start.scaled(torch.zeros(2, robot.n).double())
    rest = replace(quiet, q0=clearance.rest.expand(2, -1))
    assert clearance.penalty(rest).tolist() == [0.0, 0.0]


@pytest.mark.nightly
def test_a_design_uses_the_room_there_is(tmp_path):
    """With clearance in the search the motion keeps it, and excites more than one drawn back."""
    robot, clearance = made("6r", tmp_path, floor=-0.4, usage=0.7)
    settings = {"seed": 0, "restarts": 2, "iterations": 80, "usage": 0.7}
    free = full_design(robot, **settings)
    assert not bool(clearance.fits(free.trajectory))
    design = full_design(robot, clearance=clearance, **settings)
    assert bool(clearance.fits(design.trajectory))
    kept = AllOf.of(robot, 0.7, nominal_torque_limits(robot, usage=0.7), clearance)
    assert bool(kept.fits(design.trajectory))
    assert design.condition_after < 0.1 * design.start_condition


def test_neighbours_and_overlaps_are_told(tmp_path):
    _, clearance = made("6r", tmp_path)
    links = {tuple(clearance.link[pair].tolist()) for pair in clearance.pairs}
    assert not {(k, k + 1) for k in range(6)} & links
    assert (0, 2) in links
    said = " ".join(clearance.notes)
    assert "links next to each other" in said
    # Hubs of links 3 and 5 of this arm are as far apart as its wrist is long.
    assert "hardly ever 20 mm apart, so only kept from touching: link3 and link5" in said
    close = clearance.needed == 0
    assert {tuple(clearance.link[p].tolist()) for p in clearance.pairs[close]} == {(3, 5)}
    _, wide = made("6r", tmp_path, clearance=0.0)
    assert wide.needed.eq(0).all()
    assert "hardly" not in " ".join(wide.notes)


def test_what_overlaps_in_the_zero_posture_is_left_out(tmp_path):
    path = tmp_path / "z.urdf"
    link = (
        '<link name="{0}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" '
        'ixz="0" iyz="0"/></inertial><collision><geometry><sphere radius="0.1"/></geometry>'
        "</collision></link>"
    )
    joint = (
        '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/>'
        '<origin xyz="{3} 0 0"/><axis xyz="0 0 1"/>'
        '<limit lower="-2" upper="2" velocity="1" effort="9"/></joint>'
    )
    path.write_text(
        '<robot name="z">' + "".join(link.format(x) for x in "abcd")
        + joint.format("1", "a", "b", 0.3) + joint.format("2", "b", "c", -0.2)
        + joint.format("3", "c", "d", 0.5) + "</robot>"
    )  # fmt: skip
    clearance = motion_clearance(with_acceleration(load_robot(path)))
    # c lies 0.1 m from a at zero; d 0.6 m from a and 0.3 m from b.
    assert "overlap in the zero posture: base and c" in " ".join(clearance.notes)
    assert {tuple(clearance.link[p].tolist()) for p in clearance.pairs} == {(0, 3), (1, 3)}


def test_a_mesh_is_its_hull_and_a_missing_one_is_told(tmp_path):
    corners = [(x, y, z) for x in (-0.05, 0.05) for y in (-0.05, 0.05) for z in (-0.5, 0.5)]
    faces = [(a, b, c) for a in range(8) for b in range(a) for c in range(b)]
    data = b"\0" * 80 + struct.pack("<I", len(faces))
    for face in faces:
        numbers = [0.0] * 3 + [x for k in face for x in corners[k]]
        data += struct.pack("<12fH", *numbers, 0)
    (tmp_path / "hull.stl").write_bytes(data)
    robot = bar(tmp_path, '<mesh filename="hull.stl"/>')
    side = motion_clearance(robot, workspace=[-9, 9, -9, 0.3, -9, 9])
    still = FourierTrajectory(*[torch.zeros(1, 1).double()] * 2, torch.zeros(1).double())
    assert math.isinf(side.nearest([still]).distance)
    # The ball around it reaches the wall; it does not.
    assert float(side.penalty(still)) == 0.0
    close = motion_clearance(robot, workspace=[-9, 9, -9, 0.1, -9, 9]).nearest([still])
    assert close.distance == pytest.approx(0.05, abs=1e-6)

    robot = bar(tmp_path, '<mesh filename="none.stl"/>')
    unknown = motion_clearance(robot, workspace=[-9, 9, -9, 0.3, -9, 9])
    assert "none.stl" in unknown.warnings[0]
    assert "only joints' origins" in unknown.warnings[0]


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["3r", "kuka_lwr4"])
def test_of_a_table_only_joints_and_tool_are_checked(name):
    robot = load_robot(name)
    assert len(motion_clearance(robot).pairs) == 0
    clearance = motion_clearance(robot, floor=-0.05)
    assert "not known" in clearance.warnings[0]
    motion = random_trajectory(robot, 2, fill=True)
    done = clearance.within(motion)
    from torchid.robot.model import link_poses, tool_pose

    q = done.sample(100.0).q
    origins = torch.cat([link_poses(robot, q), tool_pose(robot, q).unsqueeze(1)], 1)[..., 2, 3]
    kept = origins > -0.05 + 0.02 - 1e-5
    # A joint that no motion moves is left where it is.
    still = origins.amax(0) - origins.amin(0) < 1e-6
    assert bool((kept | still).all())


def test_an_mjcf_brings_its_floor(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text("""<mujoco><compiler angle="radian"/><worldbody>
      <geom type="plane" size="1 1 1" pos="0 0 -0.3"/>
      <geom type="box" size="0.1 0.1 0.1" pos="0 0.6 0"/>
      <body name="a"><joint name="j" axis="0 0 1" range="-2 2" limited="true"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.04"/>
      <body name="b" pos="0.3 0 0"><joint name="k" axis="0 1 0" range="-2 2" limited="true"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.04"/></body></body>
      </worldbody></mujoco>""")
    clearance = motion_clearance(with_acceleration(load_robot(path)))
    assert {clearance.names[a] for a, _ in clearance.pairs.tolist()} == {
        "base",
        "the model's plane",
    }
    # Far at the little that this arm moves, and checked all the same.
    path.write_text(path.read_text().replace("-2 2", "-0.04 0.04"))
    assert len(motion_clearance(with_acceleration(load_robot(path))).pairs) == len(clearance.pairs)
    down = clearance.apart(torch.tensor([[0.0, 1.0]]).double())[0]
    plane = clearance.pairs[:, 0] == len(clearance.names) - 1
    expected = 0.3 - 0.3 * math.sin(1.0) - 0.04
    assert float(down[plane].min()) == pytest.approx(expected, abs=1e-6)


@pytest.mark.nightly
def test_impossible_and_bad_numbers(tmp_path):
    robot, clearance = made("6r", tmp_path, floor=0.8)
    with pytest.raises(RobotError, match=r"keeps link\d clear of the floor"):
        clearance.within(random_trajectory(robot, 0))
    for bad in (-0.1, math.inf, math.nan):
        with pytest.raises(TorchidError, match="clearance"):
            motion_clearance(robot, clearance=bad)
    for box_ in ([0, 1, 0, 1], [1, 0, 0, 1, 0, 1]):
        with pytest.raises(TorchidError, match="box"):
            motion_clearance(robot, workspace=box_)


def test_the_record_of_a_json(tmp_path):
    from torchid.next_motion.planned import clearance_record
    from torchid.report.motion import nearest_words

    robot, clearance = made("7r", tmp_path)
    still = random_trajectory(robot, 0)
    nearest = clearance.nearest([still])
    record = clearance_record(clearance, nearest)
    json.dumps(record, allow_nan=False)
    assert record["pairs"] == len(clearance.pairs)
    assert record["nearest"]["between"][1] in nearest_words(clearance, nearest)
    assert clearance_record(None, None, ["a"]) == {"checked": False, "not_checked": ["a"]}
