"""What is named of arms with a background is right, of a small thing that is there, or false."""

import pytest

from tests.torchid_bench.withheld.fakes import answer, entry
from torchid_bench.withheld.background_score import background_scores


def key(case, kind, *effects, earlier=False):
    planted = [
        {"name": name, "family": family, "acceptable": akin, "joints": [joint],
         "felt_by": [joint], "parameters": {"F0": 1.0}, "size": 0.05}
        for name, family, joint, akin in effects
    ]  # fmt: skip
    return {"id": case, "kind": kind, "earlier": earlier, "effects": planted}


def named(effect, family, joint, own, when=None, share=0.5, ambiguous=(), **coefficients):
    one = entry(effect, family, joint, ambiguous=ambiguous, share=share)
    values = {name: value for name, (value, _) in coefficients.items()}
    std = {name: s for name, (_, s) in coefficients.items()}
    return one | {
        "probabilities": {effect: own}, "when": when, "parameters": values, "std": std
    }  # fmt: skip


OFFSET = ("torque_offset", "constant", 2, ())
DECIDABLE = {"in_practice": {"class": "decidable"}, "ideally": {"class": "decidable"}}
UNDECIDABLE = {"in_practice": {"class": "undecidable"}, "ideally": {"class": "decidable"}}


def scores(key, answered, classes=(DECIDABLE,)):
    return background_scores([key], {key["id"]: answered}, {key["id"]: list(classes)})


def share(scores, *path):
    for name in path:
        scores = scores[name]
    return scores["hits"], scores["total"]


SMALL = named("coulomb_friction", "sign", 1, 0.99, share=0.8)
RIGHT = named("torque_offset", "constant", 2, 0.95, share=0.1, F0=(1.15, 0.1))
ELSEWHERE = named("torque_offset", "constant", 3, 0.95, share=0.1)
SET = named("joint_spring", "gravity", 2, 0.6, ambiguous=("torque_offset",))


@pytest.mark.parametrize(
    ("which", "earlier", "strictly", "beside", "in_set", "false"),
    [
        ([RIGHT], False, 1, 1, 1, 0),
        # A small thing that is there is larger: right beside it, but for an arm that is known.
        ([SMALL, RIGHT], False, 0, 1, 1, 0),
        ([SMALL | {"when": "new"}, RIGHT | {"when": "new"}], True, 0, 0, 0, 1),
        ([SMALL | {"when": "in both"}, RIGHT | {"when": "new"}], True, 1, 1, 1, 0),
        ([ELSEWHERE], False, 0, 0, 0, 1),
        ([SET], False, 0, 0, 1, 0),
        ([], False, 0, 0, 0, 0),
    ],
)
def test_a_decidable_effect_is_named_or_not(which, earlier, strictly, beside, in_set, false):
    found = scores(key("a", "single", OFFSET, earlier=earlier), answer("explained", *which))
    first = found["first"]["in_practice"]
    assert share(first, "strictly") == (strictly, 1)
    assert share(first, "beside_small") == (beside, 1)
    assert share(first, "in_set") == (in_set, 1)
    assert share(found, "cases_with_false_sure") == (false, 1)


def test_what_cannot_be_known_is_not_asked_for():
    found = scores(key("a", "single", OFFSET), answer("no_gap"), [UNDECIDABLE])
    assert share(found, "first", "in_practice", "strictly") == (0, 0)
    assert share(found, "first", "ideally", "strictly") == (0, 1)
    assert found["classes"]["in_practice"] == {"undecidable": 1}


def test_sizes_are_held_against_their_deviations():
    found = scores(key("a", "single", OFFSET), answer("explained", RIGHT))
    assert share(found, "within", "1") == (0, 1)
    assert share(found, "within", "1.96") == (1, 1)
    assert share(found, "sure") == (1, 1)


@pytest.mark.parametrize(
    ("which", "status", "likely", "sure", "unexplained"),
    [
        ([], "no_gap", 0, 0, 0),
        ([], "detected_unexplained", 0, 0, 1),
        ([SMALL], "explained", 0, 0, 0),
        ([SMALL | {"when": "in both"}], "explained", 0, 0, 0),
        ([SET], "explained", 1, 0, 0),
        ([ELSEWHERE], "explained", 1, 1, 0),
    ],
)
def test_of_a_healthy_arm_nothing_is_to_be_named(which, status, likely, sure, unexplained):
    found = scores(key("a", "none"), answer(status, *which), ())
    assert share(found, "nothing", "likely") == (likely, 1)
    assert share(found, "nothing", "sure") == (sure, 1)
    assert share(found, "nothing", "unexplained") == (unexplained, 1)


def test_a_log_without_an_answer_has_named_nothing():
    planted = key("a", "single", OFFSET)
    found = scores(planted, answer("refused"))
    assert share(found, "first", "in_practice", "strictly") == (0, 1)
    assert share(found, "cases_with_false_sure") == (0, 0)


@pytest.mark.parametrize(
    ("which", "status", "honest"),
    [
        ([], "detected_unexplained", 1),
        ([], "no_gap", 0),
        ([named("presliding_hysteresis", "hysteresis", 2, 0.8)], "explained", 1),
        ([named("joint_spring", "gravity", 2, 0.8)], "explained", 0),
        ([named("joint_spring", "gravity", 2, 0.8)], "partly_explained", 1),
        ([named("joint_spring", "gravity", 2, 0.99)], "partly_explained", 0),
        ([named("presliding_hysteresis", "hysteresis", 3, 0.8)], "explained", 0),
    ],
)
def test_of_an_effect_of_no_library_an_honest_answer_is_right(which, status, honest):
    creep = key("a", "outside", ("creep", "outside", 2, ("hysteresis", "phase")))
    assert share(scores(creep, answer(status, *which)), "outside") == (honest, 1)


@pytest.mark.parametrize(
    ("name", "others", "false"),
    [
        # Small things of servos, and a name without a probability of its own.
        ("motor_dependent_friction", [], 0),
        ("torque_offset", [], 0),
        ("command_gain", ["joint_spring"], 0),
        ("command_gain", [], 1),
        # One of torques is none of servos.
        ("coulomb_friction", [], 1),
    ],
)
def test_servos_have_small_things_of_their_own(name, others, false):
    cause = {
        "effect": name, "family": "servo", "joints": [1], "ambiguous_with": others,
        "parameters": {}, "ci95": {}, "error_without_mrad": 2.0, "error_with_mrad": 1.0,
        "how_sure": 0.95,
    }  # fmt: skip
    said = answer("explained", cause) | {
        "schema": "torchid.position_gap/1", "where": {"joints": [{}, {}]}
    }  # fmt: skip
    outcome = scores(key("a", "none"), said, ())
    assert share(outcome, "cases_with_false_sure") == (false, 1)
    assert share(outcome, "nothing", "sure") == (false, 1)
