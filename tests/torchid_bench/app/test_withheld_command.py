"""`torchid withheld`: make, run, score, as a user would call them."""

import json

import pytest

from tests.torchid_bench.withheld.fakes import answer, entry, plant
from torchid_bench.withheld import run as running

__all__ = ["plant"]


@pytest.fixture
def said(monkeypatch):
    """Diagnoses by hand, of cases of the kinds single, outside, none."""
    answers = {
        "case-0001": answer("explained", entry("coulomb_friction", "sign", 2)),
        "case-0002": answer("detected_unexplained"),
        "case-0003": answer("no_gap"),
    }
    monkeypatch.setattr(running, "_answer", lambda job: dict(answers[job.case]))
    return answers


@pytest.fixture
def made(plant, command, tmp_path):
    """A set of three cases, and what was printed."""
    # In this process, where the stand-in is.
    how = ("--cases", 3, "--seed", 7, "--jobs", 1)
    outcome = command("withheld", "make", "--out", tmp_path / "set", *how)
    assert outcome.code == 0, outcome.err
    return outcome, tmp_path / "set"


def test_the_seal_is_printed_and_stored_before_any_diagnosis(made):
    outcome, folder = made
    sealed = json.loads((folder / "cases.json").read_text())["keys_sha256"]
    assert sealed in outcome.out
    assert not list(folder.rglob("answer.json"))


@pytest.mark.slow
def test_make_run_score(made, said, command, tmp_path):
    _, folder = made
    outcome = command("withheld", "run", folder, "--jobs", 1, "--json", tmp_path / "run.json")
    assert outcome.code == 0, outcome.err
    assert "3 of 3 cases diagnosed" in outcome.out
    statuses = json.loads((tmp_path / "run.json").read_text())["statuses"]
    assert statuses == {"explained": 1, "detected_unexplained": 1, "no_gap": 1}
    result = tmp_path / "result"
    outcome = command("withheld", "score", folder, "--out", result)
    assert outcome.code == 0, outcome.err
    assert "one effect: first name right" in outcome.out
    assert "100.0 %" in outcome.out
    score = json.loads((result / "score.json").read_text())
    assert score["schema"] == "torchid.withheld.score/1"
    assert score["scores"]["single"]["top1"]["hits"] == 1


def test_a_score_needs_all_answers(made, said, command):
    _, folder = made
    outcome = command("withheld", "score", folder)
    assert outcome.code == 1
    assert "3 of 3 cases have no answer" in outcome.err
    command("withheld", "run", folder, "--jobs", 1, "--quiet")
    (folder / "case-0002" / "answer.json").unlink()
    assert command("withheld", "score", folder).code == 1
    outcome = command("withheld", "score", folder, "--partial")
    assert outcome.code == 0
    assert "1 cases have no answer" in outcome.out


def test_a_failing_case_is_said(made, said, command):
    _, folder = made
    del said["case-0002"]
    outcome = command("withheld", "run", folder, "--jobs", 1)
    assert outcome.code == 0
    assert "2 of 3 cases diagnosed" in outcome.out
    assert "case-0002: error: KeyError" in outcome.out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("make", "--out", "{set}", "--cases", 1, "--seed", 1), "holds a set of cases already"),
        (("make", "--out", "{set}2", "--cases", 1, "--seed", 1, "--keys", "{set}.keys.json"),
         "never overwritten"),
        (("make", "--out", "{set}/../no/set", "--cases", 1, "--seed", 1), "there is no folder"),
        (("run", "{set}/case-0001"), "cannot be read"),
        (("run", "nowhere"), "there is no folder 'nowhere'"),
        (("score", "{set}", "--keys", "nowhere.json"), "cannot be read"),
    ],
)  # fmt: skip
def test_bad_input_is_one_message(made, command, arguments, words):
    _, folder = made
    outcome = command("withheld", *(str(a).replace("{set}", str(folder)) for a in arguments))
    assert outcome.code == 1
    assert words in outcome.err
    assert outcome.out == ""


def test_wrong_usage_exits_with_2(command, tmp_path):
    assert command("withheld", "make", "--out", tmp_path / "x", "--cases", 3).code == 2
    assert command("withheld", "make", "--out", tmp_path / "x", "--cases", 0, "--seed", 1).code == 2
    assert command("withheld", "run").code == 2
    assert command("withheld", "run", "x", "--jobs", 0).code == 2
