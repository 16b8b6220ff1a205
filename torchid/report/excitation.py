"""Figure of a planned motion with the robot's limits."""

from typing import TYPE_CHECKING

import torch

from torchid.log.model import Log
from torchid.report.figures import BLUE, INK, RED, new_figure, styled
from torchid.robot.model import Robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def trajectory_figure(robot: Robot, motion: Log, title: str) -> "Figure":
    """Position, velocity and acceleration per joint, limits in red."""
    figure = new_figure(11, 1.0 + 1.25 * robot.n)
    grid = figure.subplots(robot.n, 3, sharex=True, squeeze=False)
    t = (motion.t - motion.t[0]).numpy()
    columns = (
        ("position", motion.q, robot.limits.position),
        ("velocity", motion.dq, robot.limits.velocity),
        ("acceleration", motion.ddq, robot.limits.acceleration),
    )
    for c, (name, signal, limits) in enumerate(columns):
        grid[0, c].set_title(name, fontsize=9, color=INK)
        grid[-1, c].set_xlabel("time [s]", fontsize=8, color=INK)
        for j in range(robot.n):
            axes = styled(grid[j, c])
            if signal is not None:
                axes.plot(t, signal[:, j].numpy(), color=BLUE, linewidth=1.1)
            if limits is not None and bool(torch.isfinite(limits[j]).all()):
                for bound in limits[j].tolist():
                    axes.axhline(bound, color=RED, linewidth=0.9)
    for j in range(robot.n):
        grid[j, 0].set_ylabel(f"joint {j + 1}", fontsize=8, color=INK)
    figure.suptitle(title, fontsize=11, color=INK, x=0.01, ha="left")
    return figure
