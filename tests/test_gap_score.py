"""Tables of the gap benchmark, against counts by hand; its scores are the product's."""

from typing import Any

from tests.benchmarks import loaded
from tests.withheld.test_measures import FAMILIES

score = loaded("gap_score")


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


def test_nothing_tried_says_nothing() -> None:
    assert score.share(0, 0) == "-"


def test_alarms_are_told_apart() -> None:
    quiet = score.alarms(row([], [], "no_gap"))
    assert not any(quiet.values())
    inertial = score.alarms(row([], [claim("link_inertia", [2])], "parametric_only"))
    assert inertial == {"finding": False, "parametric": True, "status": True, "any": True}
    unsure = score.alarms(row([], [], "not_testable"))
    assert not any(unsure.values())


def test_rows_are_scored_as_the_product_does() -> None:
    truth = [planted("coulomb_friction", [1])]
    found = [claim("viscous_friction", [1], 0.2), claim("coulomb_friction", [1], 0.7)]
    r = row(truth, found)
    assert [c.name for c in score.claims(r)] == ["coulomb_friction", "viscous_friction"]
    assert score.identified(r).top1
    assert not score.identified(r).exact
    assert score.joint_counts(row(truth, [claim("base_tilt", [])])) == (1, 1, 0)
    assert score.matched(r, strict=True) == (1, 1, 0)
    assert score.without_its_name(row(truth, found[:1]), FAMILIES) == "confident_wrong"


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
