"""An examination as plain data: the schema torchid.doctor/1. Joints are 1-based."""

from typing import Any

from torchid.doctor.check import Check
from torchid.doctor.conclusion import conclusion, untold
from torchid.doctor.examine import Examination
from torchid.json_data import plain

SCHEMA = "torchid.doctor/1"


def record(examination: Examination, columns: str | None = None) -> dict[str, Any]:
    """The examination as JSON-ready data.

    Args:
        examination: of a log.
        columns: what `--columns` must be to read it mended, where that can be said.
    """
    return {
        "schema": SCHEMA,
        "robot": examination.robot.name,
        "log": examination.log.source,
        "conclusion": conclusion(examination),
        "silent": examination.silent,
        "untold": list(untold(examination)),
        "checks": [_check(check, check in examination.applied) for check in examination.checks],
        "repairs": [str(repair) for repair in examination.repairs],
        "columns": columns,
    }


def _check(check: Check, applied: bool) -> dict[str, Any]:
    return {
        "name": check.name,
        "verdict": check.verdict,
        "joints": [k + 1 for k in check.joints],
        "estimate": plain(check.estimate),
        "interval": plain(check.interval),
        "unit": check.unit,
        "evidence": check.evidence,
        "fix": check.fix,
        "applicable": applied and bool(check.repairs),
        "choices": [{"name": c.name, "fix": c.fix} for c in check.choices],
        "chosen": check.chosen,
    }
