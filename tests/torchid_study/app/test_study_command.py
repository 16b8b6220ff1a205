"""torchid study from the outside."""

import json

import pytest

TINY = ("--runs", "3", "--stages", "2", "--generations", "4")


@pytest.mark.nightly
def test_a_study_leaves_its_sets_and_json(command, tmp_path):
    shown = command("study", "3r", *TINY, "--out", tmp_path, "--json", tmp_path / "s.json")
    assert shown.code == 0, shown.err
    folder = tmp_path / "3r"
    data = json.loads((tmp_path / "s.json").read_text())
    assert data == json.loads((folder / "study.json").read_text())
    assert data["schema"] == "torchid.study/1"
    assert [s["id"] for s in data["sets"]] == ["p_1", "p_4", "p_5", "p_8", "p_9", "p_12"]
    assert data["certificate"]["normal"]["phi_min"] < 1e-18
    every = json.loads((folder / "all_sets.json").read_text())["sets"]
    assert [s["id"] for s in every][2:4] == ["p_1/run_3", "p_4/run_1"]
    checked = command("check", folder / "sets.json", "--robot", "3r", "--json", tmp_path / "c.json")
    assert checked.code == 0, checked.err
    verdicts = {
        s["id"]: s["feasible"] for s in json.loads((tmp_path / "c.json").read_text())["sets"]
    }
    for entry in data["sets"]:
        # The command knows no total mass for this robot, the study does.
        if entry["reasons"] != ["total_mass"]:
            assert verdicts[entry["id"]] == entry["feasible"]


@pytest.mark.nightly
def test_a_study_by_two_processes_is_the_same(command, tmp_path):
    found = []
    for workers in (1, 2):
        target = tmp_path / f"{workers}.json"
        shown = command("study", "3r", *TINY, "--workers", workers, "--json", target)
        assert shown.code == 0, shown.err
        data = json.loads(target.read_text())
        assert set(data.pop("seconds")) > {"extraction p_1", "extraction p_12", "payload"}
        for proof in data["certificate"].values():
            proof.pop("seconds")
        found.append(data)
    assert found[0] == found[1]


@pytest.mark.nightly
def test_all_studies(command, tmp_path):
    target = tmp_path / "all.json"
    shown = command("study", "all", *TINY, "--out", tmp_path, "--json", target)
    assert shown.code == 0, shown.err
    data = json.loads(target.read_text())
    names = [study["study"] for study in data["studies"]]
    assert names == ["3r", "3r_friction", "kuka_lwr4", "kuka_lwr4_friction"]
    assert all((tmp_path / name / "study.json").is_file() for name in names)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["4r"], "available: 3r, 3r_friction, kuka_lwr4, kuka_lwr4_friction, all"),
        (["3r", "--runs", "0"], "runs"),
    ],
)
def test_bad_input(command, arguments, said):
    shown = command("study", *arguments)
    assert shown.code == 1
    assert said in shown.err


def test_choices_are_wrong_usage(command):
    assert command("study", "3r", "--schedule", "nonsense").code == 2
