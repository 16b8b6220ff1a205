"""Internal wrenches of given sets against a reference: how far, where, and why they might be."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from torchid.effects.base import Motion
from torchid.errors import TorchidError
from torchid.feasibility.bounds import bounds_groups, read_bounds, read_total_mass
from torchid.feasibility.conditions import Conditions, conditions
from torchid.feasibility.sets import ParameterSets, nominal_set
from torchid.inputs import RobotLike, as_log, as_robot
from torchid.log.model import Log
from torchid.results.record import Result
from torchid.robot.model import Robot
from torchid_study.equal_torque.setting import (
    corrected_group,
    logged_motion,
    reference_motion,
)
from torchid_study.equal_torque.study import (
    GivenReference,
    GivenSetsRecord,
    WrenchComparison,
    compared_on,
    set_errors,
)
from torchid_study.wrenches.alike import alike
from torchid_study.wrenches.compare import RESAMPLES, Comparison, compare


@dataclass(frozen=True, eq=False)
class GivenSets(WrenchComparison, Result):
    """K sets against one reference, see `WrenchComparison`.

    Attributes:
        robot: the arm.
        sets, reference: as given; the reference is one set.
        comparison: of the largest force error over the joints, by class and degree.
    """

    robot: Robot
    sets: ParameterSets
    reference: ParameterSets
    comparison: Comparison

    def __repr__(self) -> str:
        return f"GivenSets('{self.robot.name}', {len(self.sets)} sets)"

    @cached_property
    def record(self) -> GivenSetsRecord:
        """As the JSON has it."""
        return given_record(self)


def compare_wrenches(
    robot: RobotLike,
    sets: ParameterSets,
    reference: str | ParameterSets | None = None,
    *,
    motion: Log | str | Path | Motion | None = None,
    geometry: str | None = None,
    total_mass: tuple[float, float] | None = None,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> GivenSets:
    """How far the internal forces and moments of parameter sets are from those of a reference: by
    set, by joint, by reason and degree of infeasibility.

    Args:
        robot: with inertial parameters.
        sets: K of them, e.g. from `read_sets` or an extraction.
        reference: the one of the sets with this id, or one set; the robot's nominal parameters if
            None.
        motion: on which they are compared: a log, or states (T, n); a sinusoid within the robot's
            limits if None.
        geometry: group of bounds whose boxes of the centres of mass are the links' geometry; if
            None `normal_corrected`, or `normal`, where the robot has it, else physics alone counts.
        total_mass: interval of the sum of the masses [kg]; the robot's if None.
        resamples: of the bootstrap of the intervals.
        seed: of the motion and the bootstrap.

    Raises:
        RobotError: no nominal parameters, no such bounds, or incomplete limits and no motion.
        LogError: a log that does not fit the robot.
        TorchidError: no such reference.

    >>> import torchid
    >>> from torchid.feasibility.sets import nominal_set
    >>> robot = torchid.load_robot("3r")
    >>> found = compare_wrenches(robot, nominal_set(robot), resamples=20)
    >>> found.errors.force_rms.shape, float(found.errors.force_rms.max())
    (torch.Size([1, 3]), 0.0)
    """
    robot = as_robot(robot)
    robot.require_fixed_base("a comparison of wrenches")
    if reference is None:
        reference = nominal_set(robot)
    elif isinstance(reference, str):
        if reference not in sets.ids:
            raise TorchidError(
                "`reference=...` names none of the sets.", got=reference, available=sets.ids[:20]
            )
        reference = sets.part([sets.ids.index(reference)])
    if motion is None:
        motion = reference_motion(robot, seed)
    elif not isinstance(motion, Motion):
        motion = logged_motion(as_log(motion, robot), robot)
    # Boxes of the geometry, where the robot has bounds; physics alone where it has none.
    group = geometry or corrected_group(robot, "normal")
    box = read_bounds(robot, group).com if geometry or group in bounds_groups(robot) else None
    asked = conditions(robot, com_box=box, total_mass=total_mass or read_total_mass(robot))
    return given_sets(robot, sets, reference, asked, motion, resamples=resamples, seed=seed)


def given_sets(
    robot: Robot,
    sets: ParameterSets,
    reference: ParameterSets,
    conditions: Conditions,
    motion: Motion,
    *,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> GivenSets:
    """Wrench errors of given sets, their reasons and degrees.

    Args:
        robot: the arm.
        sets: K of them.
        reference: one set.
        conditions: beside physics.
        motion: states (T, n).
        resamples, seed: of the bootstrap.

    Raises:
        TorchidError: the reference is not one set, or sizes do not match.
    """
    if len(reference) != 1:
        raise TorchidError("the reference must be one set.", got=f"{len(reference)} sets")
    compared = compared_on(motion, robot, sets, reference, conditions)
    force = compared.errors.force_rms
    return GivenSets(
        **vars(compared),
        robot=robot,
        sets=sets,
        reference=reference,
        comparison=compare(
            force.amax(-1),
            [compared.checked.reasons(k) for k in range(len(sets))],
            compared.checked.degree,
            cluster=alike(force),
            resamples=resamples,
            seed=seed,
        ),
    )


def given_record(given: GivenSets, source: tuple[str, ...] = ()) -> GivenSetsRecord:
    """A comparison of given sets with a reference.

    Args:
        given: what was found.
        source: files of the sets.
    """
    return GivenSetsRecord(
        robot=given.robot.name,
        source=source,
        reference=GivenReference(
            id=given.reference.ids[0],
            force_rms=given.errors.reference_force_rms,
            moment_rms=given.errors.reference_moment_rms,
        ),
        instants=given.motion.q.shape[0],
        torque_relative_max=float(given.torque_relative.max()),
        comparison=given.comparison,
        sets=set_errors(given, given.sets.ids, given.checked.degree),
    )
