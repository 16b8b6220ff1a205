"""Motions as settings ask for them: designed, drawn or printed, in the room there is; and the plan
as one result: what they are, what they ask of the drives, how near they come."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from torchid.errors import TorchidError
from torchid.excitation.clearance import Clearance, Nearest, motion_clearance
from torchid.excitation.design import Excitation, InformedDesign, excite
from torchid.excitation.fourier import FourierTrajectory
from torchid.excitation.restriction import AllOf
from torchid.excitation.torque import (
    TorqueLimits,
    TorqueUse,
    has_torque_limits,
    nominal_torque_limits,
)
from torchid.excitation.trajectories import (
    Sinusoid,
    paper_trajectories_3r,
    random_trajectory,
    sinusoid,
    trajectory_log,
)
from torchid.json_data import picked, plain
from torchid.log.model import Log
from torchid.next_motion.design import excite_for
from torchid.next_motion.separating_motion import Separation
from torchid.next_motion.separation import other_means
from torchid.next_motion.settings import MotionSettings, Room
from torchid.parallel.workers import Progress, stage
from torchid.position.next_motion import NextCommands
from torchid.robot.model import Robot

Motions = Sequence[FourierTrajectory | Sinusoid]


@dataclass(frozen=True, eq=False)
class Planned:
    """Motions for a robot, and what they keep.

    Attributes:
        robot: that moves.
        kind: `optimised`, `next`, `random`, `sinusoid` or `paper`.
        motions: as they are driven.
        rate: of their samples [Hz].
        speed: share of the designed speed.
        limits: of torque; None where they were not checked.
        clearance: what is kept clear of; None where that was not checked.
        unknown: what could not be checked, one sentence each.
        designs: what designed them; none for motions that were given.
        result: name of the file that the next motion is for.
    """

    robot: Robot
    kind: str
    motions: Motions
    rate: float
    speed: float
    limits: TorqueLimits | None
    clearance: Clearance | None
    unknown: tuple[str, ...]
    designs: Sequence[Excitation | InformedDesign | Separation]
    result: str | None = None

    @cached_property
    def log(self) -> Log:
        """All motions as one log, a trajectory each."""
        return Log.concatenate([trajectory_log(x, self.rate) for x in self.motions])

    @cached_property
    def use(self) -> TorqueUse | None:
        """What the motions ask of the drives."""
        return None if self.limits is None else self.limits.use(self.motions)

    @cached_property
    def nearest(self) -> Nearest | None:
        """How near the motions come to what they must keep clear of."""
        return None if self.clearance is None else self.clearance.nearest(self.motions)

    def plain(self, file: str | None) -> dict[str, Any]:
        """The schema torchid.excitation/1.

        Args:
            file: that the motions are in.
        """
        series = [x for x in self.motions if isinstance(x, FourierTrajectory)]
        names = "a b q0 w_f duration ramp"
        return {
            "schema": "torchid.excitation/1",
            "robot": self.robot.name,
            "kind": self.kind,
            "file": file,
            **self._design(),
            **({"trajectories": [picked(x, names) for x in series]} if series else {}),
            "speed": self.speed,
            "torque": torque_record(self.robot, self.use),
            "clearance": clearance_record(self.clearance, self.nearest, self.unknown),
            "warnings": list(self.log.warnings),
        }

    def _design(self) -> dict[str, Any]:
        """How the motions were designed, and what that gained."""
        match self.designs:
            case [InformedDesign() as one]:
                record = informed_record(one)
            case [Separation() as one]:
                record = separation_record(one)
            case [Excitation() as first, *_]:
                excitations = [x for x in self.designs if isinstance(x, Excitation)]
                return {
                    "criterion": first.criterion,
                    "basis": first.base.basis,
                    "condition_number_before": [x.start_condition for x in excitations],
                    "condition_number_after": [x.condition_after for x in excitations],
                    "hardly_better": [x.hardly for x in excitations],
                }
            case _:
                return {}
        return record | {"result": self.result, "hardly_better": one.hardly}


def not_checked(robot: Robot) -> str | None:
    """Why the robot's torque limits cannot be checked; None where it has none or they can be."""
    if not has_torque_limits(robot) or robot.parameters is not None:
        return None
    return (
        f"torque limits were not checked: robot '{robot.name}' has no inertial parameters, which "
        "predict torque."
    )


def torque_record(robot: Robot, use: TorqueUse | None) -> dict[str, Any]:
    """JSON-ready; without a use, why torque limits were not checked."""
    if use is None:
        return {"checked": False, "reason": not_checked(robot) or "no torque limits"}
    joints = zip(use.largest.tolist(), plain(use.limits), use.share.tolist(), strict=True)
    return {
        "checked": True,
        "model": use.source,
        "joints": [
            {"joint": j, "largest": size, "limit": limit, "share": share}
            for j, (size, limit, share) in enumerate(joints, start=1)
        ],
    }


def clearance_record(
    clearance: Clearance | None, nearest: Nearest | None, unknown: Sequence[str] = ()
) -> dict[str, Any]:
    """JSON-ready; `unknown` is what could not be checked, one sentence each."""
    if clearance is None or nearest is None:
        return {"checked": False, "not_checked": list(unknown)}
    between = [nearest.first, nearest.second]
    near = {"distance": nearest.distance, "between": between, "time": nearest.time}
    return {
        "checked": True,
        "clearance": clearance.clearance,
        "pairs": len(clearance.pairs),
        "nearest": None if math.isinf(nearest.spare) else near,
        "not_checked": [*unknown, *clearance.notes],
    }


def informed_record(d: InformedDesign) -> dict[str, Any]:
    """What a motion tells of parameters before and after it, ready for JSON."""
    columns = zip(
        d.prior.base.names, d.prior.base.units, d.targets.tolist(), plain(d.before),
        d.with_plain.tolist(), d.after.tolist(), strict=True,
    )  # fmt: skip
    return {
        "criterion": d.goal,
        "shrinks_to": {"plain": d.shrinks(d.with_plain), "designed": d.shrinks(d.after)},
        "parameters": [
            {"name": name, "unit": unit, "target": target, "std": std,
             "predicted_std": {"plain": plain, "designed": designed}}
            for name, unit, target, std, plain, designed in columns
        ],
    }  # fmt: skip


def separation_record(s: Separation) -> dict[str, Any]:
    """What a motion separates, ready for JSON."""
    return {
        "criterion": "separation",
        "for": s.kind,
        "pairs": [
            {
                "if": r.truth.effect.record(r.truth.values),
                "common": len(r.truth.effects) > 1,
                "not": r.name or None,
                "separation": {"plain": plain.difference, "designed": after.difference},
                "decides": {"plain": plain.reached >= 1, "designed": after.reached >= 1},
            }
            for r, plain, after in zip(s.rivals, s.with_plain, s.after, strict=True)
        ],
        "hopeless": [
            {"effect": r.truth.effect.name, "joints": [j + 1 for j in r.truth.effect.joints],
             "not": r.name or None, "instead": other_means([r.truth.effect.name])}
            for r in s.hopeless
        ],
        "notes": list(s.notes),
    }  # fmt: skip


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
        TorchidError: a criterion, a device or a result that does not fit.
    """
    clearance, unknown = clearance_of(robot, room or Room(), asked.usage)
    designs = _designs(robot, asked, clearance, progress)
    limits = designs[0].torque if designs else nominal_torque_limits(robot, usage=asked.usage)
    # Table 5.1 is not changed.
    kept = AllOf.of(robot, asked.usage, *(() if asked.kind == "paper" else (limits, clearance)))
    made: Motions = [design.trajectory for design in designs]
    made = made or [kept.within(x) for x in _given(robot, asked, clearance)]
    if asked.speed != 1:
        # Gravity needs its torque at any speed, and the full motion may have helped it.
        made = [kept.within(x.at_speed(asked.speed)) for x in made]
    kind, source = (asked.kind, None) if asked.result is None else ("next", asked.result.name)
    return Planned(
        robot, kind, made, asked.rate, asked.speed, limits, clearance, unknown, designs, source
    )


def clearance_of(
    robot: Robot, room: Room, usage: float
) -> tuple[Clearance | None, tuple[str, ...]]:
    """What the robot's motions are checked for, None where there is nothing; and what is not
    checked for want of knowledge, one sentence each."""
    clearance = motion_clearance(robot, usage=usage, **vars(room))
    return (clearance if len(clearance.pairs) else None), clearance.warnings


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
        reported = stage(progress, f"trajectory {k + 1} of {asked.count}", k, asked.count)
        out.append(excite(robot, seed=asked.seed + k, progress=reported, **shared))
    return out


def _given(robot: Robot, asked: MotionSettings, clearance: Clearance | None) -> Motions:
    """Random Fourier series, sinusoids, or the report's table 5.1 (3R only), as printed.

    Raises:
        TorchidError: table 5.1 for another robot, or in less room than it needs.
    """
    if asked.kind != "paper":
        seeds = range(asked.seed, asked.seed + asked.count)
        sizes = {"duration": asked.duration, "usage": asked.usage}
        if asked.kind == "sinusoid":
            return [sinusoid(robot, seed, **sizes) for seed in seeds]
        return [random_trajectory(robot, seed, fill=True, **asked.series) for seed in seeds]
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
    return [printed.select(k) for k in range(3)]
