"""Tables, sentences and the picture of wrench comparisons carry the numbers of what they show."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
import torch
from msgspec import structs
from rich.console import Console

from torchid.report.table import Table
from torchid.results.files import load
from torchid.robot.library import load_robot
from torchid_study.equal_torque.given_sets import GivenSets
from torchid_study.equal_torque.given_sets import given_sets as compare_given
from torchid_study.equal_torque.study import (
    EqualTorqueRecord,
    EqualTorqueStudy,
    equal_torque_study,
)
from torchid_study.report.wrenches import (
    findings,
    report_of_equal_torque,
    report_of_given_sets,
)
from torchid_study.wrenches.resampling import Estimate

KINDS = ("feasible", "inertia", "com", "inertia+com")


@lru_cache
def study() -> EqualTorqueStudy:
    return equal_torque_study(load_robot("3r"), per_kind=18, chains=12, kinds=KINDS, resamples=30)


@lru_cache
def given() -> GivenSets:
    s = study().setting
    sets = study().family.sets
    return compare_given(s.robot, sets, s.nominal, s.conditions, study().motion, resamples=20)


def text_of(tables: list[Table]) -> str:
    console = Console(width=220, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    for table in tables:
        console.print(table)
    return console.export_text()


def line_of(text: str, start: str) -> str:
    return next(x for x in text.splitlines() if x.strip().startswith(start))


@pytest.mark.nightly
def test_masses_alone_count_only_where_their_weight_is_the_error() -> None:
    def told(share: tuple[float, float, float]) -> str:
        return findings(structs.replace(study().record, static_share=share))[1]

    assert "what counts is how far the masses are off" in told((0.99, 0.97, 1.02))
    for share in ((0.5, 0.11, 0.9), (0.0, 0.0, 0.0), (1.0, 0.98, 1.3)):
        assert "what counts" not in told(share)
        assert f"{100 * share[0]:.3g} % of the force error" in told(share)


def test_tables_of_families_carry_their_numbers() -> None:
    kinds, effects, reach = report_of_equal_torque(study().record).parts
    text = text_of([kinds])
    for kind in KINDS:
        rows = study().rows(kind)
        line = line_of(text, f"{kind} ")
        assert f"{float(study().worst[rows].quantile(0.5)):.3g}" in line
        for value in study().errors.force_rms[rows].quantile(0.5, dim=0).tolist():
            assert f"{value:.3g}" in line
    effect = study().comparison.effects[0]
    shown = f"{effect.ratio.value:.2f} [{effect.ratio.low:.2f}, {effect.ratio.high:.2f}]"
    assert shown in text_of([effects])
    for r in study().reach:
        assert f"{float(r.reached[1]):.3g}" in line_of(text_of([reach]), f"{r.kind} ")


def with_ratio(low: float, high: float) -> EqualTorqueRecord:
    base = study().record
    found = Estimate((low * high) ** 0.5, low, high, 20)
    effects = tuple(replace(e, ratio=found, delta=found) for e in base.comparison.effects)
    rho = Estimate(-0.5, *(-1.0 / low, low - 1.0), 20)
    rows = tuple(replace(c, degree=rho) for c in base.correlations)
    return structs.replace(
        base,
        comparison=replace(base.comparison, effects=effects),
        correlations=rows,
    )


def test_sentences_follow_the_intervals() -> None:
    clear = " ".join(findings(with_ratio(1.2, 3.0)))
    assert "not distinguishable" not in clear
    vague = " ".join(findings(with_ratio(0.8, 3.0)))
    assert vague.count("not distinguishable") == 3
    nan = float("nan")
    none = " ".join(findings(with_ratio(nan, nan)))
    assert "too few independent chains" in none
    degree = with_ratio(0.5, 2.0)
    assert "firmer ones have smaller errors" in " ".join(findings(degree))
    degree = with_ratio(1.5, 2.0)
    assert "no effect of the degree is visible" in " ".join(findings(degree))


def test_the_picture_shows_all_sets(tmp_path) -> None:
    # In memory and read back it is the same.
    study().save(tmp_path / "w.json")
    for result in (study(), load(tmp_path / "w.json")):
        axes = result.plot("force_by_degree").axes[0]
        assert {c.get_label() for c in axes.collections} == set(KINDS)
        marks = np.concatenate([c.get_offsets() for c in axes.collections])
        np.testing.assert_allclose(np.sort(marks[:, 1]), np.sort(study().worst.numpy()))
        np.testing.assert_allclose(np.sort(marks[:, 0]), np.sort(study().degree.numpy()))


def test_given_sets_are_listed_with_their_reasons() -> None:
    shown = report_of_given_sets(given().record)
    text = text_of(shown.parts)
    worst = given().errors.force_rms.amax(-1)
    # The table has the 40 with the largest errors.
    for k in worst.argsort(descending=True)[:40:13].tolist():
        line = line_of(text, given().sets.ids[k])
        assert f"{float(given().errors.force_rms[k, 1]):.3g}" in line
        for reason in given().checked.reasons(k):
            assert reason in line
    assert f"and {float(worst.max()):.3g} N ({given().sets.ids[int(worst.argmax())]})" in shown.last


def test_one_given_set_is_enough() -> None:
    s = study().setting
    one = compare_given(s.robot, s.nominal, s.nominal, s.conditions, study().motion, resamples=5)
    shown = report_of_given_sets(one.record)
    assert len(shown.parts) == 1
    assert "error over the joints is 0 N (3r)" in shown.last
    assert torch.equal(one.errors.force_rms, torch.zeros(1, 3, dtype=torch.float64))
    assert list(shown.figures) == ["force_by_degree"]
