"""Logs as every fit takes them: checked against the robot, on a uniform grid, none given twice."""

import torch

from torchid.design.motion import no_torque
from torchid.errors import LogError
from torchid.inputs import with_drive_gain
from torchid.log.checks import check_log
from torchid.log.model import Log
from torchid.robot.model import JointType, Robot
from torchid.statistics.criteria import OTHER_UNIT


def prepared(
    log: Log, robot: Robot, *, standing: bool = False, force: bool = False
) -> tuple[Log, tuple[str, ...]]:
    """A log checked against the robot, with torques, on a uniform grid; and its warnings.

    Args:
        log: as it was read.
        robot: that it is of.
        standing: whether a log in which nothing moves may be of use.
        force: whether units that look wrong are said, and not refused.

    Raises:
        LogError: see `check_log`; or no torque and no gain.
    """
    log = with_drive_gain(log, robot)
    noticed = check_log(
        log,
        n=robot.n,
        robot_name=robot.name,
        position_limits=robot.limits.position,
        prismatic=[t is JointType.PRISMATIC for t in robot.joint_types],
        standing=standing,
        moving_base=robot.floating,
        force=force,
    )
    even = log.even
    if even.tau is None:
        raise no_torque(even)
    # Torques far beyond the robot's limits: the wrong unit, or the wrong robot.
    beyond = []
    if (effort := robot.limits.effort) is not None:
        limits, largest = effort.tolist(), even.tau.abs().amax(0)
        beyond = [
            f"{even.source}: torque of joint {j} reaches {reached:.3g}, {reached / limit:.0f} "
            "times its limit: is it in another unit?"
            for j, (reached, limit) in enumerate(zip(largest.tolist(), limits, strict=True), 1)
            if reached > OTHER_UNIT * limit
        ]
    return even, (*noticed, *beyond, *even.warnings)


def refuse_repeated(
    log: Log, other: Log | None, why: str = "is held out and also among those to fit"
) -> None:
    """Raise if a trajectory is there twice: fitted twice, it would look twice as certain; fitted
    and held out, its errors would mean nothing.

    Args:
        log, other: with trajectories of which each is there once.
        why: what is wrong with one that both have.
    """
    parts = [(part, "is given twice") for part in log.trajectories()]
    kept = [] if other is None else other.trajectories()
    parts += [(part, why) for part in kept]
    # Of thousands of trajectories only those that begin alike are compared.
    alike: dict[tuple[float, ...], list[Log]] = {}
    for part, how in parts:
        others = alike.setdefault((part.samples, *part.q[0].tolist()), [])
        for other in others:
            pairs = (part.q, other.q), (part.tau, other.tau)
            if all(a is not None and b is not None and torch.equal(a, b) for a, b in pairs):
                raise LogError(
                    f"trajectory '{part.names[0]}' {how}.",
                    got=f"the same positions and torques as '{other.names[0]}'",
                    expected="every trajectory once",
                    hint="with one log only, hold out its end: `held_out_fraction=0.3`",
                )
        others.append(part)
