"""A small sealed set, made, diagnosed and scored: the score must not fall."""

import shutil

import pytest

from tests.golden.sentences import KEPT
from torchid.gap.settings import GapSettings
from torchid.statistics.proportion import wilson
from torchid_bench.withheld.case_set import keys_beside, make, read_answers, read_keys
from torchid_bench.withheld.run import jobs_of, run
from torchid_bench.withheld.score import summary

SEED, CASES = 101, 12
"""Of the development: releases are scored on others (docs/withheld.md)."""

RECORDED = 8, 9
"""Right answers, of those that can be wrong: no effect, parameters alone, one effect (in its set),
outside the library (no wrong family for sure), poor data (said so, or right)."""


@pytest.mark.nightly
@pytest.mark.usefixtures("types_unchecked")
def test_the_score_is_not_below_the_recorded_one(tmp_path):
    cases = make(tmp_path / "set", CASES, SEED, jobs=2)
    run(jobs_of(cases, GapSettings()), jobs=2)
    answers = read_answers(cases)
    # `make nightly` ends with the sentences of the answers in build/answers, and reads these there.
    KEPT.mkdir(parents=True, exist_ok=True)
    for case in cases.ids:
        shutil.copy(cases.answer(case), KEPT / f"sealed_{case}.json")
    scores = summary(cases, read_keys(cases, keys_beside(cases.folder)), answers)["scores"]
    assert scores["errors"] == []
    wrong = [
        scores["false_alarms"]["all"],
        scores["parameters"]["structural"],
        scores["outside"]["confident_wrong"],
    ]
    right = [scores["single"]["in_set"], scores["poor"]["honest"]]
    total = sum(rate["total"] for rate in (*wrong, *right))
    hits = sum(rate["total"] - rate["hits"] for rate in wrong) + sum(r["hits"] for r in right)
    assert total == RECORDED[1]
    assert hits >= wilson(*RECORDED)[0] * total, scores
