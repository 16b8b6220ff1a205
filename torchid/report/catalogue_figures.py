"""Pictures of the effects' families, drawn from the effects' own columns."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import torch

from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.backlash import Backlash
from torchid.effects.base import Effect, Family, Motion
from torchid.effects.coupling import GearCoupling
from torchid.effects.friction import CoulombFriction, TorqueOffset, ViscousFriction
from torchid.effects.friction_laws import (
    AsymmetricFriction,
    LoadDependentFriction,
    PowerLawFriction,
    StribeckFriction,
)
from torchid.effects.gravity import (
    BaseTilt,
    EncoderOffset,
    KinematicError,
    TorqueCrosstalk,
    TorqueGain,
)
from torchid.effects.hysteresis import PreslidingHysteresis
from torchid.effects.inertia import LinkInertia, Payload
from torchid.effects.periodic import Cogging
from torchid.effects.phase import FilterLag, JointElasticity, TimeDelay
from torchid.effects.rotor_inertia import RotorInertia
from torchid.effects.spring import JointSpring
from torchid.effects.thermal import ThermalFrictionDrift
from torchid.effects.transient import Contact, DroppedSamples, Saturation
from torchid.report.figures import BLUE, GREEN, GREY, INK, ORANGE, RED, new_figure, styled
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.typing import Tensor

if TYPE_CHECKING:
    from matplotlib.figure import Figure

JOINT = 1
"""The joint that is drawn, from 0: the shoulder, which carries the arm."""
_BODY = (1.0, 0.0, 0.0, 0.1, 0.02, 0.0, 0.0, 0.02, 0.0, 0.01)
_COLOURS = (BLUE, ORANGE, GREEN, RED, INK, GREY)

Abscissa = Literal["speed", "position", "acceleration", "time"]
Drawn = Sequence[tuple[Effect, Sequence[float], Abscissa]]
"""Effects with coefficients of a size to be seen, and what their torque is drawn over."""

_EXAMPLES: Mapping[Family, Drawn] = {
    "speed": (
        (ViscousFriction(JOINT), (2.0,), "speed"),
        (PowerLawFriction(JOINT, a=2.0), (2.0,), "speed"),
        (GearCoupling(JOINT, 2), (1.0, 0.0, 0.6), "speed"),
    ),
    "sign": (
        (CoulombFriction(JOINT), (1.0,), "speed"),
        (StribeckFriction(JOINT, vs=0.1), (1.0,), "speed"),
        (LoadDependentFriction(JOINT), (0.05,), "speed"),
    ),
    "constant": (
        (TorqueOffset(JOINT), (1.0,), "speed"),
        (AsymmetricFriction(JOINT), (1.0, 0.5), "speed"),
    ),
    "gravity": (
        (BaseTilt(), (0.03, 0.03), "position"),
        (TorqueGain(JOINT), (0.05,), "position"),
        (EncoderOffset(JOINT), (0.03,), "position"),
        (KinematicError(JOINT), (0.02, 0.0, 0.0, 0.0, 0.0), "position"),
        (TorqueCrosstalk(JOINT, 3), (0.2,), "position"),
        (JointSpring(JOINT), (2.0, 0.0), "position"),
    ),
    "inertia": (
        (RotorInertia(JOINT), (0.5,), "acceleration"),
        (Payload(), _BODY, "acceleration"),
        (LinkInertia(JOINT), _BODY, "acceleration"),
    ),
    "phase": (
        (TimeDelay(JOINT), (0.01,), "time"),
        (FilterLag(), (0.01,), "time"),
        (JointElasticity(JOINT), (1e-4,), "time"),
    ),
    "hysteresis": (
        (PreslidingHysteresis(JOINT, length=0.1), (1.0,), "position"),
        (Backlash(JOINT), (2e-3,), "time"),
    ),
    "periodic": ((Cogging(JOINT, k=12.0), (0.6, 0.3), "position"),),
    "time": ((ThermalFrictionDrift(JOINT, T=60.0), (-0.5, -0.5), "time"),),
    "transient": (
        (Saturation(JOINT, limit=40.0), (1.0,), "time"),
        (Contact(start=4.0, stop=5.0), (0.0, 0.0, -30.0), "time"),
        (DroppedSamples(JOINT, rate=2.0, length=0.3), (1.0,), "time"),
    ),
}
_AXES: Mapping[Abscissa, str] = {
    "speed": "speed [rad/s]",
    "position": "position [rad]",
    "acceleration": "acceleration [rad/s²]",
    "time": "time [s]",
}


def examples(family: Family) -> Drawn:
    """The effects of a family, with the coefficients that are drawn."""
    return _EXAMPLES[family]


def family_figure(family: Family) -> "Figure":
    """Torque of every effect of a family on the shoulder of a KUKA LWR IV+, a panel an effect."""
    motion, robot = example_motion(120.0 if family == "time" else 8.0)
    drawn = examples(family)
    columns = min(3, len(drawn))
    rows = -(-len(drawn) // columns)
    figure = new_figure(3.2 * columns, 2.3 * rows + 0.1)
    panels = figure.subplots(rows, columns, squeeze=False).flat
    for (effect, values, over), axes, colour in zip(drawn, panels, _COLOURS, strict=False):
        torque = shown_torque(effect, values, motion, robot)
        _panel(axes, effect.name, over, motion, torque, colour)
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


def shown_torque(effect: Effect, values: Sequence[float], motion: Motion, robot: Robot) -> Tensor:
    """Torque (T,) of an effect on the joint that is drawn."""
    if isinstance(effect, DroppedSamples):  # the age of samples comes with the samples themselves
        motion = motion._replace(age=effect.measured(motion, values).age)
    return effect.all_torques(motion, values, robot)[:, JOINT]


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
