"""Errors of the internal wrenches of many parameter sets against a reference set.

The difference of the wrenches is the wrench of the difference of the parameters. Sums and maxima
over the instants are taken tile by tile, while the products are in the cache.
"""

from dataclasses import dataclass

import torch

from torchid.errors import TorchidError
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import JointType, Robot
from torchid.typing import Float, Samples, Tensor
from torchid.wrenches.regressor import check_sets, square_norms, wrench_tiles


@dataclass(frozen=True)
class WrenchErrors:
    """How far the wrenches of K sets are from a reference set's, per set and joint, over a motion.

    Attributes:
        force_rms, moment_rms: (K, n) root mean square over the instants of the norm of the
            difference of the force [N] or moment [N m] vectors.
        force_max, moment_max: (K, n) its largest value.
        force_norm_rms, moment_norm_rms: (K, n) root mean square of the difference of the norms,
            | ||w|| - ||w_ref|| |: what plots of norms show (the report's figures 5.6 to 5.19). It
            is never larger than the first, and can be small when that is not.
        torque_rms: (K, n) root mean square of the difference of the joint torques [N m; N for
            prismatic joints]: 0 up to rounding for sets with the reference's base parameters.
        reference_force_rms, reference_moment_rms: (n,) root mean square of the norms of the
            reference's own force [N] and moment [N m].
    """

    force_rms: Float[Tensor, "K n"]
    moment_rms: Float[Tensor, "K n"]
    force_max: Float[Tensor, "K n"]
    moment_max: Float[Tensor, "K n"]
    force_norm_rms: Float[Tensor, "K n"]
    moment_norm_rms: Float[Tensor, "K n"]
    torque_rms: Float[Tensor, "K n"]
    reference_force_rms: Float[Tensor, " n"]
    reference_moment_rms: Float[Tensor, " n"]


@torch.no_grad()
def wrench_errors(
    robot: Robot,
    q: Samples,
    dq: Samples,
    ddq: Samples,
    parameters: InertialParameters,
    reference: InertialParameters,
) -> WrenchErrors:
    """Errors of the wrenches of K sets against a reference set's, never storing the wrenches.

    The difference of the wrenches is the wrench of the difference of the parameters, so errors far
    smaller than the wrenches keep their digits.

    Args:
        robot, q, dq, ddq, parameters: as for `internal_wrenches`, with T >= 1.
        reference: (n, 10), finite.

    Raises:
        TorchidError: motion, parameters or reference do not fit the robot or each other, or are
            not finite where they have to be.
    """
    check_sets(robot, (q, dq, ddq), parameters)
    if reference.pi.shape != parameters.pi.shape[1:]:
        raise TorchidError(
            f"the reference does not fit robot '{robot.name}'.",
            got=f"shape {tuple(reference.pi.shape)}",
            expected=f"one set ({robot.n_links} links, 10)",
        )
    if not torch.isfinite(reference.pi).all():
        raise TorchidError("the reference has parameters that are not finite.", expected="numbers")
    motion, count, axes = (q, dq, ddq), len(parameters.pi), robot.axes.to(q)
    drives = [int(drive.joint_type is JointType.REVOLUTE) for drive in robot.drives]
    squares, largest, of_norms = (q.new_zeros(2, count, robot.n_links) for _ in range(3))
    torque, of_reference = q.new_zeros(count, robot.n_links), q.new_zeros(2, robot.n_links)
    own = {
        (t.joint, t.instants.start): t.wrench
        for t in wrench_tiles(robot, motion, reference.pi.unsqueeze(0))
    }
    for (joint, _), wrench in own.items():
        of_reference[:, joint] += square_norms(wrench)[:, 0].sum(-1)
    for sets, joint, instants, apart in wrench_tiles(robot, motion, parameters.pi - reference.pi):
        square = square_norms(apart)
        squares[:, sets, joint] += square.sum(-1)
        largest[:, sets, joint] = torch.maximum(largest[:, sets, joint], square.amax(-1))
        torque[sets, joint] += (axes[joint] @ apart[drives[joint]]).square().sum(-1)
        beside = own[joint, instants.start]
        norms = square_norms(apart.add_(beside)).sqrt_().sub_(square_norms(beside).sqrt())
        of_norms[:, sets, joint] += norms.square().sum(-1)
    means = [(x / len(q)).sqrt() for x in (*squares, *of_norms, torque, *of_reference)]
    return WrenchErrors(*means[:2], *largest.sqrt(), *means[2:])
