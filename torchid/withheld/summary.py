"""A scored set as plain data: the schema torchid.withheld.score/1."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from torchid import __version__
from torchid.errors import TorchidError
from torchid.json_data import picked, plain
from torchid.withheld.case_set import CaseSet
from torchid.withheld.measures import joint_counts, matched, named, poor_verdict, verdict
from torchid.withheld.rows import Row, named_record
from torchid.withheld.run import ERROR
from torchid.withheld.score import Scored, closed_by, scored, scores

SCHEMA = "torchid.withheld.score/1"

_KEY = ("kind", "arm", "rate_hz", "colour_hz", "repeats", "level")

Answers = Mapping[str, Mapping[str, Any]]


def require_answers(cases: CaseSet, answers: Answers, *, partial: bool) -> None:
    """Check that a score would be of the whole set, or that a part of it is enough.

    Raises:
        TorchidError: cases without an answer; if `partial`, all of them.
    """
    missing = [case for case in cases.ids if case not in answers]
    if not missing or (partial and len(missing) < len(cases.ids)):
        return
    hint = f"torchid withheld run {cases.folder}"
    if len(missing) < len(cases.ids):
        hint += "; or `partial=True`"
    raise TorchidError(
        f"{len(missing)} of {len(cases.ids)} cases have no answer yet.", got=missing[0], hint=hint
    )


def summary(
    cases: CaseSet,
    keys: Sequence[Mapping[str, Any]],
    answers: Answers,
    *,
    oracle: Answers | None = None,
    truly_closed: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """Scores of a set's answers, and every case.

    Args:
        cases: the set; cases without an answer are left out, and counted.
        keys: opened, in order.
        answers: by case.
        oracle: by case, answers of the diagnosis that was told.
        truly_closed: as `score.scores`.
    """
    by_id = {key["id"]: key for key in keys}
    ours = [scored(k, answers[k["id"]]) for k in keys if k["id"] in answers]
    closed = None if oracle is None else closed_by(oracle)
    own = [answers[c.case] for c in ours]
    return plain(
        {
            "schema": SCHEMA,
            "seed": cases.seed,
            "keys_sha256": cases.keys_sha256,
            "cases": len(ours),
            "unanswered": len(cases.ids) - len(ours),
            "made_with": cases.version,
            "scored_with": __version__,
            "answered_with": dict(Counter(str(a.get("version")) for a in own)),
            "code": dict(Counter(str(a.get("code")) for a in own)),
            "kinds": dict(Counter(c.kind for c in ours)),
            "scores": scores(ours, closed, truly_closed),
            "answers": [_listed(c, by_id[c.case]) for c in ours],
        }
    )


def _listed(case: Scored, key: Mapping[str, Any]) -> dict[str, Any]:
    """One case, for the reader who wants to know what went wrong."""
    return {
        "case": case.case,
        **{name: key.get(name) for name in _KEY},
        "planted": [picked(p, "name joints=located size") for p in case.row.planted],
        "status": case.row.status,
        "named": named_record(case.row),
        "closed": case.closed,
        "right": right(case.kind, case.row),
        "seconds": case.seconds,
    }


def right(kind: str, row: Row) -> bool:
    """Whether an answer is as good as its kind of case allows: nothing more to be wished for."""
    if row.status == ERROR:
        return False
    if kind == "none":
        return not row.alarm
    if kind == "parameters":
        return row.alarm and not any(c.structural for c in row.claims)
    if kind == "outside":
        return verdict(row, every=True) not in ("confident_wrong", "missed")
    if kind == "poor":
        return poor_verdict(row) not in ("confident_wrong", "missed")
    if kind == "severity":
        return not row.alarm or named(row).in_set
    if kind == "several":
        return matched(row, strict=False)[1:] == (0, 0)
    return named(row).in_set and joint_counts(row)[1:] == (0, 0)
