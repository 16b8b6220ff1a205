"""Measures of one answer, against counts by hand and against brute force."""

import itertools
from typing import Any

import pytest
import torch

from torchid_bench.withheld.measures import (
    coefficient_coverage,
    how_named,
    joint_counts,
    largest_matching,
    matching_counts,
    poor_verdict,
    reliability,
    stated_probabilities,
    verdict,
)
from torchid_bench.withheld.rows import Claim, Planted, Row, row_of

FAMILIES = {
    "coulomb_friction": "sign",
    "stribeck_friction": "sign",
    "viscous_friction": "speed",
    "payload": "inertia",
    "link_inertia": "inertia",
    "base_tilt": "gravity",
}


def claim(name: str, *place: int, share: float = 1.0, ambiguous: tuple[str, ...] = ()) -> Claim:
    return Claim(name, FAMILIES[name], place, place or (1, 2), ambiguous, share)


def planted(name: str, *place: int, **more: Any) -> Planted:
    return Planted(name, FAMILIES.get(name, "outside"), place, place or (1, 2, 3), 5.0, **more)


def row(truth: list[Planted], found: list[Claim], status: str = "explained", **more: Any) -> Row:
    ordered = sorted(found, key=lambda c: -c.share)
    return Row(status, tuple(truth), tuple(ordered), families=FAMILIES, **more)


def test_an_alarm_is_a_claim_or_a_verdict_that_something_is_there() -> None:
    assert not row([], [], "no_gap").alarm
    assert not row([], [], "not_testable").alarm
    assert not row([], [], "error").alarm
    assert row([], [], "detected_unexplained").alarm
    assert row([], [], "parametric_only").alarm
    assert row([], [claim("viscous_friction", 1)], "no_gap").alarm


def test_the_largest_share_is_the_top_claim() -> None:
    found = [
        claim("viscous_friction", 1, share=0.2),
        claim("coulomb_friction", 1, share=0.7, ambiguous=("stribeck_friction",)),
    ]
    s = how_named(row([planted("coulomb_friction", 1)], found))
    assert (s.top1, s.in_set, s.family, s.set_size) == (True, True, True, 2)
    assert not s.exact
    swapped = how_named(row([planted("viscous_friction", 1)], found))
    assert (swapped.top1, swapped.in_set, swapped.anywhere, swapped.family) == (
        False, False, True, False,
    )  # fmt: skip


def test_exact_needs_the_joint() -> None:
    truth = [planted("coulomb_friction", 2)]
    assert how_named(row(truth, [claim("coulomb_friction", 2)])).exact
    assert not how_named(row(truth, [claim("coulomb_friction", 3)])).exact


def test_joints_of_the_whole_arm_are_those_that_feel_it() -> None:
    found = [claim("base_tilt")]  # felt on joints 1 and 2
    assert joint_counts(row([planted("payload")], found)) == (2, 0, 1)
    assert joint_counts(row([planted("coulomb_friction", 2)], found)) == (1, 1, 0)


def test_a_links_inertia_is_where_a_payload_is_felt() -> None:
    found = [claim("link_inertia", 3)]
    assert joint_counts(row([planted("payload")], found)) == (3, 0, 0)
    assert joint_counts(row([planted("link_inertia", 3)], found)) == (1, 0, 0)


def test_an_effect_of_the_whole_arm_is_on_every_joint() -> None:
    found = [claim("link_inertia", 3, ambiguous=("payload",))]
    assert matching_counts(row([planted("payload")], found), strict=False) == (1, 0, 0)
    assert matching_counts(row([planted("payload")], found), strict=True) == (0, 1, 1)


def test_largest_matching_beats_no_assignment() -> None:
    generator = torch.Generator().manual_seed(0)
    for _ in range(50):
        fits = (torch.rand(4, 4, generator=generator, dtype=torch.float64) < 0.35).tolist()
        best = max(
            sum(fits[i][j] for i, j in enumerate(order))
            for order in itertools.permutations(range(4))
        )
        assert largest_matching(fits) == best


@pytest.mark.parametrize(
    ("found", "status", "said"),
    [
        ([], "no_gap", "missed"),
        ([], "not_testable", "not_testable"),
        ([claim("stribeck_friction", 1)], "explained", "right_family"),
        ([claim("viscous_friction", 1)], "explained", "confident_wrong"),
        ([claim("link_inertia", 1)], "parametric_only", "confident_wrong"),
        ([claim("viscous_friction", 1, ambiguous=("stribeck_friction",))], "explained", "hedged"),
        ([claim("viscous_friction", 1)], "detected_unexplained", "detected_unexplained"),
    ],
)
def test_what_is_said_without_the_name(found: list[Claim], status: str, said: str) -> None:
    r = row([planted("coulomb_friction", 1)], found, status)
    assert verdict(r, every=False) == said


def test_one_wrong_claim_is_enough_where_every_one_counts() -> None:
    found = [claim("stribeck_friction", 1), claim("base_tilt", share=0.1)]
    r = row([planted("coulomb_friction", 1)], found)
    assert verdict(r, every=False) == "right_family"
    assert verdict(r, every=True) == "confident_wrong"


def test_outside_of_the_library_every_name_is_wrong_unless_it_is_acceptable() -> None:
    found = [claim("viscous_friction", 1)]
    for acceptable, said in (
        ((), "confident_wrong"),
        (("speed",), "right_family"),
        (("viscous_friction",), "right_family"),
        (("sign",), "confident_wrong"),
    ):
        r = row([planted("air_drag", 1, acceptable=acceptable)], found)
        assert verdict(r, every=True) == said
    hedged = [claim("base_tilt", ambiguous=("viscous_friction",))]
    r = row([planted("air_drag", 1, acceptable=("speed",))], hedged)
    assert verdict(r, every=True) == "hedged"


POOR = [planted("coulomb_friction", 2)]


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (row(POOR, [], "not_testable"), "not_testable"),
        (row(POOR, [], "no_gap", not_testable=(("coulomb_friction", 2),)), "not_testable"),
        (row(POOR, [], "no_gap", not_testable=(("coulomb_friction", 1),)), "missed"),
        (row(POOR, [], "no_gap", not_testable=(("base_tilt", None),)), "missed"),
        (row(POOR, [], "no_gap"), "missed"),
        (row(POOR, [claim("viscous_friction", 2)], "detected_unexplained"), "hedged"),
        (row(POOR, [claim("viscous_friction", 2)]), "confident_wrong"),
        (row(POOR, [claim("viscous_friction", 2, ambiguous=("coulomb_friction",))]), "hedged"),
        (row(POOR, [claim("coulomb_friction", 2)]), "right"),
        (row(POOR, [claim("coulomb_friction", 2), claim("base_tilt")]), "confident_wrong"),
        (row([], [], "no_gap"), "missed"),
    ],
)
def test_what_is_said_of_poor_data(answer: Row, said: str) -> None:
    assert poor_verdict(answer) == said


def test_coefficients_count_where_name_and_joint_are_right() -> None:
    truth = planted("coulomb_friction", 2, coefficients={"Fc": 1.0, "other": 2.0})
    close = Claim("coulomb_friction", "sign", (2,), (2,), coefficients={"Fc": (1.1, 0.1)})
    far = Claim("coulomb_friction", "sign", (2,), (2,), coefficients={"Fc": (1.3, 0.1)})
    elsewhere = Claim("coulomb_friction", "sign", (1,), (1,), coefficients={"Fc": (1.0, 0.1)})
    assert coefficient_coverage(row([truth], [close])) == [True]
    assert coefficient_coverage(row([truth], [far])) == [False]
    assert coefficient_coverage(row([truth], [elsewhere])) == []
    assert coefficient_coverage(row([truth, truth], [close])) == []


def test_a_row_is_read_from_files() -> None:
    key = {
        "effects": [
            {"name": "stribeck_friction", "family": "sign", "joints": [2], "felt_by": [2],
             "parameters": {"Fs": 0.3, "law": "LuGre", "stick": True}, "size": 5.0},
        ]
    }  # fmt: skip
    answer = {
        "status": "explained",
        "which": [
            {"effect": "viscous_friction", "family": "speed", "joints": [2], "places": [],
             "common": False, "ambiguous_with": [], "share": 0.1, "shape": [],
             "parameters": {"Fv": 3.0}, "file": {"Fv": 1.0}, "std": {"Fv": 0.5}},
            {"effect": "time_delay", "family": "phase", "joints": [1, 2], "places": [],
             "common": True, "ambiguous_with": ["filter_lag"], "share": None, "shape": [],
             "parameters": {"delay": None}, "std": {"delay": None}},
            {"effect": "stribeck_friction", "family": "sign", "joints": [2], "places": [],
             "common": False, "ambiguous_with": [], "share": 0.8, "shape": ["vs"],
             "parameters": {"Fs": 0.3, "vs": 0.1}, "std": {"Fs": 0.01}},
            {"effect": "link_inertia", "family": "inertia", "joints": [3], "places": [],
             "ambiguous_with": ["payload"], "share": 0.3, "parameters": {"links": [3]}, "std": {}},
        ],
        "answer": {
            "causes": [
                {"effect": "link_inertia", "joints": [3], "share": 0.3, "ambiguous_with": []},
                {"effect": "link_inertia", "joints": [], "share": 0.5, "ambiguous_with": []},
            ]
        },
        "not_testable": [{"effect": "backlash", "joint": 1}, {"effect": "payload", "joint": None}],
    }  # fmt: skip
    r = row_of(key, answer)
    assert [(c.name, c.place) for c in r.claims] == [
        ("stribeck_friction", (2,)),
        ("all_base", ()),
        ("link_inertia", (3,)),
        ("viscous_friction", (2,)),
        ("time_delay", ()),
    ]
    assert r.claims[3].coefficients == {"Fv": (2.0, 0.5)}
    assert r.claims[0].coefficients == {}  # what Fs means depends on vs
    assert [c.structural for c in r.claims] == [True, False, False, True, True]
    assert r.planted[0].coefficients == {"Fs": 0.3}
    assert r.not_testable == (("backlash", 1), ("payload", None))


def test_how_sure_is_compared_with_how_often_it_is_right():
    planted = {"name": "coulomb_friction", "family": "sign", "joints": [2], "felt_by": [2]}
    claim = {
        "effect": "coulomb_friction", "family": "sign", "joints": [2], "ambiguous_with": [],
        "how_sure": 0.9,
    }  # fmt: skip
    elsewhere = {**claim, "joints": [1], "how_sure": 0.6}
    silent = {k: v for k, v in claim.items() if k != "how_sure"}
    row = row_of(
        {"effects": [planted]}, {"status": "explained", "which": [claim, elsewhere, silent]}
    )
    assert stated_probabilities(row) == [(0.9, True), (0.6, False)]
    found = reliability(stated_probabilities(row) * 2)
    assert found["brier"] == pytest.approx((0.01 + 0.36) / 2)
    assert [(p["from"], p["hits"], p["total"]) for p in found["curve"]] == [
        (0.5, 0, 2),
        (0.8, 2, 2),
    ]
    assert reliability([]) == {"brier": None, "names": 0, "curve": []}
