"""A study of the report as a page."""

import math
from collections import Counter

from torchid.report.page.document import Page, Picture, result_page
from torchid.report.page.origin import Origin
from torchid.report.study.drawing import Section
from torchid.report.study.facts import by_feasibility, count, ids, number, torque_errors
from torchid.report.study.report import drawings
from torchid.report.study.tables import all_tables, reason_error_table
from torchid.report.study.verdict import verdict as sentences
from torchid.report.text import listed
from torchid.study.result import Study

_ORDER: tuple[Section, ...] = (
    "classification", "extraction", "wrenches", "validation", "payload", "identification",
)  # fmt: skip
"""Of the pictures: what the verdict is about comes first."""
_MOST_NAMED = 4


def study_page(study: Study, origin: Origin) -> Page:
    """The page of a study."""
    error, real = torque_errors(study.sets_motion)
    runs = sum(len(s.extraction.sets) for s in study.scenarios)
    feasible = sum(int(s.feasibility.feasible.sum()) for s in study.scenarios)
    good = len(by_feasibility(study, True))
    worst = float((study.identification.values - study.truth).abs().max())
    shown = sorted(drawings(study), key=lambda d: _ORDER.index(d.section))
    return result_page(
        f"{study.settings.title} (section {study.settings.section})",
        verdict(study),
        (
            ("Best sets feasible", f"{good} of {len(study.scenarios)}"),
            ("Runs feasible", f"{feasible} of {runs}"),
            ("Largest error of a coefficient", number(worst, 2)),
            ("Largest torque error of a set", f"{number(100 * float((error / real).max()), 2)} %"),
        ),
        origin,
        pictures=(Picture(d.name, d.plain_caption, f"Figure: {d.words}.", d.draw) for d in shown),
        findings=[s for s in sentences(study) if not s.startswith("Noticed:")],
        tables=[*all_tables(study), reason_error_table(study)],
        notes=study.warnings,
    )


def verdict(study: Study) -> str:
    """One sentence: whether the sets with the identified torque are feasible, and why not."""
    good, bad = by_feasibility(study, True), by_feasibility(study, False)
    total = count(len(study.scenarios), "best set")
    # What the best sets that are not feasible violate, the most frequent first.
    often = Counter(r for s in bad for r in s.reasons).most_common()
    names = [name for name, _ in often[:_MOST_NAMED]]
    if len(often) > _MOST_NAMED:
        names.append(f"{len(often) - _MOST_NAMED} more")
    failing = f"violate {listed(names)}" if names else "violate their conditions"
    if not bad:
        said = f"Feasible: all {total}"
    elif not good:
        said = f"Not feasible: none of the {total}, which {failing}"
    else:
        said = (
            f"Feasible in part: {len(good)} of {total} ({listed(ids(good))}), while the others "
            f"{failing}"
        )
    # What is proven to be possible, groups of bounds of which the same holds together.
    same: dict[str, list[str]] = {}
    for bounds, c in study.certificates.items():
        text = ""
        if math.isinf(c.phi_min):
            text = "there is no physical set at all"
        elif c.exact and c.with_conditions and not math.isnan(c.phi_min):
            text = "feasible sets with exactly the identified coefficients exist"
        elif c.phi_min > 0:
            whose = "feasible" if c.with_conditions else "physical"
            forced = f", forced by {listed(c.forcing)}" if c.forcing else ""
            text = f"no {whose} set has exactly the identified coefficients{forced}"
        if text:
            same.setdefault(text, []).append(bounds)
    proofs = [f"within the bounds {listed(bounds)} {text}" for text, bounds in same.items()]
    return "; ".join([said, *proofs]) + "."
