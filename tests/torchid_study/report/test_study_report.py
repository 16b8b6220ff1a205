"""The report of a study carries the study's numbers, whatever came out of it."""

import math
from dataclasses import replace

import pytest
import torch
from msgspec import structs

from tests.report.page.reading import parsed, rows_of, text_of
from tests.report.test_gap_page import made
from torchid.report.page.document import render
from torchid_study.report.study import degree_figure, report_of_study, study_page, tables, verdict
from torchid_study.result import Study
from torchid_study.settings import load_study
from torchid_study.study import run_study


@pytest.fixture(scope="module")
def study() -> Study:
    settings = load_study("3r")
    return run_study(
        structs.replace(
            settings,
            search=replace(settings.search, runs=3, stages=2, generations=4),
            scenarios=tuple(s for s in settings.scenarios if s.id in ("p_1", "p_4")),
        )
    )


def column(study: Study, section: str, table: int, heading: str) -> list[str]:
    shown = tables(study)[section][table]
    place = [name.split(" [")[0] for name in shown.columns].index(heading)
    return [str(row[place]) for row in shown.rows]


def test_tables_carry_the_studys_numbers(study):
    sets, model = study.record.sets, study.record.identification
    best = ("Classification", 0)
    assert column(study, *best, "set") == ["p_1", "p_4"]
    assert [float(x) for x in column(study, *best, "phi")] == pytest.approx(
        [s.phi for s in sets], rel=1e-3
    )
    assert column(study, *best, "why not") == [", ".join(s.reasons) or "-" for s in sets]
    assert column(study, "Extraction", 0, "bounds") == ["normal"]
    assert column(study, "Extraction", 1, "feasible") == [str(s.runs.feasible) for s in sets]
    errors = [
        [float(x) for x in y.split()] for y in column(study, "Internal wrenches", 0, "force error")
    ]
    expected = torch.stack([s.force_norm_difference_rms for s in sets])
    assert torch.tensor(errors) == pytest.approx(expected.numpy(), rel=1e-2)
    medians = [c.median for c in study.comparison.classes if c.median is not None]
    assert {f"{m:.3g}" for m in medians} <= set(
        column(study, "Internal wrenches", 1, "median force error")
    )
    assert column(study, "Identification", 0, "coefficient") == list(model.names)
    assert [float(x) for x in column(study, "Identification", 0, "real")] == pytest.approx(
        model.true.tolist(), rel=1e-5
    )


def test_the_payloads_truth_is_the_one_of_the_settings(study):
    body = load_study("3r").payload
    true = [float(x) for x in column(study, "Payload", 0, "true")]
    assert true == pytest.approx(
        [body.mass, *body.com, *body.inertia_about_com], rel=1e-3, abs=1e-15
    )


def test_the_picture_shows_every_run(study):
    axes = degree_figure(study).axes[0]
    marks = torch.cat([torch.tensor(c.get_offsets()) for c in axes.collections])
    assert sorted(marks[:, 1].tolist()) == pytest.approx(
        sorted(study.errors.force_rms.amax(-1).tolist())
    )
    degree = torch.cat([s.runs.degree for s in study.record.sets])
    assert sorted(marks[:, 0].tolist()) == pytest.approx(sorted(degree.tolist()))


@pytest.mark.slow
def test_page(study):
    tree = parsed(render(study_page(study, made())))
    assert text_of(tree, "verdict") == verdict(study.record)
    rows = rows_of(tree, "Best set of each scenario (tables 5.2 to 5.5)")
    assert [row[0] for row in rows] == [s.id for s in study.record.sets]


def changed(study: Study, found: tuple[bool, ...], **certificate: object) -> Study:
    """The study with other verdicts on its best sets, and another certificate."""
    sets = [
        structs.replace(s, feasible=good, reasons=() if good else ("total_mass",))
        for s, good in zip(study.record.sets, found, strict=True)
    ]
    proofs = {b: structs.replace(c, **certificate) for b, c in study.record.certificate.items()}
    return replace(
        study, record=structs.replace(study.record, sets=tuple(sets), certificate=proofs)
    )


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
        ((True, True), EXACT | {"phi_min": math.inf, "conflict": ("com_1x",)}, "Feasible: all 2 "
         "best sets; within the bounds normal there is no physical set at all."),
        ((True, True), EXACT | {"phi_min": math.nan}, "Feasible: all 2 best sets."),
    ],
)  # fmt: skip
def test_verdict(study, found, certificate, said):
    other = changed(study, found, **certificate)
    assert verdict(other.record) == said
    # Whatever came out, there is a report of it.
    assert report_of_study(other).last.endswith(f"{said}\n")
    assert column(other, "Extraction", 0, "no room for") == [
        ", ".join(certificate.get("conflict", ())) or "-"
    ]
