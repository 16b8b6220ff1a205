import dataclasses

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchid.errors import LogError
from torchid.log.model import Log
from torchid.log.readers import read_log, write_log

from .examples import same, snapshot, uniform


@pytest.fixture
def three() -> Log:
    """Three trajectories of 101, 201 and 51 samples."""
    return Log.concatenate(
        [uniform(samples=s, names=(f"run{s}",), source=f"{s}.csv") for s in (101, 201, 51)]
    )


def test_defaults() -> None:
    log = Log(
        torch.arange(3.0, dtype=torch.float64),
        torch.zeros(3, 2, dtype=torch.float64),
        source="here",
    )
    assert (log.n, log.samples, log.trajectory_count) == (2, 3, 1)
    assert log.trajectory.tolist() == [0, 0, 0]
    assert log.trajectory.dtype == torch.int64
    assert log.t.dtype == log.q.dtype == torch.float64
    assert log.names == ("here",)
    assert log.duration == (2.0,)
    assert list(log.signals) == ["q"]


def test_frozen(three: Log) -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        three.t = three.q  # type: ignore[misc]


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        (
            {"t": torch.zeros(0, dtype=torch.float64), "q": torch.zeros(0, 2, dtype=torch.float64)},
            "at least one",
        ),
        ({"t": torch.zeros(3, 1, dtype=torch.float64)}, "shape"),
        ({"q": torch.zeros(3, 0, dtype=torch.float64)}, "one column a joint"),
        ({"q": torch.zeros(4, 2, dtype=torch.float64)}, "q has another size"),
        ({"dq": torch.zeros(3, 1, dtype=torch.float64)}, "dq has another size"),
        ({"tau": torch.zeros(2, 2, dtype=torch.float64)}, "tau has another size"),
        ({"trajectory": torch.zeros(2, dtype=torch.int64)}, "one trajectory number a sample"),
        ({"trajectory": torch.tensor([1, 1, 1])}, "consecutive runs"),
        ({"trajectory": torch.tensor([0, 2, 2])}, "consecutive runs"),
        ({"trajectory": torch.tensor([0, 1, 0])}, "consecutive runs"),
        ({"names": ("a", "b")}, "one name a trajectory"),
        ({"q": "positions"}, "q must be a table of numbers"),
        ({"q": [[1.0, 2.0], [3.0]]}, "q must be a table of numbers"),
        ({"trajectory": [0.5, 1.0, 1.0]}, "trajectories are numbered"),
    ],
)
@pytest.mark.usefixtures("types_unchecked")
def test_wrong_sizes(fields: dict, text: str) -> None:
    with pytest.raises(LogError) as info:
        Log(
            **(
                {
                    "t": torch.zeros(3, dtype=torch.float64),
                    "q": torch.zeros(3, 2, dtype=torch.float64),
                }
                | fields
            )
        )
    assert text in str(info.value)


def test_trajectories(three: Log) -> None:
    parts = three.trajectories()
    assert [p.samples for p in parts] == [101, 201, 51]
    assert [p.names for p in parts] == [("run101",), ("run201",), ("run51",)]
    assert all((p.trajectory == 0).all() and p.t[0] == 0.0 for p in parts)
    assert three.duration == pytest.approx((1.0, 2.0, 0.5))
    again = Log.concatenate(parts)
    assert same(again, snapshot(three))
    assert again.names == three.names


def test_concatenate_merges_sources_and_warnings() -> None:
    a = uniform(source="a", warnings=("odd", "both"))
    b = uniform(source="b", warnings=("both",))
    log = Log.concatenate([a, b, a])
    assert log.source == "a, b"
    assert log.warnings == ("odd", "both")
    assert log.trajectory_count == 3
    assert Log.concatenate([a]) is a


@pytest.mark.parametrize("name", ["dq", "tau", "current"])
def test_concatenate_refuses_what_only_some_have(name: str) -> None:
    with pytest.raises(LogError, match=f"some logs have {name} and others do not") as info:
        Log.concatenate([uniform(source="with"), uniform(source="without", **{name: None})])
    assert "'with'" in str(info.value)
    assert "'without'" in str(info.value)


def test_concatenate_leaves_partial_ddq_out() -> None:
    log = Log.concatenate([uniform(ddq=None), uniform()])
    assert log.ddq is None
    assert any("ddq" in warning for warning in log.warnings)


def test_concatenate_refuses_other_joint_counts_and_nothing() -> None:
    with pytest.raises(LogError, match="different numbers of joints"):
        Log.concatenate([uniform(2), uniform(3)])
    with pytest.raises(LogError, match="no logs"):
        Log.concatenate([])


def test_with_torque(three: Log) -> None:
    before = snapshot(three)
    gain = torch.tensor([2.0, -3.0], dtype=torch.float64)
    result = three.with_torque(gain)
    assert three.current is not None
    assert torch.equal(result.tau, three.current * gain)
    assert same(three, before)
    with pytest.raises(LogError, match="one drive gain a joint") as info:
        three.with_torque(torch.ones(3, dtype=torch.float64))
    assert (info.value.got, info.value.expected) == ((3,), (2,))
    with pytest.raises(LogError, match="no motor currents") as info:
        three.replace(current=None).with_torque(gain)
    assert info.value.available == ["q", "dq", "ddq", "tau"]


def test_select_drops_empty_trajectories(three: Log) -> None:
    middle_gone = three.select(three.trajectory != 1)
    assert middle_gone.names == ("run101", "run51")
    assert middle_gone.trajectory.unique().tolist() == [0, 1]
    assert three.select(slice(None, None, 2)).samples == 177
    assert three.select(slice(150, 160)).names == ("run201",)


def test_select_refuses_nothing_and_nonsense(three: Log) -> None:
    with pytest.raises(LogError, match="leaves no sample"):
        three.select(three.t < 0)
    with pytest.raises(LogError, match="leaves no sample"):
        three.select(slice(5, 5))
    with pytest.raises(LogError, match="mask with one value a sample"):
        three.select(torch.ones(4, dtype=torch.bool))


@pytest.mark.slow
@given(
    fraction=st.floats(0.1, 0.9),
    gap=st.floats(0.0, 0.2),
    sizes=st.lists(st.integers(400, 600), min_size=1, max_size=3),
)
def test_split_cuts_every_trajectory(fraction: float, gap: float, sizes: list[int]) -> None:
    log = Log.concatenate([uniform(samples=s) for s in sizes])
    first, rest = log.split(fraction, gap)
    assert first.trajectory_count == rest.trajectory_count == len(sizes)
    for whole, a, b in zip(
        log.trajectories(), first.trajectories(), rest.trajectories(), strict=True
    ):
        border = fraction * whole.duration[0]
        assert a.t[0] == whole.t[0]
        assert b.t[-1] == whole.t[-1]
        assert a.t[-1] == pytest.approx(border, abs=0.0101)
        assert b.t[0] == pytest.approx(border + gap, abs=0.0101)
        assert b.t[0] - a.t[-1] > gap


@pytest.mark.parametrize(
    ("fraction", "gap", "text"),
    [
        (0.0, 0.0, "fraction"),
        (1.0, 0.0, "fraction"),
        (float("nan"), 0.0, "fraction"),
        (0.5, -1.0, "gap"),
        (0.5, float("nan"), "gap"),
        (0.5, 0.4, "'run51' is too short"),
        (0.001, 0.0, "too short"),
    ],
)
def test_split_refuses(three: Log, fraction: float, gap: float, text: str) -> None:
    with pytest.raises(LogError, match=text):
        three.split(fraction, gap)


def test_commands_travel_with_a_log(tmp_path):
    """Commanded positions are read, selected, joined and written like any other signal."""
    t = torch.arange(200, dtype=torch.float64) / 50
    u = torch.stack([t.sin(), t.cos()], 1)
    log = Log(t, u - 0.01, u=u, source="a")
    write_log(log, tmp_path / "a.csv")
    again = read_log(tmp_path / "a.csv")
    assert again.u is not None
    assert torch.allclose(again.u, u)
    both = Log.concatenate([again, again]).select(slice(100, 300))
    assert both.u is not None
    assert torch.allclose(both.u, torch.cat([u[100:], u[:100]]))
    with pytest.raises(LogError, match="some logs have u"):
        Log.concatenate([log, log.replace(u=None)])


def test_a_notebook_shows_trajectories_and_ranges(three: Log) -> None:
    assert repr(three).startswith("Log(3 trajectories of ")
    assert repr(three.trajectories()[0]) in three.trajectories()[0]._repr_html_()
    html = three._repr_html_()
    assert all(f"<td>{name}</td>" in html for name in (*three.names, *three.signals))
    assert html.count("<tr>") == 2 + three.trajectory_count + len(three.signals)


def test_frame_is_what_a_file_holds(three: Log) -> None:
    pytest.importorskip("pandas")
    frame = three.to_frame()
    assert same(read_log(frame), [three.t, three.trajectory, *three.signals.values()])


def test_plot_has_a_panel_for_each_joint_and_signal(three: Log) -> None:
    shown = sum(getattr(three, name) is not None for name in ("q", "dq", "tau"))
    figure = three.plot()
    assert len(figure.axes) == three.n * shown
    lines = [line for line in figure.axes[0].lines if len(line.get_xdata()) > 2]
    starts = [line.get_xdata()[0] for line in lines]
    assert len(lines) == three.trajectory_count
    assert starts == sorted(starts)
