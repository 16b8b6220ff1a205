"""Pictures of the effects' families, drawn from the effects' own columns."""

from collections.abc import Mapping
from itertools import cycle
from typing import TYPE_CHECKING, Any

import torch

from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Abscissa, Effect, Family, Motion
from torchid.effects.registry import KINDS
from torchid.effects.rivals import aged
from torchid.report.figures import BLUE, GREEN, GREY, INK, ORANGE, RED, new_figure, styled
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.typing import Tensor

if TYPE_CHECKING:
    from matplotlib.figure import Figure

JOINT = 1
"""The joint that is drawn, from 0: the shoulder, which carries the arm."""
_COLOURS = (BLUE, ORANGE, GREEN, RED, INK, GREY)

_AXES: Mapping[Abscissa, str] = {
    "speed": "speed [rad/s]",
    "position": "position [rad]",
    "acceleration": "acceleration [rad/s²]",
    "time": "time [s]",
}


def examples(family: Family) -> list[Effect]:
    """The effects of a family that are drawn."""
    return [kind.exemplar(JOINT) for kind in KINDS.values() if kind.family == family]


def family_figure(family: Family) -> "Figure":
    """Torque of every effect of a family on the shoulder of a KUKA LWR IV+, a panel an effect."""
    motion, robot = example_motion(120.0 if family == "time" else 8.0)
    drawn = examples(family)
    columns = min(3, len(drawn))
    rows = -(-len(drawn) // columns)
    figure = new_figure(3.2 * columns, 2.3 * rows + 0.1)
    panels = figure.subplots(rows, columns, squeeze=False).flat
    for effect, axes, colour in zip(drawn, panels, cycle(_COLOURS), strict=False):
        torque = shown_torque(effect, motion, robot)
        _panel(axes, effect.name, effect.example.over, motion, torque, colour)
    return figure


def example_motion(duration: float) -> tuple[Motion, Robot]:
    """A smooth motion of a KUKA LWR IV+, with the torque of its model; and the robot.

    Args:
        duration: [s], sampled at 200 Hz.
    """
    robot = load_robot("kuka_lwr4")
    t = torch.arange(round(200 * duration), dtype=torch.float64) / 200
    j = torch.arange(robot.n, dtype=torch.float64)
    q, dq, ddq = torch.zeros(3, len(t), robot.n, dtype=torch.float64).unbind()
    for amplitude, period in ((0.7, 5.0), (0.15, 1.6)):
        w = 2 * torch.pi / period * (1 + 0.07 * j)
        phase = t[:, None] * w + j
        q = q + amplitude * torch.sin(phase)
        dq = dq + amplitude * w * torch.cos(phase)
        ddq = ddq - amplitude * w**2 * torch.sin(phase)
    return Motion(q, dq, ddq, t=t, torque=inverse_dynamics(robot, q, dq, ddq)), robot


def shown_torque(effect: Effect, motion: Motion, robot: Robot) -> Tensor:
    """Torque (T,) of an example on the joint that is drawn."""
    values = effect.example.values
    return effect.all_torques(aged(effect, motion, values), values, robot)[:, JOINT]


def _panel(
    axes: Any, name: str, over: Abscissa, motion: Motion, torque: Tensor, colour: str
) -> None:
    if over == "time":
        assert motion.t is not None
        axes.plot(motion.t, torque, color=colour, linewidth=1.2)
    else:
        signal = {"speed": motion.dq, "position": motion.q, "acceleration": motion.ddq}[over]
        axes.plot(signal[:, JOINT], torque, ".", color=colour, markersize=1.5)
    styled(axes)
    axes.axhline(0, color=GREY, linewidth=0.8)
    axes.set_title(name, fontsize=9, color=INK)
    axes.set_xlabel(_AXES[over], fontsize=8, color=INK)
    axes.set_ylabel("torque [N m]", fontsize=8, color=INK)
