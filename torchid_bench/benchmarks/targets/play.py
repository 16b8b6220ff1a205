"""Motions given to a target in its own environment."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[3]


def python_of(target: str) -> str | None:
    """The interpreter of a target's environment: what TORCHID_TARGET_MJLAB and so on name, and this
    one for MuJoCo."""
    if target == "mujoco":
        return sys.executable
    return os.environ.get(f"TORCHID_TARGET_{target.upper()}") or None


def play(target: str, folder: Path) -> np.ndarray:
    """What a target does with the motion of a folder: (W, K, n), see `motion`.

    Raises:
        RuntimeError: the target's process failed.
    """
    python = python_of(target)
    assert python is not None
    module = f"torchid_bench.benchmarks.targets.in_{target}"
    surroundings = {**os.environ, "PYTHONPATH": str(ROOT)}
    run = subprocess.run(
        [python, "-m", module, str(folder)],
        check=False,
        env=surroundings,
        capture_output=True,
        text=True,
    )
    if run.returncode:
        raise RuntimeError(f"{target}: {run.stderr[-2000:]}")
    moved: np.ndarray = np.load(folder / "moved.npy")
    return moved
