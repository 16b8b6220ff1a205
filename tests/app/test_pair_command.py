"""`torchid gap --simulated SIM --real REAL [ROBOT]`."""

import json

import pytest

from tests.pair.test_pair import log
from torchid.log.readers import write_log
from torchid.results.files import load

BOTH = ("--simulated", "sim.csv", "--real", "real.csv")


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    path = tmp_path_factory.mktemp("pair")
    simulated = log(noise=1e-4)
    write_log(simulated.replace(t=2 * simulated.t), path / "fast.csv")
    write_log(simulated, path / "sim.csv")
    write_log(log(("Fc",)), path / "real.csv")
    return path


def test_a_fault_is_said_first(command, pair, tmp_path):
    done = command("gap", "--simulated", pair / "fast.csv", "--real", pair / "real.csv",
                   "--out", tmp_path)  # fmt: skip
    assert done.code == 0, done.err
    assert "2 times as long" in " ".join(done.out.split())
    said = json.loads((tmp_path / "pair.json").read_text())
    assert said["schema"] == "torchid.pair/1"
    assert said["faults"][0]["fault"] == "time_step"
    assert load(tmp_path / "pair.json").faults[0].value == pytest.approx(2, rel=1e-3)


@pytest.mark.slow
def test_an_effect_with_a_robot(command, pair, tmp_path):
    record = tmp_path / "pair.json"
    done = command("gap", "3r", "--simulated", pair / "sim.csv", "--real", pair / "real.csv",
                   "--effects", "coulomb_friction,torque_offset", "--json", record)  # fmt: skip
    assert done.code == 0, done.err
    assert "Coulomb friction that only the arm has at joint 2" in " ".join(done.out.split())
    assert json.loads(record.read_text())["which"][0]["joints"] == [2]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--real", "real.csv"), "--simulated"),
        (("--simulated", "sim.csv"), "--real"),
        ((*BOTH, "--save-model", "x.yaml"), "--save-model"),
        (("3r", "sim.csv", *BOTH), "LOG"),
        (("ur10e", *BOTH), "joint"),
    ],
)  # fmt: skip
def test_bad_options(command, pair, monkeypatch, arguments, words):
    monkeypatch.chdir(pair)
    done = command("gap", *arguments)
    assert done.code == 1
    assert words in done.err


def test_without_a_pair_robot_and_logs_are_needed(command):
    for arguments in ((), ("3r",)):
        done = command("gap", *arguments)
        assert done.code == 2
        assert "Missing argument" in done.err
