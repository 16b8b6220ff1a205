"""`torchid check`: whether parameters can belong to a real arm."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torchid.app import options as opt
from torchid.app.output import Computed
from torchid.app.signature import Switch, command
from torchid.errors import TorchidError
from torchid.json_data import plain, read_json, write_json

if TYPE_CHECKING:
    from torchid.effects.registry import Valued
    from torchid.extraction.convex.nearest import NearestSets
    from torchid.feasibility.findings import Finding
    from torchid.feasibility.record import Check
    from torchid.feasibility.sets import ParameterSets
    from torchid.robot.model import Robot


@command
def check_command(
    *,
    params: Annotated[str, typer.Argument(metavar="PARAMS")],
    robot: opt.RobotOption = None,
    geometry: opt.Group = None,
    shapes: Switch = False,
    total_mass: Annotated[str | None, typer.Option(metavar="LO,HI|none")] = None,
    bounds: opt.Bounds = None,
    nearest: opt.Written = None,
    tip: opt.Tip = None,
    seed: opt.Seed = 0,
    output: Computed,
) -> None:
    """Check whether parameters can belong to a real arm: by how much, and why not.

    Infeasible sets are a finding, not an error: the exit code is 0.

    Example: `torchid check kuka_lwr4_friction`, `torchid check sets.json --robot panda.yaml
    --nearest repaired.json`

    Args:
        params: A file of parameter sets (.json), or a robot (built-in name, .yaml, .urdf, .xml),
            whose nominal parameters are checked.
        robot: Robot whose bounds, shapes and limits count; PARAMS itself where it is a robot.
        geometry: Bounds whose boxes of the centres of mass are the links' geometry. Without it:
            `normal` where the robot has it, else the shapes in its file, else none.
        shapes: Check the yaml's cylinders and spheres too.
        total_mass: Interval of the sum of the masses [kg]; the yaml's.
        bounds: Also tell which parameters lie on these bounds.
        nearest: Write the feasible set nearest in torque to each infeasible one.
    """
    from rich.markup import escape

    from torchid.feasibility.bounds import read_total_mass
    from torchid.feasibility.derived_bounds import named_bounds
    from torchid.feasibility.record import check_sets, record
    from torchid.report.feasibility import (
        DEGREE,
        conditions_line,
        findings_lines,
        headline,
        nearest_table,
        tables,
    )

    found, sets, others, also, noticed = _read(params, robot, tip)
    total = None
    if total_mass is None:
        total = read_total_mass(found)
    elif total_mass != "none":
        total = opt.total_mass(total_mass)
    check = check_sets(
        found,
        sets,
        geometry=geometry,
        round_shapes=shapes,
        total_mass=total,
        bounds=None if bounds is None else named_bounds(found, bounds),
        also=also,
        seed=seed,
    )
    data = {**record(check), "seed": seed}
    data["warnings"] = [*noticed, *data["warnings"]]
    repaired = None
    if nearest is not None:
        with output.progress("the nearest feasible sets"):
            repaired = _nearest(check, others, nearest, data, seed)
    if repaired is not None and nearest is not None and bool(repaired.feasible.any()):
        output.written.append(nearest)
    output.write_json(data, "feasibility.json")
    output.verdict(headline(check))
    output.say(escape(conditions_line(check)), *tables(check))
    if repaired is not None:
        output.say(nearest_table(repaired))
    output.say(DEGREE)
    output.warn(data["warnings"])
    findings = findings_lines(check)
    if findings:
        output.say("\nnot plausible, though not forbidden:")
        output.warn(findings)
    if repaired is None and nearest is not None:
        output.say(f"all sets are feasible: {escape(str(nearest))} was not written")


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
    own, found = opt.load_both(params, robot, tip)
    if own.n != found.n:
        raise TorchidError(
            f"'{own.name}' and --robot '{found.name}' have different numbers of links.",
            got=own.n,
            expected=found.n,
        )
    also = own_inertial_findings(own_inertials(own))
    # The parameters' link frames need not be those of the robot that counts.
    apart = [
        str(i + 1)
        for i in range(own.n)
        if float((own.before[i] - found.before[i]).abs().max()) > 1e-6
        or float((own.after[i] - found.after[i]).abs().max()) > 1e-6
    ]
    differ = (
        f"'{own.name}' and '{found.name}' place the frames of links {', '.join(apart)} "
        "differently: boxes of centres of mass, shapes and the torque may not be meant for these "
        "parameters"
    )
    told = (differ,) if apart else ()
    return found, nominal_set(own), nominal_others(own), also, told


def _nearest(
    check: "Check", others: Sequence["Valued"], path: Path, data: dict[str, Any], seed: int
) -> "NearestSets | None":
    """Sets nearest to the infeasible ones: feasible ones to the file, what each cost in torque to
    the record; None where all are feasible."""
    from torchid.export.dynamics import described
    from torchid.extraction.convex.nearest import nearest_feasible
    from torchid.feasibility.sets import to_record

    infeasible = (~check.feasibility.feasible).nonzero().flatten().tolist()
    if not infeasible:
        return None
    nearest = nearest_feasible(
        check.robot, check.sets.part(infeasible), check.conditions, seed=seed
    )
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

    entries = {entry["id"]: entry for entry in data["sets"]}
    for k, name in enumerate(nearest.sets.ids):
        entries[name]["nearest"] = {
            "status": nearest.status[k],
            "feasible": bool(nearest.feasible[k]),
            "least": plain(nearest.least[k]),
            "torque_change": plain(nearest.torque_change[k]),
            "torque_change_relative": plain(nearest.torque_change_relative[k]),
        }
    return nearest
