"""Motions as settings ask for them: designed, drawn or printed, in the room there is."""

from collections.abc import Sequence

from torchid.errors import MissingExtraError, TorchidError
from torchid.excitation.clearance import Clearance, motion_clearance
from torchid.excitation.design import Excitation, excite
from torchid.excitation.given import Motions, given_motions
from torchid.excitation.informed import InformedDesign
from torchid.excitation.restriction import restricted
from torchid.next_motion.design import excite_for
from torchid.next_motion.planned import Planned
from torchid.next_motion.separating_motion import Separation
from torchid.next_motion.settings import MotionSettings, Room
from torchid.parallel.workers import Progress, stage
from torchid.position.next_motion import NextCommands
from torchid.robot.model import Robot


def plan(
    robot: Robot,
    asked: MotionSettings,
    room: Room | None = None,
    *,
    progress: Progress | None = None,
) -> Planned:
    """Motions for a robot.

    Args:
        robot: with limits.
        asked: which motions, and at which speed.
        room: what they keep clear of; the usual distance between links if None.
        progress: called with (stage, done, total).

    Raises:
        RobotError: the limits are incomplete, or no motion keeps them.
        MissingExtraError: a floor or a workspace is asked for, and MuJoCo is not installed.
        TorchidError: a criterion, a device or a result that does not fit.
    """
    clearance, unknown = clearance_of(robot, room or Room(), asked.usage)
    designs = _designs(robot, asked, clearance, progress)
    made: Motions
    if designs:
        made, limits = [design.trajectory for design in designs], designs[0].torque
    else:
        seeds = range(asked.seed, asked.seed + asked.count)
        made, limits = given_motions(robot, asked.kind, seeds, clearance, **asked.series)
    if asked.speed != 1:
        made = [x.at_speed(asked.speed) for x in made]
        # Gravity needs its torque at any speed, and the designed motion may have helped it.
        kept = None if asked.kind == "paper" else restricted(limits, clearance)
        made = made if kept is None else [kept.within(x) for x in made]
    kind, source = (asked.kind, None) if asked.result is None else ("next", asked.result.name)
    return Planned(
        robot, kind, made, asked.rate, asked.speed, limits, clearance, unknown, designs, source
    )


def clearance_of(
    robot: Robot, room: Room, usage: float
) -> tuple[Clearance | None, tuple[str, ...]]:
    """What the robot's motions are checked for, None where there is nothing; and what is not
    checked for want of knowledge, one sentence each."""
    try:
        found = motion_clearance(robot, usage=usage, **vars(room))
    except MissingExtraError as error:
        if room.floor is not None or room.workspace is not None:
            raise
        return None, (f"collisions were not checked: {error.problem} {error.hint}",)
    return (found if len(found.pairs) else None), found.warnings


def _designs(
    robot: Robot, asked: MotionSettings, clearance: Clearance | None, progress: Progress | None
) -> Sequence[Excitation | InformedDesign | Separation]:
    """The designs asked for; none where motions are given."""
    shared = asked.series | {"restarts": asked.restarts, "clearance": clearance}
    if asked.result is not None:
        if asked.criterion == "condition":
            raise TorchidError(
                "`result=...` has other criteria.",
                got=asked.criterion,
                available=["a_optimal", "d_optimal"],
            )
        made = excite_for(
            asked.result, robot, goal=asked.criterion, seed=asked.seed, progress=progress, **shared
        )
        assert not isinstance(made, NextCommands), "commands of servos are no planned motion"
        return [made]
    shared |= {
        "effects": asked.effects,
        "criterion": asked.criterion or "condition",
        "basis": asked.basis,
        "device": asked.device_name,
    }
    out = []
    for k in range(asked.count if asked.kind == "optimised" else 0):
        told = stage(progress, f"trajectory {k + 1} of {asked.count}")
        out.append(excite(robot, seed=asked.seed + k, progress=told, **shared))
    return out
