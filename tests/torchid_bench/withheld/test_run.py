"""Every case is diagnosed once, without its key, whatever happens to the others."""

import json
from dataclasses import replace

import pyarrow.parquet as pq
import pytest

from torchid.errors import TorchidError
from torchid.gap.settings import GapSettings
from torchid_bench.withheld import run as running
from torchid_bench.withheld.case_set import keys_beside, make
from torchid_bench.withheld.run import jobs_of, run


@pytest.fixture
def todo(plant, tmp_path):
    return jobs_of(make(tmp_path / "set", 3, seed=7), GapSettings())


@pytest.fixture
def said(monkeypatch):
    """Diagnoses without a diagnosis; the jobs that were run."""
    done = []

    def quick(job):
        done.append(job.case)
        if job.case == "case-0002" and done.count("case-0002") == 1:
            raise ValueError("no such arm")
        return {"status": "no_gap", "which": []}

    monkeypatch.setattr(running, "_answer", quick)
    return done


def test_a_failing_case_does_not_stop_the_others(todo, said):
    answers = run(todo)
    assert [a["status"] for a in answers.values()] == ["no_gap", "error", "no_gap"]
    assert answers["case-0002"]["error"] == "ValueError: no such arm"
    assert json.loads(todo[1].answer.read_text())["status"] == "error"


def test_answers_stay_and_errors_are_tried_again(todo, said):
    run(todo)
    answers = run(todo)
    assert said == ["case-0001", "case-0002", "case-0003", "case-0002"]
    assert [a["status"] for a in answers.values()] == ["no_gap", "no_gap", "no_gap"]
    run(todo)
    assert len(said) == 4


def test_answers_of_another_diagnosis_are_not_taken_for_its_own(todo, said, monkeypatch, plant):
    run(todo)
    other = [job.__class__(**{**vars(job), "settings": GapSettings(folds=4)}) for job in todo]
    with pytest.raises(TorchidError, match="other settings"):
        run(other)
    monkeypatch.setattr(running, "source_digest", lambda: "another")
    with pytest.raises(TorchidError, match="diagnosis has changed"):
        run(todo)
    monkeypatch.setattr(running, "__version__", "9.9")
    with pytest.raises(TorchidError, match="this is 9"):
        run(todo)
    assert len(said) == 3
    run(todo, again=True)
    assert len(said) == 6


def test_progress_counts_what_is_there(todo, said):
    run(todo)
    shown = []
    run(todo, progress=lambda *args: shown.append(args))
    assert shown == [("diagnosing", 2, 3), ("diagnosing", 3, 3)]


@pytest.mark.parametrize(
    ("what", "status"),
    [(TorchidError("no such unit."), "refused"), (KeyError("x"), "error"), ("slow", "out_of_time")],
)
def test_a_log_without_an_answer_has_the_reason(todo, monkeypatch, what, status):
    def answered(job):
        if what == "slow":
            while True:  # until the limit
                try:
                    sum(range(1000))
                except Exception:
                    continue
        raise what

    monkeypatch.setattr(running, "_answer", answered)
    (found,) = run([replace(todo[0], limit=0.05)]).values()
    assert (found["status"], found["which"]) == (status, [])
    assert bool(found["error"])


@pytest.mark.slow
def test_the_doctor_is_asked_first(todo):
    """A log whose torque is a thousand times too large is refused, and that is its answer."""
    columns = pq.read_table(todo[0].logs[0]).to_pandas()
    columns[["tau1", "tau2"]] *= 1e3
    columns.to_parquet(todo[0].logs[0])
    (found,) = run(todo[:1]).values()
    assert found["status"] == "refused"
    assert "looks wrong" in found["error"]


@pytest.mark.slow
def test_the_diagnosis_needs_no_key(todo, tmp_path):
    keys_beside(tmp_path / "set").unlink()
    quick = GapSettings(effects=("coulomb_friction", "viscous_friction"))
    answers = run([replace(todo[0], settings=quick)])
    found = answers["case-0001"]
    assert (found["schema"], found["status"]) == ("torchid.gap/2", "explained")
    assert [(w["effect"], w["joints"]) for w in found["which"]] == [("coulomb_friction", [2])]
    assert found["seconds"] > 0
    assert len(found["corrected"]["pi"]) == 2


def test_the_code_is_that_of_the_diagnosis():
    assert len(running.source_digest()) == 64
    assert running.source_digest() == running.source_digest()
