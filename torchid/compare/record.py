"""Comparisons as plain data: the schema torchid.compare/1. What is not a number is null."""

from typing import Any, get_args

from torchid.compare.diagnoses import GapComparison
from torchid.compare.identifications import Comparison, Verdict
from torchid.compare.scatter import Scatter
from torchid.compare.sets import SetComparison
from torchid.json_data import picked, plain

SCHEMA = "torchid.compare/1"
_PARAMETER = "name unit verdict values std held_at_zero=held p_holm"
_WHOLE = "chi_square=q degrees_of_freedom=count expected p birge"
_SHARED = "effects joints=place named_in_all=everywhere states"
_NAMED = "ambiguous_with=also joints=place effect family values std shapes units share"
_RANGE = "name unit verdict low high"
_TORQUE = "on=source rms=size spread claimed_std=claimed pairs errors"


def record(result: Comparison | GapComparison | SetComparison) -> dict[str, Any]:
    """Any comparison as JSON-ready data."""
    own: dict[str, Any]
    if isinstance(result, Comparison):
        together = result.whole
        own = {
            "compared": "identifications",
            "counts": {verdict: len(result.having(verdict)) for verdict in get_args(Verdict)},
            "parameters": [
                {**picked(p, _PARAMETER), **_scatter(p.scatter)} for p in result.parameters
            ],
            "correction": "Holm, family-wise 5 %",
            "birge": {
                "pooled": None if together is None else together.pooled,
                "pooled_expected": None if together is None else together.pooled_expected,
                "typical": result.birge,
            },
            "whole": None if together is None else picked(together, _WHOLE),
        }
    elif isinstance(result, GapComparison):
        effects = [
            {
                **picked(s, _SHARED),
                "named": [None if n is None else picked(n, _NAMED) for n in s.named],
                "smallest_detectable": s.smallest,
                "coefficients": [
                    {**picked(c, "name unit values std p_holm"), **_scatter(c.scatter)}
                    for c in s.coefficients
                ],
            }
            for s in result.shared
        ]
        own = {
            "compared": "gap diagnoses",
            "status": result.statuses,
            "closed": result.closed,
            "effects": effects,
        }
    else:
        own = {
            "compared": "parameter sets",
            "sets": result.counts,
            "parameters": [picked(r, _RANGE) for r in result.physical],
            "base_parameters": [picked(r, _RANGE) for r in result.base],
        }
    whole = {
        "schema": SCHEMA,
        "robot": result.robot,
        "results": result.labels,
        **own,
        "torque": None if result.torque is None else picked(result.torque, _TORQUE),
        "notes": result.notes,
    }
    return {**plain(whole)}


def _scatter(s: Scatter | None) -> dict[str, Any]:
    if s is None:
        return dict.fromkeys(("p", "birge", "between_std", "consensus", "consensus_std"))
    return {
        **picked(s, "p birge between_std=between consensus consensus_std=std"),
        "consensus_ci95": [s.consensus - s.quantile * s.std, s.consensus + s.quantile * s.std],
    }
