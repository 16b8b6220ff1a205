"""`torchid check` as a user calls it."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
import typer
from typer.testing import CliRunner

from tests.real_logs import FOLDER, NO_LOGS
from torchid.app.check import check_command
from torchid.app.commands import app
from torchid.feasibility.conditions import physics_only
from torchid.feasibility.margins import feasibility
from torchid.feasibility.sets import joined, nominal_set, read_sets, sets_record
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot
from torchid.robot.writer import write_robot


def call(*arguments: object):
    app = typer.Typer()
    app.command("check")(check_command)
    return CliRunner().invoke(app, [str(a) for a in arguments], env={"COLUMNS": "200"})


def said(result) -> str:
    return " ".join(result.output.split())


def sets_file(path: Path, robot: str = "3r", count: int = 2, change=None) -> Path:
    """Sets of a robot: the nominal one, then ones with a flipped inertia of link 2."""
    one = nominal_set(load_robot(robot))
    parts = [one]
    for k in range(1, count):
        pi = one.parameters.pi.clone()
        pi[0, 1, 4:] *= -1
        parts.append(type(one)((f"s{k}",), InertialParameters(pi), one.effects, one.coefficients))
    data = sets_record(joined(parts), load_robot(robot)).plain()
    if change is not None:
        change(data)
    path.write_text(json.dumps(data))
    return path


def test_the_papers_lwr_is_infeasible_and_why(tmp_path):
    mine = tmp_path / "out" / "mine.json"  # a folder that is still to be made
    got = call("kuka_lwr4_friction", "--json", mine, "--out", tmp_path / "out")
    assert got.exit_code == 0, got.output
    text = said(got)
    assert "inertia_3 and inertia_4 are not positive definite" in text
    assert "inertia_7 breaks the triangle inequality (by 778 %)" in text
    assert "Fv_6 is negative" in text
    assert "com_7z is 37 mm outside its box" in text
    assert "bounds 'normal'" in text
    assert text.index("infeasible") < text.index("link_1")
    data = json.loads(mine.read_text())
    assert data == json.loads((tmp_path / "out" / "feasibility.json").read_text())
    assert data["schema"] == "torchid.feasibility/1"
    (entry,) = data["sets"]
    assert not entry["feasible"]
    assert entry["reasons"] == ["inertia_3", "inertia_4", "inertia_7", "com_7z", "Fv_6"]


def test_a_feasible_robot_says_its_degree_and_what_is_nearest():
    got = call("3r", "--geometry", "none")
    assert got.exit_code == 0
    assert "3r is feasible, with degree" in said(got)
    assert "degree: the smallest margin" in said(got)
    assert "boxes: none" in said(got)


def test_a_file_of_sets(tmp_path):
    file = sets_file(tmp_path / "s.json")
    got = call(file, "--json", tmp_path / "f.json")  # it knows its robot
    assert got.exit_code == 0, got.output
    data = json.loads((tmp_path / "f.json").read_text())
    assert [(e["id"], e["feasible"]) for e in data["sets"]] == [("3r", True), ("s1", False)]
    assert data["sets"][1]["reasons"] == ["inertia_2"]
    assert "s1 is infeasible: inertia_2 is not positive definite" in said(got)


def test_very_many_sets_are_cut_off_and_all_in_the_record(tmp_path):
    file = sets_file(tmp_path / "s.json", count=60)
    got = call(file, "--robot", "3r", "--json", tmp_path / "f.json")
    assert "1 of 60 sets are feasible; most often violated: inertia_2 (59)." in said(got)
    assert "principal inertias" not in said(got)
    assert "And 10 more, in the JSON." in said(got)
    assert "s49" in said(got)
    assert "s50" not in said(got)
    assert len(json.loads((tmp_path / "f.json").read_text())["sets"]) == 60


def test_the_nearest_feasible_sets(tmp_path):
    pytest.importorskip("clarabel")
    near = tmp_path / "near.json"
    got = call(
        sets_file(tmp_path / "s.json"), "--robot", "3r", "--nearest", near,
        "--json", tmp_path / "f.json",
    )  # fmt: skip
    assert got.exit_code == 0, got.output
    robot = load_robot("3r")
    written = read_sets(near, robot)
    assert written.ids == ("s1",)
    assert bool(feasibility(written, physics_only(3)).feasible.all())
    data = json.loads((tmp_path / "f.json").read_text())
    assert "nearest" not in data["sets"][0]
    found = data["sets"][1]["nearest"]
    assert found["feasible"]
    assert len(found["torque_change_relative"]) == 3
    assert "nearest feasible sets" in said(got)
    # What was written is feasible for this command too, and then there is nothing to write.
    again = call(near, "--robot", "3r", "--nearest", tmp_path / "no.json")
    assert again.exit_code == 0
    assert "was not written" in said(again)
    assert not (tmp_path / "no.json").exists()


def test_the_nearest_set_keeps_every_effect(tmp_path):
    """Effects that sets have no columns for lie beside them, and come back with an export."""
    pytest.importorskip("clarabel")
    spring = {"effect": "joint_spring", "joint": 3, "k": 0.5, "c0": 0.1}
    viscous = {"effect": "viscous_friction", "joint": 2, "Fv": 0.3}
    own = load_robot("3r")
    pi = own.parameters.pi.clone()
    pi[1, 4:] *= -0.1
    robot = replace(own, effects=(viscous, spring)).with_parameters(InertialParameters(pi))
    write_robot(robot, tmp_path / "corrected.yaml")
    near = tmp_path / "near.json"
    got = call(tmp_path / "corrected.yaml", "--nearest", near)
    assert got.exit_code == 0, got.output
    assert "joint 3: joint_spring k = 0.5 N m/rad" in said(got)
    again = call(near, "--robot", "3r", "--nearest", tmp_path / "no.json")
    assert again.exit_code == 0
    out = ("--robot", "3r", "--to", "yaml", "--out", tmp_path / "o", "--geometry", "none")
    done = CliRunner().invoke(app, ["export", *map(str, (near, *out))])
    assert done.exit_code == 0, done.output
    written = load_robot(tmp_path / "o" / "3r.yaml")
    assert [(e["effect"], e["joint"]) for e in written.effects] == [
        ("viscous_friction", 2), ("joint_spring", 3),
    ]  # fmt: skip
    assert (written.effects[1]["k"], written.effects[1]["c0"]) == (0.5, 0.1)


URDF = """<robot name="r"><link name="base">{base}</link>
<link name="arm">{arm}</link><link name="hand">{hand}</link>
<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/></joint>
<joint name="f" type="{kind}"><parent link="arm"/><child link="hand"/></joint></robot>"""


def inertial(ixx, iyy, izz, mass=1.0, extra=""):
    return (
        f'<inertial><mass value="{mass}"/><inertia ixx="{ixx}" ixy="0" ixz="0" iyy="{iyy}" iyz="0" '
        f'izz="{izz}"/></inertial>{extra}'
    )


GOOD, BAD = inertial(0.02, 0.02, 0.02), inertial(0.001, 0.001, 0.003)


def test_a_bad_inertial_hidden_by_a_fixed_joint_is_named(tmp_path):
    path = tmp_path / "r.urdf"
    path.write_text(URDF.format(base=BAD, arm=GOOD, hand=BAD, kind="fixed"))
    got = call(path, "--json", tmp_path / "f.json")
    assert got.exit_code == 0
    (entry,) = json.loads((tmp_path / "f.json").read_text())["sets"]
    # The sum of both is a body.
    assert entry["feasible"]
    own = [f for f in entry["plausibility"] if f["what"] == "own_triangle"]
    assert [(f["name"], f["link"]) for f in own] == [("base", None), ("hand", 1)]
    assert "the <inertial> of 'hand' (merged into link 1) breaks the triangle" in said(got)


def test_the_yamls_total_mass_is_checked_unless_refused(tmp_path):
    import yaml

    from torchid.robot.config_files import config_folder

    data = yaml.safe_load((config_folder("robots") / "3r.yaml").read_text())
    data["bounds"]["total_mass"] = [6.0, 8.0]
    path = tmp_path / "heavy.yaml"
    path.write_text(yaml.safe_dump(data))
    assert "total_mass is 5.5 kg" in said(call(path))
    assert "is feasible" in said(call(path, "--total-mass", "none"))
    assert "is feasible" in said(call(path, "--total-mass", "5,6"))


def test_parameters_of_one_robot_against_another(tmp_path):
    got = call("kuka_lwr4", "--robot", "kuka_lwr4_friction", "--json", tmp_path / "f.json")
    assert got.exit_code == 0
    data = json.loads((tmp_path / "f.json").read_text())
    assert data["robot"] == "kuka_lwr4_friction"
    assert data["sets"][0]["id"] == "kuka_lwr4"
    assert not any("frames" in w for w in data["warnings"])
    robot = load_robot("3r")
    path = tmp_path / "r.urdf"
    path.write_text(URDF.format(base="", arm=GOOD, hand=GOOD, kind="revolute"))
    assert robot.n != 2
    other = tmp_path / "other.urdf"
    other.write_text(path.read_text().replace('xyz="0 1 0"', 'xyz="1 0 0"'))
    assert "place the frames of links 1" in said(call(path, "--robot", other))


@pytest.mark.real
@pytest.mark.skipif(not FOLDER.is_dir(), reason=NO_LOGS)
@pytest.mark.parametrize(("folder", "n"), [("ur10e", 6), ("xmate7p", 7)])
def test_real_urdfs_are_feasible_and_plausible(tmp_path, folder, n):
    got = call(FOLDER / folder / "robot.urdf", "--json", tmp_path / "f.json")
    assert got.exit_code == 0, got.output
    data = json.loads((tmp_path / "f.json").read_text())
    (entry,) = data["sets"]
    assert entry["feasible"]
    assert entry["plausibility"] == []
    densities = torch.tensor([link["density"] for link in entry["links"]], dtype=torch.float64)
    assert len(densities) == n
    assert 300 < float(densities.min()) < float(densities.max()) < 2500
    # The meshes do not come with the URDF.
    assert data["conditions"]["geometry"] == "none"
    assert any("was not found" in w for w in data["warnings"])
