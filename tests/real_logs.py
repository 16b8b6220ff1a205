"""Where the real logs are: TORCHID_REAL_DATA, or a folder beside the project."""

import os
from pathlib import Path

import pytest

_BESIDE = Path(__file__).resolve().parents[2] / "shared" / "data"
FOLDER = Path(os.environ.get("TORCHID_REAL_DATA") or _BESIDE)

SOUND = ("emps", "panda_gaz", "panda_unisa", "ur10_unisa", "ur10e", "xmate7p")
"""Arms with torque, whose logs have no fault that anybody knows. In those of the others velocities
lag, torque is coarse or missing, or its scale is that of other motors."""

NO_LOGS = f"no folder of real logs: {FOLDER} (TORCHID_REAL_DATA names one)"
NEEDS_LOGS = [pytest.mark.real, pytest.mark.skipif(not FOLDER.is_dir(), reason=NO_LOGS)]
"""Marks of a module whose tests read them."""
