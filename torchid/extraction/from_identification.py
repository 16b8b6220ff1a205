"""The extraction problem of an identification, its bounds and conditions by their names."""

from dataclasses import replace

from torchid.errors import TorchidError
from torchid.extraction.problem import (
    LossName,
    Problem,
    extraction_problem,
    one_step,
    two_step,
    with_coefficient_bounds,
)
from torchid.feasibility.bounds import bounds_groups, read_bounds
from torchid.feasibility.conditions import conditions, physics_only
from torchid.feasibility.derived_bounds import NAME, NONE, WIDE, bounds_notes, named_bounds
from torchid.identification.result import Identification
from torchid.identification.values import BaseValues, identified_base, plain_effects
from torchid.inputs import RobotLike, as_robot


def problem_of(
    robot: RobotLike,
    result: Identification | BaseValues,
    *,
    bounds: str | None = None,
    geometry: str | None = None,
    shapes: bool = False,
    total_mass: tuple[float, float] | None = None,
    loss: LossName | None = None,
) -> tuple[Problem, tuple[str, ...]]:
    """The problem whose solutions are physical parameters of the identified torque, and notes on
    it for a person.

    Args:
        robot: that was identified.
        result: its identification, or base parameters as `nominal_base` and `read_base` give.
        bounds: group of the robot's yaml, or derived ones: `from-robot`, of its nominal parameters;
            `wide`, of the size of its links; `none`, any body. If None: normal where there is one,
            else from-robot, and wide of a robot without parameters.
        geometry: group whose boxes of the centres of mass are conditions, or `none`; normal if
            there is one, else those of the bounds.
        shapes: centres of mass must also lie inside the links' shapes.
        total_mass: interval of the arm's mass [kg].
        loss: distance to the coefficients (2.28), or to the log's torques (2.29). If None: one-step
            within wide or none, where the identification is of a log, else two-step.

    Raises:
        TorchidError: a group that is not there, a one-step loss without a log, or nothing
            determined.

    >>> from torchid import load_robot
    >>> from torchid.identification.values import nominal_base
    >>> robot = load_robot("3r")
    >>> problem, notes = problem_of(robot, nominal_base(robot))
    >>> problem.size
    30
    """
    robot = as_robot(robot)
    robot.require_fixed_base("the extraction of bodies")
    base = identified_base(result) if isinstance(result, Identification) else result
    effects = plain_effects(base.effects, "an extraction")
    has_normal = "normal" in bounds_groups(robot)
    derived = WIDE if robot.parameters is None else NAME
    group = bounds or ("normal" if has_normal else derived)
    limits = named_bounds(robot, group)
    notes = list(bounds_notes(robot, limits)) if group == NAME else []
    if bounds is None and group == WIDE:
        notes.append(
            f"'{robot.name}' has neither bounds nor inertial parameters: bodies are sought within "
            'what links of its size can be (`bounds="wide"`)'
        )
    limits, added = with_coefficient_bounds(limits, base.base, effects, base.values)
    if added:
        notes.append(f"bounds of {', '.join(added)}: within twice the identified sizes")
    if loss is None:
        # Coefficients count alike whatever their torque, which bounds of known bodies alone allow.
        loose = group in (WIDE, NONE) and base.factor is not None
        loss = "one-step" if loose else "two-step"
    if loss == "two-step":
        target = two_step(base.base, effects, base.values, base.known)
    elif base.factor is None:
        raise TorchidError(
            "the one-step loss needs a log.",
            got="the robot's nominal parameters",
            expected="an identification: the JSON of `torchid identify`",
        )
    else:
        target = one_step(base.base, effects, base.values, base.factor)
    if geometry is None:
        # The robot's own boxes where it has some: `conditions` finds them.
        box = None if has_normal else limits.com
    else:
        none = geometry == "none"
        box = physics_only(robot.n_links).com_box if none else read_bounds(robot, geometry).com
    asked = conditions(robot, com_box=box, shapes=shapes, total_mass=total_mass)
    # A set that is found is as sure as the base parameters that it is for.
    problem = extraction_problem(replace(robot, knowledge=base.knowledge), target, limits, asked)
    if not bool(base.known.any()):
        raise TorchidError("the identification determined no base parameter: nothing to reproduce.")
    if unknown := base.base.named(~base.known):
        notes.append(f"not determined by the log: {', '.join(unknown)}")
    return problem, tuple(notes)
