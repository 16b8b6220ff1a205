"""Answers of `make golden` are stored, and a difference between two is said."""

import math
import tempfile

import pytest

from tests.documents import ROOT
from tests.golden.answers import ANSWERS, STORED, differences

WAS = {"status": "explained", "which": [{"effect": "a", "std": 1.0}], "n": 3}


def test_every_answer_is_stored_and_names_no_place() -> None:
    assert {path.stem for path in STORED.glob("*.json")} == set(ANSWERS)
    assert len(ANSWERS) == 12
    for path in STORED.glob("*.json"):
        text = path.read_text()
        assert not [place for place in (str(ROOT), tempfile.gettempdir()) if place in text], path


@pytest.mark.parametrize(
    ("now", "said", "by"),
    [
        (WAS, None, 0.0),
        (WAS | {"n": 3 + 3e-12}, "n: 3 -> 3.000000000003", 1e-12),
        (WAS | {"status": "no_gap"}, 'status: "explained" -> "no_gap"', math.inf),
        (WAS | {"which": []}, 'which: [{"effect": "a", "std": 1.0}] -> []', math.inf),
        (WAS | {"which": [{"effect": "a", "std": 1.1}]}, "which[0].std: 1.0 -> 1.1", 0.1 / 1.1),
        (WAS | {"more": None}, None, 0.0),
        (WAS | {"more": 1}, "more: null -> 1", math.inf),
    ],
)
def test_a_difference_is_said_with_its_size(now, said, by) -> None:
    found = list(differences(WAS, now))
    assert [text for text, _ in found] == ([] if said is None else [said])
    assert [size for _, size in found] == ([] if said is None else [pytest.approx(by)])
