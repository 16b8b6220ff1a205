"""Scores of answers made by hand, counted by hand."""

from typing import Any

import pytest

from tests.torchid_bench.withheld.fakes import answer, entry
from torchid_bench.withheld.measures import micro_f1, rate
from torchid_bench.withheld.score import Scored, scored_case, scores

RIGHT = entry("coulomb_friction", "sign", 2)
WRONG = entry("viscous_friction", "speed", 1)
HEDGED = entry("stribeck_friction", "sign", 2, ambiguous=("coulomb_friction",))
COULOMB = ("coulomb_friction", "sign", 2)


def case(
    kind: str,
    said: dict[str, Any],
    *truth: tuple[str, str, int],
    name: str = "case-0001",
    colour: float | None = None,
    level: float | None = None,
    **more: Any,
) -> Scored:
    effects = [
        {"name": n, "family": f, "joints": [j], "felt_by": [j], "size": 5.0, **more}
        for n, f, j in truth
    ]
    key = {"id": name, "kind": kind, "colour_hz": colour, "level": level, "effects": effects}
    return scored_case(key, said)


QUIET = answer("no_gap")
FOUND = answer("explained", RIGHT, how_far={"closed": 0.9, "closed_ci95": [0.8, 0.95]})


def test_a_share_of_nothing_is_none():
    assert rate([]) == {"hits": 0, "total": 0, "share": None, "ci95": [0.0, 1.0]}
    assert rate([True, False])["share"] == 0.5
    assert micro_f1([])["f1"] is None


def test_intervals_hold_the_value():
    found = micro_f1([(1, 0, 0), (1, 1, 0), (0, 1, 1), (2, 0, 0)])
    assert found["f1"] == pytest.approx(8 / 11)
    assert found["ci95"][0] < found["f1"] < found["ci95"][1]


def test_false_alarms_by_colour():
    cases = [
        case("none", QUIET),
        case("none", answer("detected_unexplained")),
        case("none", answer("not_testable"), colour=5.0),
        case("none", FOUND, colour=5.0),
        case("none", FOUND, colour=5.0),
        case("none", answer("error"), colour=5.0),
        case("single", FOUND, COULOMB),
    ]
    found = scores(cases)["false_alarms"]
    assert [(found[k]["hits"], found[k]["total"]) for k in ("all", "white", "coloured")] == [
        (3, 5), (1, 2), (2, 3),
    ]  # fmt: skip


def test_wrong_parameters_must_not_become_effects():
    inertial = entry("link_inertia", "inertia", 3)
    payload = entry("payload", "inertia", 1, ambiguous=("link_inertia",))
    cases = [
        case("parameters", answer("parametric_only", inertial)),
        case("parameters", answer("explained", payload)),
        case("parameters", answer("explained", inertial, WRONG)),
        case("parameters", QUIET),
    ]
    found = scores(cases)["parameters"]
    assert (found["structural"]["hits"], found["structural"]["total"]) == (1, 4)
    assert found["found"]["hits"] == 3
    assert found["parametric_only"]["hits"] == 1


def test_names_of_single_effects():
    cases = [
        case("single", FOUND, COULOMB),
        case("single", answer("explained", HEDGED), COULOMB, colour=5.0),
        case("single", answer("explained", WRONG), COULOMB),
        case("single", QUIET, COULOMB),
        case("single", answer("error"), ("payload", "inertia", 1)),
    ]
    found = scores(cases)["single"]
    hits = {
        k: found[k]["hits"] for k in ("detected", "top1", "in_set", "family", "branch", "exact")
    }
    expected = {"detected": 3, "top1": 1, "in_set": 2, "family": 2, "branch": 2, "exact": 1}
    assert hits == expected
    assert found["set_size"] == pytest.approx(4 / 3)
    assert found["by_effect"]["coulomb_friction"]["top1"]["total"] == 4
    assert found["by_effect"]["payload"]["top1"]["hits"] == 0
    assert found["coloured"]["in_set"]["hits"] == 1
    joints = scores(cases)["joints"]
    assert (joints["hits"], joints["extra"], joints["missed"]) == (2, 1, 3)


def test_several_effects():
    pair = (COULOMB, ("viscous_friction", "speed", 1))
    triple = (*pair, ("payload", "inertia", 3))
    cases = [
        case("several", answer("explained", RIGHT, WRONG), *pair),
        case("several", answer("explained", HEDGED), *pair),
        case("several", answer("explained", RIGHT), *triple),
    ]
    found = scores(cases)["several"]
    counts = {
        (group, how): tuple(found[group][how][k] for k in ("hits", "extra", "missed"))
        for group in ("pairs", "triples", "all")
        for how in ("with_sets", "strict")
    }
    assert counts == {
        ("pairs", "with_sets"): (3, 0, 1),
        ("pairs", "strict"): (2, 1, 2),
        ("triples", "with_sets"): (1, 0, 2),
        ("triples", "strict"): (1, 0, 2),
        ("all", "with_sets"): (4, 0, 3),
        ("all", "strict"): (3, 1, 4),
    }


def test_outside_of_the_library():
    drag = ("air_drag", "outside", 1)
    cases = [
        case("outside", answer("explained", WRONG), drag),
        case("outside", answer("explained", WRONG), drag, acceptable=["speed"]),
        case("outside", answer("detected_unexplained", WRONG), drag),
        case("outside", QUIET, drag),
    ]
    found = scores(cases)["outside"]
    assert (found["confident_wrong"]["hits"], found["confident_wrong"]["total"]) == (1, 4)
    assert found["verdicts"] == {
        "confident_wrong": 1, "right_family": 1, "detected_unexplained": 1, "missed": 1,
    }  # fmt: skip
    assert found["by_cause"] == {"air_drag": found["verdicts"]}


def test_poor_data():
    cases = [
        case("poor", answer("not_testable"), COULOMB),
        case("poor", answer("explained", HEDGED), COULOMB),
        case("poor", FOUND, COULOMB),
        case("poor", answer("explained", WRONG), COULOMB),
        case("poor", QUIET, COULOMB),
    ]
    found = scores(cases)["poor"]
    assert found["honest"]["hits"] == 3
    assert found["not_testable_or_hedged"]["hits"] == 2


def test_coverage_of_coefficients():
    def found(value: float) -> dict[str, Any]:
        known = RIGHT | {"parameters": {"Fc": value}, "std": {"Fc": 0.1}}
        return answer("explained", known)

    truth = {"parameters": {"Fc": 1.0}}
    cases = [
        case("single", found(1.1), COULOMB, name="a", **truth),
        case("single", found(1.5), COULOMB, name="b", **truth),
        case("severity", found(0.9), COULOMB, name="c", level=5.0, **truth),
    ]
    coefficients = scores(cases)["coverage"]
    assert (coefficients["hits"], coefficients["total"]) == (2, 3)


def test_errors_and_statuses_are_listed():
    found = scores([case("none", answer("error"), name="x"), case("none", QUIET, name="y")])
    assert found["errors"] == ["x"]
    assert found["status"] == {"none": {"error": 1, "no_gap": 1}}
