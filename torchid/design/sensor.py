"""What a log measured of the forces that move an arm: it decides which error a diagnosis explains.

- `torque`: measured, or current that the log's gain made a torque, or the torque that joint
  controllers were commanded (`with_commanded_torque`); the error is measured - modelled torque
  [N m; N].
- `current`: with a robot that has a `drive_gain`; the same error.
- `position`: commands and positions alone; the error is simulated - measured position [mrad].
"""

from collections.abc import Sequence
from typing import Literal

import torch

from torchid.errors import LogError
from torchid.log.checks import NO_TORQUE
from torchid.log.model import Log
from torchid.robot.model import Robot
from torchid.tensors import as_tensor
from torchid.typing import Float, Tensor

Sensor = Literal["torque", "current", "position"]


def sensor_of(log: Log, robot: Robot) -> Sensor:
    """What a log measured; a torque column of zeros is none.

    >>> import numpy as np, torchid
    >>> t = np.arange(3) / 100
    >>> sensor_of(torchid.Log(t, q=np.zeros((3, 3)), u=np.ones((3, 3))), torchid.load_robot("3r"))
    'position'
    """
    if log.tau is not None and (log.u is None or float(log.tau.abs().max()) > NO_TORQUE):
        return "torque"
    if log.tau is None and log.current is not None and robot.drive_gain is not None:
        return "current"
    return "torque" if log.u is None else "position"


def with_commanded_torque(
    log: Log, kp: float | Sequence[float] | Tensor, kd: float | Sequence[float] | Tensor
) -> Log:
    """The log with the torque that a joint controller was commanded to make.

        tau = kp (u - q) + kd (du/dt - dq) + feed-forward

    Legged robots and many arms close this loop in the drive, and log no other torque. A torque
    that the log has is taken as the feed-forward.

    Args:
        log: with commanded positions u, and dq where kd is not zero.
        kp: (n,) or one for all joints [N m/rad; N/m].
        kd: (n,) or one for all joints [N m s/rad; N s/m].

    Raises:
        LogError: no commands, no velocities for kd, or gains of another number of joints.

    >>> import numpy as np, torchid
    >>> t, zero = np.arange(3) / 100, np.zeros((3, 1))
    >>> log = torchid.Log(t, q=zero, dq=zero, u=zero + 0.1)
    >>> with_commanded_torque(log, 20.0, 0.5).tau.flatten().tolist()
    [2.0, 2.0, 2.0]
    """
    if log.u is None:
        raise LogError(
            f"{log.label} has no commands, of which controller gains make a torque.",
            expected=f"columns u1..u{log.n}",
            available=["t", *log.signals],
        )
    stiff, damped = (_gains(x, name, log) for x, name in ((kp, "kp"), (kd, "kd")))
    tau = stiff * (log.u - log.q)
    if bool(damped.any()):
        if log.dq is None:
            raise LogError(
                f"{log.label} has no velocities, on which kd acts.",
                expected=f"columns dq1..dq{log.n}",
                available=["t", *log.signals],
            )
        rate = torch.zeros_like(log.u)
        for rows in log.slices():
            if rows.stop - rows.start > 1:
                rate[rows] = torch.gradient(log.u[rows], spacing=(log.t[rows],), dim=0)[0]
        tau = tau + damped * (rate - log.dq)
    return log.replace(tau=tau if log.tau is None else tau + log.tau)


def _gains(given: float | Sequence[float] | Tensor, name: str, log: Log) -> Float[Tensor, " n"]:
    value = as_tensor(given, name).to(log.q)
    if value.shape not in ((), (log.n,)) or not bool((value >= 0).all()):
        raise LogError(
            f"the controller's {name} does not fit {log.label}.",
            got=value.tolist(),
            expected=f"a number, or {log.n} of them, not negative",
        )
    return value.expand(log.n)
