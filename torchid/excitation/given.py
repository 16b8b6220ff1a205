"""Motions that are drawn or printed, not designed, within what a robot allows."""

from collections.abc import Iterable, Sequence

from torchid.errors import TorchidError
from torchid.excitation.clearance import Clearance
from torchid.excitation.fourier import FourierTrajectory
from torchid.excitation.restriction import restricted
from torchid.excitation.torque import TorqueLimits, nominal_torque_limits
from torchid.excitation.trajectories import (
    Sinusoid,
    paper_trajectories_3r,
    random_trajectory,
    sinusoid,
)
from torchid.robot.model import Robot

Motions = Sequence[FourierTrajectory | Sinusoid]


def given_motions(
    robot: Robot,
    kind: str,
    seeds: Iterable[int],
    clearance: Clearance | None,
    *,
    harmonics: int,
    duration: float,
    usage: float,
) -> tuple[Motions, TorqueLimits | None]:
    """Motions of one kind, and the torque limits that they keep.

    Args:
        robot: with limits.
        kind: `random` Fourier series, `sinusoid`, or the report's table 5.1 (3R only), as printed,
            `paper`.
        seeds: one a motion.
        clearance: what they keep clear of.
        harmonics: of the series.
        duration: [s].
        usage: share of the limits that may be used.

    Raises:
        TorchidError: table 5.1 for another robot, or in less room than it needs.
    """
    torque = nominal_torque_limits(robot, usage=usage)
    if kind == "paper":
        if not robot.name.startswith("3r"):
            raise TorchidError(
                "table 5.1 is for the 3R.", got=robot.name, available=["3r", "3r_friction"]
            )
        printed = paper_trajectories_3r()
        if clearance is not None and not bool(clearance.fits(printed).all()):
            raise TorchidError(
                "the motions of table 5.1 leave the room there is; they are not changed.",
                available=[f'`kind="{other}"`' for other in ("optimised", "random", "sinusoid")],
            )
        return [printed.select(k) for k in range(3)], torque
    made: Motions = [
        sinusoid(robot, seed, duration=duration, usage=usage)
        if kind == "sinusoid"
        else random_trajectory(
            robot, seed, fill=True, harmonics=harmonics, duration=duration, usage=usage
        )
        for seed in seeds
    ]
    kept = restricted(torque, clearance)
    return made if kept is None else [kept.within(x) for x in made], torque
