"""`torchid demo`: what it says of a cause that was withheld, and that it did not look."""

import hashlib
import json

import pytest

from torchid.files import write_text
from torchid.results.files import load
from torchid.robot.config_files import config_folder
from torchid.robot.library import load_robot
from torchid.withheld.demo import demonstrate, withheld_cause, write_files


def test_causes_differ_by_their_seeds_and_are_those_of_their_seed() -> None:
    arm = load_robot(config_folder("demonstration") / "arm.urdf")
    drawn = [withheld_cause(arm, seed) for seed in range(60)]
    assert drawn == [withheld_cause(arm, seed) for seed in range(60)]
    assert len({cause["effect"] for cause in drawn}) == 4
    assert {cause["joint"] for cause in drawn} == set(range(1, 7))


@pytest.mark.slow
def test_the_withheld_cause_is_compared_with_what_was_named(command, tmp_path) -> None:
    out = tmp_path / "demo"
    done = command("demo", "--out", out, "--seed", 3)
    assert done.code == 0, done.err
    said = json.loads((out / "demo.json").read_text())
    key = (out / "withheld.json").read_bytes()
    assert said["keys_sha256"] == hashlib.sha256(key).hexdigest()
    assert said["doctor"] == []
    assert max(said["held_out_percent_moving"]) < 5
    (opened,) = (one for one in said["opened"] if one["withheld"])
    assert opened["planted"] == json.loads(key)["withheld"]
    assert opened["named"]
    assert opened["value"] == pytest.approx(opened["planted"]["k"], abs=4 * opened["std"])
    assert [one["named"] for one in said["opened"]] == [True, True, True]
    assert said["not_planted"] == []
    assert load(out / "gap.json").answer.headline == said["headline"]
    assert "withheld" in done.out
    page = (out / "gap.html").read_text()
    assert "arm.urdf" in page
    assert str(out / "gap.html") in " ".join(done.out.split())


@pytest.mark.nightly
def test_the_diagnosis_knows_nothing_of_the_key(tmp_path) -> None:
    """With another key the same is named, and what is withheld is not found in it."""
    files = write_files(tmp_path, 0)
    other = {"effect": "viscous_friction", "joint": 5, "Fv": 9.0}
    write_text(files.key, json.dumps({"withheld": other}))
    demo = demonstrate(files, 0)
    assert demo.opened[-1].planted == other
    assert demo.opened[-1].finding is None
    assert [f.effect for f in demo.others] == ["torque_offset"]
