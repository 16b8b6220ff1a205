"""`torchid gap` refuses what it cannot use before any work is done."""

import pytest


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--effects", "coulom_friction"), ("coulom_friction", "available", "coulomb_friction")),
        (("--effects", "none"), ("--effects", "all")),
        (("--background", "backlas"), ("backlas", "available")),
        (("--background", "torque_offset,torque_offset"), ("twice",)),
        (("--cutoff", "x"), ("--cutoff", "auto")),
        (("--cutoff", "-3"), ("--cutoff", "positive")),
        (("--held-out-fraction", "1.5"), ("held-out fraction",)),
        (("--gain", "1,2"), ("--gain", "3")),
        (("--save-model", "nowhere/robot.yaml"), ("--save-model", "folder")),
        (("--json", "nowhere/gap.json"), ("nowhere",)),
    ],
)
def test_bad_options(command, folder, arguments, words):
    outcome = command("gap", "3r", folder / "check.csv", *arguments)
    assert outcome.code == 1
    assert outcome.err.startswith("error: ")
    for word in words:
        assert word in outcome.err, outcome.err
    assert outcome.out == ""


def test_held_out_twice(command, folder):
    log = folder / "check.csv"
    outcome = command("gap", "3r", log, "--held-out", log, "--held-out-fraction", "0.2")
    assert outcome.code == 1
    assert "exclude each other" in outcome.err


def test_wrong_usage_exits_with_2(command, folder):
    assert command("gap", "3r").code == 2
    assert command("gap", "3r", folder / "check.csv", "--parameters", "maybe").code == 2
    assert command("gap", "3r", folder / "check.csv", "--max-effects", "0").code == 2


def test_missing_files(command, folder):
    outcome = command("gap", "3r", folder / "missing.csv")
    assert outcome.code == 1
    assert "missing.csv" in outcome.err
    assert command("gap", "no_robot", folder / "check.csv").code == 1


def test_help_has_an_example(command):
    shown = command("gap", "--help")
    assert shown.code == 0
    assert "Example" in shown.out
    for option in ("--effects", "--background", "--parameters", "--save-model", "--no-rollout"):
        assert option in shown.out
