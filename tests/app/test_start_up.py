"""What the command line loads before a command needs it."""

import os
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest

import torchid
from torchid.app.options import LOG_SUFFIX
from torchid.identification.settings import Basis
from torchid.log.readers import written_suffixes
from torchid.robot import model

ROOT = str(Path(__file__).resolve().parents[2])
LOADED = """
import sys
sys.argv = ["torchid", *sys.argv[1:]]
from torchid.app import main
try:
    main()
finally:
    names = ("torch", "scipy", "pandas", "matplotlib", "mujoco", "sympy", "jinja2")
    print("loaded:", *(name for name in names if name in sys.modules))
"""


def _loaded(*arguments: str, code: int = 0, folder: Path | None = None) -> list[str]:
    """Libraries that a command loads."""
    done = subprocess.run(
        [sys.executable, "-c", LOADED, *arguments],
        capture_output=True, text=True, check=False, cwd=folder,
        env=os.environ | {"PYTHONPATH": ROOT},
    )  # fmt: skip
    assert done.returncode == code, done.stderr
    return done.stdout.splitlines()[-1].split()[1:]


@pytest.mark.parametrize("arguments", [[], ["--help"], ["--version"], ["gap", "--help"]])
def test_help_needs_no_library(arguments: list[str]) -> None:
    assert _loaded(*arguments) == []


HERE = ("gap", "3r", "run.csv")


@pytest.mark.parametrize(
    "arguments",
    [
        ("gap", "nope.urdf", "run.csv"),
        ("gap", "3r", "nofile.csv"),
        (*HERE, "--effects", "glue"),
        (*HERE, "--save-model", "a.txt"),
        (*HERE, "--json", "nowhere/a.json"),
        (*HERE, "--out", "run.csv"),
        (*HERE, "--out", "old"),
        (*HERE, "--to", "urdf"),
        ("identify", "3r", "columns.csv"),
        ("identify", "3r", "run.csv", "--columns", "q=pos_{j}"),
        ("identify", "3r", "run.csv", "--effects", "glue"),
        ("excite", "3r"),
        ("simulate", "3r", "run.csv"),
        ("export", "none.json", "--to", "urdf"),
        ("explain", "old/other.json"),
        ("compare", "a.json", "b.json"),
    ],
)
def test_errors_of_arguments_files_and_names_need_no_torch(tmp_path, arguments) -> None:
    """Which is loaded in more than a second."""
    (tmp_path / "run.csv").write_text("t,q1,q2,q3,tau1,tau2,tau3\n0,0,0,0,0,0,0\n1,1,1,1,1,1,1\n")
    (tmp_path / "columns.csv").write_text("a,b,c\n0,0,0\n")
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "gap.json").write_text("{}")
    (tmp_path / "old" / "other.json").write_text("{}")
    assert _loaded(*arguments, code=1, folder=tmp_path) == []


@pytest.mark.slow
def test_a_robot_needs_torch_alone() -> None:
    assert _loaded("robot", "kuka_lwr4", "--quiet") == ["torch"]


@pytest.mark.slow
@pytest.mark.parametrize("command", ["gap", "identify"])
def test_answers_load_what_they_need(tmp_path: Path, command: str) -> None:
    """No pictures, no parser of robots' files, and nothing of torch that loads sympy."""
    robot = torchid.load_robot("3r")
    motion = torchid.excite(robot, duration=6.0, restarts=1, iterations=0).log(100.0)
    torchid.write_log(torchid.simulate(robot, motion), tmp_path / "run.csv")
    assert _loaded(command, "3r", "run.csv", "--quiet", folder=tmp_path) == ["torch", "scipy"]


def test_the_settings_name_every_basis() -> None:
    # They name them themselves, so that the command line has them without torch.
    assert get_args(Basis) == get_args(model.Basis)


def test_the_suffixes_of_logs_are_known_without_their_writers() -> None:
    assert written_suffixes() == LOG_SUFFIX.names
