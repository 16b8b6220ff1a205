"""`torchid withheld own`, as a user would call it."""

import runpy
from pathlib import Path

import pytest


def test_other_processes_can_import_the_launcher():
    launcher = Path(__file__).parents[2] / "cli.py"
    assert callable(runpy.run_path(str(launcher), run_name="__mp_main__")["main"])


@pytest.fixture
def log(command, tmp_path):
    path = tmp_path / "run.parquet"
    assert command("excite", "3r", "--kind", "random", "--to", tmp_path / "m.csv").code == 0
    outcome = command("simulate", "3r", tmp_path / "m.csv", "--noise", "honest", "--to", path)
    assert outcome.code == 0, outcome.err
    return path


def test_own_says_what_is_wrong_before_the_work(log, command):
    outcome = command("withheld", "own", "3r", log, "--background", "viscous_friction")
    assert outcome.code == 1
    assert "--parameters free" in outcome.err
    assert "Traceback" not in outcome.err
