"""What counts as right in each class of what was planted into a real log."""

from typing import Any

import pytest

from torchid_bench.benchmarks.planted import counted

KEY = {"name": "cogging", "joints": [1], "felt_by": [1], "size": 2.0}


def answer(*names: dict[str, Any], status: str = "explained") -> dict[str, Any]:
    usual = {"joints": [1], "how_sure": 0.95, "ambiguous_with": []}
    every = ({**usual, **name} for name in names)
    which = [{"probabilities": {n["effect"]: n["how_sure"]}} | n for n in every]
    return {"status": status, "which": which}


@pytest.mark.parametrize(
    ("known", "names", "right"),
    [
        ("decidable", [{"effect": "cogging"}], 1),
        ("decidable", [{"effect": "joint_spring"}, {"effect": "cogging"}], 0),
        ("decidable", [{"effect": "cogging", "joints": [2]}], 0),
        # Beside an earlier log: what is in both is nothing new.
        ("decidable", [{"effect": "payload", "when": "in both"}, {"effect": "cogging"}], 1),
        ("ambiguous", [{"effect": "joint_spring", "ambiguous_with": ["cogging"]}], 1),
        ("ambiguous", [{"effect": "joint_spring", "ambiguous_with": ["cogging", *"abc"]}], 0),
        ("undecidable", [], 1),
        ("below", [{"effect": "cogging"}], 0),
        ("below", [{"effect": "cogging", "when": "in both"}], 1),
    ],
)
def test_what_is_right_in_each_class(known: str, names: list[dict[str, Any]], right: int) -> None:
    counts = counted(KEY, answer(*names), answer(), known)
    kind = "silent" if known in ("undecidable", "below") else known
    assert counts[kind] == 1
    assert counts[f"right {kind}"] == right


def test_names_above_nine_tenths_are_counted_once() -> None:
    found = answer({"effect": "cogging"}, {"effect": "payload"})
    counts = counted(KEY, found, answer({"effect": "payload"}), "decidable")
    assert (counts["sure"], counts["sure and right"], counts["false"]) == (1, 1, 0)


def test_a_form_is_named_right_by_what_is_acceptable() -> None:
    key = KEY | {"name": "table", "acceptable": ["plane_contact"], "joints": []}
    counts = counted(key, answer({"effect": "plane_contact"}), answer(), "decidable")
    assert counts["right decidable"] == 1
    assert counted(key, answer({"effect": "table"}), answer(), "decidable")["first"] == 0


def test_a_case_without_an_answer_is_said() -> None:
    counts = counted(KEY, answer(status="refused"), answer(), "undecidable")
    assert counts["unanswered"] == 1
