"""A study of the report as a page."""

import math

from torchid.extraction.convex.certificate import Certificate
from torchid.report.page.document import Page, Picture, Section
from torchid.report.page.origin import Origin
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
from torchid.study.result import Study


def study_page(study: Study, origin: Origin) -> Page:
    """The page of a study."""
    said = tuple(s for s in sentences(study) if not s.startswith("Noticed:"))
    return Page(
        title=f"{study.settings.title} (section {study.settings.section})",
        verdict=verdict(study),
        facts=_facts(study),
        sections=(
            Section("pictures", "Pictures", pictures=tuple(map(_picture, drawings(study)))),
            Section("findings", "Findings", notes=said),
            Section("numbers", "Numbers", sheets=tuple(all_sheets(study))),
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
        said = f"Not feasible: none of the {count(total, 'best set')}"
    else:
        said = f"Feasible in part: {len(good)} of {count(total, 'best set')} ({listed(ids(good))})"
    why = [text for b, c in study.certificates.items() if (text := _proof(b, c))]
    if bad and not why:
        why = [f"what fails is {listed(_reasons(study))}"]
    return "; ".join([said, *why]) + "."


def _reasons(study: Study) -> list[str]:
    """Of the best sets that are not feasible, each once."""
    return list(dict.fromkeys(r for s in by_feasibility(study, False) for r in s.reasons))


def _proof(bounds: str, c: Certificate) -> str:
    """What is proven to be possible within a group of bounds."""
    if math.isnan(c.phi_min):
        return ""
    if math.isinf(c.phi_min):
        return f"within the bounds {bounds} there is no physical set at all"
    if c.exact and c.with_conditions:
        return f"within the bounds {bounds} feasible sets have exactly the identified coefficients"
    if c.phi_min > 0:
        whose = "feasible" if c.with_conditions else "physical"
        forced = f", forced by {listed(c.forcing)}" if c.forcing else ""
        return f"within the bounds {bounds} no {whose} set has the identified coefficients{forced}"
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
