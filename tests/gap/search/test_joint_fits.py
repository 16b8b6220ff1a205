"""Alternatives of an answer are as likely as it says."""

import json

import pytest

from tests.golden.answers import STORED


def test_alternatives_take_what_the_answer_leaves_of_its_causes() -> None:
    answer = json.loads((STORED / "friction_and_load.json").read_text())
    told, *others = answer["joint_fits"]
    assert told["words"] == ""
    assert sum(fit["weight"] for fit in (told, *others)) == pytest.approx(1)
    for cause in answer["which"]:
        of = f" of joint {cause['joints'][0]}" if cause["effect"] != "payload" else ""
        place = f"in the place of {cause['effect']}{of}"
        instead = sum(fit["weight"] for fit in others if fit["words"].endswith(place))
        # Less what is less likely than one in twenty beside the cause, nothing, and the unknown.
        assert cause["how_sure"] * (1 + instead / told["weight"]) <= 1 + 1e-9
        assert bool(instead) == bool(cause["ambiguous_with"])
