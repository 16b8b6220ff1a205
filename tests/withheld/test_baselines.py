"""Simple methods: right where the cause is simple, and in the form of a diagnosis."""

import json
import math
from dataclasses import replace

import pytest
import torch

from tests.benchmarks import loaded
from tests.withheld.fakes import Spec, arm, simulate_case
from torchid.gap.settings import GapSettings
from torchid.log.model import Log
from torchid.withheld.case_set import LOG, ROBOT, write_shown
from torchid.withheld.rows import row_of
from torchid.withheld.run import Job

simple = loaded("withheld_baselines")
METHODS, _thresholded, answer_of = simple.METHODS, simple._thresholded, simple.answer_of
baseline_case, data_of = simple.baseline_case, simple.data_of
bic, friction, stlsq = simple.bic, simple.friction, simple.stlsq


def log_of(spec: Spec) -> Log:
    c = {name: torch.from_numpy(x) for name, x in simulate_case(spec).columns.items()}
    q, tau = (torch.stack([c[f"{s}1"], c[f"{s}2"]], 1) for s in ("q", "tau"))
    return Log(c["t"], q, tau=tau, trajectory=c["traj"].long(), names=("a", "b", "c"))


@pytest.fixture(scope="module")
def data():
    """Coulomb friction of 2 N m on joint 2, noise of 0.05."""
    return data_of(arm(), log_of(Spec(1, 0)), GapSettings())


@pytest.fixture(scope="module")
def quiet():
    """The same arm without any effect."""
    return data_of(arm(), log_of(Spec(0, 0)), GapSettings())


@pytest.mark.slow
def test_friction_is_put_on_the_worst_joint(data):
    terms = friction(data)
    assert {(t.name, t.place) for t in terms} == {
        ("coulomb_friction", 1), ("viscous_friction", 1),
    }  # fmt: skip
    other = replace(data, relative=data.relative.flip(0))
    assert {t.place for t in friction(other)} == {0}


def test_stepwise_selection_finds_a_plain_cause_first(data):
    first = bic(data)[0]
    assert (first.name, first.place) == ("coulomb_friction", 1)


def test_thresholds_leave_the_cause(data):
    assert ("coulomb_friction", 1) in {(t.name, t.place) for t in stlsq(data)}


def test_the_gap_closes_with_the_cause_and_not_with_another(data):
    right = [t for t in friction(data) if t.name == "coulomb_friction"]
    assert answer_of(data, right)["how_far"]["closed"] > 0.85
    wrong = friction(replace(data, relative=data.relative.flip(0)))
    assert answer_of(data, wrong)["how_far"]["closed"] < 0.1
    assert answer_of(data, [])["how_far"]["closed"] == 0.0


@pytest.mark.slow
def test_answers_have_the_form_of_a_diagnosis(data, quiet):
    for found in (data, quiet):
        for method in METHODS.values():
            said = answer_of(found, method(found))
            json.dumps(said, allow_nan=False)
            row = row_of({"effects": []}, said)
            assert row.status in ("explained", "parametric_only", "no_gap")
            assert bool(row.claims) == (row.status != "no_gap")
    top = row_of({"effects": []}, answer_of(data, friction(data))).top
    assert (top.name, top.place, top.family) == ("coulomb_friction", (2,), "sign")


@pytest.mark.slow
def test_always_friction_cannot_be_quiet(quiet):
    assert answer_of(quiet, friction(quiet))["status"] == "explained"


def test_thresholding_is_a_sparse_least_squares():
    g = torch.Generator().manual_seed(0)
    x = torch.randn(6, 400, generator=g, dtype=torch.float64)
    x = x / x.norm(dim=1, keepdim=True)
    true = torch.tensor([0.8, 0.0, -0.5, 0.0, 0.0, 0.01], dtype=torch.float64)
    y = true @ x
    found = _thresholded(x @ x.T, x @ y, 0.1)
    assert (found != 0).tolist() == [True, False, True, False, False, False]
    expected = torch.linalg.lstsq(x[[0, 2]].T, y).solution
    assert found[[0, 2]].tolist() == pytest.approx(expected.tolist(), rel=1e-6)
    assert _thresholded(x @ x.T, x @ y, math.inf).tolist() == [0.0] * 6


def test_a_log_that_cannot_be_read_is_an_error_of_its_own(tmp_path):
    place = tmp_path / "case"
    write_shown("<robot/>", simulate_case(Spec(0, 0)).columns, place)
    job = Job("case", place / ROBOT, place / LOG, tmp_path / "out.json", GapSettings())
    assert baseline_case(job)["status"] == "error"
    assert "RobotError" in json.loads((tmp_path / "out.json").read_text())["error"]
