"""The main job on the report's robots, on synthetic logs whose truth is known."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch

from torchid.effects.registry import on_every_joint
from torchid.excitation.design import Excitation, optimise_trajectory
from torchid.excitation.settings import EXCITED_EFFECTS
from torchid.excitation.synthetic import HonestNoise, PaperNoise, synthetic_log
from torchid.excitation.trajectories import paper_trajectories_3r, sinusoid, trajectory_log
from torchid.identification.base_parameters import nominal_values
from torchid.identification.identify import Identification, Settings, identify
from torchid.log.model import Log
from torchid.robot.library import load_robot
from torchid.typing import Bool, Float, Tensor


@dataclass(frozen=True, eq=False)
class Demo:
    """An identification, and what it should have found.

    Attributes:
        result: of the identification.
        truth: (B,) base parameters of the robot that made the log [their units].
        motion: that was driven, t, q, dq, ddq.
        design: of that motion; None for one that was given.
    """

    result: Identification
    truth: Float[Tensor, " B"]
    motion: Log
    design: Excitation | None = None

    @property
    def inside(self) -> Bool[Tensor, " B"]:
        """Which true values lie inside their 95 % intervals."""
        low, high = self.result.interval().unbind(-1)
        return (low <= self.truth) & (self.truth <= high)

    @property
    def found(self) -> list[tuple[str, float, float]]:
        """Name, identified and true value of every base parameter."""
        values, truth = self.result.values.tolist(), self.truth.tolist()
        return list(zip(self.result.base.names, values, truth, strict=True))


def paper_demo() -> Demo:
    """The report's 3R: table 5.1's trajectories, 30 dB noise on them, table A.1."""
    robot = load_robot("3r")
    motion = trajectory_log(paper_trajectories_3r(), 100.0)
    log = synthetic_log(robot, motion, PaperNoise(snr_db=30.0), seed=0)
    result = identify(robot, log, settings=Settings(effects=(), cutoff=None, method="ols"))
    return Demo(result, nominal_values(robot, result.base), motion)


def kuka_demo(
    seed: int,
    device: torch.device | str = "cpu",
    progress: Callable[[str, int, int], None] | None = None,
) -> Demo:
    """The KUKA with friction: a designed trajectory, honest noise, validation on new motion.

    Args:
        seed: of the design and the noise.
        device: where regressors are evaluated.
        progress: called with (stage, done, total).
    """
    robot = load_robot("kuka_lwr4_friction")
    design = optimise_trajectory(
        robot,
        on_every_joint(EXCITED_EFFECTS, robot.n),
        seed=seed,
        device=device,
        progress=progress and partial(progress, "designing the trajectory"),
    )
    motion = trajectory_log(design.trajectory, 200.0)
    log = synthetic_log(robot, motion, HonestNoise(), seed)
    checks = [trajectory_log(sinusoid(robot, seed + k), 200.0) for k in range(2)]
    new = synthetic_log(robot, Log.concatenate(checks), HonestNoise(), seed + 1)
    # The report's f_v6 is negative: the signs are left free to find it.
    settings = Settings(effects=EXCITED_EFFECTS, signs="free")
    result = identify(robot, log, held_out=new, settings=settings, device=device, progress=progress)
    return Demo(result, nominal_values(robot, result.base), motion, design)


def demo_record(paper: Demo, kuka: Demo) -> dict[str, Any]:
    """The schema torchid.demo/1."""
    design = kuka.design
    return {
        "schema": "torchid.demo/1",
        "paper_3r": {
            "parameters": [{"name": n, "value": v, "true": true} for n, v, true in paper.found],
            "largest_error": float((paper.result.values - paper.truth).abs().max()),
        },
        "kuka": {
            **kuka.result.plain(),
            "true": kuka.truth.tolist(),
            "inside_95": int(kuka.inside.sum()),
            "condition_number_of_motion": design
            and [design.start_condition, design.condition_after],
        },
    }
