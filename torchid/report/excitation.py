"""Figure of a planned motion with the robot's limits."""

from typing import TYPE_CHECKING

import torch

from torchid.log.model import Log
from torchid.report.figures import BLUE, INK, ORANGE, RED, new_figure, styled
from torchid.robot.model import JointType, Robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST_POINTS = 1000


def trajectory_figure(robot: Robot, motion: Log, title: str, noisy: Log | None = None) -> "Figure":
    """Position, velocity and acceleration per joint, limits in red.

    Args:
        robot: whose limits are drawn.
        motion: one trajectory.
        title: of the figure.
        noisy: the same instants with noise, drawn over the motion.
    """
    figure = new_figure(11, 1.0 + 1.25 * robot.n + (0.3 if noisy is not None else 0.0))
    grid = figure.subplots(robot.n, 3, sharex=True, squeeze=False)
    step = max(1, -(-motion.samples // _MOST_POINTS))
    t = (motion.t - motion.t[0])[::step].numpy()
    columns = (("position", "q"), ("velocity", "dq"), ("acceleration", "ddq"))
    for c, (name, signal) in enumerate(columns):
        unit = _unit(robot, c)
        grid[0, c].set_title(f"{name} [{unit}]" if unit else name, fontsize=9, color=INK)
        grid[-1, c].set_xlabel("time [s]", fontsize=8, color=INK)
        planned = getattr(motion, signal)
        disturbed = None if noisy is None else getattr(noisy, signal)
        limits = getattr(robot.limits, name)
        for j in range(robot.n):
            axes = styled(grid[j, c])
            if planned is not None:
                axes.plot(
                    t, planned[::step, j].numpy(), color=BLUE, label="planned",
                    linewidth=1.1 if noisy is None else 3.0, alpha=1.0 if noisy is None else 0.4,
                )  # fmt: skip
            if disturbed is not None:
                axes.plot(
                    t, disturbed[::step, j].numpy(), color=ORANGE, linewidth=0.8, label="with noise"
                )
            if limits is not None and bool(torch.isfinite(limits[j]).all()):
                for bound in limits[j].tolist():
                    axes.axhline(bound, color=RED, linewidth=0.9, label="limit")
    for j in range(robot.n):
        grid[j, 0].set_ylabel(f"joint {j + 1}", fontsize=8, color=INK)
    if noisy is not None:
        shown = {x.get_label(): x for x in grid[0, 0].lines}
        figure.legend(
            list(shown.values()), list(shown), loc="outside lower center", ncols=3,
            frameon=False, fontsize=8,
        )  # fmt: skip
    figure.suptitle(title, fontsize=11, color=INK, x=0.01, ha="left")
    return figure


def _unit(robot: Robot, derivative: int) -> str:
    """Unit of a joint's position or its derivatives; none where the joints differ."""
    kinds = set(robot.joint_types)
    if len(kinds) > 1:
        return ""
    return ("m" if kinds == {JointType.PRISMATIC} else "rad") + ("", "/s", "/s²")[derivative]
