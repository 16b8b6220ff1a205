"""An examination in a sentence or two, and as plain data: the schema torchid.doctor/1, in which
joints are 1-based."""

from typing import Any

from torchid.doctor.check import Check, joint_list
from torchid.doctor.examine import Examination
from torchid.json_data import plain

SCHEMA = "torchid.doctor/1"
_MINOR = ("torque side", "unseen joint sign")
"""No fault is hidden where these cannot be told: a mirrored arm has the same torques."""


def conclusion(examination: Examination) -> str:
    """What is wrong, or that nothing is, and what this log cannot show."""
    said = [
        f"{word}: {', '.join(names)}"
        for word, verdict in (("wrong", "wrong"), ("to look at", "doubtful"))
        if (
            names := list(dict.fromkeys(c.name for c in examination.checks if c.verdict == verdict))
        )
    ]
    hidden = _hidden(examination)
    if not said and not hidden:
        return "Nothing speaks against this log."
    found = "; ".join(said) or "no fault found in what could be checked"
    text = f"{found[0].upper()}{found[1:]}."
    if not hidden:
        return text
    reasons = {c.evidence for c in hidden}
    reason = f" ({reasons.pop()})" if len(reasons) == 1 < len(hidden) else ""
    return f"{text} This log cannot tell: {', '.join(untold(examination))}{reason}."


def untold(examination: Examination) -> tuple[str, ...]:
    """What may hide a fault since this log cannot tell."""
    kinds = [(c.name.removeprefix("unseen "), c) for c in _hidden(examination)]
    return tuple(
        kind if kind == c.name else f"{kind} of {joint_list(c.joints)}" for kind, c in kinds
    )


def _hidden(examination: Examination) -> list[Check]:
    return [c for c in examination.checks if c.verdict == "cannot tell" and c.name not in _MINOR]


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
