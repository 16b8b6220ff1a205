"""What every target plays, and how it answers: files between torchid's process and the target's.

A folder holds `arm.xml` or what else the target reads, and motion.npz:

    kind       `position` (servos follow commands) or `torque`
    control    (W, K, n) commands [rad; m] or torques [N m; N], each held for `steps` of the physics
    q, dq      (W, n) where windows begin [rad, rad/s; m, m/s]
    dt, steps  of one control [s], of the physics
    joints     names

The target writes moved.npy, (W, K, n) positions at the beginnings of the controls. Nothing but numpy
is imported: these modules run in environments without torchid's other packages.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True, eq=False)
class Played:
    """A motion, see above."""

    kind: str
    control: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    dt: float
    steps: int
    joints: tuple[str, ...]

    @property
    def step(self) -> float:
        """Step of the physics [s]."""
        return self.dt / self.steps

    @classmethod
    def read(cls, folder: Path) -> "Played":
        """From a folder's motion.npz."""
        with np.load(folder / "motion.npz") as data:
            kept = {name: data[name] for name in data.files}
        return cls(
            str(kept["kind"]), kept["control"], kept["q"], kept["dq"], float(kept["dt"]),
            int(kept["steps"]), tuple(kept["joints"].tolist()),
        )  # fmt: skip

    def write(self, folder: Path) -> None:
        """Into a folder."""
        np.savez(folder / "motion.npz", **{k: np.array(v) for k, v in vars(self).items()})


def answer(folder: Path, moved: np.ndarray) -> None:
    """Write what a target did with a motion."""
    np.save(folder / "moved.npy", moved)
