"""--report of identify, gap and study: where it is written, and what it says of its inputs."""

import hashlib
import json
import sys
from types import SimpleNamespace

import pytest

from tests.gap.diagnoses import diagnosis
from tests.report.page.reading import parsed, rows_of, text_of
from tests.report.test_gap_page import SHORT
from torchid.app.output import Output
from torchid.report.page import document as rendering
from torchid.report.table import Report
from torchid.robot.config_files import robot_file
from torchid_study.report import study as study_report
from torchid_study.settings import study_file


@pytest.fixture(autouse=True)
def undrawn(monkeypatch):
    """Pages with empty figures: tests of the pages draw them."""
    empty = '<svg role="img" aria-label="{}"></svg>'
    monkeypatch.setattr(rendering, "inline_svg", lambda p: empty.format(p.alt))


def sha256(path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.slow
def test_identify(command, folder, tmp_path):
    page, data = tmp_path / "a page.html", tmp_path / "result.json"
    log, held = folder / "fit.parquet", folder / "check.csv"
    options = ("--held-out", held, "--report", page, "--json", data, "--seed", "5")
    done = command("identify", "3r", log, *options)
    assert done.code == 0, done.err
    assert str(page) in done.out.replace("\n", "")
    tree = parsed(page.read_text())
    inputs = rows_of(tree, "Input files")
    assert [(row[0], row[1], row[3]) for row in inputs] == [
        ("3r", "robot", sha256(robot_file("3r"))),
        (str(log), "log", sha256(log)),
        (str(held), "held-out log", sha256(held)),
    ]
    assert [int(row[2].replace("\u202f", "")) for row in inputs[1:]] == [
        log.stat().st_size, held.stat().st_size,
    ]  # fmt: skip
    said = tree.xpath("//pre")[0].text_content()
    assert said.startswith(f"torchid identify 3r {log} --held-out {held} --report '{page}'")
    settings = dict(rows_of(tree, "Seeds and settings"))
    record = json.loads(data.read_text())
    assert settings["seed"] == "5"
    assert settings["method"] == record["settings"]["method"]
    assert float(settings["cut-off used [Hz]"]) == pytest.approx(record["cutoff_hz"], rel=1e-5)
    rows = rows_of(tree, "with scaled columns)")
    for row, p in zip(rows, record["parameters"], strict=True):
        assert float(row[1].split()[0]) == pytest.approx(p["value"], abs=0.51 * p["std"])


def test_gap(command, folder, tmp_path, monkeypatch):
    asked = []

    def diagnose(robot, log, *, settings, **_):
        asked.append(settings)
        return diagnosis(settings=settings, **SHORT)

    monkeypatch.setattr("torchid.gap.diagnose.diagnose", diagnose)
    page, data = tmp_path / "gap.html", tmp_path / "gap.json"
    few = ("--effects", "coulomb_friction,viscous_friction")
    log = folder / "check.csv"
    done = command("gap", "3r", log, *few, "--report", page, "--json", data, "--quiet")
    assert done.code == 0, done.err
    assert done.out == ""
    tree, record = parsed(page.read_text()), json.loads(data.read_text())
    assert rows_of(tree, "Input files")[1][3] == sha256(log)
    settings = dict(rows_of(tree, "Seeds and settings"))
    assert settings["effects"] == "coulomb_friction, viscous_friction"
    assert settings["seed"] == "0"
    assert len(asked) == 1
    assert float(settings["cut-off [Hz]"]) == pytest.approx(record["cutoff_hz"], rel=1e-5)
    assert f"{record['how_far']['rms_before']:.3g} N m" in text_of(tree, "facts")


@pytest.mark.slow
def test_study(command, tmp_path):
    page = tmp_path / "study.html"
    tiny = ("--runs", "3", "--stages", "2", "--generations", "4", "--seed", "11")
    done = command("study", "3r", *tiny, "--report", page)
    assert done.code == 0, done.err
    tree = parsed(page.read_text())
    assert [row[3] for row in rows_of(tree, "Input files")] == [
        sha256(study_file("3r")), sha256(robot_file("3r")),
    ]  # fmt: skip
    settings = dict(rows_of(tree, "Seeds and settings"))
    assert settings["seed of the search"] == "11"
    assert "runs 3, stages 2, generations 4" in settings["search"]
    assert len(list(tree.iter("figure"))) == 1


def test_all_studies_have_pages_of_their_own(command, tmp_path, monkeypatch):
    asked = []

    def write(output, build, file, *, files, **_):
        asked.append((build(None), file.name, files[0].sha256))

    def run(settings, **_):
        return SimpleNamespace(record=SimpleNamespace(study=settings.name, plain=dict))

    monkeypatch.setattr("torchid_study.study.run_study", run)
    monkeypatch.setattr(study_report, "study_page", lambda found, _: found.record.study)
    monkeypatch.setattr(study_report, "report_of_study", lambda _: Report(parts=[]))
    monkeypatch.setattr(Output, "write_page", write)
    done = command("study", "all", "--report", tmp_path / "page.html")
    assert done.code == 0, done.err
    names = ("3r", "3r_friction", "kuka_lwr4", "kuka_lwr4_friction")
    assert asked == [(n, f"page_{n}.html", sha256(study_file(n))) for n in names]


def test_without_jinja2_nothing_is_begun(command, folder, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "jinja2", None)
    page = tmp_path / "page.html"
    page.write_text("old")
    done = command("identify", "3r", folder / "check.csv", "--report", page)
    assert done.code == 1
    assert "pip install 'torchid[report]'" in done.err
    assert page.read_text() == "old"
