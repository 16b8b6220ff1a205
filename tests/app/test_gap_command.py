"""`torchid gap`: what it finds and writes, and that it refuses what it cannot use."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from tests.marks import quick_first
from tests.position.planted import planted, true_servos
from torchid.app.gap import _Asked
from torchid.app.output import Output
from torchid.excitation.synthetic import synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.log.readers import write_log
from torchid.robot.library import load_robot
from torchid.simulation.sensors import Sensors, measured_log


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Two runs of the 3R with friction of joint 2, the first one twice: exact positions."""
    path = tmp_path_factory.mktemp("gap")
    arm = replace(
        load_robot("3r"), effects=({"effect": "coulomb_friction", "joint": 2, "Fc": 0.6},)
    )
    noise = Sensors(torque_std=0.05)
    for k, (name, seed) in enumerate((("a", 0), ("b", 1), ("again", 0))):
        motion = trajectory_log(random_trajectory(arm, seed, duration=8.0, fill=True), 200.0)
        log = measured_log(arm, synthetic_log(arm, motion), [], noise, seed=k)
        write_log(log, path / f"{name}.csv")
    motion = trajectory_log(random_trajectory(arm, 2, duration=8.0, fill=True), 100.0)
    write_log(measured_log(arm, synthetic_log(arm, motion), [], noise), path / "slow.csv")
    motion = trajectory_log(random_trajectory(arm, 2, duration=8.0, fill=True), 200.0)
    short = synthetic_log(arm, motion).select(slice(0, 120))
    write_log(measured_log(arm, short, [], noise), path / "short.csv")
    return path


FEW = ("--effects", "coulomb_friction,viscous_friction")


def test_friction_is_found_and_the_saved_model_has_it(command, runs, tmp_path, types_unchecked):
    logs = [runs / f"{name}.csv" for name in ("a", "b", "again")]
    target, model = tmp_path / "gap.json", tmp_path / "corrected.yaml"
    options = ("--json", target, "--save-model", model, "--seed", "3")
    done = command("gap", "3r", *logs, *FEW, *options)
    assert done.code == 0, done.err
    said = json.loads(target.read_text())
    assert said["schema"] == "torchid.gap/2"
    assert said["seed"] == 3
    assert said["status"] == "explained"
    (only,) = said["which"]
    assert (only["effect"], only["joints"]) == ("coulomb_friction", [2])
    assert only["parameters"]["Fc"] == pytest.approx(0.6, abs=0.02)
    assert said["how_far"]["closed"] > 0.9
    assert "joint 2" in done.out.lower()
    assert str(model) in done.out.replace("\n", "")
    saved = load_robot(str(model))
    assert [e["effect"] for e in saved.effects] == ["coulomb_friction"]
    again = command("gap", model, *logs, *FEW, "--json", target)
    assert again.code == 0, again.err
    said = json.loads(target.read_text())
    assert said["status"] == "no_gap"
    assert said["which"] == []


def test_a_later_log_is_held_against_an_earlier_one(command, runs, tmp_path, types_unchecked):
    a, b, again = (runs / f"{name}.csv" for name in ("a", "b", "again"))
    target, model = tmp_path / "gap.json", tmp_path / "arm.yaml"
    done = command("gap", "3r", b, *FEW, "--before", a, "--json", target, "--save-model", model)
    assert done.code == 0, done.err
    said = json.loads(target.read_text())
    assert said["since"] == "a"
    assert [(w["effect"], w["when"]) for w in said["which"]] == [("coulomb_friction", "in both")]
    assert "Lacking already in a: " in " ".join(done.out.split())
    # The log that was asked is beside the model, and is what the next one is held against.
    rows = tmp_path / "arm.rows.npz"
    assert rows.is_file()
    done = command("gap", model, again, *FEW, "--json", target)
    assert done.code == 0, done.err
    assert json.loads(target.read_text())["since"] == "b"
    rows.write_bytes(rows.read_bytes()[:-1])
    refused = command("gap", model, again, *FEW)
    assert refused.code == 1
    assert "--no-rows" in refused.err
    other = tmp_path / "private.yaml"
    done = command("gap", model, again, *FEW, "--no-rows", "--save-model", other, "--json", target)
    assert done.code == 0, done.err
    assert "since" not in json.loads(target.read_text())
    assert not (tmp_path / "private.rows.npz").exists()


def test_a_time_that_does_not_suffice_gives_a_whole_answer(command, runs, tmp_path, monkeypatch):
    """It says what was not looked at, on screen and in the JSON; an ample one changes nothing."""
    # However fast the machine is, files take all of the short time.
    monkeypatch.setattr("torchid.app.gap.WRITING", (30.0, 0.0, 0.0, 0.0))
    logs = [runs / f"{name}.csv" for name in ("a", "b")]
    said = {}
    for name, time in (("short", "1"), ("ample", "600"), ("none", None)):
        target = tmp_path / f"{name}.json"
        options = () if time is None else ("--time", time)
        done = command("gap", "3r", *logs, *FEW, "--json", target, *options)
        assert done.code == 0, done.err
        said[name] = json.loads(target.read_text())
        stopped = said[name].pop("stopped_after", None)
        assert (stopped is None) == (name != "short")
        if stopped is not None:
            assert "further causes" in stopped["left_out"]
            assert f"! Stopped after {stopped['seconds']:.3g} s (--time); not" in done.out
    assert said["short"]["answer"]["causes"] == []
    assert said["short"]["answer"]["stopped"]
    assert said["ample"]["which"] == said["none"]["which"] != []
    assert not (tmp_path / "so_far.json").exists()


def test_ctrl_c_keeps_the_answer_that_stood(command, runs, tmp_path, monkeypatch):
    """Of a diagnosis that is stopped behind its search."""

    def stopped(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("torchid.gap.torque.decide", stopped)
    logs = [runs / f"{name}.csv" for name in ("a", "b")]
    done = command("gap", "3r", *logs, *FEW, "--out", tmp_path)
    assert done.code == 130
    kept = tmp_path / "so_far.json"
    assert f"interrupted; the answer so far is in {kept}" in done.err
    said = json.loads(kept.read_text())
    assert said["schema"] == "torchid.so_far/1"
    assert said["answer"]["status"] == "searching"
    assert [c["joints"] for c in said["answer"]["causes"]] == [[2]]
    assert "So far" in done.out


def test_ctrl_c_writes_over_no_whole_answer(command, runs, tmp_path, monkeypatch):
    def stopped(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("torchid.gap.torque.decide", stopped)
    out = tmp_path / "out"
    out.mkdir()
    for file in (tmp_path / "a.json", out / "gap.json", out / "where.png"):
        file.write_text("whole")
    for where in (("--json", tmp_path / "a.json"), ("--out", out, "--overwrite")):
        assert command("gap", "3r", runs / "a.csv", *FEW, *where).code == 130
    held = {p.name: p.read_text() for p in (*tmp_path.glob("*.json"), *out.iterdir())}
    assert json.loads(held.pop("so_far.json"))["schema"] == "torchid.so_far/1"
    assert held == dict.fromkeys(("a.json", "gap.json", "where.png"), "whole")
    assert (tmp_path / "so_far.json").is_file()
    assert (out / "so_far.json").is_file()


@pytest.mark.slow
def test_a_folder_takes_the_same_json_and_pictures_where_they_are_asked_for(
    command, runs, tmp_path
):
    target, out = tmp_path / "gap.json", tmp_path / "out"
    asked = ("gap", "3r", runs / "a.csv", *FEW, "--json", target, "--out", out)
    done = command(*asked, "--pictures")
    assert done.code == 0, done.err
    assert json.loads((out / "gap.json").read_text()) == json.loads(target.read_text())
    assert list(out.glob("*.png"))
    # Those of an earlier result do not stay beside another one.
    assert command(*asked, "--overwrite").code == 0
    assert [p.name for p in out.iterdir()] == ["gap.json"]


@pytest.mark.parametrize("held_out", quick_first([True, False], 1))
def test_logs_of_two_rates_are_resampled_to_the_lower(command, runs, held_out):
    """What is held out to that of the other log, on which it has no influence."""
    slow, fast = runs / "slow.csv", runs / "a.csv"
    done = command("gap", "3r", slow, *["--held-out"] * held_out, fast, *FEW, "--verbose")
    assert done.code == 0, done.err
    assert "resampled to 100 Hz" in " ".join(done.out.split())


@pytest.fixture(scope="module")
def commanded():
    return planted(true_servos(3), motions=2, seconds=8.0)


def test_a_log_without_torque_is_no_bed_for_causes(tmp_path, command, commanded, monkeypatch):
    """It is refused before it is diagnosed."""
    monkeypatch.setattr("torchid.diagnose", lambda *_, **__: pytest.fail("diagnosed"))
    write_log(commanded, tmp_path / "run.csv")
    outcome = command("calibrate", "3r", tmp_path / "run.csv", "--causes", "2")
    assert outcome.code == 1
    for word in ("causes are planted in torque", "commands and positions", "tau1.."):
        assert word in outcome.err


@pytest.mark.parametrize(
    ("asked", "writing"),
    [
        ({}, 0.5),
        ({"out": Path()}, 1.0),
        ({"out": Path(), "pictures": True}, 3.0),
        ({"report": Path("a.html")}, 4.5),
    ],
)
def test_time_is_kept_for_what_is_written(asked, writing):
    left = _Asked(time=60.0).seconds(Output(**asked))
    assert left == pytest.approx(60.0 - writing, abs=0.2)
