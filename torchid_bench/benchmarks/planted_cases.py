"""Real logs in halves, and the effects that were planted into the second ones, as files.

WORK/LOG/EFFECT-SIZE.npz holds the planted log's torque at its own stamps (and its velocities, where
these are planted) and the key to it; WORK/LOG/model.yaml is the arm as the first half makes it. So
every diagnosis that is scored sees the same torques, whatever has become of the code that drew them.
"""

import gzip
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchid.log.model import Log
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid_bench.benchmarks.real_logs import LINES, read

KEPT = Path(__file__).with_name("planted")

UR10E = LINES["ptp"].logs


@dataclass(frozen=True)
class Source:
    """A real log.

    Attributes:
        robot, logs: files below the data folder.
        tip: last link, where the model has more.
        cutoff: of the fit [Hz], where the default is not the arm's.
    """

    robot: str
    logs: tuple[str, ...]
    tip: str | None = None
    cutoff: float | None = None


SOURCES = {
    "panda": Source("panda_gaz/robot.yaml", ("panda_gaz/log_exciting_traj1.parquet",)),
    "ur10e": Source("ur10e/robot.urdf", UR10E[1:]),
    "ur10": Source("ur10_unisa/robot.yaml", ("ur10_unisa/log_exciting.parquet",)),
    "xmate": Source(
        "xmate7p/robot.urdf", ("xmate7p/log_traj1.parquet", "xmate7p/log_traj2.parquet")
    ),
    "unisa": Source("panda_unisa/robot.yaml", ("panda_unisa/log_exciting.parquet",)),
    "airbot": Source("airbot_play/robot.urdf", ("airbot_play/log_trapez_real.parquet",)),
    "baxter": Source("baxter_left/robot.urdf", ("baxter_left/log_random.parquet",), cutoff=3.0),
    "kr300": Source(
        "kuka_kr300/kin.yaml",
        tuple(f"kuka_kr300/log_{k}.parquet" for k in ("A_ident", "B_val1", "C_val2")),
    ),
    "tiago": Source("tiago/robot.urdf", ("tiago/log_identification.parquet",), tip="arm_7_link"),
}


def halves(source: Source, data: Path) -> tuple[Robot, Log, Log]:
    """The arm without parameters, and both halves of its log."""
    robot = load_robot(str(data / source.robot), tip=source.tip)
    return replace(robot, parameters=None, effects=()), *read(data, source.logs).split(0.5)


@dataclass(frozen=True, eq=False)
class Case:
    """A log with an effect planted.

    Attributes:
        name: of the effect, and its size, e.g. `cogging-2`.
        key: what was planted: `effect`, its `record` as in a robot's yaml, `joints` it is located
            at and those that it is `felt_by`, both from 0, and its `size` over what the model
            leaves.
        tau: (T, n) torque of the log with it [N m; N].
        dq: (T, n) velocities [rad/s; m/s]; None where they are the log's own.
    """

    name: str
    key: dict[str, Any]
    tau: np.ndarray
    dq: np.ndarray | None = None

    def log(self, second: Log) -> Log:
        """The second half of the log with it."""
        log = second.replace(tau=torch.from_numpy(self.tau))
        return log if self.dq is None else log.replace(dq=torch.from_numpy(self.dq))

    def write(self, folder: Path) -> None:
        """Into the folder of its log."""
        held = {"key": np.array(json.dumps(self.key)), "tau": self.tau}
        if self.dq is not None:
            held["dq"] = self.dq
        np.savez_compressed(folder / f"{self.name}.npz", allow_pickle=False, **held)

    @classmethod
    def read(cls, file: Path) -> "Case":
        """As `write` has written it."""
        with np.load(file) as held:
            key = json.loads(str(held["key"]))
            return cls(file.stem, key, held["tau"], held.get("dq"))


def unpack(label: str, folder: Path) -> None:
    """What the stored classes belong to, into a folder that has nothing yet: the arm as the first
    half of the log made it, and what was left of the second one, by which sizes were drawn."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, kept in (("model.yaml", f"{label}.yaml.gz"), ("none.json", f"{label}.json.gz")):
        if not (folder / name).exists() and (KEPT / kept).exists():
            (folder / name).write_bytes(gzip.decompress((KEPT / kept).read_bytes()))


def cases(folder: Path, effects: Sequence[str], sizes: Sequence[float]) -> list[Case]:
    """What was planted into a log of these effects and sizes, in this order."""
    files = (folder / f"{name}-{size:g}.npz" for name in effects for size in sizes)
    return [Case.read(file) for file in files if file.exists()]
