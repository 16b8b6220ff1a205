"""A second run does not write over the results of the first, and one that fails leaves nothing."""

import json
import time

import torchid
from torchid.errors import TorchidError


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


def test_results_that_come_meanwhile_are_not_written_over(
    command, folder, tmp_path, monkeypatch
) -> None:
    """Another run into the same folder was faster: both sets of results are kept, and whole."""
    out = tmp_path / "result"
    asked = ("identify", "3r_friction", folder / "check.csv", "--cutoff", "8", "--out", out)
    identify = torchid.identify

    def late(*given, **more):
        found = identify(*given, **more)
        time.sleep(0.02)
        (out / "identification.json").write_text("theirs")
        return found

    monkeypatch.setattr("torchid.identify", late)
    done = command(*asked)
    assert done.code == 1
    assert "another run has put its results there" in done.err
    assert (out / "identification.json").read_text() == "theirs"
    assert [path.name for path in out.iterdir()] == ["identification.json"]
    (beside,) = tmp_path.glob("result-*")
    assert str(beside) in done.err
    assert json.loads((beside / "identification.json").read_text())["n_base"]
    # One that is asked to write over them does.
    assert command(*asked, "--overwrite").code == 0
    assert json.loads((out / "identification.json").read_text())["n_base"]


def test_a_command_that_fails_behind_its_answer_leaves_the_old_set(
    command, folder, tmp_path, monkeypatch
) -> None:
    out = tmp_path / "result"
    asked = (
        "identify", "3r_friction", folder / "check.csv", "--cutoff", "8", "--pictures",
        "--out", out,
    )  # fmt: skip
    assert command(*asked).code == 0
    before = {path: path.read_bytes() for path in out.iterdir()}
    assert len(before) > 1

    def full(*_: object) -> None:
        raise TorchidError("the disk is full.")

    monkeypatch.setattr("torchid.report.panels.save", full)
    assert command(*asked, "--overwrite", "--seed", 7).code == 1
    assert {path: path.read_bytes() for path in out.iterdir()} == before
