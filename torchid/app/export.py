"""`torchid export`: a result's dynamics in the formats of other programs; `torchid correct`: from
logs to a corrected file of the simulator, in one call."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal, get_args

import typer

import torchid
from torchid.app import options as opt
from torchid.app.inputs import MODEL, require_free
from torchid.app.output import Computed
from torchid.app.signature import Switch, command
from torchid.errors import TorchidError
from torchid.files import require_name
from torchid.gap.settings import GapSettings
from torchid.robot.config_files import names_robot

Simulated = Literal["mjcf", "urdf", "mujoco", "mjlab", "isaaclab", "gazebo"]
"""What a corrected file can be for; the last four read one of the first two."""
Format = Literal["urdf", "mjcf", "yaml", "c", "isaaclab", "mjlab", "bam"]


@command
def export_command(
    *,
    result: Annotated[str, typer.Argument(metavar="RESULT"), MODEL],
    to: Annotated[Format | None, typer.Option(metavar="FORMAT")] = None,
    robot: opt.RobotOption = None,
    chosen: Annotated[str | None, typer.Option("--set", metavar="ID")] = None,
    name: Annotated[str | None, typer.Option(metavar="NAME")] = None,
    force: Switch = False,
    plain: Switch = False,
    geometry: opt.Group = None,
    log: opt.LogFiles = None,
    held_out: opt.LogFiles = None,
    randomise: Annotated[float | None, typer.Option(metavar="LEVEL")] = None,
    draws: opt.Count = 256,
    reading: opt.Reading,
    part: opt.Part,
    seed: opt.Seed = 0,
    output: Annotated[Computed, "export_{to}.json", "randomisation.json"],
) -> None:
    """Write identified dynamics into a copy of your URDF or MJCF, as yaml, or as C.

    Every file is reloaded, also by Pinocchio and MuJoCo where they are installed, and its torque
    compared with the result's; what does not agree is not kept. Without --out, it is written to
    the present folder.

    Example: `torchid export sets/extraction.json --robot arm.urdf --to urdf --out identified`

    Args:
        result: JSON of `torchid identify`, `extract` or `gap`, a file of parameter sets, the .yaml
            of `torchid gap --save-model`, or any robot.
        to: Format to write; isaaclab and mjlab are actuator classes that add the effects without a
            field at run time, bam the servos' models of better-actuator-models. Not with
            --randomise.
        robot: Robot of the result, and the file that a copy is edited of; the one that RESULT
            records.
        chosen: Set of a file of several; the feasible one of least loss.
        name: Of the file, without suffix; the robot's name.
        force: Write infeasible parameters, too.
        plain: Leave set points of servos, which are joints of an MJCF, out of it.
        log: Refit what is written to the torque of these logs, with bodies near to the robot's, and
            run it in its engine on them (urdf and mjcf, see `torchid correct`). May be given
            several times.
        held_out: Whole trajectories that judge what was refitted.
        randomise: In the place of a file: how wide to randomise the simulator, by the JSON of
            `torchid gap` or a model that says how sure it is. The ranges hold this share, e.g.
            0.95, of what the logs leave open; written for MuJoCo, mjlab and Isaac Lab, with draws
            that are all bodies.
        draws: How many robots --randomise draws.
        geometry: Bounds of the centres of mass that count in the check, as for `torchid check`.
    """
    if randomise is not None and to is not None:
        raise TorchidError("--randomise writes ranges for all simulators.", got=f"--to {to}")
    if randomise is None and to is None:
        raise TorchidError(
            "there is nothing to write.", expected="--to FORMAT or --randomise LEVEL"
        )
    if log is not None and not output.overwrite:
        require_free({"out": output.out}, ["correction.json"])
    from torchid.export.projection import Target
    from torchid.export.results import any_diagnosis, carried
    from torchid.report import exported

    output.begin()
    folder = output.out or Path()
    if randomise is not None:
        given = None if robot is None else torchid.load_robot(robot, **part.choice.options)
        diagnosed = opt.load(result, part) if names_robot(result) else any_diagnosis(Path(result))
        ranges = torchid.randomise(diagnosed, randomise, robot=given, draws=draws, seed=seed)
        files = [str(file) for file in ranges.write(folder, name)]
        data = {**ranges.plain(), "files": files}
        report = exported.report_of_randomisation(ranges, files)
        output.give(data, "randomisation.json", lambda _: report, seed=seed)
        return
    assert to is not None
    model = carried(result, robot, part.choice, chosen, geometry)
    keep = [Path(file) for file in (result, robot, *(log or ()), *(held_out or ())) if file]
    if log is None:
        if model.diagnosed and to in get_args(Target):
            raise TorchidError(
                f"a diagnosis is refitted to what {to} can say, and needs its logs for that.",
                hint="--log LOG (several times, with --gain or --columns as before); --to yaml "
                "writes the corrected robot with all its effects",
            )
        done = torchid.export_dynamics(
            model.dynamics, to, folder, name, nominal=model.nominal,
            original=model.original, geometry=geometry, force=force, seed=seed, keep=keep,
            plain=plain,
        )  # fmt: skip
        output.give(done, f"export_{to}.json", exported.report_of_export, seed=seed)
        return
    if to != "mjcf" and to != "urdf":
        raise TorchidError(
            "only files of simulators are refitted to a log.", got=to, available=get_args(Target)
        )
    read = reading.read(log, model.original)
    apart = reading.read(held_out, model.original) if held_out else None
    made = torchid.correct(
        model.original, model.dynamics.arm or model.dynamics.robot, read, to, folder, name,
        held_out=apart, settings=replace(model.settings, seed=seed), keep=keep, plain=plain,
    )  # fmt: skip
    output.give(made, "correction.json", exported.report_of_correction)


@command
def correct_command(
    *,
    trials: opt.Trials,
    to: Annotated[Simulated, typer.Option(metavar="FORMAT")],
    name: Annotated[str | None, typer.Option(metavar="NAME")] = None,
    with_effects: Switch = False,
    plain: Switch = False,
    force: Switch = False,
    settings: Annotated[
        GapSettings, opt.GAP.only("effects background parameters held_out_fraction gain_std seed")
    ],
    output: Annotated[Computed, "correction.json"],
) -> None:
    """Correct a simulator's file by logs of the real arm.

    What it lacks is found and refitted to what the file can say, with bodies near to the nominal
    ones; the file is run in its engine on the log, and written. Without --out, it is written to the
    present folder.

    Example: `torchid correct arm.xml run1.parquet run2.parquet --held-out run3.parquet --to mjcf
    --out corrected`

    Args:
        to: Format to write (mjcf, urdf), or a simulator that reads one of them: a copy of ROBOT
            where it is of that format, else a new file of its kinematics, without shapes.
        name: Of the file, without suffix; the robot's name and `_corrected`.
        with_effects: Also write NAME_effects, fitted together with the effects that the format has
            no field for; they lie in its sidecar, and torchid.simulators.mujoco adds them at run
            time. For isaaclab and mjlab, an actuator class that does so, too.
        plain: Leave set points of servos, which are joints of an MJCF, out of it.
        force: Correct by a log that looks wrong, too.
        effects: Effects to search over, comma-separated; `all` for the whole library.
    """
    if name is not None:
        require_name(name)
    robot, log, apart, _ = trials.open(output, settings.held_out_fraction)
    from torchid.export.correct import file_format, require_field
    from torchid.report.exported import report_of_correction

    kind = file_format(to)
    require_field(kind, robot, log)
    beside = with_effects and (to if to == "isaaclab" or to == "mjlab" else True)
    with output.progress("preparing") as progress, trials.line_to_mend():
        result = torchid.diagnose(
            robot, log, held_out=apart, settings=settings, force=force, progress=progress
        )
    done = torchid.correct(
        robot, result, log, kind, output.out or Path(), name, held_out=apart, settings=settings,
        with_effects=beside, keep=trials.inputs, plain=plain or to in ("mjlab", "isaaclab"),
    )  # fmt: skip
    shown = output.keep(done, "correction.json", report_of_correction)
    output.tell(replace(shown, parts=[result.answer.headline, *shown.parts]))
