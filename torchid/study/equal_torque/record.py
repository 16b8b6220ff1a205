"""Comparisons of internal wrenches as JSON-ready data (schema torchid.wrenches/1)."""

from dataclasses import asdict
from typing import Any

import torch

from torchid.json_data import plain
from torchid.study.equal_torque.given_sets import GivenSets
from torchid.study.equal_torque.study import EqualTorqueStudy

SCHEMA = "torchid.wrenches/1"


def study_record(study: EqualTorqueStudy) -> dict[str, Any]:
    """A study of sets with equal torque; numbers that are not known are null."""
    setting = study.setting
    data = {
        "schema": SCHEMA,
        "mode": "equal_torque",
        "robot": setting.robot.name,
        "seed": study.seed,
        "geometry": setting.geometry,
        "outer": setting.outer.name,
        "total_mass": setting.conditions.total_mass,
        "reference": {
            "origin": setting.origin,
            "mass": setting.reference.parameters.mass[0],
            "torque_change_rms": setting.torque_change,
            "force_rms": study.errors.reference_force_rms,
            "force_rms_to_nominal": study.reference_to_nominal,
        },
        "instants": study.motion.q.shape[0],
        "torque_relative_max": float(study.torque_relative.max()),
        "static_share": study.static_share,
        "kinds": [_kind(study, kind) for kind in study.kinds],
        "comparison": asdict(study.comparison),
        "comparison_to_nominal": None if study.to_nominal is None else asdict(study.to_nominal),
        **asdict(study.statistics),
        "other_truths": [asdict(t) for t in study.truths],
        "firm_truths": [asdict(t) for t in study.firm_truths],
        "reach": [vars(r) for r in study.reach],
        "variants": [{**vars(v), "reach": [vars(r) for r in v.reach]} for v in study.variants],
        "warnings": study.warnings,
        "sets": _sets(study),
    }
    return dict(plain(data))


def given_record(found: GivenSets, source: list[str]) -> dict[str, Any]:
    """A comparison of given sets with a reference.

    Args:
        found: what was found.
        source: files of the sets.
    """
    data = {
        "schema": SCHEMA,
        "mode": "sets",
        "robot": found.robot.name,
        "source": source,
        "reference": {
            "id": found.reference.ids[0],
            "force_rms": found.errors.reference_force_rms,
            "moment_rms": found.errors.reference_moment_rms,
        },
        "instants": found.motion.q.shape[0],
        "torque_relative_max": float(found.torque_relative.max()),
        "comparison": asdict(found.comparison),
        "sets": _sets(found),
    }
    return dict(plain(data))


def _kind(study: EqualTorqueStudy, kind: str) -> dict[str, Any]:
    rows = study.rows(kind)

    def three(x: torch.Tensor) -> torch.Tensor:
        return torch.quantile(x[rows], x.new_tensor([0.25, 0.5, 0.75]), dim=0).movedim(0, -1)

    return {
        "kind": kind,
        "sets": len(rows),
        "largest_force_rms": three(study.worst),
        "force_rms": three(study.errors.force_rms),
        "moment_rms": three(study.errors.moment_rms),
        "degree": [study.degree[rows].min(), study.degree[rows].max()],
    }


def _sets(found: EqualTorqueStudy | GivenSets) -> list[dict[str, Any]]:
    kinds: list[dict[str, Any]]
    if isinstance(found, EqualTorqueStudy):
        ids, degree = found.family.sets.ids, found.degree
        kinds = [{"kind": kind} for kind in found.family.kind]
    else:
        ids, degree = found.sets.ids, found.checked.degree
        kinds = [{} for _ in ids]
    errors = {
        name: getattr(found.errors, name)
        for name in ("force_rms", "force_max", "force_norm_rms", "moment_rms")
    }
    errors |= {"torque_relative": found.torque_relative, "carried_mass_difference": found.carried}
    return [
        {
            "id": name,
            **kinds[k],
            "feasible": bool(found.checked.feasible[k]),
            "reasons": found.checked.reasons(k),
            "degree": degree[k],
            **{key: values[k] for key, values in errors.items()},
        }
        for k, name in enumerate(ids)
    ]
