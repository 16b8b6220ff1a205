"""`torchid export` from the command line."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from typer.testing import CliRunner

import torchid
from tests.export.arms import write_urdf
from torchid.app.commands import app
from torchid.errors import TorchidError
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot
from torchid.robot.writer import write_robot

runner = CliRunner()


def run(*arguments: object) -> str:
    """Output of a command that succeeds; a TorchidError is raised as it is."""
    done = runner.invoke(app, ["export", *map(str, arguments)])
    if isinstance(done.exception, TorchidError):
        raise done.exception
    assert done.exit_code == 0, done.output
    return done.output


@pytest.mark.parametrize("to", ["urdf", "mjcf", "yaml", "c"])
def test_every_format(tmp_path, to):
    record = tmp_path / "r.json"
    out = tmp_path / "out"
    said = run("3r", "--to", to, "--out", out, "--json", record)
    assert "agrees" in said
    assert "written: the parameters of 3r" in said
    data = json.loads(record.read_text())
    assert data["schema"] == "torchid.export/1"
    assert (data["what"], data["format"], data["feasible"]) == ("robot", to, True)
    assert all(Path(file).is_file() for file in data["files"])
    assert all(c["ok"] for c in data["checks"] if c["ok"] is not None)
    assert (out / f"export_{to}.json").is_file()


def test_sets_into_the_users_file(tmp_path):
    """check --nearest writes feasible sets that know their robot; they go into its URDF."""
    urdf = write_urdf(tmp_path)
    sets = tmp_path / "sets.json"
    from torchid.feasibility.sets import nominal_set, sets_record

    robot = load_robot(urdf)
    sets.write_text(json.dumps(sets_record(nominal_set(robot), robot).plain()))
    out = tmp_path / "out"
    said = run(sets, "--to", "urdf", "--out", out, "--name", "mine", "--geometry", "none")
    assert (out / "mine.urdf").is_file()
    assert "<!-- a comment -->" in (out / "mine.urdf").read_text()
    assert "the set 'arm'" in said.replace("\n", " ")
    with pytest.raises(TorchidError, match="no such set"):
        run(sets, "--to", "urdf", "--out", out, "--set", "z", "--overwrite")


def test_an_infeasible_robot_needs_force(tmp_path):
    with pytest.raises(TorchidError, match="inertia_3"):
        run("kuka_lwr4", "--to", "urdf", "--out", tmp_path)
    assert list(tmp_path.iterdir()) == []
    said = run("kuka_lwr4", "--to", "urdf", "--out", tmp_path, "--force", "--quiet")
    assert said == ""
    data = json.loads((tmp_path / "export_urdf.json").read_text())
    assert data["feasible"] is False
    assert "inertia_3" in data["reasons"]
    assert any("infeasible" in w for w in data["warnings"])


@pytest.mark.slow
def test_a_corrected_model_goes_into_the_users_file(tmp_path):
    """The yaml of gap --save-model, with the file that it came from."""
    urdf = write_urdf(tmp_path)
    model = tmp_path / "corrected.yaml"
    write_robot(load_robot(urdf), model)
    run(model, "--robot", urdf, "--to", "urdf", "--out", tmp_path / "o", "--geometry", "none")
    assert "package://none.stl" in (tmp_path / "o" / "arm.urdf").read_text()
    with pytest.raises(TorchidError, match="take the place"):
        run(model, "--to", "yaml", "--out", tmp_path, "--name", "corrected")
    with pytest.raises(TorchidError, match="chooses a part"):
        run(model, "--to", "yaml", "--out", tmp_path, "--tip", "l4")


def test_links_of_no_material_are_named(tmp_path):
    """A steel ball's mass in a thousandth of its inertia: a body, but none that can be built."""
    robot = load_robot("3r")
    small = robot.require_parameters("a test")
    inertia = InertialParameters.from_com(
        small.mass, small.com, 1e-4 * small.inertia_about_com.abs().clamp(min=1e-3)
        * torch.tensor([1.0, 0, 0, 1, 0, 1], dtype=torch.float64)
    )  # fmt: skip
    write_robot(robot.with_parameters(inertia), tmp_path / "points.yaml")
    options = ("--to", "urdf", "--out", tmp_path / "o", "--geometry", "none", "--force")
    run(tmp_path / "points.yaml", *options)
    warnings = json.loads((tmp_path / "o" / "export_urdf.json").read_text())["warnings"]
    (said,) = [w for w in warnings if "lead" in w]
    assert "link 1, 2, 3 is that of a body denser than lead" in said
    run("3r", *options, "--overwrite")
    warnings = json.loads((tmp_path / "o" / "export_urdf.json").read_text())["warnings"]
    assert not any("lead" in w for w in warnings)


@pytest.mark.slow
def test_how_wide_to_randomise(tmp_path, monkeypatch):
    """From a diagnosis to files of ranges and draws, and their record read back."""
    from tests.gap.small_logs import ONCE, ROBOT, Recording, arm, friction, logged
    from torchid.gap.diagnose import diagnose
    from torchid.gap.settings import GapSettings

    settings = GapSettings(effects=("coulomb_friction",))
    log = logged(arm(friction(2, Fc=1.0)), Recording(ONCE, duration=4.0))
    gap = tmp_path / "gap.json"
    diagnose(ROBOT, log, settings=settings).save(gap)
    out = tmp_path / "out"
    said = run(gap, "--randomise", "0.9", "--draws", "32", "--out", out, "--name", "arm")
    assert "90 % of the draws lie within each range" in said.replace("\n", " ")
    record = torchid.load(out / "randomisation.json")
    assert (record.draws, record.level, len(record.files)) == (32, 0.9, 4)
    assert all(Path(file).is_file() for file in record.files)
    assert [(r.field, r.name) for r in record.ranges] == [("friction", "joint_2")]
    with pytest.raises(TorchidError, match="for all simulators"):
        run(gap, "--randomise", "0.9", "--to", "mjcf")
    with pytest.raises(TorchidError, match="nothing to write"):
        run(gap)

    def broken(*_: object) -> None:
        raise TorchidError("broken")

    # Ranges and draws come with their JSON, or not at all.
    monkeypatch.setattr("torchid.report.exported.report_of_randomisation", broken)
    with pytest.raises(TorchidError, match="broken"):
        run(gap, "--randomise", "0.9", "--draws", "32", "--out", tmp_path / "none")
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize("to", ["isaaclab", "mjlab"])
def test_actuators(tmp_path, to):
    robot = replace(
        load_robot("3r"),
        effects=(
            {"effect": "coulomb_friction", "joint": 1, "Fc": 0.5},
            {"effect": "stribeck_friction", "joint": 1, "Fs": 0.3, "vs": 0.1},
            {"effect": "time_delay", "joint": 2, "delay": 0.003},
        ),
    )
    write_robot(robot, tmp_path / "arm.yaml")
    out = tmp_path / "out"
    said = run(tmp_path / "arm.yaml", "--to", to, "--out", out, "--name", "arm")
    assert f"LEFT OUT of the {to} file: joint 2: time_delay" in said.replace("\n", " ")
    record = torchid.load(out / f"export_{to}.json")
    assert record.effects.in_file[0].startswith("joint 1: stribeck_friction")
    assert record.effects.beside[0].startswith("joint 1: coulomb_friction")
    compile((out / f"arm_actuator_{to}.py").read_text(), "actuator", "exec")
    with pytest.raises(TorchidError, match="no effect that an actuator adds"):
        run("3r", "--to", to, "--out", out, "--overwrite")
