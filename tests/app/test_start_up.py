"""What the command line loads before a command needs it."""

import subprocess
import sys
from typing import get_args

import pytest

from torchid.identification.settings import Basis
from torchid.robot import model

LOADED = """
import sys
sys.argv = ["torchid", *sys.argv[1:]]
from torchid.app import main
try:
    main()
finally:
    print("loaded:", *(name for name in ("torch", "scipy", "pandas") if name in sys.modules))
"""


def _loaded(*arguments: str) -> list[str]:
    """Libraries that a command loads."""
    done = subprocess.run(
        [sys.executable, "-c", LOADED, *arguments], capture_output=True, text=True, check=True
    )
    return done.stdout.splitlines()[-1].split()[1:]


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["gap", "--help"]])
def test_help_needs_no_library(arguments: list[str]) -> None:
    assert _loaded(*arguments) == []


@pytest.mark.slow
def test_a_robot_needs_torch_alone() -> None:
    assert _loaded("robot", "kuka_lwr4", "--quiet") == ["torch"]


def test_the_settings_name_every_basis() -> None:
    # They name them themselves, so that the command line has them without torch.
    assert get_args(Basis) == get_args(model.Basis)
