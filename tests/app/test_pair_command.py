"""`torchid pair --simulated SIM --real REAL [ROBOT]`."""

import json

import pytest

from tests.pair.test_pair import log
from torchid.log.readers import write_log
from torchid.results.files import load
from torchid.robot.library import load_robot


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    path = tmp_path_factory.mktemp("pair")
    simulated = log(noise=1e-4)
    write_log(simulated.replace(t=2 * simulated.t), path / "fast.csv")
    write_log(simulated, path / "sim.csv")
    write_log(log(("Fc",)), path / "real.csv")
    return path


def test_a_fault_is_said_first(command, pair, tmp_path):
    done = command("pair", "--simulated", pair / "fast.csv", "--real", pair / "real.csv",
                   "--out", tmp_path)  # fmt: skip
    assert done.code == 0, done.err
    assert "2 times as long" in " ".join(done.out.split())
    said = json.loads((tmp_path / "pair.json").read_text())
    assert said["schema"] == "torchid.pair/2"
    assert said["faults"][0]["fault"] == "time_step"
    assert load(tmp_path / "pair.json").faults[0].value == pytest.approx(2, rel=1e-3)


@pytest.mark.slow
def test_an_effect_with_a_robot(command, pair, tmp_path):
    record, model, page = (tmp_path / f"pair.{kind}" for kind in ("json", "yaml", "html"))
    done = command("pair", "3r", "--simulated", pair / "sim.csv", "--real", pair / "real.csv",
                   "--effects", "coulomb_friction,torque_offset", "--json", record,
                   "--save-model", model, "--report", page)  # fmt: skip
    assert done.code == 0, done.err
    (only,) = load_robot(model).effects
    assert (only["effect"], only["joint"]) == ("coulomb_friction", 2)
    assert only["Fc"] == pytest.approx(0.8, abs=0.05)
    text = page.read_text()
    assert "Simulator beside arm" in text
    assert "Coulomb friction that only the arm has" in text
    assert "Coulomb friction that only the arm has at joint 2" in " ".join(done.out.split())
    assert json.loads(record.read_text())["which"][0]["joints"] == [2]


@pytest.mark.slow
def test_without_effects_there_is_no_corrected_model(command, pair, tmp_path):
    done = command("pair", "3r", "--simulated", pair / "fast.csv", "--real", pair / "real.csv",
                   "--save-model", tmp_path / "x.yaml", "--json", tmp_path / "x.json")  # fmt: skip
    assert done.code == 1
    assert "no corrected model" in done.err
    assert not (tmp_path / "x.yaml").exists()
    assert json.loads((tmp_path / "x.json").read_text())["faults"]
