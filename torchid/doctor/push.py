"""Does a push at one link explain what no bodies do? A hand, a wall or a cable pulls with a force
that nobody knows, and what it makes of the joints' torques may look like a mechanism."""

import numpy as np

from torchid.doctor.cone import Normal, fit, shares
from torchid.doctor.hypothesis import Hypothesis, Judge
from torchid.robot.jacobian import point_of_link, tool_jacobian

_RIDGE = 1e-3
"""Of forces, beside the squares of their torques' share: directions that hardly show stay at
zero."""


def pushed_loss(judge: Judge, hypothesis: Hypothesis) -> float:
    """Sum of the joints' log errors beside a force at the end of one link, the one that explains
    most. It may be any force at each instant: what it makes of a joint's torque is predicted from
    the other joints alone, by leverages, as residuals of left-out points are (Allen 1974)."""
    robot, moving = judge.robot, judge.moving(hypothesis)
    rows, tau = judge.columns(hypothesis).rows, judge.torque(hypothesis) * moving
    q = judge.motion(hypothesis)[..., 0]
    plain = judge.normal(hypothesis)
    size = np.sqrt(np.maximum(judge.score(hypothesis).fit.variance, 1e-300))
    losses = []
    for link in sorted(set(robot.own_links)):
        point = point_of_link(robot, robot.link_names[link], 1.0)
        arms = tool_jacobian(robot, q, point)[:, :3].numpy().transpose(0, 2, 1)
        # (T, n, 3) torques of unit forces, in units of each joint's error.
        arms = arms * moving[..., None] / size[:, None]
        squares = arms.transpose(0, 2, 1) @ arms
        ridge = _RIDGE * np.trace(squares, axis1=1, axis2=2)[:, None, None] + 1e-300
        hat = arms @ np.linalg.solve(squares + ridge * np.eye(3), arms.transpose(0, 2, 1))
        left = np.eye(robot.n) - hat
        left = left / np.diagonal(left, axis1=1, axis2=2)[..., None]
        left = left * size[:, None] / size
        a = np.einsum("tij,jtp->itp", left, rows, optimize=True)
        y = np.einsum("tij,tj->it", left, tau)
        cross, square = (y[:, None] @ a)[:, 0], np.square(y).sum(1)
        normal = Normal(
            (a.transpose(0, 2, 1) @ a)[None], cross[None], square[None], plain.count, plain.spread
        )
        found = fit(normal, judge.cone)
        losses.append(float(np.log(shares(found.variance, plain.spread)).sum()))
    return min(losses)
