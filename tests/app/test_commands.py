"""Every command from the outside: what it prints, writes and returns."""

import json
import os
import runpy
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from torchid.robot.library import load_robot
from torchid.robot.writer import write_robot

ROOT = Path(__file__).resolve().parents[2]


def test_other_processes_can_import_the_launcher():
    assert callable(runpy.run_path(str(ROOT / "cli.py"), run_name="__mp_main__")["main"])


@pytest.mark.slow
@pytest.mark.parametrize("launcher", [["cli.py"], ["-m", "torchid"]])
def test_launchers_run_one_thread_by_default(launcher):
    result = subprocess.run(
        [sys.executable, *launcher, "robot", "3r", "--quiet"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [([], "1"), (["--threads", "3"], "3"), (["--threads=2"], "2"), (["--threads", "x"], "1")],
)
def test_threads_are_set_before_torch_loads(monkeypatch, arguments, expected):
    from torchid.app import set_environment

    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    set_environment(["identify", "3r", *arguments])
    import os

    assert os.environ["OMP_NUM_THREADS"] == expected
    assert os.environ["OPENBLAS_NUM_THREADS"] == expected


def test_import_loads_neither_torch_nor_numpy():
    code = (
        "import sys, torchid, torchid.app; "
        "print([m for m in ('torch', 'numpy', 'matplotlib') if m in sys.modules])"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert result.stdout.strip() == "[]"


@pytest.mark.parametrize("name", ["3r", "kuka_lwr4_friction", "panda"])
def test_robot(command, tmp_path, name):
    target = tmp_path / "robot.json"
    shown = command("robot", name, "--json", target)
    assert shown.code == 0
    assert name in shown.out
    data = json.loads(target.read_text())
    assert data["schema"] == "torchid.robot/1"
    assert [j["joint"] for j in data["joints"]] == list(range(1, len(data["joints"]) + 1))


def test_robot_names_inconsistent_links(command):
    shown = " ".join(command("robot", "kuka_lwr4").out.split())
    for link in (3, 4, 7):
        assert f"link 'link_{link}' is not physically consistent" in shown
    assert "link 'link_5'" not in shown


def test_robot_without_parameters_says_so(command):
    assert "no inertial parameters" in command("robot", "panda").out


def test_identify_writes_everything(command, folder, tmp_path):
    out, target = tmp_path / "result", tmp_path / "result.json"
    shown = command(
        "identify", "3r_friction", folder / "fit.parquet", "--held-out", folder / "check.csv",
        "--cutoff", "8", "--out", out, "--pictures", "--json", target,
    )  # fmt: skip
    assert shown.code == 0, shown.err
    assert "15 base parameters of 3r_friction" in shown.out
    assert json.loads(target.read_text()) == json.loads((out / "identification.json").read_text())
    data = json.loads(target.read_text())
    assert data["schema"] == "torchid.identification/1"
    assert data["n_base"] == 15
    assert data["cutoff_hz"] == 8.0
    assert max(data["held_out"]["relative_error_percent_moving"]) < 3
    pictures = sorted(p.name for p in out.glob("*.png"))
    assert pictures == ["parameters.png", "torque_1.png"]
    assert all((out / p).read_bytes().startswith(b"\x89PNG") for p in pictures)
    assert not list(out.glob("*.tmp*"))


def test_identify_takes_effects_with_places_and_shapes(command, folder, tmp_path):
    target = tmp_path / "result.json"
    effects = "viscous_friction,joint_spring:joint=2,curvature=0,stribeck_friction:joint=3"
    shown = command(
        "identify", "3r_friction", folder / "check.csv", "--cutoff", "8", "--effects", effects,
        "--json", target,
    )  # fmt: skip
    assert shown.code == 0, shown.err
    data = json.loads(target.read_text())
    assert data["settings"]["effects"] == [
        "viscous_friction", "joint_spring:joint=2,curvature=0", "stribeck_friction:joint=3"
    ]  # fmt: skip
    friction, spring, stribeck = data["effects"]
    assert "places" not in friction
    assert spring["places"] == [{"joint": 2, "curvature": 0.0}]
    assert stribeck["places"][0]["vs"] > 0
    assert any("was searched on the training data" in w for w in data["warnings"])
    for row in ("curvature = 0 1/rad² of joint spring, joint 2; vs = ", "c02 ", "Fs3 "):
        assert row in " ".join(shown.out.split())


def test_quiet_prints_nothing(command, folder):
    shown = command("identify", "3r_friction", folder / "check.csv", "--quiet", "--cutoff", "8")
    assert (shown.code, shown.out, shown.err) == (0, "", "")


@pytest.mark.slow
def test_currents_need_gains(command, broken, tmp_path):
    def to_currents(table):
        return {k.replace("tau", "i"): v / 10 if k[:3] == "tau" else v for k, v in table.items()}

    path = broken(to_currents)
    target = tmp_path / "gain.json"
    assert command("identify", "3r_friction", path, "--gain", "10,10,10", "--cutoff", "8",
                   "--json", target).code == 0  # fmt: skip
    fc = next(
        e for e in json.loads(target.read_text())["effects"] if e["effect"] == "coulomb_friction"
    )
    assert fc["joints"] == [1, 2, 3]
    assert fc["parameters"]["Fc"] == pytest.approx([0.245, 0.1523, 0.1827], rel=0.1)


@pytest.mark.parametrize("kind", ["random", "sinusoid", "paper"])
def test_excite_kinds(command, tmp_path, kind):
    target = tmp_path / "motion.parquet"
    assert command("excite", "3r", "--kind", kind, "--count", 2, "--to", target).code == 0
    from torchid.log.readers import read_log

    assert read_log(target).trajectory_count == (3 if kind == "paper" else 2)


@pytest.fixture
def weak_arm(tmp_path):
    """weak_arm(limits) -> a yaml of the 3R with torque limits."""

    def made(*limits: float) -> Path:
        robot = load_robot("3r_friction")
        upper = torch.tensor(limits, dtype=torch.float64)
        torque = torch.stack([-upper, upper], -1)
        robot = replace(robot, limits=replace(robot.limits, torque=torque))
        write_robot(robot, tmp_path / "weak.yaml")
        return tmp_path / "weak.yaml"

    return made


def test_excite_beyond_every_drive_writes_nothing(command, weak_arm, tmp_path):
    done = command("excite", weak_arm(0.6, 3, 0.1), "--out", tmp_path / "out")
    assert done.code == 1
    assert "no motion keeps the torque limit of joint 3" in done.err
    assert not list((tmp_path / "out").glob("*"))


@pytest.mark.parametrize(("robot", "limited"), [("panda", True), ("3r", False)])
def test_excite_says_that_torque_limits_were_not_checked(command, tmp_path, robot, limited):
    data = tmp_path / "m.json"
    done = command("excite", robot, "--kind", "random", "--json", data)
    assert done.code == 0, done.err
    said = json.loads(data.read_text())["torque"]
    assert said["checked"] is False
    assert (
        ("limits were not checked" in done.out)
        == ("no inertial parameters" in said["reason"])
        == limited
    )


@pytest.mark.slow
@pytest.mark.parametrize("more", [(), ("--json", "-")])
def test_a_reader_that_leaves_is_no_error(tmp_path: Path, more: tuple[str, ...]) -> None:
    """`torchid ... | head`: what is left unsaid is no failure, and files are still written."""
    reading, writing = os.pipe()
    os.close(reading)
    arguments = ["robot", "3r", *(more or ("--json", tmp_path / "r.json"))]
    done = subprocess.run(
        [sys.executable, ROOT / "cli.py", *arguments],
        check=False, stdout=writing, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    os.close(writing)
    assert (done.returncode, done.stderr) == (0, "")
    assert more or json.loads((tmp_path / "r.json").read_text())["schema"]
