"""Internal wrenches of given sets against a reference: how far, where, and why they might be."""

from dataclasses import dataclass

from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Motion
from torchid.errors import TorchidError
from torchid.feasibility.conditions import Conditions
from torchid.feasibility.margins import Feasibility, feasibility
from torchid.feasibility.sets import ParameterSets
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor
from torchid.wrenches.compare import RESAMPLES, Comparison, compare
from torchid.wrenches.deviation import WrenchErrors, alike, wrench_errors


@dataclass(frozen=True, eq=False)
class GivenSets:
    """K sets against one reference.

    Attributes:
        robot: the arm.
        sets, reference: as given; the reference is one set.
        motion: on which they were compared.
        checked: the sets' feasibility.
        errors: of their wrenches, per set and joint.
        torque_relative: (K, n) root mean square of the torque's difference over the torque's.
        carried: (K, n) difference of the mass that each joint carries [kg].
        comparison: of the largest force error over the joints, by class and degree.
    """

    robot: Robot
    sets: ParameterSets
    reference: ParameterSets
    motion: Motion
    checked: Feasibility
    errors: WrenchErrors
    torque_relative: Float[Tensor, "K n"]
    carried: Float[Tensor, "K n"]
    comparison: Comparison


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

    The torque of effects such as friction is not a wrench of the links and is left out.

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
    own = InertialParameters(reference.parameters.pi[0])
    errors = wrench_errors(robot, *motion.state, sets.parameters, own)
    checked = feasibility(sets, conditions)
    tau = inverse_dynamics(robot, *motion.state, own)
    mass = sets.parameters.mass - own.mass
    return GivenSets(
        robot=robot,
        sets=sets,
        reference=reference,
        motion=motion,
        checked=checked,
        errors=errors,
        torque_relative=errors.torque_rms / tau.square().mean(0).sqrt(),
        carried=mass.flip(-1).cumsum(-1).flip(-1),
        comparison=compare(
            errors.force_rms.amax(-1),
            [checked.reasons(k) for k in range(len(sets))],
            checked.degree,
            cluster=alike(errors.force_rms),
            resamples=resamples,
            seed=seed,
        ),
    )
