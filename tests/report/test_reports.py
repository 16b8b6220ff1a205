"""Tables and figures carry the numbers of the result they show."""

from dataclasses import replace

import pytest
import torch
from rich.console import Console

from tests.gap.diagnoses import diagnosis
from torchid.errors import TorchidError
from torchid.excitation.synthetic import HonestNoise, synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.feasibility.sets import nominal_set
from torchid.identification.identify import Settings, identify
from torchid.report.identification import (
    parameter_figure,
    tables,
    torque_figure,
)
from torchid.report.log import trajectory_figure
from torchid.report.panels import save
from torchid.robot.library import load_robot


@pytest.fixture(scope="module")
def result():
    robot = load_robot("3r_friction")
    motion = trajectory_log(random_trajectory(robot, 0, fill=True), 100.0)
    log = synthetic_log(robot, motion, HonestNoise(), 0)
    return identify(robot, log, settings=Settings(cutoff=8.0, held_out_fraction=0.3))


def text_of(result) -> str:
    console = Console(width=200, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    for table in tables(result):
        console.print(table)
    return console.export_text()


def test_tables_show_every_parameter_with_its_value(result):
    base, effects, _ = tables(result)
    rows = [*base.rows, *effects.rows]
    assert tuple(row[0] for row in rows) == result.base.names
    for row, value, std in zip(rows, result.values.tolist(), result.std.tolist(), strict=True):
        assert float(row[1].split()[0]) == pytest.approx(value, abs=0.51 * std)


def test_tables_show_the_errors(result):
    text = text_of(result)
    for e in (result.fit, result.held_out):
        for value in e.relative_percent.tolist():
            assert f"{value:.3g}" in text


def test_absorbed_and_held_coefficients_are_marked(result):
    base, effects, _ = tables(replace(result, free=torch.arange(len(result.free)) > 0))
    assert effects.note.endswith("In sums with base parameters: Ia1 and Ia2.")
    assert [row[-1] for row in base.rows] == ["no"] + 14 * ["yes"]
    assert base.rows[0][2:4] == ["-", "-"]  # neither deviation nor interval
    assert {row[-1] for row in effects.rows} == {"yes"}


def test_everything_prints_as_one_line(result):
    log = trajectory_log(random_trajectory(result.robot, 0), 10.0)
    robot = load_robot("3r")
    for thing in (result, result.robot, log, nominal_set(robot), diagnosis()):
        assert "\n" not in repr(thing)
        assert len(repr(thing)) < 200
    assert "3r_friction" in repr(result)
    assert "15 base parameters" in repr(result)


def test_predict_takes_arrays(result):
    q, dq, ddq = torch.rand(3, 5, 3, dtype=torch.float64, generator=torch.Generator())
    own = result.predict(q, dq, ddq)
    torch.testing.assert_close(
        result.predict(q.numpy(), dq.tolist(), ddq), own, rtol=1e-12, atol=1e-12
    )
    torch.testing.assert_close(
        result.residual(q, dq, ddq, own.numpy()), torch.zeros_like(own), rtol=1e-12, atol=1e-12
    )
    assert result.predict([0, 0, 0], [0, 0, 0], [0, 0, 0]).dtype == torch.float64
    with pytest.raises(TorchidError, match="one column a joint"):
        result.predict(q[:, :2].numpy(), dq.numpy(), ddq.numpy())
    with pytest.raises(TorchidError, match="table of numbers"):
        result.predict(["a"], dq, ddq)


def test_figures_draw_the_data(result, tmp_path):
    prediction = result.held_out_predictions[0]
    figure = torque_figure(prediction, ["N m"] * 3, "title")
    assert len(figure.axes) == 6
    drawn = figure.axes[0].lines[0].get_ydata()
    assert drawn[0] == pytest.approx(float(prediction.measured[0, 0]))
    path = save(figure, tmp_path / "torque.png")
    assert path.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("rows", ["all", "moving"])
def test_torque_figures_show_the_rows_they_judge(result, rows):
    """A joint that rests for half of the time, with a residual of another size there."""
    whole = result.held_out_predictions[0]
    rests = torch.arange(len(whole.t)) < len(whole.t) // 2
    moving = whole.moving & ~rests.unsqueeze(-1)
    predicted = whole.predicted + 5.0 * rests.unsqueeze(-1)
    error = whole.measured - predicted
    sums = replace(
        whole.sums,
        error=error.square().sum(0),
        moving_error=(error * moving).square().sum(0),
        moving_torque=(whole.measured * moving).square().sum(0),
    )
    prediction = replace(whole, predicted=predicted, moving=moving, sums=sums)
    figure = torque_figure(prediction, ["N m"] * 3, "title", rows)
    judged = moving[:, 0] if rows == "moving" else torch.ones_like(moving[:, 0])
    right = figure.axes[1]
    drawn = torch.as_tensor(right.lines[0].get_ydata())
    assert torch.equal(torch.isfinite(drawn), judged)
    assert torch.equal(drawn[judged], error[judged, 0])
    low = right.get_ylim()[0]
    assert (low < -4.0) == (rows == "all")
    percent = 100 * float(error[judged, 0].norm() / whole.measured[judged, 0].norm())
    assert f"{percent:.1f} %" in [text.get_text() for text in right.texts]


@pytest.mark.slow
def test_the_parameter_figure_has_a_bar_for_each_free_parameter(result):
    free = int(result.free.sum())
    assert len(parameter_figure(result.record).axes[0].patches) == free


def test_trajectory_figure_shows_limits():
    robot = load_robot("3r")
    motion = trajectory_log(random_trajectory(robot, 0), 50.0)
    figure = trajectory_figure(robot, motion, "title")
    heights = [line.get_ydata()[0] for line in figure.axes[0].lines[1:]]
    assert sorted(heights) == pytest.approx([-2.8973, 2.8973])
