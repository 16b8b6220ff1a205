"""The corrected model as one that a simulator can run: links that are bodies."""

from collections.abc import Sequence

import torch

from torchid.design.segments import Segment
from torchid.effects.motion import Motion
from torchid.extraction.convex.nearest import nearest_feasible
from torchid.feasibility.sets import ParameterSets
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor

STATES = 400
"""States of a log over which the torque of links that are no bodies counts [1]."""


def with_bodies_nearest(
    robot: Robot, segments: Sequence[Segment]
) -> tuple[Robot, Float[Tensor, " n"]]:
    """A robot with the bodies whose torque along a log is nearest to its own.

    Args:
        robot: with inertial parameters that may belong to no bodies.
        segments: of the log.

    Returns:
        The robot, and by how much the torque of its links changes (n,), RMS [N m; N]; the robot as
        it is, and zeros, where its links are bodies or none were found.
    """
    parameters = robot.require_parameters("bodies")
    unchanged = robot, torch.zeros(robot.n, dtype=torch.float64)
    if bool((parameters.consistency_margin() >= 0).all()):
        return unchanged
    every = [torch.cat(x) for x in zip(*(s.motion.state for s in segments), strict=True)]
    step = max(1, len(every[0]) // STATES)
    states = Motion(*(x[::step].double() for x in every))
    none = torch.zeros(1, 0, dtype=torch.float64)
    pi = parameters.pi.detach().cpu().double().unsqueeze(0)
    one = ParameterSets((robot.name,), InertialParameters(pi), (), none)
    near = nearest_feasible(robot, one, motion=states)
    if not bool(near.feasible[0]):
        return unchanged
    own = InertialParameters(near.sets.parameters.pi[0])
    return robot.with_parameters(own), near.torque_change[0]
