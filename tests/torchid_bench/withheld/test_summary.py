"""A scored set as data and as a table."""

import json

import pytest

from tests.torchid_bench.withheld.fakes import answer, draw_case, entry, key_of
from torchid_bench.report.withheld import LINES, score_table
from torchid_bench.withheld.case_set import CaseSet
from torchid_bench.withheld.score import summary

RIGHT = answer("explained", entry("coulomb_friction", "sign", 2))
WRONG = answer("explained", entry("viscous_friction", "speed", 1))


@pytest.fixture
def cases(tmp_path):
    return CaseSet(tmp_path, 0, ("case-0001", "case-0002", "case-0003"), "ab" * 32, "0.1.0")


@pytest.fixture
def keys(cases):
    """Of the kinds none, single, outside."""
    return [key_of(draw_case(0, k)) | {"id": case} for k, case in enumerate(cases.ids)]


@pytest.fixture
def answers(cases):
    return dict(zip(cases.ids, (answer("no_gap"), RIGHT, WRONG), strict=True))


def test_every_case_is_listed_with_what_was_said(cases, keys, answers):
    found = summary(cases, keys, answers)
    assert found["schema"] == "torchid.withheld.score/1"
    assert [c["right"] for c in found["answers"]] == [True, True, False]
    assert found["answers"][1]["planted"][0]["joints"] == [2]
    assert found["answers"][2]["named"][0]["name"] == "viscous_friction"
    assert found["kinds"] == {"none": 1, "single": 1, "outside": 1}
    json.dumps(found, allow_nan=False)


def test_every_line_has_a_value_and_targets_can_be_missed(cases, keys, answers):
    good = summary(cases, keys, answers)["scores"]
    bad = summary(cases, keys, dict.fromkeys(cases.ids, WRONG))["scores"]
    met = {line.label: (line.met(good), line.met(bad)) for line in LINES}
    assert met["false alarms, white noise"] == (True, False)
    assert met["one effect: first name right"] == (True, False)
    assert met["one effect: family right"] == (True, False)
    assert met["joints, F1"] == (True, False)
    assert met["outside: wrong family for sure"] == (False, False)
    for line in LINES:
        assert line.label
        assert line.path
        assert line.target or line.met(good) is None


def test_the_table_has_what_there_are_cases_for(cases, keys, answers):
    found = summary(cases, keys, answers)
    known = [line for line in LINES if line.value(found["scores"]) is not None]
    assert 5 < len(known) < len(LINES)
    assert len(score_table(found, LINES).rows) == len(known)
