import os
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from torchid.errors import LogError, TorchidError
from torchid.log.model import Log
from torchid.log.readers import read_log, write_log

from .examples import same, snapshot, uniform

SUFFIXES = [".parquet", ".csv", ".npz"]
T = np.arange(4) * 0.1


def save(path: Path, columns: dict) -> Path:
    """Write any columns, right or wrong, in the format of the suffix."""
    if path.suffix == ".npz":
        np.savez(path, **columns)
    elif path.suffix == ".parquet":
        pa.parquet.write_table(pa.table(columns), path)
    else:
        rows = [",".join(str(x) for x in row) for row in zip(*columns.values(), strict=True)]
        path.write_text("\n".join([",".join(columns), *rows]) + "\n")
    return path


@pytest.fixture(params=SUFFIXES)
def path(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    return tmp_path / f"run{request.param}"


finite = st.floats(-1e20, 1e20, width=64)


@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), samples=st.integers(2, 5), n=st.integers(1, 12), runs=st.integers(1, 3))
def test_round_trip_is_exact(
    path: Path, data: st.DataObject, samples: int, n: int, runs: int
) -> None:
    def log() -> Log:
        values = {
            k: torch.from_numpy(data.draw(arrays(np.float64, (samples, n), elements=finite)))
            for k in ("q", "tau")
        }
        t = torch.from_numpy(data.draw(arrays(np.float64, (samples,), elements=finite)))
        return Log(t=t, **values)

    written = Log.concatenate([log() for _ in range(runs)])
    write_log(written, path)
    read = read_log(path)
    assert list(read.signals) == ["q", "tau"]
    assert same(read, snapshot(written))
    assert read.names == (("run",) if runs == 1 else tuple(f"run[traj={k}]" for k in range(runs)))
    assert read.source == str(path)


def test_round_trip_of_all_signals(path: Path) -> None:
    written = Log.concatenate([uniform(), uniform(samples=77)])
    before = snapshot(written)
    write_log(written, path)
    assert same(written, before)
    assert same(read_log(path), before)
    assert os.listdir(path.parent) == [path.name]


def test_several_files_are_several_trajectories(tmp_path: Path) -> None:
    paths = [tmp_path / f"run{k}{suffix}" for k, suffix in enumerate(SUFFIXES)]
    for k, path in enumerate(paths):
        write_log(uniform(samples=100 + k), path)
    log = read_log([str(path) for path in paths])
    assert log.names == ("run0", "run1", "run2")
    assert [len(range(*s.indices(999))) for s in log.slices()] == [100, 101, 102]
    assert read_log([paths[0]]).names == ("run0",)


def test_extra_columns_are_ignored(path: Path) -> None:
    columns = {"t": T, "q1": T, "q_ref1": ["a"] * 4, "vir1": T, "Q2": T}
    log = read_log(save(path, columns))
    assert list(log.signals) == ["q"]
    assert log.n == 1
    assert log.warnings == ()


def test_integers_and_float32_become_float64(tmp_path: Path) -> None:
    columns = {"t": np.arange(4), "q1": T.astype(np.float32)}
    for suffix in SUFFIXES:
        log = read_log(save(tmp_path / f"a{suffix}", columns))
        assert log.t.dtype == log.q.dtype == torch.float64


def test_empty_cells_become_nan(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,q1\n0,1\n1,\n2,nan\n3,inf\n")
    save(tmp_path / "a.parquet", {"t": [0, 1], "q1": pa.array([1, None])})
    assert torch.isnan(read_log(tmp_path / "a.csv").q[1:3]).all()
    assert torch.isinf(read_log(tmp_path / "a.csv").q[3]).all()
    assert torch.isnan(read_log(tmp_path / "a.parquet").q[1]).all()


def test_trajectories_by_column(path: Path) -> None:
    columns = {"t": [0, 1, 0, 1], "q1": T, "traj": [7, 7, 3, 3]}
    log = read_log(save(path, columns))
    assert log.trajectory.tolist() == [0, 0, 1, 1]
    assert log.names == ("run[traj=7]", "run[traj=3]")


def test_sorted_by_number_not_by_name(path: Path) -> None:
    columns = {"t": T} | {f"q{k}": T + k for k in (10, 2, 9, 1, 3, 4, 5, 6, 7, 8)}
    log = read_log(save(path, columns))
    assert log.q[0].tolist() == list(range(1, 11))


def test_csv_dialects(tmp_path: Path) -> None:
    texts = {
        "semicolon": "t;q1\n0;1\n1;2\n",
        "tab": "t\tq1\n0\t1\n1\t2\n",
        "spaces": "t, q1\n0, 1\n1, 2\n",
        "quoted": '"t","q1"\r\n0,1\r\n1,2\r\n',
        "bom": "\ufefft,q1\n0,1\n1,2\n",
        "extra twice": "t,x,x,q1\n0,a,,1\n1,b,,2\n",
        "no end": "t,q1\n0,1\n1,2",
        "blank lines": "t,q1\n0,1\n1,2\n\n\n",
    }
    for name, text in texts.items():
        (tmp_path / "a.csv").write_text(text, encoding="utf-8", newline="")
        log = read_log(tmp_path / "a.csv")
        assert log.q.flatten().tolist() == [1, 2], name
        assert log.t.tolist() == [0, 1], name


def test_npz_arrays(tmp_path: Path) -> None:
    signals = {k: np.random.default_rng(0).normal(size=(4, 3)) for k in ("q", "dq", "ddq", "tau")}
    current = signals["q"] + 1
    np.savez(tmp_path / "a.npz", t=T[:, None], current=current, **signals, other=np.array([None]))
    log = read_log(tmp_path / "a.npz")
    for name, values in (signals | {"current": current}).items():
        assert np.array_equal(getattr(log, name).numpy(), values)
    np.savez(tmp_path / "b.npz", t=T, q=T, i=T)
    assert read_log(tmp_path / "b.npz").current is not None


def test_suffix_in_capitals(tmp_path: Path) -> None:
    save(tmp_path / "a.csv", {"t": T, "q1": T}).rename(tmp_path / "a.CSV")
    assert read_log(tmp_path / "a.CSV").n == 1


BAD = {
    "no t": ({"q1": T}, "no column t"),
    "no q": ({"t": T, "tau1": T}, "no column q1"),
    "gap": ({"t": T, "q1": T, "q3": T}, r"has no column q2\."),
    "middle": (
        {"t": T, "q1": T, "q2": T, "q4": T, "tau1": T, "tau2": T, "tau3": T},
        r"has no column q3\.",
    ),
    "from zero": ({"t": T, "q0": T, "q1": T}, "q columns are not numbered q1..q2"),
    "dq count": ({"t": T, "q1": T, "q2": T, "dq1": T}, "2 q columns and 1 dq columns"),
    "tau count": ({"t": T, "q1": T, "tau1": T, "tau2": T}, "1 q columns and 2 tau columns"),
    "text": ({"t": T, "q1": ["a", "b", "c", "d"]}, "column q1 is not numeric"),
    "no rows": ({"t": T[:0], "q1": T[:0]}, "no rows"),
    "one": ({"t": T[:1], "q1": T[:1]}, "one sample only"),
    "traj nan": ({"t": T, "q1": T, "traj": [0, 0, np.nan, 1]}, "column traj is not integer"),
    "traj back": ({"t": T, "q1": T, "traj": [0, 1, 1, 0]}, "trajectory 0 comes back in row 4"),
    "traj single": ({"t": T, "q1": T, "traj": [0, 0, 0, 1]}, "trajectory 1 has one sample only"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_columns(path: Path, case: str) -> None:
    columns, text = BAD[case]
    save(path, columns)
    with pytest.raises(LogError, match=text) as info:
        read_log(path)
    assert str(path) in str(info.value)


def test_numbers_that_turn_up_late(tmp_path: Path) -> None:
    """Whole numbers for megabytes, then a fraction, then a word."""
    path = tmp_path / "a.csv"
    lines = "".join(f"{k},0\n" for k in range(300_000))
    path.write_text(f"t,q1\n{lines}300000,0.5\n")
    assert read_log(path).q[-1].item() == 0.5
    path.write_text(f"t,q1\n{lines}300000,late\n")
    with pytest.raises(LogError, match="column q1 is not numeric") as info:
        read_log(path)
    assert "'late'" in str(info.value)


def test_missing_file_folder_and_suffix(tmp_path: Path) -> None:
    write_log(uniform(), tmp_path / "there.csv")
    with pytest.raises(LogError, match="does not exist") as info:
        read_log(tmp_path / "their.csv")
    assert info.value.available == ["there.csv"]
    with pytest.raises(LogError, match="does not exist"):
        read_log(tmp_path / "nowhere" / "a.csv")
    with pytest.raises(LogError, match="is a folder") as info:
        read_log(tmp_path)
    assert info.value.available == ["there.csv"]
    (tmp_path / "a.xlsx").write_bytes(b"PK")
    with pytest.raises(LogError, match="no reader") as info:
        read_log(tmp_path / "a.xlsx")
    assert info.value.got == ".xlsx"
    assert {".csv", ".npz", ".parquet", ".mat", ".h5", ".bag", ".mcap"} <= set(info.value.available)
    (tmp_path / "bare").write_bytes(b"?")
    with pytest.raises(LogError, match="no reader") as info:
        read_log(tmp_path / "bare")
    assert info.value.got == "no suffix"
    with pytest.raises(LogError, match="no log is given"):
        read_log([])


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_renamed_files(path: Path, suffix: str) -> None:
    if suffix == path.suffix:
        pytest.skip("its own suffix")
    write_log(uniform(), path)
    renamed = path.rename(path.with_suffix(suffix))
    with pytest.raises(LogError, match=f"not a {suffix[1:]} file, though its name says so"):
        read_log(renamed)


def test_pickled_npz_is_never_unpickled(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, t=T, q1=np.array([None, 1, 2, 3], dtype=object))
    with pytest.raises(LogError, match=r"array q1 .*Python objects"):
        read_log(path)


def test_npz_shapes(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    wrong = {
        "array t has the wrong number": {"t": np.zeros((4, 2)), "q": np.zeros((4, 2))},
        "array q has the wrong number": {"t": T, "q": np.zeros((4, 2, 1))},
        "array q1 has the wrong number": {"t": T, "q1": np.float64(3)},
        "gives q1 twice": {"t": T, "q": np.zeros((4, 2)), "q1": T},
        "column q1 has another length": {"t": T, "q": np.zeros((3, 2))},
        "column traj has another length": {"t": T, "q": T, "traj": np.zeros(3, dtype=int)},
        "column q1 is not numeric": {"t": T, "q": T + 1j},
        "no column q1": {"t": T, "q": np.zeros((4, 0))},
    }
    for text, arrays_ in wrong.items():
        np.savez(path, **arrays_)
        with pytest.raises(LogError, match=text):
            read_log(path)


def test_csv_without_header_or_ragged(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("0,1\n1,2\n")
    with pytest.raises(LogError, match="no header line"):
        read_log(path)
    path.write_text("t,q1\n0,1\n1\n")
    with pytest.raises(LogError, match=r"a\.csv"):
        read_log(path)
    path.write_text("t,q1,q1\n0,1,1\n")
    with pytest.raises(LogError, match="two columns q1"):
        read_log(path)


def test_parquet_with_a_column_twice(tmp_path: Path) -> None:
    table = pa.Table.from_arrays([pa.array(T)] * 3, names=["t", "q1", "q1"])
    pa.parquet.write_table(table, tmp_path / "a.parquet")
    with pytest.raises(LogError, match="two columns q1"):
        read_log(tmp_path / "a.parquet")


def test_write_refuses_suffix_and_missing_folder(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="suffix") as info:
        write_log(uniform(), tmp_path / "a.xlsx")
    assert info.value.available == [".csv", ".npz", ".parquet"]
    with pytest.raises(TorchidError, match="no folder"):
        write_log(uniform(), tmp_path / "nowhere" / "a.csv")
