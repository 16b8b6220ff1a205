"""Figures of a diagnosis draw its data."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
import torch
from msgspec import structs

from tests.gap.diagnoses import coulomb, diagnosis, floor, some_left, trace
from tests.marks import quick_first
from torchid.errors import TorchidError
from torchid.report.diagnosis import report_of_diagnosis
from torchid.report.friction import (
    MOST_SAMPLES,
    friction_figure,
    friction_picture,
    friction_table,
)
from torchid.report.gap_figures import binned, joint_figure, map_figure, samples, worst_joints
from torchid.report.over_time import torque_over_time
from torchid.report.panels import save
from torchid.results.friction import FrictionAt, FrictionCurve, FrictionLaw
from torchid.results.record import Rows
from torchid.results.words import span


@pytest.mark.parametrize("status", quick_first(["explained", "no_gap"], 1))
def test_every_figure_is_drawn(status, tmp_path):
    drawn = report_of_diagnosis(diagnosis(status)).figures
    assert set(drawn) == {"where", "joint_2", "torque", "motion"}
    for name, draw in drawn.items():
        assert save(draw(), tmp_path / f"{name}.png").stat().st_size > 5000


@pytest.mark.parametrize("source", ["repeats", "bracket"])
def test_pictures_have_the_noise_of_the_answer(source):
    """Without repeats the lowest that it may be, and not what the residual would be as noise."""
    d = diagnosis(floor=structs.replace(floor(), source=source))
    noise = d.answer.joints[1].noise
    width, over_time = noise[source == "repeats"], torque_over_time(d)
    for figure in (joint_figure(d, 1), over_time.draw(1)):
        bands = [p for axes in figure.axes for p in axes.patches if "noise" in p.get_label()]
        assert bands
        for band in bands:
            assert band.get_label() == f"noise, RMS {span(noise, 2)}"
            assert (band.get_y(), band.get_height()) == pytest.approx((-width, 2 * width))


@pytest.mark.slow
def test_figures_of_invalid_instants_zero_noise_and_two_trajectories(tmp_path):
    made = trace(coulomb, some_left, seconds=12.0)
    valid = made.valid.clone()
    valid[1000:1500] = False
    measured = made.measured.clone()
    measured[1000:1500] = torch.nan
    traces = (
        replace(made, valid=valid, measured=measured),
        trace(coulomb, seconds=3.0, rate=100.0),
    )
    d = diagnosis(traces=traces, floor=floor(noise=0.0))
    for name, draw in report_of_diagnosis(d).figures.items():
        save(draw(), tmp_path / f"{name}.png")


def with_friction(**given: float):
    """A diagnosis whose joint 2 has the planted friction as its law; `given` of it the model's."""
    speed = (-1.0, -0.1, 0.1, 1.0)
    own = tuple(given.get("Fc", 0.0) * x for x in np.sign(speed))
    law = FrictionLaw(
        joint=1, how_sure=0.99, share=0.5, removes=(0.0, 1.0, 0.0), unit="N m", speed_unit="rad/s",
        details=(), at=(FrictionAt(0.5, 1.0, 0.1, -1.0, 0.1),),
        curve=FrictionCurve(speed, (-1.2, -1.0, 1.0, 1.2), (0.1,) * 4, own),
    )  # fmt: skip
    return diagnosis(friction=Rows([law]))


@pytest.mark.parametrize("Fc", [0.0, 0.3])
def test_the_model_without_its_friction_is_drawn_under_the_law(Fc, tmp_path):
    d = with_friction(Fc=Fc)
    (axes,) = (a for a in friction_figure(d).axes if a.get_visible())
    points = axes.collections[0].get_offsets()
    # Points are the gap and what the model has of friction already.
    gap = samples(d.traces, 1)
    some = slice(None, None, max(1, len(gap["dq"]) // MOST_SAMPLES))
    expected = gap["before"][some] + Fc * np.sign(gap["dq"][some])
    assert np.allclose(points[:, 1], expected)
    labels = axes.get_legend_handles_labels()[1]
    assert ("model as given" in labels) == (Fc > 0)
    assert save(friction_figure(d, narrow=True), tmp_path / "narrow.png").stat().st_size > 5000
    assert "friction" in report_of_diagnosis(d).figures


def test_a_joint_without_friction_has_no_figure_of_it():
    with pytest.raises(TorchidError, match="no friction law"):
        friction_figure(with_friction(), joint=0)
    assert friction_picture(diagnosis()) is None


def test_its_table_has_both_ways_and_what_is_not_driven():
    d = with_friction()
    table = friction_table(d.record)
    assert table.rows[0][0] == "2"
    assert "at 0.5 rad/s: 1.00 ± 0.10 N m; -1.00 ± 0.10 N m" in table.rows[0][2]
    one_way = FrictionAt(0.5, 1.0, 0.1, np.nan, np.nan)
    law = msgspec.structs.replace(d.friction[0], at=(one_way,))
    assert "not driven" in friction_table(replace(d, friction=Rows([law])).record).rows[0][2]


def test_no_traces_no_joint_figures():
    assert set(report_of_diagnosis(diagnosis(traces=())).figures) == {"where"}


def test_a_map_that_would_be_empty_is_not_drawn():
    assert "where" not in report_of_diagnosis(diagnosis(regimes=())).figures


def test_map_shows_clear_cells_only():
    texts = [t.get_text() for t in map_figure(diagnosis().record).axes[0].texts]
    assert sorted(t for t in texts if t != "·") == ["20\u2009%", "40\u2009%", "64\u2009%"]
    assert texts.count("·") == 1


def test_worst_joints_have_shares():
    assert worst_joints(diagnosis().record) == [1]


def test_binned_means_of_a_step():
    g = np.random.default_rng(0)
    x = g.uniform(-1, 1, 20_000)
    y = np.sign(x) + 0.1 * g.standard_normal(20_000)
    centre, mean, half = binned(x, y, np.arange(20_000) // 100)
    outer = np.abs(centre) > 0.1
    assert mean[outer] == pytest.approx(np.sign(centre[outer]), abs=0.03)
    white = 1.96 * 0.1 / np.sqrt(20_000 / 24)
    assert np.median(half[outer]) == pytest.approx(white, rel=0.25)


def test_intervals_of_bins_know_that_samples_of_a_block_are_alike():
    g = np.random.default_rng(0)
    block = np.arange(24_000) // 100
    x, y = g.uniform(-1, 1, 24_000), g.standard_normal(240)[block]
    _, _, half = binned(x, y, block)
    assert np.median(half) == pytest.approx(1.96 / np.sqrt(240), rel=0.4)


def test_samples_are_the_valid_ones():
    made = trace(coulomb, seconds=5.0)
    assert len(samples((made, made), 1)["q"]) == 2 * int(made.valid.sum())
