"""What the command line loads before a command needs it."""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
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
import json, sys
from torchid.app import main
names = ("torch", "scipy", "pandas", "matplotlib", "mujoco", "sympy", "jinja2")
for line in json.loads(sys.argv.pop()):
    sys.argv[1:] = line
    sys.argv[0], code = "torchid", 0
    try:
        main()
    except SystemExit as stop:
        code = stop.code or 0
    print("loaded:", code, *(name for name in names if name in sys.modules))
"""


def _after(lines: Sequence[Sequence[str]], folder: Path | None = None) -> list[str]:
    """Exit codes of commands in one process, one after the other, and libraries loaded by then."""
    done = subprocess.run(
        [sys.executable, "-c", LOADED, json.dumps(lines)],
        capture_output=True, text=True, check=True, cwd=folder,
        env=os.environ | {"PYTHONPATH": ROOT},
    )  # fmt: skip
    return [x[8:] for x in done.stdout.splitlines() if x.startswith("loaded: ")]


def _loaded(*arguments: str, folder: Path | None = None) -> list[str]:
    """Libraries that a command loads."""
    (said,) = _after([arguments], folder)
    code, *names = said.split()
    assert code == "0"
    return names


def test_help_needs_no_library() -> None:
    assert _after([[], ["--help"], ["--version"], ["gap", "--help"]]) == ["0"] * 4


HERE = ("gap", "3r", "run.csv")


WRONG = (
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
)


def test_errors_of_arguments_files_and_names_need_no_torch(tmp_path) -> None:
    """Which is loaded in more than a second."""
    (tmp_path / "run.csv").write_text("t,q1,q2,q3,tau1,tau2,tau3\n0,0,0,0,0,0,0\n1,1,1,1,1,1,1\n")
    (tmp_path / "columns.csv").write_text("a,b,c\n0,0,0\n")
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "gap.json").write_text("{}")
    (tmp_path / "old" / "other.json").write_text("{}")
    assert _after(WRONG, tmp_path) == ["1"] * len(WRONG)


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
