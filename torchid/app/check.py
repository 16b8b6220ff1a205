"""`torchid check`: whether parameters can belong to a real arm."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torchid.app.options import Json, Out, Quiet, Seed, Threads, Tip, interval
from torchid.app.output import Output, open_output
from torchid.errors import TorchidError
from torchid.json_data import read_json, write_json

if TYPE_CHECKING:
    from torchid.effects.registry import Valued
    from torchid.extraction.convex.nearest import NearestSets
    from torchid.feasibility.findings import Finding
    from torchid.feasibility.record import Check
    from torchid.feasibility.sets import ParameterSets
    from torchid.robot.model import Robot


def check_command(
    params: Annotated[
        str,
        typer.Argument(
            metavar="PARAMS",
            help="A file of parameter sets (.json), or a robot (built-in name, .yaml, .urdf, "
            ".xml), whose nominal parameters are checked.",
        ),
    ],
    robot: Annotated[
        str | None,
        typer.Option(
            "--robot",
            metavar="ROBOT",
            help="Robot whose bounds, shapes and limits count; PARAMS itself where it is a robot.",
        ),
    ] = None,
    geometry: Annotated[
        str | None,
        typer.Option(
            metavar="GROUP|none",
            help="Bounds whose boxes of the centres of mass are the links' geometry. Without it: "
            "`normal` where the robot has it, else the shapes in its file, else none.",
        ),
    ] = None,
    shapes: Annotated[
        bool, typer.Option("--shapes", help="Check the yaml's cylinders and spheres too.")
    ] = False,
    total_mass: Annotated[
        str | None,
        typer.Option(
            metavar="LO,HI|none", help="Interval of the sum of the masses [kg]; the yaml's."
        ),
    ] = None,
    bounds: Annotated[
        str | None,
        typer.Option(
            metavar="GROUP|from-robot", help="Also tell which parameters lie on these bounds."
        ),
    ] = None,
    nearest: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write the feasible set nearest in torque to each infeasible one.",
        ),
    ] = None,
    tip: Tip = None,
    json_file: Json = None,
    out: Out = None,
    seed: Seed = 0,
    quiet: Quiet = False,
    threads: Threads = None,
) -> None:
    """Check whether parameters can belong to a real arm: by how much, and why not.

    Infeasible sets are a finding, not an error: the exit code is 0.

    Example: `torchid check kuka_lwr4_friction`, `torchid check sets.json --robot panda.yaml
    --nearest repaired.json`
    """
    output = open_output(json_file, out, quiet, threads)
    if nearest is not None and not nearest.parent.is_dir():
        raise TorchidError(f"the folder of '{nearest}' does not exist.")
    from torchid.feasibility.derived_bounds import named_bounds
    from torchid.feasibility.record import check_sets, record

    found, sets, others, also, noticed = _read(params, robot, tip)
    check = check_sets(
        found,
        sets,
        geometry=geometry,
        round_shapes=shapes,
        total_mass=_total_mass(total_mass, found),
        bounds=None if bounds is None else named_bounds(found, bounds),
        also=also,
        seed=seed,
    )
    repaired = None if nearest is None else _repair(check, seed)
    data = {**record(check), "seed": seed}
    data["warnings"] = [*noticed, *data["warnings"]]
    if repaired is not None and nearest is not None:
        _write_nearest(repaired, check, others, nearest, data)
    _show(check, tuple(data["warnings"]), repaired, output)
    if repaired is None and nearest is not None:
        output.say(f"all sets are feasible: {nearest} was not written")
    output.write_json(data, "feasibility.json")


def _read(
    params: str, robot: str | None, tip: str | None
) -> tuple["Robot", "ParameterSets", Sequence["Valued"], Sequence["Finding"], tuple[str, ...]]:
    """The robot that counts, the sets, effects beside them, what the robot's file's own elements
    show, and warnings."""
    from torchid.effects.registry import nominal_others
    from torchid.feasibility.findings import own_inertial_findings
    from torchid.feasibility.sets import nominal_set, other_robot, read_other_effects, read_sets
    from torchid.robot.library import is_robot, load_robot, named_robot
    from torchid.robot.shapes import own_inertials

    if not is_robot(params):
        if not Path(params).is_file():
            raise TorchidError(
                f"'{params}' is neither a file nor a built-in robot.",
                expected="a .json of parameter sets, or a robot",
            )
        if robot is None:
            found = named_robot(Path(params), read_json(Path(params), "parameter sets"), tip)
        else:
            found = load_robot(robot, tip=tip)
        sets = read_sets(Path(params), found)
        noticed = other_robot(Path(params), found)
        others = read_other_effects(Path(params), found)
        return found, sets, others, (), () if noticed is None else (noticed,)
    names = [params] if robot is None else [params, robot]
    # A tip is for the files that can branch; where none can, the reader refuses it.
    trees = [name for name in names if Path(name).suffix.lower() in (".urdf", ".xml")]
    own, *counts = [
        load_robot(name, tip=tip if name in trees or not trees else None) for name in names
    ]
    found = counts[0] if counts else own
    if own.n != found.n:
        raise TorchidError(
            f"'{own.name}' and --robot '{found.name}' have different numbers of links.",
            got=own.n,
            expected=found.n,
        )
    also = own_inertial_findings(own_inertials(own))
    return found, nominal_set(own), nominal_others(own), also, _frames_differ(own, found)


def _frames_differ(own: "Robot", found: "Robot") -> tuple[str, ...]:
    """A warning where the parameters' link frames are not those of the robot that counts."""
    apart = [
        str(i + 1)
        for i in range(own.n)
        if float((own.before[i] - found.before[i]).abs().max()) > 1e-6
        or float((own.after[i] - found.after[i]).abs().max()) > 1e-6
    ]
    if not apart:
        return ()
    return (
        f"'{own.name}' and '{found.name}' place the frames of links {', '.join(apart)} "
        "differently: boxes of centres of mass, shapes and the torque may not be meant for these "
        "parameters",
    )


def _total_mass(text: str | None, robot: "Robot") -> tuple[float, float] | None:
    from torchid.feasibility.bounds import read_total_mass

    if text is None:
        return read_total_mass(robot)
    if text == "none":
        return None
    return interval("--total-mass", text)


def _repair(check: "Check", seed: int) -> "NearestSets | None":
    """The sets nearest to the infeasible ones; None where there are none."""
    from torchid.extraction.convex.nearest import nearest_feasible

    infeasible = (~check.feasibility.feasible).nonzero().flatten().tolist()
    if not infeasible:
        return None
    return nearest_feasible(check.robot, check.sets.part(infeasible), check.conditions, seed=seed)


def _write_nearest(
    nearest: "NearestSets",
    check: "Check",
    others: Sequence["Valued"],
    path: Path,
    data: dict[str, Any],
) -> None:
    """Feasible sets to the file; what each cost in torque to the record."""
    import math

    from torchid.export.dynamics import described
    from torchid.feasibility.sets import to_record

    good = nearest.feasible.nonzero().flatten().tolist()
    if good:
        sets = nearest.sets.part(good)
        write_json(to_record(sets, check.robot, others), path)
        data["warnings"] += [
            f"not part of the sets, and listed beside them in {path} as it is, for `torchid "
            f"export`: {described(*pair, check.robot)}"
            for pair in others
        ]
    else:
        data["warnings"].append(f"no feasible set was found: {path} was not written")

    def finite(values: list[float]) -> list[float | None]:
        return [v if math.isfinite(v) else None for v in values]

    entries = {entry["id"]: entry for entry in data["sets"]}
    for k, name in enumerate(nearest.sets.ids):
        entries[name]["nearest"] = {
            "status": nearest.status[k],
            "feasible": bool(nearest.feasible[k]),
            "least": finite([float(nearest.least[k])])[0],
            "torque_change": finite(nearest.torque_change[k].tolist()),
            "torque_change_relative": finite(nearest.torque_change_relative[k].tolist()),
        }


def _show(
    check: "Check", warnings: tuple[str, ...], nearest: "NearestSets | None", output: Output
) -> None:
    from rich.markup import escape

    from torchid.report.feasibility import (
        DEGREE,
        conditions_line,
        findings_lines,
        headline,
        nearest_table,
        tables,
    )

    output.say(f"[bold]{escape(headline(check))}[/]\n")
    output.say(escape(conditions_line(check)))
    for table in tables(check):
        output.say(table)
    if nearest is not None:
        output.say(nearest_table(nearest))
    output.say(DEGREE)
    output.warn(warnings)
    findings = findings_lines(check)
    if findings:
        output.say("\nnot plausible, though not forbidden:")
        output.warn(findings)
