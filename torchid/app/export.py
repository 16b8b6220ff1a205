"""`torchid export`: a result's dynamics in the formats of other programs."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, get_args

import typer

from torchid.app import options as opt
from torchid.app.correct import corrected_by, say_corrected
from torchid.app.output import Computed, Output
from torchid.app.signature import Switch, command
from torchid.errors import TorchidError
from torchid.gap.settings import GapSettings

if TYPE_CHECKING:
    from torchid.export.dynamics import Dynamics


@command
def export_command(
    *,
    result: Annotated[str, typer.Argument(metavar="RESULT")],
    to: Literal["urdf", "mjcf", "yaml", "csv", "c", "isaaclab", "mjlab"] | None = None,
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
        _say_randomised(output, result, robot, tip, randomise, spread or [], draws, seed, name)
        return
    if to is None:
        raise TorchidError(
            "there is nothing to write.", expected="--to FORMAT or --randomise LEVEL"
        )
    from torchid.export.export import export_dynamics, require_name, stem_of
    from torchid.export.projection import Target
    from torchid.export.results import (
        CORRECTED,
        base_dynamics,
        diagnosis_dynamics,
        load,
        model_of,
        robot_dynamics,
        set_dynamics,
    )
    from torchid.report.robot import (
        comparison_table,
        effect_lines,
        export_headline,
    )
    from torchid.robot.library import is_robot, load_both, load_robot, named_robot

    settings = GapSettings()
    if is_robot(result):
        nominal, original = load_both(result, robot, tip)
        dynamics = robot_dynamics(nominal)
    elif CORRECTED in (data := load(Path(result))):
        dynamics, settings = diagnosis_dynamics(Path(result))
        nominal = original = model_of(Path(result), robot, tip)
        if log is None and to in get_args(Target):
            raise TorchidError(
                f"a diagnosis is refitted to what {to} can say, and needs its logs for that.",
                hint="--log LOG (several times, with --gain or --columns as before); --to yaml "
                "writes the corrected robot with all its effects",
            )
    else:
        path = Path(result)
        nominal = named_robot(path, data, tip) if robot is None else load_robot(robot, tip=tip)
        original = nominal
        if "sets" in data:
            dynamics = set_dynamics(path, data, nominal, chosen, geometry)
        else:
            dynamics = base_dynamics(path, nominal)
    keep = [Path(file) for file in (result, robot, *(log or ()), *(held_out or ())) if file]
    if log is not None:
        if to != "mjcf" and to != "urdf":
            raise TorchidError(
                "only files of simulators are refitted to a log.",
                got=to,
                available=get_args(Target),
            )
        read, apart = (reading.read(x, original) if x else None for x in (log, held_out))
        assert read is not None
        whole = dynamics.robot
        made = corrected_by(output, original, whole, read, apart, to, name, keep, settings)
        say_corrected(output, made)
        return
    if to == "isaaclab" or to == "mjlab":
        stem = stem_of(nominal) if name is None else name
        require_name(stem)
        _write_actuator(output, dynamics, to, stem, seed)
        return
    done = export_dynamics(
        dynamics,
        to,
        output.out or Path(),
        name,
        nominal=nominal,
        original=original,
        geometry=geometry,
        force=force,
        seed=seed,
        keep=keep,
    )
    output.write_json({**done.plain(), "seed": seed}, f"export_{to}.json")
    output.say(comparison_table(done), *effect_lines(done))
    output.warn(done.warnings)
    output.say(f"\nwritten: {export_headline(done)}")


def _say_randomised(
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
    from torchid.export.randomise import randomise
    from torchid.export.results import diagnosis
    from torchid.report.randomisation import headline, tables
    from torchid.robot.library import load_robot

    given = None if robot is None else load_robot(robot, tip=tip)
    done = randomise(
        diagnosis(Path(result)), level, robot=given, spread=spread, draws=draws, seed=seed
    )
    files = [str(file) for file in done.write(output.out or Path(), name)]
    output.write_json({**done.plain(), "files": files, "seed": seed}, "randomisation.json")
    output.verdict(headline(done))
    output.say(*tables(done))
    output.warn(done.warnings)
    output.say(f"\nwritten: {', '.join(files)}")


def _write_actuator(
    output: Output, dynamics: "Dynamics", to: Literal["isaaclab", "mjlab"], stem: str, seed: int
) -> None:
    """Write the effects as an actuator class, and tell which it adds."""
    from torchid.effects.registry import nominal_effects
    from torchid.export.dynamics import described
    from torchid.export.record import ExportRecord, Places
    from torchid.simulators.actuator import EffectTorque
    from torchid.simulators.actuator_files import write_actuator

    robot = dynamics.robot
    files = [str(file) for file in write_actuator(robot, to, output.out or Path(), stem)]
    # What the simulator has fields for, what the actuator adds, and what nobody does.
    ignored = EffectTorque(robot).ignored
    places: dict[str, list[str]] = {"in_file": [], "beside": [], "left_out": []}
    for effect, values in nominal_effects(robot):
        field = effect.attributes(values, True) is not None
        place = "beside" if field else "left_out" if effect.name in ignored else "in_file"
        places[place].append(described(effect, values, robot))
    lost = [f"LEFT OUT of the actuator: {words}" for words in places["left_out"]]
    done = ExportRecord(
        robot=robot.name,
        what=dynamics.kind,
        result=dynamics.title,
        format=to,
        files=tuple(files),
        original=None,
        feasible=None,
        reasons=(),
        checks=(),
        effects=Places(**{key: tuple(words) for key, words in places.items()}),
        warnings=tuple(lost),
    )
    output.write_json({**done.plain(), "seed": seed}, f"export_{to}.json")
    output.say(*(f"added at run time: {words}" for words in places["in_file"]))
    output.say(*(f"left to the simulator's own fields: {words}" for words in places["beside"]))
    output.warn(lost)
    output.say(f"\nwritten: {', '.join(files)}")
