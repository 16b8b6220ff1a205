"""Answers on commands and positions are scored by the measures that answers on torques are."""

from typing import Any

from torchid_bench.withheld.measures import coefficient_coverage, how_named, joint_counts, verdict
from torchid_bench.withheld.rows import row_of
from torchid_bench.withheld.score import scored_case, scores


def found(effect: str, family: str, joint: int | None, gain: float, **more: Any) -> dict[str, Any]:
    return {
        "effect": effect, "family": family, "joints": [] if joint is None else [joint],
        "ambiguous_with": [], "parameters": {}, "ci95": {},
        "error_without_mrad": (1 + gain**2) ** 0.5, "error_with_mrad": 1.0,
    } | more  # fmt: skip


def answer(*which: dict[str, Any], status: str = "explained") -> dict[str, Any]:
    return {
        "schema": "torchid.position_gap/1", "status": status, "which": list(which),
        "where": {"joints": [{"joint": j} for j in (1, 2, 3)]}, "how_far": {"closed": 0.97},
    }  # fmt: skip


def key(name: str, family: str, *joints: int, **more: Any) -> dict[str, Any]:
    effect = {
        "name": name, "family": family, "joints": list(joints), "felt_by": list(joints) or [1, 2],
        "size": 9.0, "parameters": {}, "acceptable": [],
    } | more  # fmt: skip
    return {"id": "case-0001", "kind": "single", "effects": [effect]}


def test_entries_of_one_effect_are_one_claim():
    every = key("set_point_profile", "command")
    said = answer(
        found("derivative_gain", "servo", 2, 7.0),
        *(found("set_point_profile", "command", j, 5.0) for j in (1, 2, 3)),
    )
    row = row_of(every, said)
    assert [(c.name, c.place) for c in row.claims] == [
        ("set_point_profile", (1, 2, 3)),
        ("derivative_gain", (2,)),
    ]
    assert row.claims[0].share == 3 * 25.0 or abs(row.claims[0].share - 75.0) < 1e-9
    assert how_named(row).top1
    assert not how_named(row).exact


def test_a_plane_is_felt_by_all_joints():
    row = row_of(
        key("plane_contact", "world", felt_by=[1, 2, 3]),
        answer(found("plane_contact", "world", None, 4.0)),
    )
    assert how_named(row).exact
    assert joint_counts(row) == (3, 0, 0)


def test_families_are_those_of_positions():
    # In answers on torques an offset is of the family `constant`.
    outside = key("cable", "outside", 2, acceptable=["servo"])
    said = found("stribeck_friction", "friction", 2, 3.0, ambiguous_with=["torque_offset"])
    assert verdict(row_of(outside, answer(said)), every=True) == "hedged"
    wrong = found("stribeck_friction", "friction", 2, 3.0)
    assert verdict(row_of(outside, answer(wrong)), every=True) == "confident_wrong"
    unsure = answer(wrong, status="partly_explained")
    assert verdict(row_of(outside, unsure), every=True) == "hedged"


def test_intervals_are_compared_with_what_was_planted():
    planted = key("command_delay", "command", 2, parameters={"delay": 0.05})
    for ends, held in (((0.04, 0.06), True), ((0.02, 0.03), False)):
        middle = {"parameters": {"delay": sum(ends) / 2}, "ci95": {"delay": ends}}
        row = row_of(planted, answer(found("command_delay", "command", 2, 3.0, **middle)))
        assert coefficient_coverage(row) == [held]


def test_a_set_is_scored():
    planted = key("dead_zone", "servo", 1)
    one = scored_case(planted, answer(found("dead_zone", "servo", 1, 2.0)))
    none = scored_case(planted | {"kind": "none", "effects": []}, answer(status="no_gap"))
    result = scores([one, none])
    assert result["single"]["exact"]["share"] == 1.0
    assert result["false_alarms"]["all"]["hits"] == 0
    assert result["joints"]["f1"] == 1.0
    assert one.closed == 0.97
