"""`torchid excite`: trajectories that make the parameters visible."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

import torchid
from torchid.app import options as opt
from torchid.app.output import Computed, Progress, stage
from torchid.app.planned import Controllers, Room
from torchid.app.signature import command
from torchid.errors import TorchidError
from torchid.excitation.settings import DURATION, EXCITED_EFFECTS, HARMONICS, RESTARTS, USAGE

if TYPE_CHECKING:
    from torchid.excitation.clearance import Clearance
    from torchid.excitation.design import Excitation
    from torchid.excitation.informed import InformedDesign
    from torchid.next_motion.separating_motion import Separation


@dataclass(frozen=True, kw_only=True)
class Motion:
    """What motions are asked for.

    Attributes:
        result: The next motion for an identification.json (fixes the parameters it knows least)
            or a gap.json (separates what it cannot tell apart, or shows what it could not test).
        kind: Optimised Fourier series, random ones, sinusoids for validation, or the report's
            table 5.1 (3R only).
        count: How many trajectories.
        criterion: What to improve: the condition number (default) or the determinant of the
            information; with --for an identification, its least known parameters (a_optimal,
            default) or all (d_optimal).
        effects: Effects to be identified with it, comma-separated; `none`.
        basis: Base parameters whose condition number it is: as the report groups them, or as logs
            tell them apart best (default: the robot's own). With --for, those of the result.
        duration: Seconds.
        rate: Samples per second in the file [Hz].
        harmonics: Harmonics of the series.
        restarts: Random starts of the design.
        usage: Share of the limits that may be used.
        speed: Share of the designed speed that the motion is written at: 0.1 for a first run.
    """

    result: Annotated[Path | None, typer.Option("--for", metavar="RESULT")] = None
    kind: Literal["optimised", "random", "sinusoid", "paper"] = "optimised"
    count: opt.Count = 1
    criterion: Literal["condition", "d_optimal", "a_optimal"] | None = None
    effects: opt.Excited = EXCITED_EFFECTS
    basis: Literal["report", "conditioned"] | None = None
    duration: float = DURATION
    rate: float = 100.0
    harmonics: Annotated[int, typer.Option(min=1, max=100)] = HARMONICS
    restarts: opt.Count = RESTARTS
    usage: float = USAGE
    speed: float = 1.0
    seed: opt.Seed = 0
    device_name: opt.Device = "cpu"

    def __post_init__(self) -> None:
        for name in ("duration", "rate", "usage", "speed"):
            if not getattr(self, name) > 0:
                raise TorchidError(f"--{name} must be positive.", got=getattr(self, name))
        if self.usage > 1:
            raise TorchidError("--usage is a share of the limits.", got=self.usage, expected="0..1")
        if self.speed > 1:
            raise TorchidError(
                "--speed is a share of the designed speed.", got=self.speed, expected="0..1"
            )
        if self.duration / self.speed * self.rate > 1e7:
            raise TorchidError(
                "the trajectory would have more than ten million samples.",
                got=f"{self.duration / self.speed:g} s at {self.rate:g} Hz",
            )
        if self.result is not None and (self.kind != "optimised" or self.count != 1):
            raise TorchidError(
                "--for RESULT designs one optimised trajectory.",
                got=f"--kind {self.kind} --count {self.count}",
            )
        if self.basis is not None and (self.result is not None or self.kind != "optimised"):
            raise TorchidError(
                "--basis is of the condition number that a new design improves.",
                got=f"--kind {self.kind}" if self.result is None else f"--for {self.result}",
                expected="--kind optimised without --for",
            )

    @property
    def series(self) -> dict[str, Any]:
        """Of the Fourier series."""
        return {"harmonics": self.harmonics, "duration": self.duration, "usage": self.usage}


@command
def excite_command(
    *,
    robot: Annotated[str | None, typer.Argument(metavar="[ROBOT]")] = None,
    motion: Motion,
    room: Room,
    to: opt.Written = None,
    files: Controllers,
    max_velocity: opt.Velocities = None,
    max_acceleration: opt.Accelerations = None,
    tip: opt.Tip = None,
    output: Computed,
) -> None:
    """Design an exciting trajectory within the robot's limits, at rest at both ends.

    Torque limits are kept by the robot's parameters, or those that RESULT holds, if there are any;
    the links of a URDF or MJCF are kept apart (needs torchid's extra `mjcf`).

    Example: `torchid excite kuka_lwr4 --out motion`

    Example: `torchid excite arm.urdf --max-acceleration 5 --floor 0 --ros2 first.json --speed 0.1`

    Example: `torchid excite --for result/identification.json --max-acceleration 5 --out next`

    Args:
        robot: Built-in name, or a .yaml (ours), .urdf or .xml (MJCF) file; with --for, the one
            that the result records if absent.
        to: Trajectory file (.csv, .parquet, .npz).
        max_velocity: Velocity limits, in place of the robot's.
    """
    from torchid.excitation.given import Motions, given_motions
    from torchid.excitation.restriction import restricted
    from torchid.next_motion.design import read_asking
    from torchid.next_motion.planned import Planned
    from torchid.report import motion as words

    target = to or (output.out and output.out / "trajectory.csv")
    if not (target or output.json_file or files.ros2 or files.urscript):
        raise TorchidError(
            "nowhere to write the trajectory.",
            expected="--to FILE, --out DIR, --ros2 FILE, --urscript FILE or --json FILE",
        )
    found = None if robot is None else opt.load(robot, tip)
    if motion.result is not None:
        found = found or read_asking(motion.result).model
    if found is None:
        if motion.result is not None:
            raise TorchidError(
                f"'{motion.result}' does not record its robot.", expected="torchid excite ROBOT"
            )
        raise TorchidError("which robot?", expected="torchid excite ROBOT, or --for RESULT")
    arm = opt.limited(found, max_velocity, max_acceleration)
    files.check(arm, 3 if motion.kind == "paper" else motion.count)
    clearance, unknown = room.of(arm, motion.usage)
    with output.progress() as progress:
        designs = _designs(arm, motion, clearance, progress)
    made: Motions
    if designs:
        made, limits = [design.trajectory for design in designs], designs[0].torque
    else:
        seeds = range(motion.seed, motion.seed + motion.count)
        made, limits = given_motions(arm, motion.kind, seeds, clearance, **motion.series)
    if motion.speed != 1:
        made = [x.at_speed(motion.speed) for x in made]
        # Gravity needs its torque at any speed, and the designed motion may have helped it.
        kept = None if motion.kind == "paper" else restricted(limits, clearance)
        made = made if kept is None else [kept.within(x) for x in made]
    kind, source = (motion.kind, None) if motion.result is None else ("next", motion.result.name)
    planned = Planned(
        arm, kind, made, motion.rate, motion.speed, limits, clearance, unknown, designs, source
    )
    output.put(target, partial(torchid.write_log, planned.log))
    files.write(arm, made, motion.rate, output)
    data = planned.plain(None if target is None else target.name)
    said = output.keep(data, "excitation.json", lambda _: words.shown(planned))
    output.tell(words.design_shown(planned))
    output.tell(said)


def _designs(
    robot: "torchid.Robot",
    motion: Motion,
    clearance: "Clearance | None",
    progress: Progress | None,
) -> "Sequence[Excitation | InformedDesign | Separation]":
    """The designs asked for; none where motions are given."""
    if motion.result is not None:
        if motion.criterion == "condition":
            raise TorchidError(
                "--for a result has other criteria.",
                got=motion.criterion,
                available=["a_optimal", "d_optimal"],
            )
        made = torchid.excite_for(
            motion.result, robot, goal=motion.criterion, restarts=motion.restarts,
            seed=motion.seed, clearance=clearance, progress=progress, **motion.series,
        )  # fmt: skip
        return [made]
    settings = motion.series | {
        "effects": motion.effects,
        "restarts": motion.restarts,
        "criterion": motion.criterion or "condition",
        "basis": motion.basis,
        "device": opt.device(motion.device_name),
        "clearance": clearance,
    }
    out = []
    for k in range(motion.count if motion.kind == "optimised" else 0):
        told = stage(progress, f"trajectory {k + 1} of {motion.count}")
        out.append(torchid.excite(robot, seed=motion.seed + k, progress=told, **settings))
    return out
