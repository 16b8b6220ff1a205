"""What a study of sets with equal torque starts from: conditions, outer bounds, a feasible set."""

from dataclasses import dataclass, replace
from typing import Literal

import torch

from torchid.design.motion import measurements
from torchid.effects.base import Motion
from torchid.errors import LogError, TorchidError
from torchid.excitation.trajectories import sinusoid
from torchid.extraction.convex.nearest import nearest_feasible
from torchid.feasibility.bounds import Bounds, bounds_groups, read_bounds, read_total_mass
from torchid.feasibility.conditions import Conditions, conditions
from torchid.feasibility.margins import feasibility
from torchid.feasibility.sets import ParameterSets, nominal_set
from torchid.identification.base_parameters import BaseParameters, base_parameters
from torchid.log.model import Log
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor
from torchid_study.equal_torque.settings import MARGIN

TOTAL_MASS = (0.9, 1.25)
"""Interval of the total mass where the robot's file has none, in shares of the nominal one: 13 to
18 kg for the LWR."""
LOG_CUTOFF = 8.0
"""Of the filter under which a log's velocities and accelerations are made [Hz]."""
RATE = 100.0
"""Samples per second of the reference motion [Hz], as in the report's section 5.1."""


@dataclass(frozen=True, eq=False)
class Setting:
    """A robot, what a set must meet, and the feasible set whose torque all others have.

    Attributes:
        robot: the arm.
        geometry: name of the group of bounds whose boxes the centres of mass must keep.
        outer: limits of sets that need not be feasible.
        conditions: boxes of the centres of mass and the total mass, beside physics.
        base: base parameters, with the nominal set's effects.
        nominal: the robot's own parameters, K = 1.
        reference: K = 1: the nominal set if it is feasible, else the feasible one that is nearest
            in torque.
        origin: which of the two.
        torque_change: (n,) root mean square of the joints' torques between the two, over random
            states [N m; N]; zero when they are the same.
        notes: sentences for the user.
    """

    robot: Robot
    geometry: str
    outer: Bounds
    conditions: Conditions
    base: BaseParameters
    nominal: ParameterSets
    reference: ParameterSets
    origin: Literal["nominal", "nearest"]
    torque_change: Float[Tensor, " n"]
    notes: tuple[str, ...] = ()


def equal_torque_setting(
    robot: Robot,
    *,
    geometry: str | None = None,
    total_mass: tuple[float, float] | None = None,
    margin: float = MARGIN,
) -> Setting:
    """Conditions, outer bounds and reference of a robot with groups of bounds.

    Args:
        robot: with inertial parameters and bounds.
        geometry: group whose CoM boxes are the links' geometry; by default `normal_corrected`, or
            `normal` where there is no such group.
        total_mass: interval [kg]; by default the robot's, or `TOTAL_MASS` of the nominal one.
        margin: of a reference that has to be found, see `MARGIN`.

    Raises:
        RobotError: no parameters, or no such bounds.
        TorchidError: no feasible set near the nominal one was found.
    """
    robot.require_fixed_base("a study of equal torque")
    nominal = nominal_set(robot)
    geometry = geometry or corrected_group(robot, "normal")
    outer_bounds = read_bounds(robot, corrected_group(robot, "loose"))
    mass = float(nominal.parameters.mass.sum())
    interval = total_mass or read_total_mass(robot) or (TOTAL_MASS[0] * mass, TOTAL_MASS[1] * mass)
    asked = conditions(robot, com_box=read_bounds(robot, geometry).com, total_mass=interval)
    checked, notes = feasibility(nominal, asked), []
    reference, change = nominal, torch.zeros(robot.n, dtype=torch.float64)
    reasons = ", ".join(checked.reasons(0))
    if reasons:
        nearest = nearest_feasible(robot, nominal, asked, margin=margin)
        if not bool(nearest.feasible[0]):
            raise TorchidError(
                f"no feasible set near the parameters of robot '{robot.name}' was found.",
                got=f"{reasons}; solver: {nearest.status[0]}",
                hint="wider boxes, another interval of the total mass, or a smaller margin",
            )
        reference, change = replace(nearest.sets, ids=("reference",)), nearest.torque_change[0]
        notes = [
            f"the nominal parameters are not feasible ({reasons}): the reference is the feasible "
            f"set nearest in torque, {float(change.square().mean().sqrt()):.3g} N m from them (RMS "
            "over joints and random states)"
        ]
        before, after = nominal.coefficients[0].tolist(), reference.coefficients[0].tolist()
        for k in checked.violated_coefficients[0].nonzero().flatten().tolist():
            name = checked.coefficient_names[k]
            notes.append(
                f"{name}: {before[k]:.4g} became {after[k]:.4g}, as physics forbids its sign"
            )
    return Setting(
        robot=robot,
        geometry=geometry,
        outer=outer_bounds,
        conditions=asked,
        base=base_parameters(robot, nominal.effects),
        nominal=nominal,
        reference=reference,
        origin="nearest" if reasons else "nominal",
        torque_change=change,
        notes=tuple(notes),
    )


def reference_motion(robot: Robot, seed: int = 0) -> Motion:
    """A sinusoid within the robot's limits (eq. 5.2), sampled at `RATE`.

    Raises:
        RobotError: the limits are incomplete.
    """
    return sinusoid(robot, seed).sample(RATE)._replace(t=None)


def logged_motion(log: Log, robot: Robot) -> Motion:
    """States (T, n) of a log, one trajectory after the other; velocities and accelerations it lacks
    are differentiated, under a filter of `LOG_CUTOFF`.

    Raises:
        LogError: another number of joints, or too short to be differentiated.
    """
    if log.n != robot.n:
        raise LogError(
            f"log '{log.source}' does not fit robot '{robot.name}'.",
            got=f"{log.n} joints",
            expected=f"{robot.n}",
        )
    if log.dq is not None and log.ddq is not None:
        return Motion(log.q, log.dq, log.ddq)
    # The torque is not used; without one, a log has nothing to be differentiated for.
    every = measurements(log.replace(tau=torch.zeros_like(log.q)).even, LOG_CUTOFF)
    states = [m.motion.part(slice(m.edge, m.samples - m.edge)).state for m in every]
    return Motion(*(torch.cat(x) for x in zip(*states, strict=True)))


def corrected_group(robot: Robot, group: str) -> str:
    """`group`_corrected where the robot has such bounds, as where printed ones are known to exclude
    the true parameters; else the group itself."""
    name = f"{group}_corrected"
    return name if name in bounds_groups(robot) else group
