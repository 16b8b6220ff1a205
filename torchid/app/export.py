"""`torchid export`: a result's dynamics in the formats of other programs."""

from pathlib import Path
from typing import Annotated, Literal, get_args

import typer

import torchid
from torchid.app import options as opt
from torchid.app.output import Computed, Output
from torchid.app.signature import Switch, command
from torchid.errors import TorchidError


@command
def export_command(
    *,
    result: Annotated[str, typer.Argument(metavar="RESULT")],
    to: Literal["urdf", "mjcf", "drake", "yaml", "csv", "c", "isaaclab", "mjlab"] | None = None,
    robot: opt.RobotOption = None,
    chosen: Annotated[str | None, typer.Option("--set", metavar="ID")] = None,
    name: Annotated[str | None, typer.Option(metavar="NAME")] = None,
    force: Switch = False,
    geometry: opt.Group = None,
    log: opt.LogFiles = None,
    held_out: opt.LogFiles = None,
    randomise: Annotated[float | None, typer.Option(metavar="LEVEL")] = None,
    spread: Annotated[list[Path] | None, typer.Option(metavar="FILE")] = None,
    draws: opt.Count = 256,
    reading: opt.Reading,
    tip: opt.Tip = None,
    seed: opt.Seed = 0,
    output: Computed,
) -> None:
    """Write identified dynamics into a copy of your URDF or MJCF, as yaml, as a table, or as C.

    Every file is reloaded, also by Pinocchio and MuJoCo where they are installed, and its torque
    compared with the result's; what does not agree is not kept. Without --out, it is written to
    the present folder.

    Example: `torchid export sets/extraction.json --robot arm.urdf --to urdf --out identified`

    Args:
        result: JSON of `torchid identify`, `extract` or `gap`, a file of parameter sets, the .yaml
            of `torchid gap --save-model`, or any robot.
        to: Format to write; isaaclab and mjlab are actuator classes that add the effects without a
            field at run time. Not with --randomise.
        robot: Robot of the result, and the file that a copy is edited of; the one that RESULT
            records.
        chosen: Set of a file of several; the feasible one of least loss.
        name: Of the file, without suffix; the robot's name.
        force: Write infeasible parameters, too.
        log: Refit what is written to the torque of these logs, with bodies near to the robot's, and
            run it in its engine on them (urdf and mjcf, see `torchid correct`). May be given
            several times.
        held_out: Whole trajectories that judge what was refitted.
        randomise: In the place of a file: how wide to randomise the simulator, by the JSON of
            `torchid gap`. The ranges hold this share, e.g. 0.95, of what the log leaves open;
            written for MuJoCo, mjlab and Isaac Lab, with draws that are all bodies.
        spread: JSON of `torchid compare` or `torchid fleet identify`: how far sessions or units of
            the type are apart, for --randomise. May be given several times.
        draws: How many robots --randomise draws.
        geometry: Bounds of the centres of mass that count in the check, as for `torchid check`.
    """
    if randomise is not None:
        if to is not None:
            raise TorchidError("--randomise writes ranges for all simulators.", got=f"--to {to}")
        _randomised(output, result, robot, tip, randomise, spread or [], draws, seed, name)
        return
    if to is None:
        raise TorchidError(
            "there is nothing to write.", expected="--to FORMAT or --randomise LEVEL"
        )
    from torchid.export.projection import Target
    from torchid.export.results import carried
    from torchid.report.robot import correction_shown, export_shown

    found = carried(result, robot, tip, chosen, geometry)
    keep = [Path(file) for file in (result, robot, *(log or ()), *(held_out or ())) if file]
    if log is None:
        if found.diagnosed and to in get_args(Target):
            raise TorchidError(
                f"a diagnosis is refitted to what {to} can say, and needs its logs for that.",
                hint="--log LOG (several times, with --gain or --columns as before); --to yaml "
                "writes the corrected robot with all its effects",
            )
        done = torchid.export_dynamics(
            found.dynamics, to, output.out or Path(), name, nominal=found.nominal,
            original=found.original, geometry=geometry, force=force, seed=seed, keep=keep,
        )  # fmt: skip
        output.give(done, f"export_{to}.json", export_shown, seed=seed)
        return
    if to != "mjcf" and to != "urdf" and to != "drake":
        raise TorchidError(
            "only files of simulators are refitted to a log.", got=to, available=get_args(Target)
        )
    read = reading.read(log, found.original)
    apart = reading.read(held_out, found.original) if held_out else None
    made = torchid.correct(
        found.original, found.dynamics.robot, read, to, output.out or Path(), name,
        held_out=apart, settings=found.settings, keep=keep,
    )  # fmt: skip
    output.give(made, "correction.json", correction_shown)


def _randomised(
    output: Output,
    result: str,
    robot: str | None,
    tip: str | None,
    level: float,
    spread: list[Path],
    draws: int,
    seed: int,
    name: str | None,
) -> None:
    """Draw robots of a diagnosis, write and tell their ranges."""
    from torchid.export.results import diagnosis
    from torchid.report.randomisation import randomisation_shown

    given = None if robot is None else torchid.load_robot(robot, tip=tip)
    done = torchid.randomise(
        diagnosis(Path(result)), level, robot=given, spread=spread, draws=draws, seed=seed
    )
    files = [str(file) for file in done.write(output.out or Path(), name)]
    shown = randomisation_shown(done, files)
    plain = {**done.plain(), "files": files}
    output.give(plain, "randomisation.json", lambda _: shown, seed=seed)
