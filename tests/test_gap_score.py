"""Scores of the gap benchmark, against counts by hand and against brute force."""

import importlib.util
import itertools
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import torch
from scipy.stats import binomtest

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"

FAMILIES = {
    "coulomb_friction": "sign",
    "stribeck_friction": "sign",
    "viscous_friction": "speed",
    "payload": "inertia",
    "link_inertia": "inertia",
    "base_tilt": "gravity",
}


def loaded() -> ModuleType:
    path = BENCHMARKS / "gap_score.py"
    spec = importlib.util.spec_from_file_location("gap_score", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


score = loaded()


def claim(
    name: str, place: list[int], share: float = 1.0, ambiguous: tuple[str, ...] = ()
) -> dict[str, Any]:
    return {
        "name": name,
        "family": FAMILIES[name],
        "place": place,
        "joints": place or [1, 2],
        "ambiguous": list(ambiguous),
        "share": share,
    }


def planted(name: str, place: list[int], joints: tuple[int, ...] = (1, 2, 3)) -> dict[str, Any]:
    return {
        "name": name,
        "family": FAMILIES[name],
        "place": place,
        "joints": place or list(joints),
        "size": 5.0,
    }


def row(
    truth: list[Any], found: list[Any], status: str = "explained", **more: Any
) -> dict[str, Any]:
    inertial = [c for c in found if c["name"] == "link_inertia"]
    others = [c for c in found if c["name"] != "link_inertia"]
    both = {"truth": truth, "status": status, "findings": others, "parametric": inertial}
    return {"colour_hz": None, "robot": "3r", "same_joint": False, "level": 5.0} | both | more


@pytest.mark.parametrize(("hits", "total"), [(0, 20), (3, 20), (20, 20), (1, 1), (50, 100)])
def test_wilson_is_the_textbooks_interval(hits: int, total: int) -> None:
    reference = binomtest(hits, total).proportion_ci(0.95, method="wilson")
    assert score.wilson(hits, total) == pytest.approx((reference.low, reference.high), abs=1e-4)


def test_nothing_tried_says_nothing() -> None:
    assert score.wilson(0, 0) == (0.0, 1.0)
    assert score.share(0, 0) == "-"


def test_alarms_are_told_apart() -> None:
    quiet = score.alarms(row([], [], "no_gap"))
    assert not any(quiet.values())
    inertial = score.alarms(row([], [claim("link_inertia", [2])], "parametric_only"))
    assert inertial == {"finding": False, "parametric": True, "status": True, "any": True}
    unsure = score.alarms(row([], [], "not_testable"))
    assert unsure == {"finding": False, "parametric": False, "status": True, "any": True}


def test_the_largest_share_is_the_top_claim() -> None:
    found = [claim("viscous_friction", [1], 0.2), claim("coulomb_friction", [1], 0.7)]
    s = score.identified(row([planted("coulomb_friction", [1])], found))
    assert s["top1"]
    assert s["in_set"]
    assert not s["exact"]
    swapped = score.identified(row([planted("viscous_friction", [1])], found))
    assert not swapped["top1"]
    assert swapped["in_set"]
    assert not swapped["family"]


def test_an_alternative_counts_for_the_set_and_not_for_the_name() -> None:
    found = [claim("stribeck_friction", [2], ambiguous=("coulomb_friction", "viscous_friction"))]
    s = score.identified(row([planted("coulomb_friction", [2])], found))
    assert (s["top1"], s["in_set"], s["family"], s["exact"]) == (False, True, True, False)
    assert s["set_size"] == 3


def test_exact_needs_the_joint() -> None:
    truth = [planted("coulomb_friction", [2])]
    assert score.identified(row(truth, [claim("coulomb_friction", [2])]))["exact"]
    assert not score.identified(row(truth, [claim("coulomb_friction", [3])]))["exact"]


def test_silence_is_no_set() -> None:
    s = score.identified(row([planted("payload", [])], [], "no_gap"))
    assert s == {
        "detected": False,
        "top1": False,
        "in_set": False,
        "set_size": None,
        "family": False,
        "exact": False,
    }


def test_joints_of_the_whole_arm_are_those_that_feel_it() -> None:
    found = [claim("base_tilt", [])]  # felt on joints 1 and 2
    assert score.joint_counts(row([planted("payload", [], (1, 2, 3))], found)) == (2, 0, 1)
    assert score.joint_counts(row([planted("coulomb_friction", [2])], found)) == (1, 1, 0)


def test_f1_is_the_harmonic_mean_of_precision_and_recall() -> None:
    hits, extra, missed = 3, 2, 5
    precision, recall = hits / (hits + extra), hits / (hits + missed)
    assert score.f1((hits, extra, missed)) == pytest.approx(
        2 * precision * recall / (precision + recall)
    )
    assert score.f1((0, 0, 0)) == 1.0


def test_one_claim_is_not_two_hits() -> None:
    truth = [planted("coulomb_friction", [1]), planted("stribeck_friction", [1])]
    found = [claim("stribeck_friction", [1], ambiguous=("coulomb_friction",))]
    assert score.matched(row(truth, found), strict=False) == (1, 0, 1)
    assert score.matched(row(truth, found), strict=True) == (1, 0, 1)


def test_strict_hits_need_name_and_joint() -> None:
    truth = [planted("coulomb_friction", [1]), planted("viscous_friction", [2])]
    found = [
        claim("stribeck_friction", [1], ambiguous=("coulomb_friction",)),
        claim("viscous_friction", [3]),
    ]
    assert score.matched(row(truth, found), strict=False) == (1, 1, 1)
    assert score.matched(row(truth, found), strict=True) == (0, 2, 2)


def test_an_effect_of_the_whole_arm_is_on_every_joint() -> None:
    found = [claim("link_inertia", [3], ambiguous=("payload",))]
    assert score.matched(row([planted("payload", [])], found), strict=False) == (1, 0, 0)
    assert score.matched(row([planted("payload", [])], found), strict=True) == (0, 1, 1)


def test_largest_matching_beats_no_assignment() -> None:
    generator = torch.Generator().manual_seed(0)
    for _ in range(50):
        fits = (torch.rand(4, 4, generator=generator) < 0.35).tolist()
        best = max(
            sum(fits[i][j] for i, j in enumerate(order))
            for order in itertools.permutations(range(4))
        )
        assert score.largest_matching(fits) == best


@pytest.mark.parametrize(
    ("found", "status", "verdict"),
    [
        ([], "no_gap", "missed"),
        ([claim("stribeck_friction", [1])], "explained", "right_family"),
        ([claim("viscous_friction", [1])], "explained", "confident_wrong"),
        ([claim("link_inertia", [1])], "parametric_only", "confident_wrong"),
        ([claim("viscous_friction", [1], 1.0, ("stribeck_friction",))], "explained", "hedged"),
        ([claim("viscous_friction", [1])], "detected_unexplained", "detected_unexplained"),
    ],
)
def test_what_is_said_without_the_name(found: list[Any], status: str, verdict: str) -> None:
    r = row([planted("coulomb_friction", [1])], found, status)
    assert score.without_its_name(r, FAMILIES) == verdict


def test_coverage_is_two_sided() -> None:
    assert score.inside(1.0, 0.1, 1.19)
    assert score.inside(1.0, 0.1, 0.81)
    assert not score.inside(1.0, 0.1, 1.2)


def test_rates_count_by_size() -> None:
    truth = [planted("coulomb_friction", [1])]
    rows = [
        row(truth, [], "no_gap", level=0.1),
        row(truth, [], "detected_unexplained", level=1.0),
        row(truth, [claim("coulomb_friction", [1])], level=1.0),
    ]
    assert score.rates(rows) == {"coulomb_friction": {0.1: (0, 0, 1), 1.0: (2, 1, 2)}}


def test_tables_are_markdown_with_a_row_a_group() -> None:
    truth = [planted("coulomb_friction", [1])]
    rows = [row(truth, [claim("coulomb_friction", [1])]), row(truth, [], "no_gap", colour_hz=5.0)]
    for text, lines in (
        (score.single_table(rows), 6),
        (score.severity_table(rows), 3),
        (score.several_table(rows), 6),
        (score.withheld_table(rows, FAMILIES), 4),
        (score.closing_table(rows), 4),
        (score.none_table(rows), 6),
    ):
        every = text.splitlines()
        assert len(every) == lines
        assert len({line.count("|") for line in every}) == 1
    assert "| coulomb_friction | 1/2 | 1/2 | 1/2 | 1/2 |" in score.single_table(rows)


def test_closing_rows_give_ratios_and_coverage() -> None:
    truth = [planted("coulomb_friction", [1])]
    inside = {"coefficient": "Fc", "true": 1.0, "value": 1.05, "std": 0.1}
    outside = inside | {"true": 2.0}
    rows = [
        row(truth, [], closed=0.8, oracle_closed=1.0, closed_ci95=(0.7, 0.9), fresh_closed=0.75,
            oracle_fresh_closed=0.95, coverage=[inside, outside]),
        row(truth, [], closed=None, closed_ci95=None, oracle_closed=0.9, fresh_closed=0.1),
    ]  # fmt: skip
    cells = score.closing_table(rows).splitlines()[-1].split(" | ")
    assert cells[2:7] == ["0.80", "1.00", "0.80", "0.42", "0.95"]
    assert cells[7].startswith("1/1")
    assert cells[8].startswith("1/2")
