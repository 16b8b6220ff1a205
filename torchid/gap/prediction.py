"""Torque of a model along a passage, as the rows of the least squares see it."""

from collections.abc import Sequence

from torchid.effects.base import Motion
from torchid.effects.registry import Valued, in_rounds, model_torque
from torchid.gap.passages import Passage, Rows
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor

SMOOTHED = ("q", "dq", "ddq", "torque")


def smoothed(motion: Motion, rows: Rows) -> Motion:
    """A motion low-passed like the rows."""
    return motion._replace(**{k: rows.low_passed(getattr(motion, k)) for k in SMOOTHED})


def predicted_torque(
    robot: Robot, effects: Sequence[Valued], passage: Passage, rows: Rows
) -> Float[Tensor, "T n"]:
    """Torque of a model along a passage. Effects that differentiate the model's torque see the
    motion low-passed like the rows, as their columns do: twice differentiated, the encoder's noise
    would be all that is left of them."""
    rough = [p for p in effects if p[0].smooth]
    others = [p for p in effects if not any(p is r for r in rough)]
    tau = model_torque(robot, others, passage.motion)
    if rough:
        first, _ = in_rounds(effects)
        load = model_torque(robot, first, passage.motion)
        smooth = smoothed(passage.motion._replace(torque=load), rows)
        tau = tau + sum(effect.all_torques(smooth, values, robot) for effect, values in rough)
    return tau
