"""An extraction as plain data (schema torchid.extraction/1)."""

import math
from typing import Any

from torchid.extraction.convex.atlas import Atlas
from torchid.extraction.convex.certificate import Certificate
from torchid.extraction.problem import Problem
from torchid.feasibility.margins import Feasibility
from torchid.json_data import plain
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
    verdict = found.feasible.tolist()
    degree = found.degree.tolist()
    return [
        {
            "id": name,
            "phi": plain(phi[k]),
            "gamma": plain(gamma[k]),
            "feasible": verdict[k],
            "reasons": list(found.reasons(k)),
            "degree": plain(degree[k]),
        }
        for k, name in enumerate(ids)
    ]


def certificate_record(proof: Certificate | None) -> dict[str, Any] | None:
    """phi_min and what forces it; None where there is no certificate."""
    if proof is None:
        return None
    return {
        "feasible": proof.feasible and proof.with_conditions,
        "with_conditions": proof.with_conditions,
        "phi_min": plain(proof.phi_min),
        "phi_strict": plain(proof.phi_strict),
        "exact": proof.exact,
        "conflict": list(proof.conflict),
        "forcing": list(proof.forcing),
        "phi_min_without": noticeable(proof),
        "relaxed": list(proof.relaxed_active),
        "seconds": proof.seconds,
    }


def noticeable(proof: Certificate) -> dict[str, float]:
    """Conditions whose release lowers phi_min noticeably, and to what; those of most effect
    first."""
    limit = proof.phi_min * (1 - NOTICEABLE)
    lower = {name: value for name, value in proof.released.items() if value < limit}
    return dict(sorted(lower.items(), key=lambda item: item[1]))


def atlas_record(atlas: Atlas, problem: Problem) -> dict[str, Any]:
    """Ranges of all parameters."""
    rows = zip(
        atlas.names, atlas.units, atlas.low.tolist(), atlas.high.tolist(),
        atlas.bounds_low.tolist(), atlas.bounds_high.tolist(), atlas.narrowed.tolist(),
        atlas.status, strict=True,
    )  # fmt: skip
    return {
        "schema": ATLAS_SCHEMA,
        **problem_record(problem),
        "kind": atlas.kind,
        "radius": plain(atlas.radius),
        "parameters": [
            {
                "name": name,
                "unit": unit,
                "low": plain(low),
                "high": plain(high),
                "bounds": [plain(below), plain(above)],
                "share_of_bounds": plain(share),
                "status": list(status),
            }
            for name, unit, low, high, below, above, share, status in rows
        ],
    }
