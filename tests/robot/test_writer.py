"""Independent here: the reader, and the torque of the robot that was written."""

import math
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
import torch
import yaml

import torchid
from tests.arms import arm, consistent_parameters, relative, states
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Effect, ModelEffect
from torchid.effects.registry import KINDS, nominal_effects
from torchid.errors import RobotError, TorchidError
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import built_in_robots, load_robot
from torchid.robot.model import Limits, Robot, tool_pose
from torchid.robot.placement import dh_classical, dh_modified, pose, rotation_z
from torchid.robot.writer import robot_yaml, to_mapping, write_robot
from torchid.robot.yaml_file import from_mapping

TENSORS = ("before", "after", "gravity", "tool", "drive_gain")
PLAIN = ("name", "joint_names", "link_names", "joint_types", "basis")
ROBOTS = (*built_in_robots(), "mixed", "urdf", "mjcf")

MJCF = """
<mujoco model="arm"><option gravity="0.5 -1 -9"/><worldbody>
  <body name="b1" pos="0 0 0.4" euler="0 30 0">
    <joint name="j1" axis="0 0 1" pos="0.1 -0.05 0.2" range="-100 120" damping="0.5"/>
    <inertial pos="0.01 0.02 0.1" mass="3" fullinertia="0.05 0.04 0.03 0.002 -0.003 0.001"/>
    <body name="b2" pos="0.3 0 0" quat="0.9 0.1 -0.3 0.2">
      <joint name="j2" type="slide" axis="1 2 3" ref="0.1" armature="0.02"/>
      <geom type="capsule" size="0.05" fromto="0 0 0 0.3 0.1 0"/>
    </body>
  </body>
</worldbody></mujoco>
"""


@pytest.fixture
def robot(request: pytest.FixtureRequest, tmp_path: Path) -> Robot:
    kind = request.param
    if kind == "urdf":
        return load_robot(request.getfixturevalue("arm_urdf"))
    if kind == "mjcf":
        (tmp_path / "arm.xml").write_text(MJCF, encoding="utf-8")
        return load_robot(tmp_path / "arm.xml")
    return arm(kind)


def again(robot: Robot, tmp_path: Path) -> Robot:
    path = tmp_path / "written.yaml"
    write_robot(robot, path)
    return load_robot(path)


def same(a: object, b: object) -> bool:
    if isinstance(a, torch.Tensor) and isinstance(b, torch.Tensor):
        return torch.equal(a, b)
    return a is b is None


@pytest.mark.parametrize("robot", ROBOTS, indirect=True)
def test_the_same_robot_is_read_back(robot: Robot, tmp_path: Path) -> None:
    read = again(robot, tmp_path)
    assert all(getattr(read, name) == getattr(robot, name) for name in PLAIN)
    assert all(same(getattr(read, name), getattr(robot, name)) for name in TENSORS)
    for name in ("position", "velocity", "acceleration", "torque"):
        assert same(getattr(read.limits, name), getattr(robot.limits, name)), name
    assert [dict(e) for e in read.effects] == [dict(e) for e in robot.effects]
    assert read.bounds == robot.bounds
    assert read.parameters is not None
    assert robot.parameters is not None
    assert torch.equal(read.parameters.pi, robot.parameters.pi)


@pytest.mark.parametrize("robot", ROBOTS, indirect=True)
def test_torque_and_tool_are_the_same(robot: Robot, tmp_path: Path) -> None:
    read = again(robot, tmp_path)
    motion = states(robot, 50)
    assert relative(inverse_dynamics(read, *motion), inverse_dynamics(robot, *motion)) < 1e-12
    assert relative(tool_pose(read, motion[0]), tool_pose(robot, motion[0])) < 1e-12


@pytest.mark.parametrize("name", built_in_robots())
def test_a_dh_robot_stays_one(name: str) -> None:
    written, given = to_mapping(load_robot(name)), load_robot(name)
    source = yaml.safe_load(Path(given.source).read_text(encoding="utf-8"))
    assert "placements" not in written
    rows = zip(written["dh"]["joints"], source["dh"]["joints"], strict=True)
    for row, expected in rows:
        assert (row["a"], row["d"]) == (expected.get("a", 0), expected.get("d", 0))
        angle = row["alpha"] if "alpha" in row else math.radians(row["alpha_deg"])
        declared = expected.get("alpha", math.radians(expected.get("alpha_deg", 0)))
        assert angle == pytest.approx(declared, abs=1e-15)


@pytest.mark.parametrize("convention", ["classical", "modified"])
@pytest.mark.parametrize("seed", range(20))
def test_oblique_dh_tables_are_exact_whichever_form_they_take(convention: str, seed: int) -> None:
    """Recovered angles may differ in the last bit; then placements must be written."""
    g = torch.Generator().manual_seed(seed)
    a, alpha, d, theta = (4 * torch.rand(4, generator=g, dtype=torch.float64) - 2).tolist()
    if convention == "classical":
        before, after = pose(), dh_classical(a, alpha, d, theta)
    else:
        before, after = dh_modified(a, alpha) @ pose(rotation_z(theta), (0, 0, d)), pose()
    robot = replace(
        arm("3r"),
        before=torch.stack([before] * 3),
        after=torch.stack([after] * 3),
    )
    read = from_mapping(yaml.safe_load(robot_yaml(robot)), "r")
    assert torch.equal(read.before, robot.before)
    assert torch.equal(read.after, robot.after)


def test_everything_else_a_description_can_hold(tmp_path: Path) -> None:
    inf = math.inf
    robot = replace(
        arm("3r"),
        name="no: 1e3 #ä",
        joint_names=("1", "null", "yes"),
        link_names=("a b", "link_2", "-"),
        limits=Limits(
            position=torch.tensor(
                [[-inf, inf], [-1e-7, 0.1 + 0.2], [0, 1e300]], dtype=torch.float64
            )
        ),
        drive_gain=torch.tensor([1 / 3, 1e-17, 2.0], dtype=torch.float64),
        bounds=MappingProxyType(
            {"normal": {"lower": {"mass": np.array([0.1, 1e-5])}}, "total_mass": (1, np.float64(2))}
        ),
        warnings=("two\nlines: [1", "more"),
    )
    read = again(robot, tmp_path)
    assert all(getattr(read, name) == getattr(robot, name) for name in PLAIN)
    assert same(read.limits.position, robot.limits.position)
    assert same(read.drive_gain, robot.drive_gain)
    assert read.bounds == {"normal": {"lower": {"mass": [0.1, 1e-5]}}, "total_mass": [1, 2.0]}
    assert "# warning: two lines: [1\n# warning: more\n" in (tmp_path / "written.yaml").read_text(
        encoding="utf-8"
    )


def test_a_massless_link_keeps_its_first_moment(tmp_path: Path) -> None:
    pi = consistent_parameters(3, seed=2).pi.clone()
    pi[1, 0] = 0.0
    robot = arm("3r").with_parameters(InertialParameters(pi))
    read = again(robot, tmp_path)
    assert read.parameters is not None
    assert torch.equal(read.parameters.pi, pi)
    bare = again(robot.with_parameters(None), tmp_path)
    assert bare.parameters is None


def test_a_batch_of_parameters_is_not_one_robot(tmp_path: Path) -> None:
    robot = arm("3r").with_parameters(consistent_parameters(3, seed=2, batch=(4,)))
    with pytest.raises(ValueError, match="not a batch"):
        write_robot(robot, tmp_path / "r.yaml")
    assert not list(tmp_path.iterdir())


def test_a_folder_that_does_not_exist_is_named(tmp_path: Path) -> None:
    with pytest.raises(TorchidError, match="there is no folder"):
        write_robot(arm("3r"), tmp_path / "none" / "r.yaml")


def instances(kind: type[Effect], robot: Robot) -> list[Effect]:
    """With shapes that no short decimal holds, inside their bounds."""
    if issubclass(kind, ModelEffect):
        return [*kind.candidates(robot)]
    shapes = {s.name: s.low + (s.high - s.low) / 3 for s in kind.shapes}
    return [kind(joint=robot.n - 1, **shapes)]  # type: ignore[call-arg]


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_every_effect_is_read_back(kind: type[Effect], tmp_path: Path) -> None:
    robot = arm("mixed")
    given = [(e, [(k + 1) / 3 for k in range(len(e.coefficients))]) for e in instances(kind, robot)]
    assert given
    effects = tuple(MappingProxyType(e.record(values)) for e, values in given)
    read = again(replace(robot, effects=effects), tmp_path)
    assert nominal_effects(read) == given


PLACED = {
    "name": "placed",
    "placements": {
        "joints": [
            {"type": "R", "before": {"xyz": [0, 0, 1]}, "after": {}},
            {"type": "P", "before": {"rotation": [[1, 0, 0], [0, 0, 1], [0, -1, 0]]}},
        ]
    },
}


def test_placements_as_written_by_hand() -> None:
    robot = from_mapping(PLACED, "placed")
    assert robot.joint_names == ("joint_1", "joint_2")
    assert robot.link_names == ("link_1", "link_2")
    assert torch.equal(robot.after, torch.eye(4, dtype=torch.float64).expand(2, 4, 4))
    q = torch.tensor([math.pi / 2, 0.5], dtype=torch.float64)
    # The slider moves along y of link 1, which a quarter turn makes -x of the base.
    position = tool_pose(robot, q)[:3, 3]
    assert torch.allclose(position, torch.tensor([-0.5, 0, 1], dtype=torch.float64), atol=1e-15)


@pytest.mark.parametrize(
    ("joints", "message"),
    [
        ([], r"length >= 1 - at `\$\.placements\.joints`"),
        ([{"type": "S"}], r"'S' - at `\$\.placements\.joints\[0\]\.type`"),
        ([{"a": 1}], "unknown field `a`"),
        ([{"before": [1]}], r"got `array` - at .*\.before`"),
        ([{"before": {"rpy": [0, 0, 0]}}], "unknown field `rpy`"),
        ([{"before": {"xyz": [0, 0]}}], "wrong size"),
        ([{"after": {"rotation": [[1, 0, 0], [0, 1, 0], [0, 0.1, 1]]}}], "not a rotation"),
        ([{"after": {"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}}], "not a rotation"),
    ],
)
def test_bad_placements_are_named(joints: list, message: str) -> None:
    with pytest.raises(RobotError, match=message):
        from_mapping({"name": "r", "placements": {"joints": joints}}, "r")


def test_kinematics_are_given_once() -> None:
    dh = {"convention": "classical", "joints": [{"a": 1}]}
    with pytest.raises(RobotError, match="both 'dh' and 'placements'"):
        from_mapping(PLACED | {"dh": dh}, "r")
    with pytest.raises(RobotError, match="'dh' is missing") as error:
        from_mapping({"name": "r"}, "r")
    assert "placements" in str(error.value)
    with pytest.raises(RobotError, match=r"field `joints` - at `\$\.placements`"):
        from_mapping({"name": "r", "placements": {}}, "r")


@pytest.mark.parametrize("inertia", ["inertia_about_com", "inertia_about_link_frame"])
def test_first_moments_in_place_of_centres(inertia: str) -> None:
    base = consistent_parameters(2, seed=5)
    parameters = {"mass": base.mass.tolist(), inertia: getattr(base, inertia).tolist()}
    for moment in ("com", "first_moment"):
        given = parameters | {moment: getattr(base, moment).tolist()}
        robot = from_mapping(PLACED | {"parameters": given}, "r")
        assert robot.parameters is not None
        assert relative(robot.parameters.pi, base.pi) < 1e-14
    both = parameters | {"com": [[0, 0, 0]] * 2, "first_moment": [[0, 0, 0]] * 2}
    with pytest.raises(RobotError, match="needs mass, com"):
        from_mapping(PLACED | {"parameters": both}, "r")


def test_a_model_that_no_data_confirm_says_so_first_and_in_what_is_exported(tmp_path: Path) -> None:
    said = "not confirmed: error 2 -> 2 N m on run9"
    write_robot(replace(load_robot("3r"), warnings=(said,)), tmp_path / "arm.yaml")
    assert (tmp_path / "arm.yaml").read_text().startswith(f"# warning: {said}\n")
    again = load_robot(tmp_path / "arm.yaml")
    assert again.warnings == (said,)
    for kind in ("urdf", "mjcf"):
        torchid.export_dynamics(again, kind, tmp_path / "out", nominal="3r")
    files = [p for p in (tmp_path / "out").iterdir() if p.suffix in (".urdf", ".xml")]
    assert len(files) == 2
    for file in files:
        assert said in file.read_text().partition("-->")[0]
