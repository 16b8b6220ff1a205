"""Is a log within its robot's limits? Far outside, it is of another robot, or in other units."""

from collections.abc import Iterator

import torch

from torchid.log.columns import some
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
    found: list[str] = []
    if position_limits is not None:
        found += _positions(log.q, position_limits.to(log.q))
    if torque_limits is not None and log.tau is not None:
        found += _torques(log.tau, torque_limits.to(log.tau))
    return tuple(found)


def finite_range(signal: Float[Tensor, "T n"]) -> Float[Tensor, "n 2"]:
    """Smallest and largest finite value of each joint (n, 2); nan where there is none."""
    # Joint by joint: a copy of the whole signal may be half a gigabyte.
    columns = [column[column.isfinite()] for column in signal.unbind(1)]
    none = signal.new_tensor([torch.nan, torch.nan])
    return torch.stack([torch.stack(c.aminmax()) if len(c) else none for c in columns])


def _positions(q: Float[Tensor, "T n"], limits: Float[Tensor, "n 2"]) -> Iterator[str]:
    low, high = limits.unbind(-1)
    least, most = finite_range(q).unbind(-1)
    margin = FAR_POSITION * (high - low)
    said = [
        f"q{j + 1} {float(least[j]):.3g} .. {float(most[j]):.3g}, "
        f"limits {float(low[j]):.3g} .. {float(high[j]):.3g}"
        for j in range(q.shape[1])
        if least[j] < low[j] - margin[j] or most[j] > high[j] + margin[j]
    ]
    if said:
        yield (
            f"positions far outside the robot's limits ({'; '.join(some(said, 3))}): "
            "are order, units, zero and direction of the joints the robot's?"
        )


def _torques(tau: Float[Tensor, "T n"], limits: Float[Tensor, "n 2"]) -> Iterator[str]:
    size = tau.abs().where(torch.isfinite(tau), 0.0)
    # A spike is no unit.
    most = size.kthvalue(max(1, round(0.99 * len(size))), dim=0).values
    limit = limits.abs().amax(-1)
    said = [
        f"tau{j + 1} {float(most[j]):.3g}, limit {float(limit[j]):.3g}"
        for j in range(tau.shape[1])
        if torch.isfinite(limit[j]) and most[j] > FAR_TORQUE * limit[j]
    ]
    if said:
        yield (
            f"torques more than {FAR_TORQUE:g} times the robot's limits "
            f"({'; '.join(some(said, 3))}): are they in N m? mN m are read by "
            '`columns="tau=.. mNm"`'
        )
