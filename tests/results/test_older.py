"""Files of older versions are read as if they were written now."""

import json
from pathlib import Path

import pytest

import torchid
from torchid.errors import TorchidError
from torchid.gap.older import of_positions
from torchid.report.explain import report_of_file

FIRST, FIRST_PAIR = (Path(__file__).parent / "older" / f"{name}_1.json" for name in ("gap", "pair"))


def test_a_diagnosis_of_gap_1_has_causes_of_one_kind(tmp_path):
    found = torchid.load(FIRST)
    assert found.schema == "torchid.gap/2"
    assert [c.effect for c in found.which] == ["viscous_friction", "coulomb_friction"]
    # What was a change of the file's number is the arm's, with the file's beside it.
    wrong = json.loads(FIRST.read_text())["which"][0]
    (size,) = found.which[0].sizes
    assert (size.was, size.value) == (2.0, pytest.approx(2.0 + wrong["parameters"]["Fv"]))
    assert found.which[1].file == {}
    corrected = {e["effect"]: e for e in found.corrected.effects}
    assert size.value == pytest.approx(corrected["viscous_friction"]["Fv"], rel=1e-5)
    # All base parameters were apart.
    assert [c.name for c in found.answer.causes] == [
        "viscous friction", "inertial parameters", "Coulomb friction"
    ]  # fmt: skip
    (suspect,) = found.answer.suspects
    assert (suspect.role, suspect.remedy) == ("suspect", "accelerate the joint")
    assert found.answer.after.value == json.loads(FIRST.read_text())["answer"]["after"]
    assert found.covariance.matrix.shape == (2, 2)
    # Once more, it is the same; and people are told it.
    found.save(tmp_path / "again.json")
    assert torchid.load(tmp_path / "again.json").plain() == found.plain()
    assert "2 -> 0.604" in report_of_file(FIRST)[1].verdict + str(found.answer)


def test_draws_are_made_of_it():
    wide = torchid.randomise(torchid.load(FIRST), draws=16)
    assert {r.field for r in wide.ranges} == {"damping", "friction"}


@pytest.mark.parametrize("lost", ["which", "how_far", "robot"])
def test_a_fault_in_it_is_said(lost, tmp_path):
    data = json.loads(FIRST.read_text())
    del data[lost]
    (tmp_path / "gap.json").write_text(json.dumps(data))
    with pytest.raises(TorchidError, match=f"field `{lost}`"):
        torchid.load(tmp_path / "gap.json")


def test_an_answer_of_positions_of_before():
    size = {"name": "kd", "unit": "N m s/rad", "value": 2.0, "std": 0.1, "was": 1.0}
    cause = {"effect": "derivative_gain", "branch": "", "joints": [2], "sizes": [size],
             "how_sure": 0.9, "ambiguous_with": [], "closes": 0.5, "remedy": "set it"}  # fmt: skip
    old = {"schema": "torchid.position_gap/1",
           "answer": {"before": 3.0, "after": 1.0, "unit": "mrad", "causes": [cause]}}  # fmt: skip
    now = of_positions(old)
    assert now["answer"]["after"] == {
        "value": 1.0, "unit": "mrad", "on": [], "how": "left out in turn"
    }  # fmt: skip
    (told,) = now["answer"]["causes"]
    assert (told["parameters"], told["file"], told["share"]) == ({"kd": 2.0}, {"kd": 1.0}, 0.5)
    assert of_positions(now) is now


def test_a_pair_of_pair_1_has_causes_of_one_kind(tmp_path):
    found = torchid.load(FIRST_PAIR)
    assert found.schema == "torchid.pair/2"
    (one,) = found.which
    was = json.loads(FIRST_PAIR.read_text())["which"][0]
    (size,) = one.sizes
    assert (size.was, size.value) == (was["simulator"]["Fc"], was["arm"]["Fc"])
    assert (one.effect, one.more, one.only, one.how_sure) == ("coulomb_friction", "arm", True, 1.0)
    found.save(tmp_path / "again.json")
    assert torchid.load(tmp_path / "again.json").plain() == found.plain()
