"""An identification as plain data: the schema torchid.identification/1 (design: README, Contracts).

Joints are 1-based, numbers are plain floats, and what is not a number (an infinite relative
standard deviation, say) is null.
"""

from typing import Any

from torchid.effects.base import Effect
from torchid.effects.registry import COLUMN_KINDS
from torchid.identification.identify import Identification
from torchid.identification.validation import Errors
from torchid.json_data import plain
from torchid.robot.library import named_record
from torchid.robot.record import robot_record

SCHEMA = "torchid.identification/1"


def record(result: Identification) -> dict[str, Any]:
    """The result as JSON-ready data."""
    settings = result.settings
    return {
        "schema": SCHEMA,
        **named_record(result.robot),
        "n_base": result.base.n_rigid,
        "parameters": [_parameter(result, k) for k in range(result.base.n_rigid)],
        "effects": _effects(result),
        "combined": _combined(result),
        "condition_number": plain(result.condition_number),
        "scaled_condition_number": plain(result.scaled_condition_number),
        "cutoff_hz": result.cutoff,
        "cutoff_choice": _choice(result),
        "reversal_speed": result.reversal.tolist(),
        "fit": _errors(result.fit),
        "held_out": None if result.held_out is None else _errors(result.held_out),
        "bounded": list(result.bounded),
        "wrong_sign": list(result.wrong_sign),
        "undetermined": list(result.undetermined),
        "dropped": list(result.dropped),
        "absorbed": result.base.absorbed_effects(),
        "rank_gap": list(result.base.rank_gap),
        "grouping": {
            "parameters": list(result.base.parameter_names),
            "matrix": result.base.grouping.tolist(),
        },
        "base_names": list(result.base.names),
        "base_values": result.values.tolist(),
        "covariance": result.covariance.tolist(),
        "factor": result.factor.tolist(),
        "rows": {
            "seconds": result.rows.seconds,
            "per_second": result.rows.per_second,
            "whitening": result.rows.whitening.tolist(),
        },
        "statistics": {
            "method": "leverage-corrected block jackknife",
            "blocks": result.uncertainty.blocks,
            "block_seconds": result.uncertainty.block_seconds,
            "correlation_seconds": result.uncertainty.correlation_seconds,
            "quantile95": result.uncertainty.quantile(0.95),
        },
        "settings": {
            "effects": list(settings.effects),
            "cutoff": settings.cutoff,
            "reversal": settings.reversal,
            "rows": settings.rows,
            "method": settings.method,
            "covariance": settings.covariance,
            "signs": settings.signs,
            "essential": settings.essential,
            "held_out_fraction": settings.held_out_fraction,
            "error_cutoff_hz": settings.error_cutoff,
            "compiled": settings.compiled,
        },
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
    position = _positions(result)
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
            entry["places"] = [_place(e) for e in members]
    return list(found.values())


def _place(effect: Effect) -> dict[str, Any]:
    """An effect without its coefficients, as `effect_from_record` takes it."""
    names = [c.name for c in effect.coefficients]
    record = effect.record([0.0] * len(names))
    return {k: v for k, v in record.items() if k != "effect" and k not in names}


def _combined(result: Identification) -> list[dict[str, Any]]:
    """Base parameters led by an effect's coefficient that are sums with others."""
    base = result.base
    led = range(base.n_rigid, len(base))
    return [_parameter(result, b) for b in led if not base.is_single(b)]


def _positions(result: Identification) -> dict[int, int]:
    """Base parameter led by each independent parameter."""
    return {k: b for b, k in enumerate(result.base.independent)}


def _errors(e: Errors) -> dict[str, Any]:
    return {
        "trajectories": list(e.trajectories),
        "rmse": plain(e.rmse),
        "relative_error_percent": plain(e.relative_percent),
        "relative_error_percent_moving": plain(e.relative_percent_moving),
        "relative_error_percent_raw": plain(e.relative_percent_raw),
        "standstill_fraction": plain(e.standstill_fraction),
        "standstill_error_share": plain(e.standstill_error_share),
    }


def _choice(result: Identification) -> dict[str, Any] | None:
    if result.cutoff_choice is None:
        return None
    return {
        "candidates_hz": list(result.cutoff_choice.candidates),
        "cross_validated_error_percent": plain(result.cutoff_choice.scores),
    }
