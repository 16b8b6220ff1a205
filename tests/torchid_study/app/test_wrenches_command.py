"""`torchid wrenches` as a user calls it."""

import json

import pytest
import typer
from typer.testing import CliRunner

from torchid.errors import TorchidError
from torchid.excitation.synthetic import HonestNoise, synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.feasibility.sets import joined, nominal_set, sets_record
from torchid.log.readers import write_log
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot
from torchid_study.app.wrenches import wrenches_command


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """sets.json: the 3R's own set and one with 1 kg more on link 3; motion.csv; log.parquet."""
    path = tmp_path_factory.mktemp("wrenches")
    robot = load_robot("3r")
    own = nominal_set(robot)
    pi = own.parameters.pi.clone()
    pi[0, 2, :4] *= 2.2 / 1.2
    heavy = type(own)(("heavy",), InertialParameters(pi), (), own.coefficients)
    (path / "sets.json").write_text(json.dumps(sets_record(joined([own, heavy]), robot).plain()))
    motion = random_trajectory(robot, 0, duration=4.0)
    write_log(trajectory_log(motion, 100.0), path / "motion.csv")
    log = synthetic_log(robot, trajectory_log(motion, 100.0), HonestNoise(), 0)
    write_log(log.replace(dq=None, ddq=None, tau=None), path / "positions.csv")
    return path


def call(*arguments: object):
    app = typer.Typer()
    app.command("wrenches")(wrenches_command)
    return CliRunner().invoke(app, [str(a) for a in arguments])


@pytest.mark.slow
def test_families_with_equal_torque(tmp_path):
    got = call(
        "3r", "--per-kind", 15, "--json", tmp_path / "w.json",
        "--out", tmp_path / "out", "--pictures", "--seed", 3, "--resamples", 20,
    )  # fmt: skip
    assert got.exit_code == 0, got.output
    text = " ".join(got.output.split())
    assert "The torque is equal" in text
    assert "against the nominal parameters" in text
    data = json.loads((tmp_path / "w.json").read_text())
    assert data == json.loads((tmp_path / "out" / "wrenches.json").read_text())
    assert (data["schema"], data["mode"]) == ("torchid.wrenches/1", "equal_torque")
    assert (data["robot"], data["seed"]) == ("3r", 3)
    assert data["torque_relative_max"] < 1e-9
    for entry in data["sets"]:
        kinds = {r.split("_")[0] for r in entry["reasons"]}
        assert entry["feasible"] == (entry["kind"] == "feasible") == (not kinds)
        assert (entry["degree"] < 0) == (not entry["feasible"])
    feasible = next(k for k in data["kinds"] if k["kind"] == "feasible")
    assert feasible["sets"] == 15
    assert len(feasible["force_rms"]) == 3
    reach = {r["kind"]: r for r in data["reach"]}
    assert max(reach["feasible"]["bound"]) > feasible["largest_force_rms"][1]
    figures = {p.name for p in (tmp_path / "out").glob("*.png")}
    assert figures == {"force_by_degree.png"}


def test_given_sets_against_the_nominal_one(folder, tmp_path):
    got = call(
        "3r", "--sets", folder / "sets.json", "--trajectory", folder / "motion.csv",
        "--json", tmp_path / "w.json", "--out", tmp_path, "--pictures",
    )  # fmt: skip
    assert got.exit_code == 0, got.output
    data = json.loads((tmp_path / "w.json").read_text())
    assert data["mode"] == "sets"
    own, heavy = data["sets"]
    assert own["force_rms"] == [0.0, 0.0, 0.0]
    assert own["feasible"]
    # 1 kg more on link 3 weighs 9.81 N on every joint, and a little more in motion.
    assert heavy["carried_mass_difference"] == pytest.approx([1.0] * 3)
    assert heavy["force_rms"] == pytest.approx([9.81] * 3, rel=0.1)
    assert max(heavy["torque_relative"]) > 0.1
    assert (tmp_path / "force_by_degree.png").exists()


def test_positions_alone_are_differentiated(folder, tmp_path):
    results = []
    for name in ("motion.csv", "positions.csv"):
        got = call(
            "3r", "--sets", folder / "sets.json", "--trajectory", folder / name, "--quiet",
            "--json", tmp_path / "w.json",
        )  # fmt: skip
        assert (got.exit_code, got.output) == (0, "")
        results.append(json.loads((tmp_path / "w.json").read_text())["sets"][1]["force_rms"])
    assert results[1] == pytest.approx(results[0], rel=0.02)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("panda",), "no inertial parameters"),
        (("3r", "--total-mass", "6,5"), "--total-mass"),
        (("3r", "--geometry", "cosy"), "no bounds 'cosy'"),
        (("3r", "--sets", "nowhere.json"), "nowhere.json"),
        (("kuka_lwr4", "--trajectory", "MOTION"), "does not fit robot"),
    ],
)
def test_mistakes_are_one_message(folder, arguments, said):
    got = call(*(folder / "motion.csv" if a == "MOTION" else a for a in arguments))
    assert isinstance(got.exception, TorchidError), got.output
    assert said in str(got.exception)
