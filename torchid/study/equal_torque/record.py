"""Comparisons of internal wrenches as JSON-ready data (schema torchid.wrenches/1)."""

from dataclasses import asdict
from typing import Any

import torch

from torchid.json_data import picked, plain
from torchid.study.equal_torque.given_sets import GivenSets
from torchid.study.equal_torque.study import EqualTorqueStudy

SCHEMA = "torchid.wrenches/1"
_STUDY = (
    "robot=setting.robot.name seed geometry=setting.geometry outer=setting.outer.name "
    "total_mass=setting.conditions.total_mass"
)
_REFERENCE = (
    "torque_change_rms=setting.torque_change force_rms=errors.reference_force_rms "
    "force_rms_to_nominal=reference_to_nominal"
)
_SETS = (
    "force_rms=errors.force_rms force_max=errors.force_max force_norm_rms=errors.force_norm_rms "
    "moment_rms=errors.moment_rms torque_relative carried_mass_difference=carried"
)


def study_record(study: EqualTorqueStudy) -> dict[str, Any]:
    """A study of sets with equal torque; numbers that are not known are null."""
    data = {
        "schema": SCHEMA,
        "mode": "equal_torque",
        **picked(study, _STUDY),
        "reference": {
            "origin": study.setting.origin,
            "mass": study.setting.reference.parameters.mass[0],
            **picked(study, _REFERENCE),
        },
        **_motion(study),
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
    own = picked(found.errors, "force_rms=reference_force_rms moment_rms=reference_moment_rms")
    data = {
        "schema": SCHEMA,
        "mode": "sets",
        "robot": found.robot.name,
        "source": source,
        "reference": {"id": found.reference.ids[0], **own},
        **_motion(found),
        "comparison": asdict(found.comparison),
        "sets": _sets(found),
    }
    return dict(plain(data))


def _motion(found: EqualTorqueStudy | GivenSets) -> dict[str, Any]:
    worst = found.torque_relative.max()
    return {"instants": found.motion.q.shape[0], "torque_relative_max": worst}


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
    checked, columns = found.checked, dict[str, Any]()
    if isinstance(found, EqualTorqueStudy):
        columns |= {"id": found.family.sets.ids, "kind": found.family.kind}
        degree = found.degree
    else:
        columns["id"], degree = found.sets.ids, checked.degree
    columns |= {
        "feasible": plain(checked.feasible),
        "reasons": tuple(checked.reasons(k) for k in range(len(degree))),
        "degree": plain(degree),
        **picked(found, _SETS),
    }
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
