"""The diagnosis that is told: it looks for what was planted, where it was planted."""

import pytest

from tests.torchid_bench.withheld.fakes import draw_case, key_of
from torchid.errors import TorchidError
from torchid.gap.settings import GapSettings
from torchid_bench.benchmarks import withheld_score as references
from torchid_bench.benchmarks.withheld_beside import closed_by
from torchid_bench.withheld.case_set import keys_beside, make, read_keys

oracle_answers, key_settings = references.oracle_answers, references.key_settings


def planted(*effects):
    return {"effects": [{"name": name, "joints": joints} for name, joints in effects]}


def test_settings_name_the_effect_and_its_joint():
    found = key_settings(planted(("coulomb_friction", [2])), GapSettings())
    assert found.only == (("coulomb_friction", 1),)
    assert (found.effects, found.parameters, found.max_effects) == (
        ("coulomb_friction",), "trusted", 1,
    )  # fmt: skip


def test_an_effect_of_the_whole_arm_is_anywhere():
    found = key_settings(planted(("base_tilt", []), ("link_inertia", [3])), GapSettings())
    assert found.only == (("base_tilt", None), ("link_inertia", 2))
    assert (found.parameters, found.max_effects) == ("auto", 2)


def test_what_the_library_lacks_cannot_be_told():
    assert key_settings(planted(("air_drag", [1])), GapSettings()) is None
    assert key_settings(planted(), GapSettings()) is None
    with pytest.raises(TorchidError, match="unknown effect"):
        GapSettings(only=(("air_drag", 0),))


@pytest.mark.slow
def test_it_finds_what_it_is_told_and_nothing_else(plant, tmp_path):
    made = make(tmp_path / "set", 3, seed=7)
    keys = read_keys(made, keys_beside(made.folder))
    found = oracle_answers(made, keys, made.ids, 1)
    assert list(found) == ["case-0001"]  # the only one with an effect of the library
    assert [(w["effect"], w["joints"]) for w in found["case-0001"]["which"]] == [
        ("coulomb_friction", [2])
    ]
    assert closed_by(found)["case-0001"] == pytest.approx(1.0, abs=0.05)
    assert not list(made.folder.rglob("answer.json"))


@pytest.mark.slow
def test_told_of_another_joint_it_finds_nothing(plant, tmp_path):
    made = make(tmp_path / "set", 1, seed=7)
    key = key_of(draw_case(7, 0)) | {"id": "case-0001"}
    key["effects"][0]["joints"] = [1]
    found = oracle_answers(made, [key], made.ids, 1)["case-0001"]
    assert 2 not in {j for w in found["which"] for j in w["joints"]}
    assert found["status"] != "error"
    assert (closed_by({"case-0001": found})["case-0001"] or 0.0) < 0.2


def test_an_answer_without_a_share_closes_nothing():
    assert closed_by({"a": {"status": "error"}, "b": {"how_far": {"closed": None}}}) == {
        "a": None, "b": None,
    }  # fmt: skip
