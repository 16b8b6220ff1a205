"""Comparisons as plain data: the schema torchid.compare/1. What is not a number is null."""

from dataclasses import asdict
from typing import Any

from torchid.compare.diagnoses import GapComparison, Named, Shared
from torchid.compare.identifications import Compared, Comparison
from torchid.compare.scatter import Scatter
from torchid.compare.sets import Range, SetComparison
from torchid.compare.torque import TorqueSpread
from torchid.json_data import plain

SCHEMA = "torchid.compare/1"


def record(result: Comparison | GapComparison | SetComparison) -> dict[str, Any]:
    """Any comparison as JSON-ready data."""
    if isinstance(result, Comparison):
        own = _identifications(result)
    elif isinstance(result, GapComparison):
        own = _diagnoses(result)
    else:
        own = _sets(result)
    whole = {
        "schema": SCHEMA,
        "robot": result.robot,
        "results": result.labels,
        **own,
        "torque": None if result.torque is None else _torque(result.torque),
        "notes": result.notes,
    }
    return {**plain(whole)}


def _identifications(result: Comparison) -> dict[str, Any]:
    whole = result.whole
    return {
        "compared": "identifications",
        "counts": {
            v: len(result.having(v))
            for v in ("agree", "drift", "differ", "never_determined", "not_compared")
        },
        "parameters": [_parameter(p) for p in result.parameters],
        "correction": "Holm, family-wise 5 %",
        "birge": {
            "pooled": None if whole is None else whole.pooled,
            "pooled_expected": None if whole is None else whole.pooled_expected,
            "typical": result.birge,
        },
        "whole": None
        if whole is None
        else {
            "chi_square": whole.q,
            "degrees_of_freedom": whole.count,
            "expected": whole.expected,
            "p": whole.p,
            "birge": whole.birge,
        },
    }


def _parameter(p: Compared) -> dict[str, Any]:
    return {
        "name": p.name,
        "unit": p.unit,
        "verdict": p.verdict,
        "values": p.values,
        "std": p.std,
        "held_at_zero": p.held,
        "p_holm": p.p_holm,
        **_scatter(p.scatter),
    }


def _scatter(s: Scatter | None) -> dict[str, Any]:
    if s is None:
        return dict.fromkeys(("p", "birge", "between_std", "consensus", "consensus_std"))
    return {
        "p": s.p,
        "birge": s.birge,
        "between_std": s.between,
        "consensus": s.consensus,
        "consensus_std": s.std,
        "consensus_ci95": [s.consensus - s.quantile * s.std, s.consensus + s.quantile * s.std],
    }


def _diagnoses(result: GapComparison) -> dict[str, Any]:
    return {
        "compared": "gap diagnoses",
        "status": result.statuses,
        "closed": result.closed,
        "effects": [_shared(s) for s in result.shared],
    }


def _shared(s: Shared) -> dict[str, Any]:
    return {
        "effects": s.effects,
        "joints": s.place,
        "named_in_all": s.everywhere,
        "states": s.states,
        "named": [None if n is None else _named(n) for n in s.named],
        "smallest_detectable": s.smallest,
        "coefficients": [
            {"name": c.name, "unit": c.unit, "values": c.values, "std": c.std, "p_holm": c.p_holm,
             **_scatter(c.scatter)}
            for c in s.coefficients
        ],
    }  # fmt: skip


def _named(n: Named) -> dict[str, Any]:
    data = asdict(n)
    return {"ambiguous_with": data.pop("also"), "joints": data.pop("place"), **data}


def _sets(result: SetComparison) -> dict[str, Any]:
    return {
        "compared": "parameter sets",
        "sets": result.counts,
        "parameters": [_range(r) for r in result.physical],
        "base_parameters": [_range(r) for r in result.base],
    }


def _range(r: Range) -> dict[str, Any]:
    return {"name": r.name, "unit": r.unit, "verdict": r.verdict, "low": r.low, "high": r.high}


def _torque(t: TorqueSpread) -> dict[str, Any]:
    return {
        "on": t.source,
        "rms": t.size,
        "spread": t.spread,
        "claimed_std": t.claimed,
        "pairs": t.pairs,
        "errors": t.errors,
    }
