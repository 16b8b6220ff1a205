"""The page of a study says what the study holds."""

import math
from dataclasses import replace

import pytest
import torch
from msgspec import structs

from tests.report.page.reading import parsed, rows_of, text_of
from tests.report.test_gap_page import made
from torchid.report.page.document import render
from torchid.report.panels import Picture
from torchid_study.report.study.page import page_verdict, study_page
from torchid_study.result import Study
from torchid_study.settings import load_study
from torchid_study.study import run_study


@pytest.fixture(scope="module")
def study() -> Study:
    settings = load_study("3r")
    return run_study(
        replace(
            settings,
            search=replace(settings.search, runs=3, stages=2, generations=4),
            scenarios=tuple(s for s in settings.scenarios if s.id in ("p_1", "p_4")),
        )
    )


@pytest.mark.slow
def test_page(study):
    page = study_page(study, made())
    # No pictures: they are drawn in the tests of the figures.
    few = [
        replace(s, parts=[p for p in s.parts if not isinstance(p, Picture)]) for s in page.sections
    ]
    tree = parsed(render(replace(page, sections=few)))
    assert text_of(tree, "verdict") == page_verdict(study)
    rows = rows_of(tree, "Best set of each scenario (tables 5.2 to 5.5)")
    for row, s in zip(rows, study.plain()["sets"], strict=True):
        assert (row[0], row[6]) == (s["id"], "yes" if s["feasible"] else "no")
        assert float(row[3]) == pytest.approx(s["phi"], rel=1e-3)


def test_the_first_picture_is_about_feasibility(study):
    names = [p.name for p in study_page(study, made()).pictures]
    assert names[0] == "degrees"
    assert len(set(names)) == len(names) > 10


def changed(study: Study, found: tuple[bool, ...], **certificate: object) -> Study:
    """The study with other verdicts on its best sets, and another certificate."""
    scenarios = []
    for s, good in zip(study.scenarios, found, strict=True):
        was = s.feasibility
        none = {
            name: torch.zeros_like(getattr(was, name))
            for name in ("violated", "violated_total", "violated_coefficients")
        }
        none["violated_total"][s.extraction.best] = not good
        scenarios.append(replace(s, feasibility=replace(was, **none)))
    proofs = {b: structs.replace(c, **certificate) for b, c in study.certificates.items()}
    return replace(study, scenarios=tuple(scenarios), certificates=proofs)


EXACT = {"phi_min": 0.0, "exact": True, "with_conditions": True, "forcing": ()}
FORCED = EXACT | {"phi_min": 0.3, "exact": False, "forcing": ("Fv_6", "inertia_3")}


@pytest.mark.parametrize(
    ("found", "certificate", "said"),
    [
        ((True, True), EXACT, "Feasible: all 2 best sets; within the bounds normal feasible sets "
         "with exactly the identified coefficients exist."),
        ((True, False), EXACT, "Feasible in part: 1 of 2 best sets (p_1), while the others violate "
         "total_mass; within the bounds normal feasible sets with exactly the identified "
         "coefficients exist."),
        ((False, False), FORCED, "Not feasible: none of the 2 best sets, which violate total_mass; "
         "within the bounds normal no feasible set has exactly the identified coefficients, forced "
         "by Fv_6 and inertia_3."),
        ((False, False), FORCED | {"with_conditions": False, "forcing": ()}, "Not feasible: none "
         "of the 2 best sets, which violate total_mass; within the bounds normal no physical set "
         "has exactly the identified coefficients."),
        ((True, True), EXACT | {"phi_min": math.inf}, "Feasible: all 2 best sets; within the "
         "bounds normal there is no physical set at all."),
        ((True, True), EXACT | {"phi_min": math.nan}, "Feasible: all 2 best sets."),
    ],
)  # fmt: skip
def test_verdict(study, found, certificate, said):
    assert page_verdict(changed(study, found, **certificate)) == said
