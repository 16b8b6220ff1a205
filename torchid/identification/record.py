"""An identification as plain data: the schema torchid.identification/1 (design: README, Contracts).

Joints are 1-based, numbers are plain floats, and what is not a number (an infinite relative
standard deviation, say) is null.
"""

from typing import Any

from torchid.effects.registry import COLUMN_KINDS
from torchid.identification.identify import Identification
from torchid.json_data import picked, plain
from torchid.robot.library import named_record
from torchid.robot.record import robot_record

SCHEMA = "torchid.identification/1"
_CHOICE = "candidates_hz=candidates cross_validated_error_percent=scores"
_ERRORS = (
    "trajectories rmse relative_error_percent=relative_percent "
    "relative_error_percent_moving=relative_percent_moving "
    "relative_error_percent_raw=relative_percent_raw standstill_fraction standstill_error_share"
)
_SETTINGS = (
    "effects cutoff reversal rows basis method covariance signs essential held_out_fraction "
    "error_cutoff_hz=error_cutoff compiled"
)


def record(result: Identification) -> dict[str, Any]:
    """The result as JSON-ready data."""
    choice, base = result.cutoff_choice, result.base
    # Base parameters led by an effect's coefficient that are sums with others.
    combined = [b for b in range(base.n_rigid, len(base)) if not base.is_single(b)]
    return {
        "schema": SCHEMA,
        **named_record(result.robot),
        "n_base": base.n_rigid,
        "basis": base.basis,
        "parameters": [_parameter(result, k) for k in range(base.n_rigid)],
        "effects": _effects(result),
        "combined": [_parameter(result, b) for b in combined],
        **picked(result, "condition_number scaled_condition_number cutoff_hz=cutoff"),
        "cutoff_choice": None if choice is None else picked(choice, _CHOICE),
        "reversal_speed": result.reversal.tolist(),
        "fit": picked(result.fit, _ERRORS),
        "held_out": None if result.held_out is None else picked(result.held_out, _ERRORS),
        **picked(result, "bounded wrong_sign undetermined dropped"),
        "absorbed": result.base.absorbed_effects(),
        "rank_gap": list(result.base.rank_gap),
        "grouping": picked(result.base, "parameters=parameter_names matrix=grouping"),
        **picked(result, "base_names=base.names base_values=values covariance factor"),
        "rows": picked(result.rows, "seconds per_second whitening"),
        "statistics": {
            "method": "leverage-corrected block jackknife",
            **picked(result.uncertainty, "blocks block_seconds correlation_seconds"),
            "quantile95": result.uncertainty.quantile(0.95),
        },
        "settings": picked(result.settings, _SETTINGS),
        "warnings": list(result.warnings),
        "model": robot_record(result.robot),
    }


def _parameter(result: Identification, k: int) -> dict[str, Any]:
    low, high = result.interval()[k].tolist()
    free = bool(result.free[k])
    return {
        "name": result.base.names[k],
        "unit": result.base.units[k],
        "value": float(result.values[k]),
        "std": float(result.std[k]) if free else None,
        "relative_std_percent": plain(result.relative_std_percent[k]) if free else None,
        "ci95": [low, high] if free else None,
        "estimated": free,
    }


def _effects(result: Identification) -> list[dict[str, Any]]:
    """One entry a kind of effect, over the joints on which a coefficient is a base parameter of its
    own; one that is part of a sum is null here, and in `combined` or `absorbed`. Effects that are
    not on every joint, or have shapes, also list their `places`: joints, from 1, and shapes."""
    # Base parameter led by each independent parameter.
    position = {k: b for b, k in enumerate(result.base.independent)}
    start = result.base.n_rigid_parameters
    found: dict[str, dict[str, Any]] = {}
    for effect in result.effects:
        entry = found.setdefault(
            effect.name,
            {
                "effect": effect.name,
                "joints": [],
                "parameters": {c.name: [] for c in effect.coefficients},
                "std": {c.name: [] for c in effect.coefficients},
            },
        )
        width = len(effect.coefficients)
        own = [position.get(start + c) for c in range(width)]
        start += width
        single = [b if b is not None and result.base.is_single(b) else None for b in own]
        if all(b is None for b in single):
            continue
        entry["joints"].append(effect.identity[1][0] + 1)
        for c, b in zip(effect.coefficients, single, strict=True):
            known = b is not None and bool(result.free[b])
            value = None if b is None else float(result.values[b])
            entry["parameters"][c.name].append(value)
            entry["std"][c.name].append(float(result.std[b]) if known else None)
    for name, entry in found.items():
        members = [e for e in result.effects if e.name == name]
        if name not in COLUMN_KINDS or len(members) < result.robot.n:
            # Effects without their coefficients, as `effect_from_record` takes them.
            left_out = {"effect", *entry["parameters"]}
            records = [e.record([0.0] * len(e.coefficients)) for e in members]
            entry["places"] = [{k: v for k, v in r.items() if k not in left_out} for r in records]
    return list(found.values())
