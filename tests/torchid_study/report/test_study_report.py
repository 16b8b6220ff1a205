"""The report of a study carries the study's numbers, whatever came out of it."""

import io
import json
import re
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import pytest
import torch
from msgspec import structs
from rich.console import Console

from tests.report.test_gap_page import made
from torchid.errors import TorchidError
from torchid.feasibility.sets import read_sets
from torchid.report.log import trajectory_figure
from torchid.report.table import Table
from torchid_study.report.study import facts
from torchid_study.report.study.facts import verdict
from torchid_study.report.study.figures import drawings
from torchid_study.report.study.page import (
    all_tables,
    identification_table,
    page_verdict,
    payload_table,
    scenario_table,
    set_wrench_table,
    study_page,
    write_study,
)
from torchid_study.result import Study
from torchid_study.settings import load_study
from torchid_study.study import excitation, run_study


def tiny(name: str, scenarios: tuple[str, ...]) -> Study:
    settings = load_study(name)
    return run_study(
        replace(
            settings,
            search=replace(settings.search, runs=4, stages=3, generations=5),
            scenarios=tuple(s for s in settings.scenarios if s.id in scenarios),
        )
    )


pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def study() -> Study:
    return tiny("3r", ("p_1", "p_4", "p_9"))


@pytest.fixture(scope="module")
def written(study, tmp_path_factory) -> list[Path]:
    return write_study(study, tmp_path_factory.mktemp("studies") / "made")


@pytest.fixture(scope="module")
def without_feasible() -> Study:
    return tiny("3r", ("p_1", "p_9"))


def text_of(study: Study) -> str:
    console = Console(width=200, file=io.StringIO(), record=True)
    for table in all_tables(study):
        console.print(table)
    return console.export_text()


@pytest.mark.nightly
def test_every_file_is_there_and_figures_are_png(study, written):
    names = {path.name for path in written}
    assert {"study.md", "sets.json", "all_sets.json"} < names
    assert names == {path.name for path in written[0].parent.iterdir()}
    for d in drawings(study):
        assert (written[0].parent / d.file).read_bytes().startswith(b"\x89PNG")
    assert sum(p.stat().st_size for p in written if p.suffix == ".png") < 1.5e6


def test_there_is_a_figure_of_every_combination(study, written):
    good = [s.scenario.id for s in study.scenarios if s.feasible]
    bad = [s.scenario.id for s in study.scenarios if not s.feasible]
    assert good
    assert bad
    found = {path.name for path in written if path.name.startswith("wrenches")}
    assert found == {f"wrenches_F-{a}_UN-{b}.png" for a in good for b in bad}


def test_the_page_shows_every_figure_and_every_set(study, written):
    text = written[0].read_text(encoding="utf-8")
    shown = re.findall(r"!\[[^\]]*\]\(([^)]*)\)", text)
    assert sorted(shown) == sorted(d.file for d in drawings(study))
    for s in study.scenarios:
        assert re.search(rf"^\| {s.scenario.id} \|", text, re.MULTILINE)
    assert text.index("- Identification:") < text.index("## Classification")


def test_the_page_names_no_place_of_this_machine(written):
    text = written[0].read_text(encoding="utf-8")
    assert str(written[0].parent.parent) not in text
    assert not re.search(r"(?<![\w.])/(home|work|tmp|usr|root)\b", text)


def test_every_line_of_a_table_on_the_page_has_all_its_cells(study, written):
    lines = written[0].read_text(encoding="utf-8").splitlines()
    runs: list[list[str]] = [[]]
    for line in lines:
        if line.startswith("|"):
            runs[-1].append(line)
        elif runs[-1]:
            runs.append([])
    tables_on_page = [run for run in runs if run]
    assert len(tables_on_page) == len(all_tables(study))
    for run in tables_on_page:
        assert len({len(re.findall(r"(?<!\\)\|", line)) for line in run}) == 1


def test_captions_are_sentences_without_broken_numbers(study):
    for d in drawings(study):
        assert d.caption.endswith(".")
        assert "nan" not in d.caption.split()
        assert "  " not in d.caption


def test_tables_carry_the_studys_numbers(study):
    text = text_of(study)
    for s in study.scenarios:
        rows = [line.split() for line in text.splitlines() if line.split()[:1] == [s.scenario.id]]
        assert [s.scenario.id, s.scenario.bounds, s.scenario.penalty, f"{s.phi:.4g}"] in [
            row[:4] for row in rows
        ]
    for c in study.comparison.classes:
        if c.median is not None:
            assert f"{c.median:.3g}" in text


def test_coefficients_are_those_of_the_identification(study):
    rows = identification_table(study).rows
    assert [row[0] for row in rows] == list(study.identification.base.names)
    assert [float(row[2]) for row in rows] == pytest.approx(
        study.identification.values.tolist(), rel=1e-5
    )
    assert [float(row[3]) for row in rows] == pytest.approx(study.truth.tolist(), rel=1e-5)


def test_reasons_and_least_losses_stand_beside_the_sets(study):
    sheet = scenario_table(study)
    why, least = sheet.columns.index("why not"), sheet.columns.index("phi_min")
    for row, s in zip(sheet.rows, study.scenarios, strict=True):
        assert row[why] == (", ".join(s.reasons) or "-")
        if study.certificates:
            assert float(row[least]) == pytest.approx(
                study.certificates[s.scenario.bounds].phi_min, rel=1e-3
            )


def test_wrench_errors_are_those_of_the_best_runs(study):
    """The row of a best set among all runs: against the norms along the same motion."""
    wrench = study.wrench_motion
    for k, (s, row) in enumerate(zip(study.scenarios, facts.best_rows(study), strict=True)):
        of_norms = facts.rms(wrench.force[k + 1] - wrench.force[0])
        assert torch.allclose(study.errors.force_norm_rms[row], of_norms, rtol=1e-6, atol=1e-9)
        cells = set_wrench_table(study).rows[k + 1]
        assert cells[0] == s.scenario.id
        assert float(cells[2]) == pytest.approx(float(study.errors.force_rms[row, 0]), rel=1e-2)


def test_the_payloads_truth_is_the_one_of_the_settings(study):
    rows = {row[0]: row for row in payload_table(study).rows}
    body = study.settings.payload
    assert float(rows["mass"][2]) == body.mass
    assert [float(rows[f"com {a}"][2]) for a in "xyz"] == pytest.approx(body.com)
    inertia = [float(row[2]) for name, row in rows.items() if name.startswith("inertia")]
    assert inertia == pytest.approx(body.inertia_about_com, rel=1e-3, abs=1e-15)


def test_sets_are_written_under_their_ids(study, written):
    folder = written[0].parent
    best = read_sets(folder / "sets.json", study.robot)
    assert best.ids == tuple(s.scenario.id for s in study.scenarios)
    expected = torch.cat([s.best.parameters.pi for s in study.scenarios])
    assert torch.equal(best.parameters.pi, expected)
    every = json.loads((folder / "all_sets.json").read_text())["sets"]
    assert len(every) == sum(len(s.extraction.sets) for s in study.scenarios)
    assert every[0]["id"] == f"{study.scenarios[0].scenario.id}/run_1"


def test_a_folder_that_cannot_be_made_is_refused(study, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(TorchidError, match="cannot be made"):
        write_study(study, tmp_path / "file" / "inside")


def test_a_study_without_certificates_has_a_report(study):
    bare = replace(study, certificates=MappingProxyType({}), warnings=("no certificate: missing",))
    sheet = scenario_table(bare)
    assert {row[sheet.columns.index("phi_min")] for row in sheet.rows} == {"-"}
    text = study_page(bare, made()).markdown()
    assert "there is no certificate" in text
    assert "no certificate: missing" in text
    assert "mpossible" not in text
    next(d for d in drawings(bare) if d.name == "degrees").draw()
    assert page_verdict(bare)


def test_an_impossible_certificate_has_a_report(study):
    c = next(iter(study.certificates.values()), None)
    if c is None:
        pytest.skip("no solver of semidefinite programs")
    none = structs.replace(
        c, feasible=False, phi_min=torch.inf, phi_strict=torch.nan, sets=None, conflict=("com_1x",)
    )
    changed = replace(study, certificates=MappingProxyType({"normal": none}))
    assert "no physical set" in page_verdict(changed)
    assert "com_1x" in text_of(changed)
    next(d for d in drawings(changed) if d.name == "force_error_by_degree").draw()


@pytest.mark.nightly
def test_a_study_without_feasible_sets_has_a_report(without_feasible):
    assert not any(s.feasible for s in without_feasible.scenarios)
    figures = drawings(without_feasible)
    found = {d.file: d for d in figures if d.name.startswith("wrenches")}
    assert set(found) == {f"wrenches_UN-{s.scenario.id}.png" for s in without_feasible.scenarios}
    for d in figures:
        if d.name in ("degrees", "force_error_by_degree"):
            d.draw()
    labels = [line.get_label() for line in found["wrenches_UN-p_1.png"].draw().axes[0].lines]
    assert labels == ["real", "UN = p_1"]
    text = study_page(without_feasible, made()).markdown()
    assert f"Not feasible: none of the {len(without_feasible.scenarios)} best sets" in text


def test_what_is_said_of_classes_follows_their_intervals(study):
    said = [line for line in verdict(study) if line.startswith("Internal forces: the errors")]
    judged = [e for e in study.comparison.effects if e.ratio.value == e.ratio.value]
    assert len(said) == len(judged)
    for line, e in zip(said, judged, strict=True):
        if "not judged" in line or e.ratio.low != e.ratio.low:
            continue
        word = "larger" if e.ratio.low > 1 else "smaller" if e.ratio.high < 1 else "not told apart"
        assert f"({word}," in line


def test_noise_is_drawn_with_the_planned_motion(study):
    noisy = load_study("3r_friction")
    plan = excitation(study.robot, noisy.excitation).trajectories()[0]
    disturbed = plan.replace(q=plan.q + 0.01)
    axes = trajectory_figure(study.robot, plan, "title", disturbed).axes[0]
    drawn = {line.get_label(): line.get_ydata() for line in axes.lines}
    assert drawn["with noise"][0] - drawn["planned"][0] == pytest.approx(0.01)


def test_different_values_are_counted_once():
    values = torch.tensor([1.0, 2.0, 1.0 + 1e-9, 2.0, 3.0], dtype=torch.float64)
    assert facts.count_different(values) == 3
    assert facts.count_different(values[:0]) == 0


def test_runs_that_end_in_the_same_set_count_once(study):
    s = study.scenarios[0]
    sets = s.extraction.sets.part([0, 0, 1, 0])
    same = replace(s, extraction=replace(s.extraction, sets=sets))
    assert facts.endings(same).tolist() == [0, 0, 2, 0]


def test_markdown_and_terminal_show_a_cell_as_it_is():
    sheet = Table("t [m]", ("a", "b"), [("||x|| *y*", "[N m]")], "p", "n [kg]")
    assert sheet.markdown().splitlines()[4] == r"| \|\|x\|\| \*y\* | [N m] |"
    console = Console(width=80, file=io.StringIO(), record=True)
    console.print(sheet)
    text = console.export_text()
    for part in ("t [m]", "||x|| *y*", "[N m]", "n [kg]"):
        assert part in text
