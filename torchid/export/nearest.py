"""Feasible parameters near to infeasible ones: of base parameters the bodies nearest to the robot's
own, and of sets those nearest in torque, as a file and a part of a record."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from torchid.effects.registry import Valued
from torchid.export.dynamics import Dynamics, effect_text
from torchid.export.results import of_set
from torchid.extraction.convex.nearest import NearestSets, nearest_feasible
from torchid.extraction.from_identification import problem_of
from torchid.extraction.methods import near_set
from torchid.feasibility.record import Check
from torchid.feasibility.sets import sets_record
from torchid.json_data import plain
from torchid.robot.model import Robot


def nearest_bodies(dynamics: Dynamics, robot: Robot, geometry: str | None) -> Dynamics:
    """Bodies that have identified base parameters nearly: those nearest to the robot's own, or to
    typical ones, in the entropic metric (`torchid.extraction.methods`).

    Args:
        dynamics: of base parameters.
        robot: that was identified.
        geometry: group of bounds of the centres of mass, as for `check_sets`.

    Raises:
        TorchidError: effects or bounds that such a search does not take.
    """
    assert dynamics.base is not None
    problem, _ = problem_of(robot, dynamics.base, geometry=geometry)
    found = near_set(problem)
    one = of_set(robot, found.sets, dynamics.title)
    note = (
        "the parameters nearest to the robot's own that have exactly the identified base "
        "parameters are no bodies: these are bodies, whose torque is up to "
        f"{100 * float(found.torque.max()):.2g} % from the identified one; "
        "`torchid extract` finds others"
    )
    near = replace(one.robot, knowledge=dynamics.base.knowledge)
    return replace(one, robot=near, kind=dynamics.kind, warnings=(*one.warnings, note))


def nearest_sets(
    check: Check, others: Sequence[Valued], path: Path, data: dict[str, Any], seed: int
) -> NearestSets | None:
    """Sets nearest to the infeasible ones of a check; None where all are feasible.

    Args:
        check: of the sets.
        others: effects beside them, which go into the file.
        path: where the feasible ones are written, if there are any.
        data: the check's record, to which is added what each cost in torque.
        seed: of the search.
    """
    infeasible = (~check.feasibility.feasible).nonzero().flatten().tolist()
    if not infeasible:
        return None
    nearest = nearest_feasible(
        check.robot, check.sets.part(infeasible), check.conditions, seed=seed
    )
    good = nearest.feasible.nonzero().flatten().tolist()
    if good:
        sets = nearest.sets.part(good)
        sets_record(sets, check.robot, others).save(path)
        data["warnings"] += [
            f"not part of the sets, and listed beside them in {path} as it is, for `torchid "
            f"export`: {effect_text(*pair, check.robot)}"
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
