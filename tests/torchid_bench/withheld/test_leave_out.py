"""Every effect in turn is planted, and its diagnosis must do without it."""

import pytest

from tests.torchid_bench.withheld import fakes
from tests.torchid_bench.withheld.fakes import answer, entry
from torchid.effects.registry import KINDS
from torchid.errors import TorchidError
from torchid_bench.benchmarks import withheld_left_out as left_out
from torchid_bench.withheld import run as running

LeftOut, leave_out, summary = left_out.LeftOut, left_out.leave_out, left_out.summary
leave_out_headline, leave_out_markdown = left_out.leave_out_headline, left_out.leave_out_markdown

STRIBECK = answer("explained", entry("stribeck_friction", "sign", 2))
VISCOUS = answer("explained", entry("viscous_friction", "speed", 2))
SAID = {
    "coulomb_friction-1": STRIBECK,
    "coulomb_friction-2": VISCOUS,
    "backlash-1": answer("detected_unexplained"),
    "backlash-2": answer("error"),
}


@pytest.fixture
def asked(plant, monkeypatch):
    """Cases of one planted effect without a simulation, answered by hand; the jobs done."""
    done = []

    def draw(seed, number, *, kind, effects):
        assert kind == "single"
        done.append((seed, number, *effects))
        return effects[0]

    def simulate(name):
        log = fakes.simulate_case(fakes.Spec(0, 0))
        effect = {"name": name, "family": KINDS[name].family, "joints": [2], "size": 5.0}
        return fakes.Simulated(log.urdf, log.columns, {"kind": "single", "effects": [effect]})

    def said(job):
        assert set(KINDS) - set(job.settings.effects) == {job.case.rsplit("-", 1)[0]}
        return dict(SAID[job.case])

    plant.draw_case, plant.simulate_case = draw, simulate
    monkeypatch.setattr(running, "_answer", said)
    return done


def test_the_verdicts_are_counted(asked, tmp_path):
    found = leave_out(tmp_path / "out", 3, effects=("coulomb_friction", "backlash"), per_effect=2)
    assert found["schema"] == "torchid.withheld.leave_out/1"
    hits = {name: v["hits"] for name, v in found["verdicts"].items()}
    assert hits == {
        "right_family": 1, "hedged": 0, "detected_unexplained": 1, "confident_wrong": 1,
        "missed": 0, "not_testable": 0,
    }  # fmt: skip
    assert found["verdicts"]["confident_wrong"]["total"] == 3  # an error proves nothing
    assert found["errors"] == ["backlash-2"]
    assert found["by_effect"]["coulomb_friction"] == {"right_family": 1, "confident_wrong": 1}
    assert "1 of 3 answers name another family for sure: 33.3 %" in leave_out_headline(found)
    text = leave_out_markdown(found)
    assert "| coulomb_friction | coulomb_friction-2 | confident wrong | explained |" in text
    assert "coulomb_friction-1 |" not in text


def test_cases_are_all_different_and_simulated_once(asked, tmp_path):
    names = ("coulomb_friction", "backlash")
    leave_out(tmp_path / "out", 3, effects=names, per_effect=2)
    assert len({number for _, number, _ in asked}) == 4
    leave_out(tmp_path / "out", 3, effects=names, per_effect=2)
    assert len(asked) == 4


def test_a_folder_of_another_seed_is_refused(asked, tmp_path):
    leave_out(tmp_path / "out", 3, effects=("coulomb_friction",))
    with pytest.raises(TorchidError, match="another seed"):
        leave_out(tmp_path / "out", 4, effects=("coulomb_friction",))


def test_an_unknown_effect_is_refused(asked, tmp_path):
    with pytest.raises(TorchidError, match="unknown effect"):
        leave_out(tmp_path / "out", 3, effects=("air_drag",))
    assert not (tmp_path / "out").exists()


def test_an_effect_that_the_plant_has_not_is_refused(asked, tmp_path):
    """The plant is written on its own: an effect may be torchid's alone."""
    with pytest.raises(TorchidError, match="plant has no effect 'position_dependent_friction'"):
        leave_out(tmp_path / "out", 3, effects=("position_dependent_friction",))


def test_nothing_judged_is_no_share():
    one = LeftOut("backlash", "backlash-1", 0)
    key = {"effects": [{"name": "backlash", "family": "hysteresis", "joints": [1]}]}
    found = summary(0, [one], {one.case: key}, {one.case: answer("error")})
    assert found["verdicts"]["confident_wrong"]["share"] is None
    assert "1 diagnoses failed" in leave_out_headline(found)
    assert leave_out_markdown(found)
