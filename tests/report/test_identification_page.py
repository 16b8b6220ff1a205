"""The page of an identification says what the identification holds."""

import math
import re
from dataclasses import replace

import pytest
from msgspec import structs

from tests.report.page.reading import parsed, rows_of, text_of
from tests.report.test_gap_page import made
from torchid.excitation.synthetic import HonestNoise, synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.identification.identify import Identification, identify
from torchid.report.identification import identification_page, verdict
from torchid.report.page.document import render
from torchid.robot.library import load_robot


@pytest.fixture(scope="module")
def result() -> Identification:
    robot = load_robot("3r_friction")
    logs = [
        synthetic_log(robot, trajectory_log(random_trajectory(robot, s, fill=True), 100.0),
                      HonestNoise(), s)
        for s in (0, 1)
    ]  # fmt: skip
    return identify(robot, logs[0], held_out=logs[1])


@pytest.fixture(scope="module")
def tree(result):
    return parsed(render(identification_page(result, made())))


@pytest.mark.slow
def test_numbers_are_those_of_the_json(result, tree):
    data = result.plain()
    rows = rows_of(tree, "with scaled columns)")
    assert [row[0] for row in rows] == [p["name"] for p in data["parameters"]]
    for row, p in zip(rows, data["parameters"], strict=True):
        value, std, unit = re.fullmatch(r"(\S+) ± (\S+) (.*)", row[1]).groups()
        assert unit == p["unit"].replace("^2", "²")
        # As many digits as the standard deviation leaves.
        assert float(value) == pytest.approx(p["value"], abs=0.51 * p["std"])
        assert float(std) == pytest.approx(p["std"], rel=0.35)
        assert float(row[2]) == pytest.approx(p["relative_std_percent"], rel=5e-3)
        low, high = (float(x) for x in row[3].split(" .. "))
        assert [low, high] == pytest.approx(p["ci95"], rel=1e-3)
    effects = rows_of(tree, "Coefficients of the effects")
    assert len(rows) + len(effects) == len(result.base)
    (moving,) = (r for r in rows_of(tree, "less in slow logs)") if r[0] == "held out, moving")
    expected = data["held_out"]["relative_error_percent_moving"]
    assert [float(x) for x in moving[1:4]] == pytest.approx(expected, rel=5e-3)


def test_verdict(result, tree):
    said = verdict(result)
    assert text_of(tree, "verdict") == said
    errors = result.held_out.relative_percent_moving
    best, worst = int(errors.argmin()), int(errors.argmax())
    assert said.startswith("On motion that was held out the model misses the torque by ")
    assert f"(joint {best + 1}) to " in said
    assert f"(joint {worst + 1}) of its size while the joint moves; " in said
    half = result.uncertainty.quantile() * result.relative_std_percent
    poor = int((half[result.free] > 100).sum())
    assert (f"{poor} are not distinguishable from zero" in said) == (poor > 0)
    assert said.count(". ") == 0
    unsure = verdict(replace(result, covariance=1e6 * result.covariance))
    assert f"{int(result.free.sum())} are not distinguishable from zero" in unsure


def test_verdict_without_held_out_motion(result):
    said = verdict(replace(result, held_out=None, held_out_predictions=()))
    assert "was fitted to (none was held out)" in said


def test_verdict_of_what_is_not_determined_and_of_joints_that_rest(result):
    errors = structs.replace(result.held_out, relative_percent_moving=result.values[:3] * math.nan)
    said = verdict(replace(result, held_out=errors, undetermined=("m1",)))
    assert said.startswith("No joint moves in motion that was held out")
    assert "1 not determined at all (m1)" in said
    alone = result.held_out.relative_percent_moving.clone()
    alone[:2] = math.nan
    alone[2] = 72.0
    said = verdict(replace(result, held_out=structs.replace(errors, relative_percent_moving=alone)))
    assert "by 72.0 % of its size while the joint moves and is of no use there" in said


@pytest.mark.slow
def test_pictures(result, tree):
    assert len(list(tree.iter("figure"))) == 2
    fitted = replace(result, held_out=None, held_out_predictions=())
    assert "fitted data" in render(identification_page(fitted, made()))
