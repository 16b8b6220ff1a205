"""What a study of sets with equal torque starts from: conditions, outer bounds, a feasible set."""

from dataclasses import dataclass, replace
from typing import Literal

import torch

from torchid.effects.base import Motion
from torchid.errors import TorchidError
from torchid.excitation.trajectories import sinusoid
from torchid.extraction.convex.nearest import nearest_feasible
from torchid.feasibility.bounds import Bounds, bounds_groups, read_bounds, read_total_mass
from torchid.feasibility.conditions import Conditions, conditions
from torchid.feasibility.margins import feasibility
from torchid.feasibility.sets import ParameterSets, nominal_set
from torchid.identification.base_parameters import BaseParameters, base_parameters
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor

TOTAL_MASS = (0.9, 1.25)
"""Interval of the total mass where the robot's file has none, in shares of the nominal one: 13 to
18 kg for the LWR."""
MARGIN = 1e-3
"""Smallest eigenvalue of the pseudo-inertias [kg m^2, kg] of a reference that has to be found. With
nearly none, all sets of its torque lie on the edge of feasibility."""
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

    def widened(self, name: str, share: float, *, total_mass: bool = True) -> "Setting":
        """The same setting with outer bounds that are only a share of the way from the conditions'
        boxes to the outer ones; and without the condition on the total mass, if asked for."""
        box, outer = self.conditions.com_box, self.outer.com
        low, high = (torch.minimum, torch.maximum)
        widest = torch.stack(
            [low(box[..., 0], outer[..., 0]), high(box[..., 1], outer[..., 1])], -1
        )
        own = read_bounds(self.robot, self.geometry).mass
        free = self.conditions.total_mass.new_tensor([-torch.inf, torch.inf])
        return replace(
            self,
            outer=replace(
                self.outer,
                name=name,
                com=box + share * (widest - box),
                mass=own + share * (self.outer.mass - own),
            ),
            conditions=self.conditions if total_mass else replace(self.conditions, total_mass=free),
        )


def equal_torque_setting(
    robot: Robot,
    *,
    geometry: str | None = None,
    outer: str | None = None,
    total_mass: tuple[float, float] | None = None,
    margin: float = MARGIN,
) -> Setting:
    """Conditions, outer bounds and reference of a robot with groups of bounds.

    Args:
        robot: with inertial parameters and bounds.
        geometry: group whose CoM boxes are the links' geometry; by default `normal_corrected`, or
            `normal` where there is no such group.
        outer: group that limits all sets; by default `loose_corrected` or `loose`.
        total_mass: interval [kg]; by default the robot's, or `TOTAL_MASS` of the nominal one.
        margin: of a reference that has to be found, see `MARGIN`.

    Raises:
        RobotError: no parameters, or no such bounds.
        TorchidError: no feasible set near the nominal one was found.
        MissingExtraError: Clarabel is needed to find one, and not installed.
    """
    nominal = nominal_set(robot)
    geometry = geometry or corrected_group(robot, "normal")
    outer_bounds = read_bounds(robot, outer or corrected_group(robot, "loose"))
    mass = float(nominal.parameters.mass.sum())
    interval = total_mass or read_total_mass(robot) or (TOTAL_MASS[0] * mass, TOTAL_MASS[1] * mass)
    asked = conditions(robot, com_box=read_bounds(robot, geometry).com, total_mass=interval)
    nominal_is_feasible = bool(feasibility(nominal, asked).feasible[0])
    notes: tuple[str, ...] = ()
    reference, change = nominal, torch.zeros(robot.n, dtype=torch.float64)
    if not nominal_is_feasible:
        reference, change, notes = _nearest(robot, nominal, asked, margin)
    return Setting(
        robot=robot,
        geometry=geometry,
        outer=outer_bounds,
        conditions=asked,
        base=base_parameters(robot, nominal.effects),
        nominal=nominal,
        reference=reference,
        origin="nominal" if nominal_is_feasible else "nearest",
        torque_change=change,
        notes=notes,
    )


def reference_motion(robot: Robot, seed: int = 0, *, duration: float = 10.0) -> Motion:
    """A sinusoid within the robot's limits (eq. 5.2), sampled at `RATE`.

    Raises:
        RobotError: the limits are incomplete.
    """
    sampled = sinusoid(robot, seed, duration=duration).sample(RATE)
    return Motion(sampled.q, sampled.dq, sampled.ddq)


def corrected_group(robot: Robot, group: str) -> str:
    """`group`_corrected where the robot has such bounds, as where printed ones are known to exclude
    the true parameters; else the group itself."""
    name = f"{group}_corrected"
    return name if name in bounds_groups(robot) else group


def _nearest(
    robot: Robot, nominal: ParameterSets, asked: Conditions, margin: float
) -> tuple[ParameterSets, Tensor, tuple[str, ...]]:
    """The nearest feasible set, its change of torque, and what to tell the user."""
    checked = feasibility(nominal, asked)
    found = nearest_feasible(robot, nominal, asked, margin=margin)
    if not bool(found.feasible[0]):
        raise TorchidError(
            f"no feasible set near the parameters of robot '{robot.name}' was found.",
            got=f"{', '.join(checked.reasons(0))}; solver: {found.status[0]}",
            hint="wider boxes, another interval of the total mass, or a smaller margin",
        )
    change = found.torque_change[0]
    reasons = ", ".join(checked.reasons(0))
    notes = [
        f"the nominal parameters are not feasible ({reasons}): the reference is the feasible set "
        f"nearest in torque, {float(change.square().mean().sqrt()):.3g} N m from them (RMS over "
        "joints and random states)"
    ]
    notes += [
        f"{name}: {before:.4g} became {after:.4g}, as physics forbids its sign"
        for name, before, after, bad in zip(
            checked.coefficient_names,
            nominal.coefficients[0].tolist(),
            found.sets.coefficients[0].tolist(),
            checked.violated_coefficients[0].tolist(),
            strict=True,
        )
        if bad
    ]
    return replace(found.sets, ids=("reference",)), change, tuple(notes)
