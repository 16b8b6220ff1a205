"""The feasible sets nearest in torque to infeasible ones, as a file and a part of a record."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from torchid.effects.registry import Valued
from torchid.export.dynamics import described
from torchid.extraction.convex.nearest import NearestSets, nearest_feasible
from torchid.feasibility.record import Check
from torchid.feasibility.sets import sets_record
from torchid.json_data import plain


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
