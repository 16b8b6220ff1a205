"""A diagnosis as plain data: the schema torchid.gap/1 (design: README, Contracts).

Joints and links are 1-based, numbers are plain floats, and what is not a number is null. The
contract's keys are always there; the others say more about the same thing.
"""

from collections.abc import Iterable
from typing import Any

from torchid.effects.base import PLACES, Coefficient
from torchid.gap.diagnosis import (
    Diagnosis,
    Finding,
    Parametric,
    RegimeGap,
)
from torchid.json_data import plain
from torchid.robot.model import JointType, Robot
from torchid.robot.record import robot_record

SCHEMA = "torchid.gap/1"

INERTIA_MEANING = "The link's mass, centre of mass or inertia differs from the model's."
INERTIA_REMEDY = (
    "Replace the link's inertial parameters, or all of them by those `torchid identify` finds."
)


def record(diagnosis: Diagnosis) -> dict[str, Any]:
    """The diagnosis as JSON-ready data."""
    which = [finding_record(f, diagnosis.robot) for f in diagnosis.findings]
    which += [_link_inertia(p) for p in diagnosis.parametric if p.links]
    return plain(
        {
            "schema": SCHEMA,
            "robot": diagnosis.robot.name,
            "status": diagnosis.status,
            "where": {
                "joints": [
                    {
                        "joint": gap.joint + 1,
                        "gap_rms": gap.gap_rms,
                        "noise_floor_rms": gap.noise_floor_rms,
                        "share": gap.share,
                    }
                    for gap in diagnosis.joints
                ],
                "regimes": [_regime(gap) for gap in diagnosis.regimes],
            },
            "which": which,
            "parametric": [
                {
                    "links": [link + 1 for link in p.links],
                    "all_base_parameters": not p.links,
                    "share": p.share,
                    "p_value": p.p_value,
                    "how_sure": p.how_sure,
                    "ambiguous_with": p.ambiguous_with,
                }
                for p in diagnosis.parametric
            ],
            "how_far": _how_far(diagnosis),
            "budget": {
                "parametric": diagnosis.budget.parametric,
                "structural": diagnosis.budget.structural,
                "unexplained": diagnosis.budget.unexplained,
            },
            "not_testable": [
                {
                    "effect": x.effect,
                    "joint": x.joints[0] + 1 if x.joints else None,
                    "joints": [j + 1 for j in x.joints],
                    "smallest_detectable": x.smallest_detectable,
                    "unit": x.unit,
                    "reason": x.reason,
                }
                for x in diagnosis.not_testable
            ],
            "next_experiment": diagnosis.next_experiment,
            "noise_floor": {
                "source": diagnosis.floor.source,
                "low": diagnosis.floor.low,
                "high": diagnosis.floor.high,
                "notes": diagnosis.floor.notes,
            },
            "trajectories": [t.name for t in diagnosis.traces],
            "band_hz": diagnosis.band,
            "cutoff_hz": diagnosis.cutoff,
            "settings": diagnosis.settings,
            "warnings": diagnosis.warnings,
            "model": robot_record(diagnosis.robot),
            "corrected": robot_record(diagnosis.corrected),
        }
    )


def unit_of(unit: str, joints: Iterable[int], robot: Robot) -> str:
    """A coefficient's unit on these joints: that of revolute ones unless all are prismatic."""
    kinds = {robot.joint_types[j] for j in joints}
    return Coefficient("", unit, False, "").unit_for(kinds == {JointType.PRISMATIC})


def finding_record(finding: Finding, robot: Robot) -> dict[str, Any]:
    """An accepted effect; `parameters` holds coefficients, and shape parameters and places too."""
    effect = finding.effect
    written = effect.record(finding.values)
    # Coefficients, shapes and places of the effect; private keys are the program's own.
    own = {
        k: v for k, v in written.items() if k not in ("effect", "joint", "joints") and k[0] != "_"
    }
    located = finding.located or finding.joints
    # A unit follows the joints that the effect is at.
    units = {c.name: unit_of(c.unit, located, robot) for c in effect.coefficients}
    units |= {s.name: unit_of(s.unit, located, robot) for s in effect.shapes}
    return {
        "effect": effect.name,
        "family": effect.family,
        "joints": [j + 1 for j in finding.joints],
        "common": finding.common,
        "ambiguous_with": finding.ambiguous_with,
        "parameters": own,
        "p_value": finding.p_value,
        "how_sure": finding.how_sure,
        "std": dict(zip((c.name for c in effect.coefficients), finding.std, strict=True)),
        "unit": units,
        "shape": [name for name in own if name in {s.name for s in effect.shapes}],
        "places": [name for name in own if name in PLACES],
        "share": finding.share,
        "first": finding.first,
        "meaning": effect.meaning,
        "remedy": effect.remedy,
        "source": effect.source,
        "notes": finding.notes,
        "planted": None
        if finding.planted is None
        else vars(finding.planted) | {"smallest": finding.planted.smallest},
    }


def _link_inertia(p: Parametric) -> dict[str, Any]:
    """Changed inertial parameters as an entry of `which`; a link has the number of its joint."""
    links = [link + 1 for link in p.links]
    return {
        "effect": "link_inertia",
        "family": "inertia",
        "joints": links,
        "ambiguous_with": p.ambiguous_with,
        "parameters": {"links": links},
        "p_value": p.p_value,
        "how_sure": p.how_sure,
        "std": {},
        "unit": {},
        "shape": [],
        "places": [],
        "share": p.share,
        "first": None,
        "meaning": INERTIA_MEANING,
        "remedy": INERTIA_REMEDY,
        "source": None,
        "notes": [],
    }


def _regime(gap: RegimeGap) -> dict[str, Any]:
    return {
        "joint": gap.joint + 1,
        "regime": gap.regime,
        "excess": gap.excess,
        "ci95": gap.ci95,
        "p": gap.p,
        "times": [{"trajectory": n, "from_s": a, "to_s": b} for n, a, b in gap.times],
    }


def _how_far(diagnosis: Diagnosis) -> dict[str, Any]:
    """RMS over all joints as root of the sum of the joints' mean squares."""
    far, floor = diagnosis.how_far, diagnosis.floor
    joints = zip(far.rms_before.tolist(), far.rms_after.tolist(), strict=True)
    return {
        "rms_before": float(far.rms_before.norm()),
        "rms_after": float(far.rms_after.norm()),
        "noise_floor_rms": [float(floor.low.norm()), float(floor.high.norm())],
        "closed": far.closed,
        "closed_ci95": far.closed_ci95,
        "per_joint": [
            {
                "joint": j + 1,
                "before": before,
                "after": after,
                "noise_floor_rms": [float(floor.low[j]), float(floor.high[j])],
            }
            for j, (before, after) in enumerate(joints)
        ],
        "rollout": far.rollout,
    }
