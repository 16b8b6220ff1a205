"""The oracle's classes of a set are made once, and known for planted effects alone."""

import json
from dataclasses import replace

import pytest

from torchid_bench.withheld import decidable
from torchid_bench.withheld.case_set import CaseSet
from torchid_bench.withheld.decidable import FIXED, classes_of, judged


def test_classes_are_kept_beside_the_set(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(
        decidable, "judged", lambda *case: asked.append(case) or [{"ideally": {"class": "below"}}]
    )
    cases = CaseSet(tmp_path / "set", 3, ("case-0001", "case-0002"), "ab", "", background=0.15)
    found = classes_of(cases)
    assert asked == [(3, 0.15, 0), (3, 0.15, 1)]
    assert classes_of(cases) == found == {
        name: [{"ideally": {"class": "below"}}] for name in cases.ids
    }  # fmt: skip
    assert len(asked) == 2
    # Those of another set that lay in this place are none of its.
    other = replace(cases, seed=4, keys_sha256="cd")
    assert classes_of(other) == found
    assert asked[2:] == [(4, 0.15, 0), (4, 0.15, 1)]
    assert json.loads((tmp_path / "set.classes.json").read_text())["classes"] == found


@pytest.mark.slow
def test_a_large_effect_is_told_apart_where_the_background_is_known():
    every = [(k, *judged(5, 0.07, k)) for k in range(6)]
    single = [one for _, *own in every for one in own]
    assert single
    for one in single:
        assert one["in_practice"]["share_of_torque"] == one["ideally"]["share_of_torque"]
        assert {one[how]["class"] for how in one} <= {
            "below", "undecidable", "ambiguous", "decidable"
        }  # fmt: skip
    known = [one["ideally"]["over_nothing"] for one in single]
    real = [one["in_practice"]["over_nothing"] for one in single]
    assert sorted(known)[len(known) // 2] > sorted(real)[len(real) // 2]
    assert any(one["ideally"]["class"] == "decidable" for one in single)


@pytest.mark.parametrize("path", sorted(FIXED.glob("*.json")), ids=lambda path: path.stem)
def test_kept_classes_are_those_of_their_keys_and_half_can_be_decided(path, monkeypatch):
    document = json.loads(path.read_text())
    assert document["keys_sha256"][:16] == path.stem
    every = [one["in_practice"]["class"] for own in document["classes"].values() for one in own]
    assert every.count("decidable") >= len(every) / 2
    monkeypatch.setattr(decidable, "judged", lambda *case: pytest.fail("asked again"))
    cases = CaseSet(
        path.parent, document["seed"], tuple(document["classes"]), document["keys_sha256"], "",
        background=document["background"],
    )  # fmt: skip
    assert classes_of(cases) == document["classes"]
