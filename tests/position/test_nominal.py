"""Servos as they are said to be."""

import math
from pathlib import Path

import pytest

import torchid
from tests.position.diagnosed import diagnosis
from torchid.errors import TorchidError
from torchid.position.diagnosis import PositionDiagnosis
from torchid.position.model import ServoArm
from torchid.position.nominal import PRESETS, nominal_servos, read_servos, types_of
from torchid.robot.library import load_robot
from torchid.robot.writer import robot_yaml


def test_the_gain_of_a_dynamixel() -> None:
    """By hand: P 800 makes 800/128 steps of duty a count, 885 of which are the stall torque."""
    (servo,) = read_servos("XM430 gain=800", 1)
    counts = 4096 / (2 * math.pi)
    assert servo.values["kp"] == pytest.approx(800 / 128 * counts / 885 * 4.1)
    assert servo.values["clip"] == 4.1
    # One step of the profile's acceleration is 214.577 revolutions a minute, a minute.
    assert servo.units["acceleration"] == pytest.approx(214.577 * 2 * math.pi / 60**2)


def test_what_is_not_in_public_tables_is_unknown() -> None:
    assert "kp" not in PRESETS["STS3215"].values
    assert 254 * PRESETS["STS3215"].units["acceleration"] == pytest.approx(38.96, abs=0.01)
    with pytest.raises(TorchidError, match="what a step of the gain makes is not known of STS3215"):
        read_servos("STS3215 gain=16", 1)
    assert read_servos("sts3215 kp=17.8 counts=unknown", 1)[0].counts is None


def test_which_are_units_of_one_type() -> None:
    assert types_of(read_servos("STS3215", 3)) == ("STS3215",) * 3
    assert types_of(read_servos("kp=3", 2)) == ("", "")  # each as it is said to be
    assert types_of(read_servos("type=big kp=3,type=big,type=small", 3)) == ("big", "big", "small")


def test_one_a_joint() -> None:
    first, second = read_servos("XL330 clip=unknown, kp=3 dead_zone=0.002", 2)
    assert first.name == "XL330-M288"
    assert "clip" not in first.values
    assert second.values == {"kp": 3.0, "dead_zone": 0.002}
    with pytest.raises(TorchidError, match="another number of servos"):
        read_servos("XL330,XL330", 3)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("SG90", "no such servo"),
        ("XL330 speedy=3", "no such value"),
        ("XL330 clip=strong", "not a number"),
        ("", "no such servo"),
    ],
)
def test_bad_texts(text: str, problem: str) -> None:
    if not text:
        assert read_servos(text, 1)[0].values == {}
        return
    with pytest.raises(TorchidError, match=problem):
        read_servos(text, 1)


def test_in_a_robots_yaml(tmp_path: Path) -> None:
    plain = robot_yaml(load_robot("3r"))
    file = tmp_path / "arm.yaml"
    file.write_text(plain + "servo: MX-64\n")
    assert [s.name for s in nominal_servos(load_robot(file), None)] == ["MX-64"] * 3
    assert nominal_servos(load_robot(file), "XL430")[0].name == "XL430-W250"
    file.write_text(plain + "servo: [MX-64, XL430, kp=3]\n")
    assert [s.name for s in nominal_servos(load_robot(file), None)] == [
        "MX-64",
        "XL430-W250",
        "servo",
    ]
    file.write_text(plain)
    assert nominal_servos(load_robot(file), None) == ()
    assert nominal_servos(load_robot("3r"), None) == ()


def test_servos_of_an_earlier_fit_are_not_forgotten(tmp_path: Path) -> None:
    """A model that `torchid gap --save-model` wrote of commands and positions."""
    file = tmp_path / "corrected.yaml"
    ServoArm.of(load_robot("3r"), kp=[30.0, 20.0, 10.0], delay=0.02).write(file)
    found = nominal_servos(load_robot(file), None)
    assert [servo.values["kp"] for servo in found] == [30.0, 20.0, 10.0]
    assert {servo.values["delay"] for servo in found} == {0.02}
    assert nominal_servos(load_robot(file), "XL430")[0].name == "XL430-W250"


def test_servos_that_the_recorder_names_are_of_one_type(monkeypatch: pytest.MonkeyPatch) -> None:
    """As `servo=...` says it, unless the user or the robot's file says something else."""
    made, asked = diagnosis(), []

    def search(*_: object, types: tuple[str, ...], **__: object) -> PositionDiagnosis:
        asked.append(types)
        return made

    monkeypatch.setattr("torchid.gap.diagnose.diagnose_positions", search)
    log = made.data.log.replace(servos="STS3215", source="set")
    found = torchid.diagnose(made.data.robot, log)
    assert isinstance(found, PositionDiagnosis)
    assert [s.name for s in found.nominal] == ["STS3215"] * 3
    assert "recorded from servos STS3215" in found.warnings[0]
    assert found.warnings[1:] == made.warnings
    denied = torchid.diagnose(made.data.robot, log, servo="kp=unknown")
    assert denied.warnings == made.warnings
    torchid.diagnose(made.data.robot, log.replace(servos=""))
    assert asked == [("STS3215",) * 3, ("",) * 3, ()]
