"""An examination in a sentence or two."""

from torchid.doctor.check import Check, joint_list
from torchid.doctor.examine import Examination

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
    return tuple(_untold(check) for check in _hidden(examination))


def _hidden(examination: Examination) -> list[Check]:
    return [c for c in examination.checks if c.verdict == "cannot tell" and c.name not in _MINOR]


def _untold(check: Check) -> str:
    kind = check.name.removeprefix("unseen ")
    return f"{kind} of {joint_list(check.joints)}" if kind != check.name else kind
