"""`torchid excite --for RESULT`: the next motion, given what a result has told already."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from torchid.app.output import Output, progress_bar, stage
from torchid.errors import TorchidError
from torchid.json_data import read_json

if TYPE_CHECKING:
    from torchid.excitation.fourier import FourierTrajectory
    from torchid.excitation.torque import TorqueLimits
    from torchid.excitation.trajectories import Sinusoid
    from torchid.robot.model import Robot

    Designed = tuple[FourierTrajectory, dict[str, Any], TorqueLimits | None]

EVALUATIONS = 75
"""Trajectories that the search for a separating motion tries a restart."""


def read_result(path: Path) -> Mapping[str, Any]:
    """What a motion can be designed for.

    Raises:
        TorchidError: another kind of file, or of another version.
    """
    from torchid.identification.record import SCHEMA as IDENTIFICATION
    from torchid.next_motion.ambiguity import SCHEMA as GAP

    data = read_json(path, "a result")
    schema = data.get("schema")
    if schema in (IDENTIFICATION, GAP):
        return data
    kind = str(schema).partition("/")[0]
    commands = {GAP.partition("/")[0]: "gap", IDENTIFICATION.partition("/")[0]: "identify"}
    again = f"it is of another version: torchid {commands.get(kind)} ROBOT LOG... --json FILE"
    raise TorchidError(
        f"'{path}' is not a result that a motion can be designed for.",
        got=f"schema {schema}",
        available=[IDENTIFICATION, GAP],
        hint=again if kind in commands else None,
    )


def designed_for(
    path: Path,
    data: Mapping[str, Any],
    robot: "Robot",
    seed: int,
    criterion: str | None,
    restarts: int,
    settings: dict[str, Any],
    output: Output,
) -> "Designed":
    """The trajectory, its record and the torque limits kept, by the kind of the result.

    Raises:
        TorchidError: a result that asks for no motion.
    """
    from torchid.excitation.informed import design_for
    from torchid.identification.reading import read_prior
    from torchid.next_motion.ambiguity import SCHEMA as GAP
    from torchid.report.motion import informed_record, informed_table, informed_verdict

    if data["schema"] == GAP:
        if criterion not in (None, "separation"):
            raise TorchidError(
                "for a gap diagnosis motions are designed to separate.", got=criterion
            )
        return _for_gap(path, data, robot, seed, restarts, settings, output)
    if criterion not in (None, "a_optimal", "d_optimal"):
        raise TorchidError(
            "--for an identification has other criteria.",
            got=criterion,
            available=["a_optimal", "d_optimal"],
        )
    goal: Literal["a_optimal", "d_optimal"] = (
        "d_optimal" if criterion == "d_optimal" else "a_optimal"
    )
    prior = read_prior(path, robot)
    with progress_bar(output) as progress:
        found = design_for(
            robot, prior, seed=seed, goal=goal, restarts=restarts, **settings,
            progress=stage(progress, "designing"),
        )  # fmt: skip
    output.verdict(informed_verdict(found))
    output.say(informed_table(found))
    return found.trajectory, informed_record(found), found.torque


def _for_gap(
    path: Path,
    data: Mapping[str, Any],
    robot: "Robot",
    seed: int,
    restarts: int,
    settings: dict[str, Any],
    output: Output,
) -> "Designed":
    from torchid.excitation.design import optimise_trajectory
    from torchid.excitation.torque import corrected_torque_limits
    from torchid.next_motion.ambiguity import read_open
    from torchid.next_motion.rivals import rivals
    from torchid.next_motion.separating_motion import design_separation
    from torchid.report.motion import (
        separation_record,
        separation_table,
        separation_verdict,
    )

    found = read_open(path, data, robot)
    model, given, usage = found.setting.robot, found.setting.given, settings["usage"]
    torque = corrected_torque_limits(model, given, usage=usage)
    with progress_bar(output) as progress:
        plain = optimise_trajectory(
            robot, seed=seed, restarts=restarts, torque=torque, **settings,
            progress=stage(progress, "a plain motion to compare with"),
        ).trajectory  # fmt: skip
        made = design_separation(
            found.setting, rivals(found, plain), plain, seed=seed, usage=usage,
            evaluations=EVALUATIONS * restarts, progress=stage(progress, "separating"),
        )  # fmt: skip
    output.verdict(separation_verdict(made, found.kind))
    output.say(separation_table(made, found.kind))
    output.warn(found.notes)
    record = {**separation_record(made, found.kind), "notes": list(found.notes)}
    return made.trajectory, record, made.torque


def torque_use(
    robot: "Robot",
    torque: "TorqueLimits | None",
    trajectories: "Sequence[FourierTrajectory | Sinusoid]",
    output: Output,
) -> dict[str, Any]:
    """Prints what motions ask of the drives, or that it is not known, and gives its record."""
    from torchid.report.motion import not_checked, torque_record, torque_table

    use = None if torque is None else torque.use(trajectories)
    if use is not None:
        output.say(torque_table(robot, use))
    elif reason := not_checked(robot):
        output.warn((reason,))
    return {"torque": torque_record(robot, use)}
