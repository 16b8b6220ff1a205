"""Comparisons of internal wrenches as JSON-ready data (schema torchid.wrenches/1)."""

import math
from dataclasses import asdict
from typing import Any

import torch

from torchid.study.equal_torque.force_reach import ForceReach
from torchid.study.equal_torque.given_sets import GivenSets
from torchid.study.equal_torque.study import EqualTorqueStudy

SCHEMA = "torchid.wrenches/1"


def study_record(study: EqualTorqueStudy, *, with_sets: bool = True) -> dict[str, Any]:
    """A study of sets with equal torque; numbers that are not known are null.

    Args:
        study: what was found.
        with_sets: whether every set has its entry (id, kind, reasons, degree, errors per joint).
    """
    setting = study.setting
    low, high = setting.conditions.total_mass.tolist()
    data = {
        "schema": SCHEMA,
        "mode": "equal_torque",
        "robot": setting.robot.name,
        "seed": study.seed,
        "geometry": setting.geometry,
        "outer": setting.outer.name,
        "total_mass": [low, high],
        "reference": {
            "origin": setting.origin,
            "mass": setting.reference.parameters.mass[0].tolist(),
            "torque_change_rms": setting.torque_change.tolist(),
            "force_rms": study.errors.reference_force_rms.tolist(),
            "force_rms_to_nominal": study.reference_to_nominal,
        },
        "instants": study.motion.q.shape[0],
        "torque_relative_max": float(study.torque_relative.max()),
        "static_share": list(study.static_share),
        "kinds": [_kind(study, kind) for kind in study.kinds],
        "comparison": asdict(study.comparison),
        "comparison_to_nominal": None if study.to_nominal is None else asdict(study.to_nominal),
        **asdict(study.statistics),
        "other_truths": [asdict(t) for t in study.truths],
        "firm_truths": [asdict(t) for t in study.firm_truths],
        "reach": [_reach(r) for r in study.reach],
        "variants": [{**vars(v), "reach": [_reach(r) for r in v.reach]} for v in study.variants],
        "warnings": list(study.warnings),
    }
    if with_sets:
        data["sets"] = _sets(study)
    return dict(_plain(data))


def given_record(found: GivenSets, source: list[str]) -> dict[str, Any]:
    """A comparison of given sets with a reference.

    Args:
        found: what was found.
        source: files of the sets.
    """
    return dict(
        _plain(
            {
                "schema": SCHEMA,
                "mode": "sets",
                "robot": found.robot.name,
                "source": source,
                "reference": {
                    "id": found.reference.ids[0],
                    "force_rms": found.errors.reference_force_rms.tolist(),
                    "moment_rms": found.errors.reference_moment_rms.tolist(),
                },
                "instants": found.motion.q.shape[0],
                "torque_relative_max": float(found.torque_relative.max()),
                "comparison": asdict(found.comparison),
                "sets": _sets(found),
            }
        )
    )


def _kind(study: EqualTorqueStudy, kind: str) -> dict[str, Any]:
    rows = study.rows(kind)

    def three(x: torch.Tensor) -> Any:
        found = torch.quantile(x[rows], x.new_tensor([0.25, 0.5, 0.75]), dim=0)
        return found.movedim(0, -1).tolist()

    return {
        "kind": kind,
        "sets": len(rows),
        "largest_force_rms": three(study.worst),
        "force_rms": three(study.errors.force_rms),
        "moment_rms": three(study.errors.moment_rms),
        "degree": [
            float(study.degree[rows].min()),
            float(study.degree[rows].max()),
        ],
    }


def _sets(found: EqualTorqueStudy | GivenSets) -> list[dict[str, Any]]:
    drawn = isinstance(found, EqualTorqueStudy)
    ids = found.family.sets.ids if isinstance(found, EqualTorqueStudy) else found.sets.ids
    degree = found.degree if isinstance(found, EqualTorqueStudy) else found.checked.degree
    kinds = found.family.kind if isinstance(found, EqualTorqueStudy) else ("",) * len(ids)
    return [
        {
            "id": name,
            **({"kind": kinds[k]} if drawn else {}),
            "feasible": bool(found.checked.feasible[k]),
            "reasons": list(found.checked.reasons(k)),
            "degree": float(degree[k]),
            "force_rms": found.errors.force_rms[k].tolist(),
            "force_max": found.errors.force_max[k].tolist(),
            "force_norm_rms": found.errors.force_norm_rms[k].tolist(),
            "moment_rms": found.errors.moment_rms[k].tolist(),
            "torque_relative": found.torque_relative[k].tolist(),
            "carried_mass_difference": found.carried[k].tolist(),
        }
        for k, name in enumerate(ids)
    ]


def _reach(reach: ForceReach) -> dict[str, Any]:
    return {
        "kind": reach.kind,
        "reached": reach.reached.tolist(),
        "bound": reach.bound.tolist(),
    }


def _plain(value: Any) -> Any:
    """Tuples as lists, numbers that are not finite as None."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
