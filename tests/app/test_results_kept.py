"""A second run does not write over the results of the first, and one that fails leaves nothing."""

import os

import pytest


def _held(folder) -> dict[str, float]:
    return {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}


def test_a_second_run_is_told_what_to_paste(command, folder, tmp_path) -> None:
    out, model = tmp_path / "result", tmp_path / "kept.yaml"
    asked = ("identify", "3r_friction", folder / "check.csv", "--cutoff", "8", "--out", out)
    assert command(*asked).code == 0
    before = _held(out)
    again = command(*asked)
    assert (again.code, again.out) == (1, "")
    assert f"{out}/identification.json" in again.err
    assert again.err.rstrip().endswith("--overwrite")
    assert "torchid identify 3r_friction" in again.err
    assert _held(out) == before
    # Another command has other names there.
    assert command("robot", "3r", "--out", out).code == 0
    assert command(*asked, "--overwrite").code == 0
    assert _held(out)["identification.json"] > before["identification.json"]
    model.write_text("mine")
    refused = command("gap", "3r", folder / "check.csv", "--save-model", model)
    assert (refused.code, str(model) in refused.err) == (1, True)
    assert model.read_text() == "mine"


def test_what_goes_on_is_no_second_run(command, tmp_path, monkeypatch) -> None:
    out = tmp_path / "sets"
    few = ("extract", "3r", "--runs", "2", "--stages", "1", "--generations", "1", "--out", out)
    assert command(*few, "--no-certificate").code == 0
    assert command(*few).code == 1


@pytest.mark.parametrize("out", ["one", "one/two"])
@pytest.mark.parametrize("there", [False, True])
def test_a_run_that_fails_leaves_no_empty_folder(command, broken, tmp_path, out, there) -> None:
    target = tmp_path / out
    if there:
        target.mkdir(parents=True)

    def one_short(table):
        return {name: values[:7] for name, values in table.items()}

    log = broken(one_short)
    before = sorted(os.walk(tmp_path))
    done = command("identify", "3r_friction", log, "--cutoff", "none", "--out", target)
    assert done.code == 1, done.out
    assert sorted(os.walk(tmp_path)) == before
