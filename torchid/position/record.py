"""A diagnosis of commands and positions as JSON."""

from typing import Any

from torchid.json_data import plain
from torchid.position.diagnosis import Accuracy, PositionDiagnosis, PositionFinding

SCHEMA = "torchid.position_gap/1"


def record(result: PositionDiagnosis) -> dict[str, Any]:
    """The diagnosis as JSON-ready data: errors in mrad of the log's unit, joints from 1."""
    low, high = result.gains[1].unbind(-1)
    joints = [
        {
            "joint": j + 1,
            "commanded_mrad": commanded,
            "plain_mrad": before,
            "answered_mrad": after,
            "kp": k,
            "kp_ci95": [a, b],
            "ratio_only": ratio,
            "never_moves": still,
        }
        for j, (commanded, before, after, k, a, b, ratio, still) in enumerate(
            zip(
                *(
                    x.tolist()
                    for x in (
                        result.commanded.whole, result.plain.whole, result.answered.whole,
                        result.gains[0], low, high, result.ratio_only, result.still,
                    )
                ),
                strict=True,
            )
        )
    ]  # fmt: skip
    regimes = [
        {"joint": j + 1, "regime": name, "plain_mrad": before, "answered_mrad": after}
        for name, both in result.regimes.items()
        for j, (before, after) in enumerate(zip(*(x.tolist() for x in both), strict=True))
    ]
    return plain(
        {
            "schema": SCHEMA,
            "robot": result.data.robot.name,
            "motions": len(result.motions[0]),
            "status": "explained" if result.findings else "no_gap",
            "where": {"joints": joints, "regimes": regimes},
            "which": [_finding(f) for f in result.findings],
            "how_far": {
                "commanded": _accuracy(result.commanded),
                "plain": _accuracy(result.plain),
                "answered": _accuracy(result.answered),
                "per_motion": [
                    {"motion": name, "answered_mrad": row}
                    for name, row in zip(result.motions[0], result.motions[1].tolist(), strict=True)
                ],
            },
            "servos": result.servos.record(),
            "log_scale": result.data.scale,
            "warnings": result.warnings,
            "seconds": result.seconds,
        }
    )


def _accuracy(way: Accuracy) -> dict[str, Any]:
    return {
        "whole_mrad": float(way.whole.mean()),
        "windows_2s_mrad": float(way.windows.mean()),
        "whole_per_joint": way.whole,
        "windows_per_joint": way.windows,
    }


def _finding(found: PositionFinding) -> dict[str, Any]:
    return {
        "effect": found.effect,
        "family": found.family,
        "joints": [] if found.joint is None else [found.joint],
        "ambiguous_with": found.ambiguous_with,
        "parameters": {s.name: s.value for s in found.sizes},
        "ci95": {s.name: s.interval for s in found.sizes},
        "error_without_mrad": found.error_without,
        "error_with_mrad": found.error_with,
        "meaning": found.meaning,
        "remedy": found.remedy,
    }
