"""A study of the report as a page."""

import math
from collections import Counter

from torchid.extraction.convex.certificate import Certificate
from torchid.report.page.document import Page, Picture, Section
from torchid.report.page.origin import Origin
from torchid.report.study.drawing import Section as StudySection
from torchid.report.study.facts import (
    by_feasibility,
    count,
    ids,
    listed,
    number,
    torque_errors,
)
from torchid.report.study.figures import Drawing, drawings
from torchid.report.study.tables import all_sheets
from torchid.report.study.verdict import verdict as sentences
from torchid.report.study.wrench_tables import reason_error_sheet
from torchid.study.result import Study

_ORDER: tuple[StudySection, ...] = (
    "classification", "extraction", "wrenches", "validation", "payload", "identification",
)  # fmt: skip
"""Of the pictures: what the verdict is about comes first."""
_MOST_NAMED = 4


def study_page(study: Study, origin: Origin) -> Page:
    """The page of a study."""
    shown = sorted(drawings(study), key=lambda d: _ORDER.index(d.section))
    sheets = [*all_sheets(study), reason_error_sheet(study)]
    said = tuple(s for s in sentences(study) if not s.startswith("Noticed:"))
    return Page(
        title=f"{study.settings.title} (section {study.settings.section})",
        verdict=verdict(study),
        facts=_facts(study),
        sections=(
            Section("pictures", "Pictures", pictures=tuple(map(_picture, shown))),
            Section("findings", "Findings", notes=said),
            Section("numbers", "Numbers", sheets=tuple(s for s in sheets if s)),
            Section("remarks", "To bear in mind", notes=study.warnings),
        ),
        origin=origin,
    )


def verdict(study: Study) -> str:
    """One sentence: whether the sets with the identified torque are feasible, and why not."""
    good, bad = by_feasibility(study, True), by_feasibility(study, False)
    total = len(study.scenarios)
    if not bad:
        said = f"Feasible: all {count(total, 'best set')}"
    elif not good:
        said = f"Not feasible: none of the {count(total, 'best set')}, which {_failing(study)}"
    else:
        said = (
            f"Feasible in part: {len(good)} of {count(total, 'best set')} "
            f"({listed(ids(good))}), while the others {_failing(study)}"
        )
    return "; ".join([said, *_proofs(study)]) + "."


def _failing(study: Study) -> str:
    """What the best sets that are not feasible violate, the most frequent first."""
    often = Counter(r for s in by_feasibility(study, False) for r in s.reasons).most_common()
    names = [name for name, _ in often[:_MOST_NAMED]]
    if len(often) > _MOST_NAMED:
        names.append(f"{len(often) - _MOST_NAMED} more")
    return f"violate {listed(names)}" if names else "violate their conditions"


def _proofs(study: Study) -> list[str]:
    """What is proven to be possible, groups of bounds of which the same holds together."""
    same: dict[str, list[str]] = {}
    for bounds, c in study.certificates.items():
        if text := _proof(c):
            same.setdefault(text, []).append(bounds)
    return [f"within the bounds {listed(bounds)} {text}" for text, bounds in same.items()]


def _proof(c: Certificate) -> str:
    if math.isnan(c.phi_min):
        return ""
    if math.isinf(c.phi_min):
        return "there is no physical set at all"
    if c.exact and c.with_conditions:
        return "feasible sets with exactly the identified coefficients exist"
    if c.phi_min > 0:
        whose = "feasible" if c.with_conditions else "physical"
        forced = f", forced by {listed(c.forcing)}" if c.forcing else ""
        return f"no {whose} set has exactly the identified coefficients{forced}"
    return ""


def _facts(study: Study) -> tuple[tuple[str, str], ...]:
    error, real = torque_errors(study.sets_motion)
    runs = sum(len(s.extraction.sets) for s in study.scenarios)
    feasible = sum(int(s.feasibility.feasible.sum()) for s in study.scenarios)
    good = len(by_feasibility(study, True))
    worst = float((study.identification.values - study.truth).abs().max())
    return (
        ("Best sets feasible", f"{good} of {len(study.scenarios)}"),
        ("Runs feasible", f"{feasible} of {runs}"),
        ("Largest error of a coefficient", number(worst, 2)),
        ("Largest torque error of a set", f"{number(100 * float((error / real).max()), 2)} %"),
    )


def _picture(d: Drawing) -> Picture:
    name = d.name.replace("_", " ")
    return Picture(d.name, d.caption.replace("*", ""), f"Figure: {name}.", d.draw)
