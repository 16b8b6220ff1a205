"""The scores of a set of answers, once its keys are open (gap.md, section 3, of the design).

Shares come with their Wilson 95 % intervals, F1 and medians with bootstrap intervals over cases. A
log that has no diagnosis counts as one of which nothing is said, and in false alarms not at all.
"""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from torchid import __version__
from torchid.errors import TorchidError
from torchid.json_data import picked, plain
from torchid_bench.withheld.case_set import CaseSet
from torchid_bench.withheld.measures import (
    coefficient_coverage,
    how_named,
    joint_counts,
    matching_counts,
    micro_f1,
    poor_verdict,
    rate,
    reliability,
    stated_probabilities,
    verdict,
)
from torchid_bench.withheld.rows import Row, named_record, row_of
from torchid_bench.withheld.run import ERROR, UNANSWERED


@dataclass(frozen=True)
class Scored:
    """A case with its key and an answer.

    Attributes:
        case, kind: name and kind.
        colour_hz: cut-off of coloured torque noise [Hz]; None for white.
        grows: by how much it is larger at speed than at rest, as a share.
        level: size that was asked for, in standard deviations of the noise; None without one.
        row: what was planted and said.
        closed: closed share of the closable gap; 0 where none was claimed.
        seconds: that the diagnosis took.
    """

    case: str
    kind: str
    colour_hz: float | None
    grows: float
    level: float | None
    row: Row
    closed: float
    seconds: float | None

    @property
    def cause(self) -> str:
        """Names of what was planted."""
        return " + ".join(p.name for p in self.row.planted)


def scored_case(key: Mapping[str, Any], answer: Mapping[str, Any]) -> Scored:
    """A case from its key and answer, as they are in files."""
    far = answer.get("how_far") or {}
    return Scored(
        case=key["id"],
        kind=key["kind"],
        colour_hz=key.get("colour_hz"),
        grows=float(key.get("noise_grows", 0.0)),
        level=key.get("level"),
        row=row_of(key, answer),
        closed=float(far.get("closed") or 0.0),
        seconds=answer.get("seconds"),
    )


def scores(cases: Sequence[Scored]) -> dict[str, Any]:
    """All scores of one method's answers."""
    kinds = _by(cases, lambda c: c.kind)
    single, several, severity = (kinds.get(k, []) for k in ("single", "several", "severity"))
    quiet = [c for c in kinds.get("none", []) if c.row.status not in UNANSWERED]
    only_parameters, outside = kinds.get("parameters", []), kinds.get("outside", [])
    # Of logs with one effect: its name, in all and by effect.
    out = _naming(single)
    groups = _by(single, lambda c: c.row.planted[0].name)
    out["by_effect"] = {name: _naming(groups[name]) for name in sorted(groups)}
    out |= {noise: _naming(some) for noise, some in _by_noise(single).items()}
    # 2.5: size of an effect, in standard deviations of the noise, from which it should be named:
    # half of what is asked for. Some arms cannot have more of one: a spring softer than the
    # controller bears.
    return {
        # Of logs without any effect: whether anything is said to be there.
        "false_alarms": {
            noise: rate(c.row.alarm for c in some)
            for noise, some in {"all": quiet, **_by_noise(quiet)}.items()
        },
        # Of logs where only inertial parameters are wrong.
        "parameters": {
            "structural": rate(any(c.structural for c in s.row.claims) for s in only_parameters),
            "found": rate(s.row.alarm for s in only_parameters),
            "parametric_only": rate(s.row.status == "parametric_only" for s in only_parameters),
        },
        "single": out,
        "single_clear": _naming([c for c in single if c.row.planted[0].size >= 2.5]),
        # Of one effect of any size: whether a wrong family is named for sure.
        "wrong_for_sure": rate(
            verdict(c.row, every=False) == "confident_wrong" for c in single + severity
        ),
        "how_sure": reliability([pair for c in cases for pair in stated_probabilities(c.row)]),
        "joints": micro_f1([joint_counts(c.row) for c in single + several]),
        "several": _several(several),
        "outside": _outside(outside),
        "poor": _poor(kinds.get("poor", [])),
        # Whether 95 % intervals hold the true coefficients.
        "coverage": rate(flag for c in single + severity for flag in coefficient_coverage(c.row)),
        "status": {k: dict(Counter(c.row.status for c in some)) for k, some in kinds.items()},
        # Of all logs, which are good ones: what came of the question.
        "outcomes": {
            name: rate(outcome(c.row) == name for c in cases)
            for name in ("named", "silent", *UNANSWERED)
        },
        "errors": [c.case for c in cases if c.row.status == ERROR],
        "seconds": {
            name: float(of([c.seconds for c in cases if c.seconds is not None] or [0.0]))
            for name, of in (("median", np.median), ("worst", np.max))
        },
    }


def outcome(row: Row) -> str:
    """What came of the question: why there is no answer, or whether the answer names a cause."""
    return row.status if row.status in UNANSWERED else "named" if row.claims else "silent"


def _naming(cases: Sequence[Scored]) -> dict[str, Any]:
    names = [how_named(c.row) for c in cases]
    sizes = [n.set_size for n in names if n.set_size is not None]
    return {
        "detected": rate(c.row.alarm for c in cases),
        **{
            name: rate(getattr(n, name) for n in names)
            for name in ("top1", "in_set", "anywhere", "family", "branch", "exact")
        },
        "set_size": sum(sizes) / len(sizes) if sizes else None,
    }


def _several(cases: Sequence[Scored]) -> dict[str, Any]:
    """F1 of (effect, joint) on logs with two or three effects, alternatives counting or not."""
    out: dict[str, Any] = {}
    groups = {
        "all": cases,
        "pairs": [c for c in cases if len(c.row.planted) == 2],
        "triples": [c for c in cases if len(c.row.planted) == 3],
    }
    for name, some in groups.items():
        out[name] = {
            "with_sets": micro_f1([matching_counts(c.row, strict=False) for c in some]),
            "strict": micro_f1([matching_counts(c.row, strict=True) for c in some]),
        }
    return out


def _outside(cases: Sequence[Scored]) -> dict[str, Any]:
    """How often a wrong family is named for sure of logs with a cause that the library lacks."""
    said: Counter[str] = Counter()
    by_cause: dict[str, Counter[str]] = defaultdict(Counter)
    for case in cases:
        judged = verdict(case.row, every=True)
        said[judged] += 1
        by_cause[case.cause][judged] += 1
    return {
        "confident_wrong": rate(v == "confident_wrong" for v in said.elements()),
        "verdicts": dict(said),
        "by_cause": {name: dict(by_cause[name]) for name in sorted(by_cause)},
    }


def _poor(cases: Sequence[Scored]) -> dict[str, Any]:
    """How often the answer says so of logs that excite too little."""
    said = [poor_verdict(c.row) for c in cases]
    return {
        "honest": rate(v in ("not_testable", "hedged", "right") for v in said),
        "not_testable_or_hedged": rate(v in ("not_testable", "hedged") for v in said),
        "verdicts": dict(Counter(said)),
    }


def _by_noise(cases: Iterable[Scored]) -> dict[str, list[Scored]]:
    def noise(c: Scored) -> str:
        if c.grows:
            return "growing"
        return "white" if c.colour_hz is None else "coloured"

    groups = _by(cases, noise)
    return {noise: groups.get(noise, []) for noise in ("white", "coloured", "growing")}


def _by(cases: Iterable[Scored], key: Callable[[Scored], str]) -> dict[str, list[Scored]]:
    groups: dict[str, list[Scored]] = defaultdict(list)
    for case in cases:
        groups[key(case)].append(case)
    return dict(groups)


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
) -> dict[str, Any]:
    """Scores of a set's answers, and every case.

    Args:
        cases: the set; cases without an answer are left out, and counted.
        keys: opened, in order.
        answers: by case.
    """
    by_id = {key["id"]: key for key in keys}
    ours = [scored_case(k, answers[k["id"]]) for k in keys if k["id"] in answers]
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
            "scores": scores(ours),
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
        "right": is_right(case.kind, case.row),
        "seconds": case.seconds,
    }


def is_right(kind: str, row: Row) -> bool:
    """Whether an answer is as good as its kind of case allows: nothing more to be wished for."""
    if row.status in UNANSWERED:
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
        return not row.alarm or how_named(row).in_set
    if kind == "several":
        return matching_counts(row, strict=False)[1:] == (0, 0)
    return how_named(row).in_set and joint_counts(row)[1:] == (0, 0)
