"""From a real log to the user's URDF: identify, extract, export, reload."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tests.marks import some
from tests.real_logs import FOLDER, NEEDS_LOGS
from torchid.app.commands import app
from torchid.robot.library import load_robot

pytestmark = NEEDS_LOGS
UR10E = FOLDER / "ur10e"
URDF = UR10E / "robot.urdf"
GAINS = "14.87,13.26,11.13,10.62,11.03,11.47"


def run(*arguments: object) -> None:
    words = [*map(str, arguments), "--quiet"]
    done = CliRunner().invoke(app, words, catch_exceptions=False)
    assert done.exit_code == 0, done.output


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The extraction from a log of the UR10e."""
    pytest.importorskip("clarabel")
    folder = tmp_path_factory.mktemp("ur10e")
    log = UR10E / "log_est_30s_12harm.parquet"
    run("identify", URDF, log, "--gain", GAINS, "--cutoff", 7, "--json", folder / "id.json")
    run("extract", URDF, folder / "id.json", "--method", "sdp", "--out", folder / "sets")
    return folder / "sets" / "extraction.json"


@pytest.mark.parametrize("to", some(["urdf", "mjcf", "c"], 1))
def test_a_ur10e_goes_back_into_its_urdf(tmp_path, sets, to):
    run("export", sets, "--to", to, "--out", tmp_path / to)
    data = json.loads((tmp_path / to / f"export_{to}.json").read_text())
    assert data["feasible"]
    asked = [c for c in data["checks"] if c["ok"] is not None]
    assert asked
    assert all(c["ok"] for c in asked)
    if to == "c":
        return
    again = load_robot(data["files"][0])
    assert len(again.effects) == 24
    assert again.joint_names == load_robot(URDF).joint_names
    if to == "urdf":
        text = (tmp_path / to / "ur10e.urdf").read_text()
        assert text.count("package://ur_e_description/meshes") == 14
        assert "EDITING THIS FILE BY HAND IS NOT RECOMMENDED" in text
