"""`torchid fleet` from the outside."""

import json

import pytest

from tests.fleet.simulated import Plan, make
from torchid.robot.library import load_robot

EFFECTS = ("--effects", "viscous_friction,coulomb_friction,torque_offset")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("fleet")
    make(load_robot("3r_friction"), Plan(units=2, sessions=2), place)
    return place


def test_identify_writes_and_says_the_verdict_first(command, folder, tmp_path) -> None:
    out = tmp_path / "out"
    done = command("fleet", "identify", "3r_friction", folder, *EFFECTS, "--out", out)
    assert done.code == 0, done.err
    assert done.out.startswith("3r_friction: 2 units, 4 sessions, 4 logs")
    assert "no unit can be called odd" in " ".join(done.out.split())
    data = json.loads((out / "fleet.json").read_text())
    assert data["schema"] == "torchid.fleet/1"
    assert [u["unit"] for u in data["units"]] == ["arm-000", "arm-001"]
    assert (out / "store" / "index.parquet").exists()


@pytest.mark.slow
def test_the_type_is_written_and_a_unit_is_asked_about(command, folder, tmp_path) -> None:
    model = tmp_path / "type.yaml"
    done = command("fleet", "identify", "3r_friction", folder, *EFFECTS, "--save-model", model)
    assert done.code == 0, done.err
    log = next(folder.rglob("*.parquet"))
    done = command("gap", model, log, "--json", tmp_path / "gap.json")
    assert done.code == 0, done.err
    said = json.loads((tmp_path / "gap.json").read_text())
    assert said["knowledge"]["sources"] == ["2 units in 4 sessions"]
    assert said["which"] == []  # nothing is odd about this unit


def test_parts_then_the_whole_by_a_manifest(command, folder, tmp_path) -> None:
    logs = sorted(folder.rglob("*.parquet"))
    rows = [f"{log},{log.parent.name},{log.stem}" for log in logs]
    manifest = tmp_path / "fleet.csv"
    manifest.write_text("\n".join(["log,unit,session", *rows]) + "\n")
    asked = ("fleet", "identify", "3r_friction", "--manifest", manifest, *EFFECTS,
             "--store", tmp_path / "store")  # fmt: skip
    for part in ("1/2", "2/2"):
        done = command(*asked, "--array", part)
        assert done.code == 0, done.err
        assert f"part {part[0]} of 2: 2 logs, 0 of them not used" in done.out
    done = command(*asked, "--json", tmp_path / "fleet.json")
    assert done.code == 0, done.err
    assert len(json.loads((tmp_path / "fleet.json").read_text())["logs"]) == 4
