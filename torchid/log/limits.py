"""Is a log within its robot's limits? Far outside, it is of another robot, or in other units."""

import torch

from torchid.log.model import Log
from torchid.typing import Float, Tensor

FAR_TORQUE = 3.0
"""No drive gives this many times the limit of its description for long."""
FAR_POSITION = 0.1
"""Of the range, beyond it: calibration and rounded limits make less."""


def beyond_limits(
    log: Log,
    *,
    position_limits: Float[Tensor, "n 2"] | None = None,
    torque_limits: Float[Tensor, "n 2"] | None = None,
) -> tuple[str, ...]:
    """What is far outside of the robot's limits, one sentence each signal.

    Args:
        log: of as many joints as the robot.
        position_limits: (n, 2) lower and upper [rad or m]; not finite where unknown.
        torque_limits: (n, 2) lower and upper [N m or N]; not finite where unknown.
    """
    found = []
    if position_limits is not None:
        low, high = position_limits.to(log.q).unbind(-1)
        seen = torch.where(torch.isfinite(log.q), log.q, ((low + high) / 2).nan_to_num())
        margin = FAR_POSITION * (high - low)
        far = (seen.amin(0) < low - margin) | (seen.amax(0) > high + margin)
        said = [
            f"q{j + 1} {float(seen[:, j].min()):.3g} .. {float(seen[:, j].max()):.3g}, "
            f"limits {float(low[j]):.3g} .. {float(high[j]):.3g}"
            for j in far.nonzero().flatten().tolist()
        ]
        if said:
            found.append(
                f"positions far outside the robot's limits ({'; '.join(said)}): are order, units, "
                "zero and direction of the joints the robot's?"
            )
    if torque_limits is not None and log.tau is not None:
        size = torch.where(torch.isfinite(log.tau), log.tau.abs(), 0.0)
        # A spike is no unit.
        most = size.kthvalue(max(1, round(0.99 * len(size))), dim=0).values
        limit = torque_limits.to(most).abs().amax(-1)
        far = torch.isfinite(limit) & (most > FAR_TORQUE * limit)
        said = [
            f"tau{j + 1} {float(most[j]):.3g}, limit {float(limit[j]):.3g}"
            for j in far.nonzero().flatten().tolist()
        ]
        if said:
            found.append(
                f"torques more than {FAR_TORQUE:g} times the robot's limits ({'; '.join(said)}): "
                'are they in N m? mN m are read by --columns "tau=.. mNm"'
            )
    return tuple(found)
