"""A planned motion for people: its figure, and what it asks of the drives."""

import math
from typing import TYPE_CHECKING, Any

import torch

from torchid.excitation.torque import TorqueUse, has_torque_limits
from torchid.json_data import plain
from torchid.log.model import Log
from torchid.report.colours import BLUE, INK, ORANGE, RED
from torchid.report.panels import finish, label, new_figure, styled
from torchid.report.table import Table
from torchid.report.text import joint_unit
from torchid.robot.model import JointType, Robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIGNALS = (("position", "q"), ("velocity", "dq"), ("acceleration", "ddq"))
"""Names of the signals of a motion, and their fields."""
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
    wide = {"linewidth": 1.1} if noisy is None else {"linewidth": 3.0, "alpha": 0.4}
    kinds = set(robot.joint_types)
    length = "m" if kinds == {JointType.PRISMATIC} else "rad"
    for c, (name, signal) in enumerate(SIGNALS):
        # Where the joints differ, no unit holds for all.
        unit = "" if len(kinds) > 1 else f" [{length}{('', '/s', '/s²')[c]}]"
        grid[0, c].set_title(name + unit, fontsize=9, color=INK)
        label(grid[-1, c], "time [s]")
        planned = getattr(motion, signal)
        disturbed = None if noisy is None else getattr(noisy, signal)
        limits = getattr(robot.limits, name)
        for j in range(robot.n):
            axes = styled(grid[j, c])
            if planned is not None:
                values = planned[::step, j].numpy()
                axes.plot(t, values, color=BLUE, label="planned", **wide)
            if disturbed is not None:
                values = disturbed[::step, j].numpy()
                axes.plot(t, values, color=ORANGE, linewidth=0.8, label="with noise")
            if limits is not None and bool(torch.isfinite(limits[j]).all()):
                for bound in limits[j].tolist():
                    axes.axhline(bound, color=RED, linewidth=0.9, label="limit")
    for j in range(robot.n):
        label(grid[j, 0], y=f"joint {j + 1}")
    return finish(figure, title, *(() if noisy is None else grid[:1, 0]), columns=3)


def torque_table(robot: Robot, use: TorqueUse) -> Table:
    """The largest torque of every joint beside its limit."""
    rows = []
    for j, (size, share) in enumerate(zip(use.largest.tolist(), use.share.tolist(), strict=True)):
        unit = joint_unit(robot, j)
        low, high = use.limits[j].tolist()
        limit = f"{high:g} {unit}" if low == -high else f"{low:g} .. {high:g} {unit}"
        known = math.isfinite(min(-low, high))
        cells = (limit, f"{100 * share:.0f} %") if known else ("none", "-")
        rows.append((str(j + 1), f"{size:.3g} {unit}", *cells))
    title = f"largest torque, by the {use.source}"
    return Table(title, ("joint", "torque", "limit", "share"), rows, least_width=len(title))


def torque_record(robot: Robot, use: TorqueUse | None) -> dict[str, Any]:
    """JSON-ready; without a use, why torque limits were not checked."""
    if use is None:
        return {"checked": False, "reason": not_checked(robot) or "no torque limits"}
    joints = zip(use.largest.tolist(), plain(use.limits), use.share.tolist(), strict=True)
    return {
        "checked": True,
        "model": use.source,
        "joints": [
            {"joint": j, "largest": size, "limit": limit, "share": share}
            for j, (size, limit, share) in enumerate(joints, start=1)
        ],
    }


def not_checked(robot: Robot) -> str | None:
    """Why the robot's torque limits cannot be checked; None where it has none or they can be."""
    if not has_torque_limits(robot) or robot.parameters is not None:
        return None
    return (
        f"torque limits were not checked: robot '{robot.name}' has no inertial parameters, which "
        "predict torque."
    )
