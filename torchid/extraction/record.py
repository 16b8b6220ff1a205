"""An extraction as plain data (schema torchid.extraction/1)."""

import math
from typing import Any

from torchid.extraction.convex.atlas import Atlas
from torchid.extraction.convex.certificate import Certificate
from torchid.extraction.problem import Problem
from torchid.feasibility.margins import Feasibility
from torchid.json_data import picked, plain
from torchid.robot.library import named_record
from torchid.typing import Float, Tensor

SCHEMA = "torchid.extraction/1"
ATLAS_SCHEMA = "torchid.atlas/1"
NOTICEABLE = 1e-3
"""Share of phi_min by which releasing a condition must lower it to be listed."""


def problem_record(problem: Problem) -> dict[str, Any]:
    """Which base parameters were asked for, within which bounds and conditions."""
    target, low = problem.target, problem.box[:, 0]
    total = problem.conditions.total_mass.tolist()
    return {
        **named_record(problem.robot),
        "loss": target.loss,
        "bounds": problem.bounds.name,
        "base_names": list(target.base.names),
        "base_values": target.values.tolist(),
        "search_variables": len(low),
        "total_mass": total if all(math.isfinite(x) for x in total) else None,
    }


def sets_record(
    ids: tuple[str, ...], phi: Float[Tensor, " K"], gamma: Float[Tensor, " K"], found: Feasibility
) -> list[dict[str, Any]]:
    """One entry a set: loss, penalty, verdict."""
    rows = (
        {"id": name, "phi": phi[k], "gamma": gamma[k], "feasible": found.feasible[k],
         "reasons": found.reasons(k), "degree": found.degree[k]}
        for k, name in enumerate(ids)
    )  # fmt: skip
    return [dict(plain(row)) for row in rows]


def certificate_record(proof: Certificate | None) -> dict[str, Any] | None:
    """phi_min and what forces it; None where there is no certificate."""
    if proof is None:
        return None
    return {
        "feasible": proof.feasible and proof.with_conditions,
        **picked(proof, "with_conditions phi_min phi_strict exact conflict forcing"),
        "phi_min_without": noticeable(proof),
        **picked(proof, "relaxed=relaxed_active seconds"),
    }


def noticeable(proof: Certificate) -> dict[str, float]:
    """Conditions whose release lowers phi_min noticeably, and to what; those of most effect
    first."""
    limit = proof.phi_min * (1 - NOTICEABLE)
    lower = {name: value for name, value in proof.released.items() if value < limit}
    return dict(sorted(lower.items(), key=lambda item: item[1]))


def atlas_record(atlas: Atlas, problem: Problem) -> dict[str, Any]:
    """Ranges of all parameters."""
    share = atlas.narrowed
    parameters = [
        {
            "name": name,
            "unit": atlas.units[k],
            "low": atlas.low[k],
            "high": atlas.high[k],
            "bounds": [atlas.bounds_low[k], atlas.bounds_high[k]],
            "share_of_bounds": share[k],
            "status": atlas.status[k],
        }
        for k, name in enumerate(atlas.names)
    ]
    return {
        "schema": ATLAS_SCHEMA,
        **problem_record(problem),
        "kind": atlas.kind,
        "radius": plain(atlas.radius),
        "parameters": plain(parameters),
    }
